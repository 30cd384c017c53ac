"""What goes through a record sample by sample, y[k] = step(y[k-1], u[k]), with exact derivatives.

The step is written once, in torch, for all samples alike. Native code runs it where it can be compiled; torch, one
sample after the other, where it cannot.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from rotorid_torch.core.native.build import compiled_or_none
from rotorid_torch.core.native.recurrences import CompiledRecursion, Step


def followed(step: Step, start: Tensor, *inputs: Tensor) -> Tensor:
    """y[k] = step(y[k-1], *inputs at k), from y[-1] = start; [..., T, n].

    First derivatives are exact, forward and in reverse: dy[k] = a[k] dy[k-1] + b[k] du[k], with a and b the derivatives
    of the step; they are recursions of the same kind.

    step : torch function of y[k-1] and of each input at k, entry by entry, without branches on values; a function of a
        module, not one made for the call, is compiled once.
    start : [..., n]. inputs : [..., T, n], or [..., 1, n] for what is the same at all samples; dimensions broadcast.
    """
    return _Followed.apply(step, start, *inputs)[0]


def linear(y: Tensor, factor: Tensor, driven: Tensor) -> Tensor:
    """Step of a first-order linear recursion, factor y[k-1] + driven."""
    return factor * y + driven


class _Followed(torch.autograd.Function):
    """The outputs and the slopes of all steps; the outputs alone have derivatives."""

    @staticmethod
    def forward(step: Step, start: Tensor, *inputs: Tensor) -> tuple[Tensor, ...]:
        run = lambda: CompiledRecursion.of(step, len(inputs)).run(start, inputs)  # noqa: E731
        native = compiled_or_none(run, "records are followed in torch, sample by sample", start, *inputs)
        return reference(step, start, inputs) if native is None else native

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(*output)
        ctx.save_for_forward(*output)
        ctx.shapes = [value.shape for value in inputs[1:]]

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        """By the adjoint l[k] = g[k] + a[k+1] l[k+1], a recursion that runs backwards."""
        _, by_last, *slopes = ctx.saved_tensors
        after = torch.cat([by_last[..., 1:, :], torch.zeros_like(by_last[..., :1, :])], dim=-2)
        grad = grad_outputs[0]
        adjoint = followed(linear, torch.zeros_like(grad[..., 0, :]), after.flip(-2), grad.flip(-2)).flip(-2)
        gradients = [by_last[..., 0, :] * adjoint[..., 0, :], *(slope * adjoint for slope in slopes)]
        return None, *(value.sum_to_size(shape) for value, shape in zip(gradients, ctx.shapes, strict=True))

    @staticmethod
    def jvp(ctx: Any, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        y, by_last, *slopes = ctx.saved_tensors
        _, start, *inputs = tangents
        driven = torch.zeros_like(y)
        for slope, tangent in zip(slopes, inputs, strict=True):
            driven = driven if tangent is None else driven + slope * tangent
        first = torch.zeros_like(driven[..., 0, :]) if start is None else start
        return followed(linear, first, by_last, driven), *([None] * (1 + len(slopes)))

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *args: Any) -> tuple[tuple[Tensor, ...], Any]:
        """The batch is one more leading dimension."""
        step, start, *inputs = args
        each = [*zip((start, *inputs), in_dims[1:], (1, *([2] * len(inputs))), strict=True)]
        lead = max(v.dim() - (d is not None) - n for v, d, n in each)
        moved = [v if d is None else _front(v, d, lead + n) for v, d, n in each]
        return _Followed.apply(step, *moved), tuple([0] * (2 + len(inputs)))


def reference(step: Step, start: Tensor, inputs: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """What native code does, by torch alone: the outputs, and the slopes of the steps by y[k-1] and each input."""
    samples = max(u.shape[-2] for u in inputs)
    each = [u.expand(*u.shape[:-2], samples, u.shape[-1]) for u in inputs]
    rows = [start]
    for now in zip(*(u.unbind(-2) for u in each), strict=True):
        rows.append(step(rows[-1], *now))
    shape = rows[-1].shape
    rows = [row.expand(shape) for row in rows]
    before = torch.stack(rows[:-1], dim=-2)
    y, slopes, *_ = torch.func.vjp(step, before, *(u.expand(before.shape) for u in each))
    return torch.stack(rows[1:], dim=-2), *slopes(torch.ones_like(y))


def _front(value: Tensor, batch: int, trailing: int) -> Tensor:
    """A value with its batch before `trailing` other dimensions."""
    value = value.movedim(batch, 0)
    return value.reshape(value.shape[0], *[1] * (trailing + 1 - value.dim()), *value.shape[1:])
