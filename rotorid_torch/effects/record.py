"""What happens to a record on its way: shifted, lagged, limited in rate, caught in a play; all columns at once.

Records are [..., T, n]; parameters [..., n], one per column, may carry leading dimensions of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

SHARPNESS = 8
"""Power of the smooth switches: a rate at its limit is cut to 0.92 of it, one at half the limit by 0.05 %."""
EDGE = 0.02
"""Share of half a play over which its edges are rounded, to either side; within them nothing moves."""
NOTHING = 1e-12
"""Keeps the rounding of no play from being nothing over nothing."""

QUIET_S = 0.1
"""s over which the noise of a record is taken out before a play, whose edges would follow the largest of it."""
SWEEPS = 12
"""Steps of Newton's method for a whole record, at most."""
SETTLED = 1e-14
"""Change of a followed record, over the largest number in it, that is nothing but rounding."""


def shifted(record: Tensor, delay: Tensor, dt: float) -> Tensor:
    """The record later by a fractional number of samples (delay in s; earlier where negative).

    Cubic (Catmull-Rom) interpolation: exact at whole samples, smooth in the delay between them and continuous with its
    first derivative across them; beyond its ends the record is held.

    Source: Catmull and Rom (1974), Computer Aided Geometric Design.
    """
    samples = record.shape[-2]
    shift = (delay / dt).unsqueeze(-2)
    place = torch.arange(samples, dtype=record.dtype, device=record.device)[:, None] - shift
    whole = torch.floor(place.detach())
    part = place - whole
    start = whole.to(torch.int64)
    shape = (*np.broadcast_shapes(start.shape[:-2], record.shape[:-2]), samples, record.shape[-1])

    def at(offset: int) -> Tensor:
        index = (start + offset).clamp(0, samples - 1)
        return record.expand(shape).gather(-2, index.expand(shape))

    before, here, after, beyond = (at(k) for k in (-1, 0, 1, 2))
    slope, curve = 0.5 * (after - before), before - 2.5 * here + 2.0 * after - 0.5 * beyond
    twist = 1.5 * (here - after) + 0.5 * (beyond - before)
    return here + part * (slope + part * (curve + part * twist))


def lagged(record: Tensor, tau: Tensor, dt: float) -> Tensor:
    """First-order response tau y' = u - y to the record, linear between samples; exact, and the record itself at tau 0.

    Source: Astrom and Wittenmark, Computer-Controlled Systems, sec. 2 (first-order hold).
    """
    tau = tau.unsqueeze(-2)
    a = torch.exp(-dt / tau.clamp(min=dt / 700.0))
    share = tau / dt * (1.0 - a)
    before, here = record[..., :-1, :], record[..., 1:, :]
    driven = (share - a) * before + (1.0 - share) * here
    y = torch.cat([record[..., :1, :].expand(*driven.shape[:-2], 1, driven.shape[-1]), driven], dim=-2)
    return _summed(a.expand_as(y), y)


def rate_limited(record: Tensor, inverse: Tensor, dt: float) -> Tensor:
    """The record followed no faster than 1/inverse per s; the switch at the limit is smoothed, inverse 0 is no limit.

    y[k] = u[k] - d (1 - g), d = u[k] - y[k-1], g = (1 + (inverse d/dt)^8)^(-1/8).

    Source: Klyde and Mitchell (2004), J. Guidance 27 (rate-limiting elements); the smoothing is ours.
    """

    def follow(y: Tensor, u: Tensor, inverse: Tensor) -> tuple[Tensor, Tensor]:
        d = u - y
        speed = (inverse * d / dt).square()
        g = (1.0 + speed.square().square()) ** (-1.0 / SHARPNESS)
        return u - d * (1.0 - g), 1.0 - g ** (SHARPNESS + 1)

    return _followed(record, inverse, follow)


def with_play(record: Tensor, width: Tensor, place: Tensor | float = 0.0) -> Tensor:
    """The record passed through a linkage with a play of this width; edges are smoothed.

    place : where the linkage stands in the play at first, from the middle, 0, to the last places where nothing moves,
    -1 and 1. What comes out starts as the record does wherever that is: what trims the vehicle is the linkage.

    y[k] = u[k] - s(d), d = u[k] - y[k-1]: s is d inside the play and half of the play h beyond it, with a parabola from
    one to the other over h (1 - 0.02) to h (1 + 0.02).

    Source: Nordin and Gutman (2002), Automatica 38 (backlash as a hysteresis); the rounding is ours.
    """

    def follow(y: Tensor, u: Tensor, width: Tensor) -> tuple[Tensor, Tensor]:
        half, d = 0.5 * width, u - y
        edge, far = (EDGE * half).clamp(min=NOTHING), d.abs()
        pushed = (0.5 * (far - (1.0 - EDGE) * half) / edge).clamp(0.0, 1.0)
        left = torch.where(pushed < 1.0, far - edge * pushed.square(), half)
        return u - d.sign() * left, 1.0 - pushed

    out = (0.5 * (1.0 - EDGE) * width * place).unsqueeze(-2)
    record = record + 0.0 * out
    return _followed(torch.cat([record[..., :1, :] + out, record], dim=-2), width, follow)[..., 1:, :] - out


def with_play_behind_noise(record: Tensor, width: Tensor, dt: float, place: Tensor | float = 0.0) -> Tensor:
    """The record with what a play of this width changes of it: that of the record without most of its noise.

    Noise of the recording moves no linkage. A play that followed it would be pushed by the largest of it, to both
    sides, and act as if it were narrower by three or four of its standard deviations. What is left where the record is
    smoothed over several samples is small; motion faster than some 4 Hz is taken for noise too.
    """
    quiet = smoothed(record, 2 * int(0.5 * QUIET_S / dt + 1e-6) + 1)
    return record + (with_play(quiet, width, place) - quiet)


def smoothed(record: Tensor, width: int) -> Tensor:
    """The record by a Hann window of so many samples, held at its ends."""
    kernel = torch.hann_window(width + 2, periodic=False, dtype=record.dtype, device=record.device)[1:-1]
    rows = record.movedim(-2, -1)
    before, after = width // 2, width - 1 - width // 2
    held = [rows[..., :1].expand(*rows.shape[:-1], before), rows, rows[..., -1:].expand(*rows.shape[:-1], after)]
    return (torch.cat(held, dim=-1).unfold(-1, width, 1) @ (kernel / kernel.sum())).movedim(-1, -2)


Follow = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""y[k] by y[k-1], u[k] and the parameter, and its derivative by y[k-1]."""


def _followed(record: Tensor, parameter: Tensor, follow: Follow) -> Tensor:
    """y[k] = follow(y[k-1], u[k], parameter) from y[0] = u[0].

    All samples at once, by Newton's method on the whole record; the last step, from where the record is already
    followed, gives exact first derivatives.
    """
    found = _Followed.apply(record, parameter, follow)
    return _newton(found, record, parameter.unsqueeze(-2), follow)


def _newton(y: Tensor, record: Tensor, parameter: Tensor, follow: Follow) -> Tensor:
    """The record followed with every sample's step linear about y."""
    first, here, before = record[..., :1, :] + 0.0 * parameter, record[..., 1:, :], y[..., :-1, :]
    after, slope = follow(before, here, parameter)
    slope = slope.detach()
    factor = torch.cat([torch.zeros_like(first), slope], dim=-2)
    return _summed(factor, torch.cat([first, after - slope * before], dim=-2))


class _Followed(torch.autograd.Function):
    """The record as it is followed, a constant for all derivatives."""

    @staticmethod
    def forward(record: Tensor, parameter: Tensor, follow: Follow) -> Tensor:
        y = record + 0.0 * parameter.unsqueeze(-2)
        for _ in range(SWEEPS):
            y, before = _newton(y, record, parameter.unsqueeze(-2), follow), y
            if bool(((y - before).abs() <= SETTLED * record.abs().amax()).all()):
                return y
        rows = [y[..., 0, :]]  # a record that turns round again and again at its limit: one sample after the other
        for u in record.unbind(-2)[1:]:
            rows.append(follow(rows[-1], u, parameter)[0])
        return torch.stack(rows, dim=-2)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        ctx.mark_non_differentiable(output)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[None, None, None]:
        return None, None, None

    @staticmethod
    def jvp(ctx: Any, *tangents: Tensor | None) -> None:
        return None

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *args: Any) -> tuple[Tensor, int | None]:
        """The batch is one more leading dimension."""
        record, parameter, follow = args
        if in_dims[:2] == (None, None):
            return _Followed.apply(record, parameter, follow), None
        lead = max(record.dim() - 2 - (in_dims[0] is not None), parameter.dim() - 1 - (in_dims[1] is not None))
        return _Followed.apply(_front(record, in_dims[0], lead + 2), _front(parameter, in_dims[1], lead + 1), follow), 0


def _front(value: Tensor, batch: int | None, own: int) -> Tensor:
    """A value with its batch before `own` other dimensions."""
    if batch is None:
        return value
    value = value.movedim(batch, 0)
    return value.reshape(value.shape[0], *[1] * (own + 1 - value.dim()), *value.shape[1:])


def _summed(factor: Tensor, driven: Tensor) -> Tensor:
    """y[k] = factor[k] y[k-1] + driven[k] from y[0] = driven[0], by doubling: few passes over the whole record.

    Source: Hillis and Steele (1986), Communications of the ACM 29.
    """
    y, reach = driven, 1
    while reach < y.shape[-2]:
        y = torch.cat([y[..., :reach, :], y[..., reach:, :] + factor[..., reach:, :] * y[..., :-reach, :]], dim=-2)
        factor = torch.cat([factor[..., :reach, :], factor[..., reach:, :] * factor[..., :-reach, :]], dim=-2)
        reach *= 2
    return y
