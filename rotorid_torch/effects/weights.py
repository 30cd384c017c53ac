"""Weights of torch modules that an effect holds: they leave the modules and join the effect's parameters.

A module finds them again as slices of the parameter vector while the effect is called, so that one vector is all that
is trained, saved and told.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from weakref import WeakSet

import torch
from torch import Tensor, nn

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.errors import InputError

_TAKEN = WeakSet[nn.Module]()
"""Modules whose weights are parameters of an effect."""


@dataclass(frozen=True, eq=False)
class Weight:
    """One tensor of weights: its name within the effect, the modules that use it, and its shape."""

    name: str
    places: tuple[tuple[nn.Module, str], ...]
    shape: tuple[int, ...]

    @property
    def count(self) -> int:
        """Numbers in it."""
        return math.prod(self.shape)

    def entries(self) -> list[str]:
        """A name for each number, in order: net.0.weight[3,2]; the tensor's where it has only one."""
        places = itertools.product(*(range(n) for n in self.shape))
        return [self.name] if self.count == 1 else [f"{self.name}[{','.join(map(str, place))}]" for place in places]


def taken(effect: nn.Module, who: str, sd: float | Mapping[str, float]) -> tuple[list[Weight], list[Parameter]]:
    """All weights of an effect's modules, out of them, and the parameters that they become.

    who : what messages call the effect. sd : prior's standard deviation about the values drawn, by the beginning of a
    weight's name where several are told.

    Raises InputError: a module's weights would not be trained, or nothing is told of their size.
    """
    refuse_hidden(effect, who)
    effect.double()
    tensors: dict[int, tuple[str, Tensor, list[tuple[nn.Module, str]]]] = {}
    for path, module in effect.named_modules():
        for key, weight in module._parameters.items():
            if weight is not None:
                name = f"{path}.{key}" if path else key
                tensors.setdefault(id(weight), (name, weight, []))[2].append((module, key))
    weights, parameters = [], []
    for name, weight, places in tensors.values():
        _refuse_untrained(weight, name, who)
        one = Weight(name, tuple(places), tuple(weight.shape))
        scale = _scale(name, who, sd)
        values = zip(one.entries(), weight.detach().reshape(-1).tolist(), strict=True)
        parameters += [
            Parameter(entry, value, "1", prior_sd=scale, doc="weight of a network") for entry, value in values
        ]
        weights.append(one)
    for one in weights:
        for module, key in one.places:
            module._parameters[key] = None
            _TAKEN.add(module)
    return weights, parameters


def refuse_foreign(effect: nn.Module, weights: Sequence[Weight], who: str) -> None:
    """Refuse modules whose weights have become parameters of another effect than the one with these weights."""
    mine = {module for weight in weights for module, _ in weight.places}
    for path, module in effect.named_modules():
        if module in _TAKEN and module not in mine:
            wrong = "is of another effect too, or of an earlier one of this class: its weights are there"
            raise InputError(f"effect {who}", path, wrong, "a module that __init__ makes")


def refuse_hidden(effect: nn.Module, who: str) -> None:
    """Refuse modules in plain lists and dicts, which torch does not look into, and compiled ones."""
    for path, module in effect.named_modules():
        if isinstance(module, torch.jit.ScriptModule):
            raise InputError(f"effect {who}", path, "is a script, which keeps its weights", "the module itself")
        for key, held in vars(module).items():
            if not key.startswith("_") and any(isinstance(one, nn.Module | nn.Parameter) for one in _inside(held)):
                wrong = f"is a {type(held).__name__} of modules, whose weights would not be trained"
                name = f"{path}.{key}" if path else key
                raise InputError(f"effect {who}", name, wrong, "nn.ModuleList, nn.ModuleDict or a module")


def _inside(held: Any) -> Sequence[Any]:
    if isinstance(held, Mapping):
        return list(held.values())
    return list(held) if isinstance(held, list | tuple | set) else []


def _refuse_untrained(weight: Tensor, name: str, who: str) -> None:
    if isinstance(weight, nn.parameter.UninitializedParameter):
        raise InputError(f"effect {who}", name, "has no size yet", "a module whose sizes are told where it is made")
    if weight.is_meta:
        raise InputError(f"effect {who}", name, "holds no numbers: it is on the device meta", "weights with numbers")
    if not weight.requires_grad:
        wrong = "requires no gradient, so that it would not be trained"
        raise InputError(f"effect {who}", name, wrong, "requires_grad_(True), or a buffer for what is to stay")


def _scale(name: str, who: str, sd: float | Mapping[str, float]) -> float:
    if isinstance(sd, Mapping):
        fits = [k for k in sd if name == k or name.startswith(f"{k}.")]
        if not fits:
            raise InputError(
                f"effect {who}", "weight_sd", f"says nothing of {name}", f"an entry '{name.split('.')[0]}'"
            )
        sd = sd[max(fits, key=len)]
    return arguments.number(Argument(f"effect {who}", "weight_sd"), sd, f"standard deviation of {name}", above=0.0)


@contextmanager
def lent(weights: Sequence[Weight], vector: Tensor) -> Iterator[None]:
    """Within the block the modules have these numbers [n] for weights."""
    first = 0
    try:
        for one in weights:
            values = vector[first : first + one.count].view(one.shape)
            first += one.count
            for module, key in one.places:
                module._parameters[key] = values  # pyright: ignore[reportArgumentType]
        yield
    finally:
        for one in weights:
            for module, key in one.places:
                module._parameters[key] = None
