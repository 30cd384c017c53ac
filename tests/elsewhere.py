"""A device that every machine has: tensors that refuse to meet those of the processor, as a GPU's do.

They hold their numbers in ordinary tensors, so that data-dependent code runs too. What is not checked: kernels that
a GPU lacks, but for the one that is known (least squares by singular values).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

MADE = {
    *(torch.tensor, torch.as_tensor, torch.zeros, torch.ones, torch.empty, torch.full, torch.eye, torch.arange),
    *(torch.linspace, torch.randn, torch.rand),
}
"""What a default device rules."""
ATEN = torch.ops.aten


class Elsewhere(Tensor):
    """A tensor on that device; its device is told as "meta"."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> Elsewhere:
        """Around the tensor that holds its numbers."""
        made = torch.Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=torch.device("meta"),
        )
        made.held = held
        return made

    def tolist(self) -> Any:
        """The numbers, which torch itself reads from memory."""
        return self.held.tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run on what is held, and refuse two devices."""
        kwargs = dict(kwargs or {})
        target = kwargs.pop("device", None)
        if func is ATEN._to_copy.default and target is not None and torch.device(target).type == "cpu":
            return args[0].held.clone()
        _refuse(func, args, kwargs)
        result = func(*tree_map(held, args), **tree_map(held, kwargs))
        if func._schema.is_mutable:  # a tensor that was changed is itself, not another one around the same numbers
            return kwargs.get("out", args[0])
        return tree_map(there, result)


def _refuse(func: Any, args: Any, kwargs: Any) -> None:
    given = [a for a in tree_flatten((args, kwargs))[0] if isinstance(a, Tensor)]
    strange = [a for a in given if not isinstance(a, Elsewhere) and a.dim() > 0]
    if func in (
        ATEN.index.Tensor,
        ATEN.index_put.default,
        ATEN.index_put_.default,
    ):  # a GPU takes the processor's places
        strange = [a for a in strange if a is args[0]]
    if strange:
        raise RuntimeError(f"{func}: expected all tensors to be on one device; {tuple(strange[0].shape)} is on the CPU")
    if func is ATEN.linalg_lstsq.default and kwargs.get("driver") not in (None, "gels"):
        raise RuntimeError("torch.linalg.lstsq: on a GPU the driver can only be gels")


def there(value: Any) -> Any:
    """On that device."""
    return Elsewhere(value.resolve_conj()) if isinstance(value, Tensor) and not isinstance(value, Elsewhere) else value


def held(value: Any) -> Any:
    """The numbers."""
    return value.held if isinstance(value, Elsewhere) else value


class MadeInside(TorchDispatchMode):
    """What torch's own functions make there."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Tensors of the device from the processor's."""
        kwargs = dict(kwargs or {})
        if any(isinstance(a, Elsewhere) for a in tree_flatten((args, kwargs))[0]):
            return Elsewhere.__torch_dispatch__(func, types, args, kwargs)
        if kwargs.get("device") == torch.device("meta"):  # a copy to there is made of a copy here
            return there(func(*args, **(kwargs | {"device": "cpu"})))
        return func(*args, **kwargs)


class MadeElsewhere(TorchFunctionMode):
    """As `with torch.device(...)`: what names no device is made there."""

    def __enter__(self) -> MadeElsewhere:
        """From here on."""
        self.inside = MadeInside()
        self.inside.__enter__()
        return super().__enter__()

    def __exit__(self, *error: Any) -> None:
        """No longer."""
        super().__exit__(*error)
        self.inside.__exit__(*error)

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Make on the processor, and take it there."""
        kwargs = dict(kwargs or {})
        if func not in MADE or torch.device(kwargs.get("device") or "meta").type == "cpu":
            return func(*args, **kwargs)
        if kwargs.get("generator") is not None:
            raise RuntimeError("expected a generator of the device")
        if func in (torch.tensor, torch.as_tensor) and isinstance(args[0], Tensor):
            return args[0].to(kwargs.get("dtype", args[0].dtype)).to("meta")
        return func(*args, **(kwargs | {"device": "cpu"})).to("meta")


def one_by_one(function: Any) -> Any:
    """`torch.func.vmap` as a loop: its own tensors and these do not nest."""

    def mapped(items: Tensor) -> Any:
        results = [function(item) for item in items.unbind(0)]
        if isinstance(results[0], Tensor):
            return torch.stack(results)
        return tuple(torch.stack(parts) for parts in zip(*results, strict=True))

    return mapped


def forward(function: Any, inputs: Any, tangents: Any) -> Any:
    """`torch.func.jvp` by two backward passes."""
    with torch.enable_grad():
        return torch.autograd.functional.jvp(function, inputs, tangents)


def backward(function: Any, *inputs: Tensor) -> Any:
    """`torch.func.vjp` by one."""
    with torch.enable_grad():
        leaves = [a.detach().requires_grad_() for a in inputs]
        value = function(*leaves)

    def pull(seed: Tensor) -> Any:
        if not value.requires_grad:
            return tuple(torch.zeros_like(a) for a in inputs)
        return torch.autograd.grad(value, leaves, seed, retain_graph=True, allow_unused=True, materialize_grads=True)

    return value.detach(), pull
