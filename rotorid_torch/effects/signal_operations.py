"""What happens to a record on its way: shifted, lagged, limited in rate, caught in a play; all columns at once.

Records are [..., T, n]; parameters [..., n], one per column, may carry leading dimensions of their own.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core.recursion import followed, linear

SHARPNESS = 8
"""Power of the smooth switches: a rate at its limit is cut to 0.92 of it, one at half the limit by 0.05 %."""
EDGE = 0.02
"""Share of half a play over which its edges are rounded, to either side; within them nothing moves."""
NOTHING = 1e-12
"""Keeps the rounding of no play from being nothing over nothing."""

HELD_S = 2.0
"""s for which a record is held at its ends while a filter of second order rings out."""

SAME = 1e-3
"""Of a sample: by so much no length of a mean differs."""

QUIET_S = 0.1
"""s over which the noise of a record is taken out before a play, whose edges would follow the largest of it."""


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
    first = record[..., :1, :]
    driven = torch.cat([(1.0 - a) * first, (share - a) * before + (1.0 - share) * here], dim=-2)
    return followed(linear, first[..., 0, :], a, driven)


def low_passed(record: Tensor, period: Tensor, damping: Tensor, variance: Tensor, dt: float) -> Tensor:
    """The record behind a second-order filter and a symmetric window, from rest; itself where both are none.

    T² y'' + 2 zeta T y' + y = u with T = `period`, s; then a Gaussian window without phase of this `variance`, s².
    By discrete Fourier transforms of the record held at both ends, so it is exact for what the samples can hold.

    Source: Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed., sec. 8.7 (filtering by transforms).
    """
    samples, first = record.shape[-2], record[..., :1, :]
    held = int(HELD_S / dt) + 1
    back = torch.linspace(0.0, torch.pi, 2 * held, dtype=record.dtype, device=record.device).cos()[:, None]
    # held before and after, and led back to where it began: the transform sees one smooth period
    moved = record - first
    ends = moved[..., -1:, :]
    whole = [torch.zeros_like(ends).expand(*ends.shape[:-2], held, -1), moved, ends * (0.5 + 0.5 * back)]
    period_of_all = torch.cat(whole, dim=-2)
    count = period_of_all.shape[-2]
    omega = 2.0 * torch.pi * torch.fft.rfftfreq(count, dt, dtype=record.dtype, device=record.device)[:, None]
    t, z, v = (each.unsqueeze(-2) for each in (period, damping, variance))
    response = torch.exp(-0.5 * v * omega**2) / torch.complex(1.0 - (t * omega) ** 2, 2.0 * z * t * omega)
    change = torch.fft.irfft((response - 1.0) * torch.fft.rfft(period_of_all, dim=-2), n=count, dim=-2)
    return record + change[..., held : held + samples, :]


def rate_limited(record: Tensor, inverse: Tensor, dt: float) -> Tensor:
    """The record followed no faster than 1/inverse per s; the switch at the limit is smoothed, inverse 0 is no limit.

    y[k] = u[k] - d (1 - g), d = u[k] - y[k-1], g = (1 + (inverse d/dt)^8)^(-1/8).

    Source: Klyde and Mitchell (2004), J. Guidance 27 (rate-limiting elements); the smoothing is ours.
    """
    return followed(slewed, record[..., 0, :], record, (inverse / dt).unsqueeze(-2))


def slewed(y: Tensor, u: Tensor, inverse: Tensor) -> Tensor:
    """One sample of `rate_limited`, with 1/inverse the limit per sample."""
    d = u - y
    speed = (inverse * d).square()
    return u - d * (1.0 - (1.0 + speed.square().square()) ** (-1.0 / SHARPNESS))


def with_play(record: Tensor, width: Tensor, place: Tensor | float = 0.0) -> Tensor:
    """The record passed through a linkage with a play of this width; edges are smoothed.

    place : where the linkage stands in the play at first, from the middle, 0, to the last places where nothing moves,
    -1 and 1. What comes out starts as the record does wherever that is: what trims the vehicle is the linkage.

    y[k] = u[k] - s(d), d = u[k] - y[k-1]: s is d inside the play and half of the play h beyond it, with a parabola from
    one to the other over h (1 - 0.02) to h (1 + 0.02).

    Source: Nordin and Gutman (2002), Automatica 38 (backlash as a hysteresis); the rounding is ours.
    """
    out = 0.5 * (1.0 - EDGE) * width * place
    return followed(pushed, record[..., 0, :] + out, record, width.unsqueeze(-2)) - out.unsqueeze(-2)


def pushed(y: Tensor, u: Tensor, width: Tensor) -> Tensor:
    """One sample of `with_play`: y stays until u is further than the play from it."""
    half, d = 0.5 * width, u - y
    edge = (EDGE * half).clamp(min=NOTHING)
    beyond = (0.5 * (d.abs() - (1.0 - EDGE) * half) / edge).clamp(0.0, 1.0)
    return torch.where(beyond < 1.0, y + d.sign() * edge * beyond.square(), u - d.sign() * half)


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


def half_of(seconds: float, dt: float) -> int:
    """Samples to either side of a centred mean over so many seconds: 2 of 30 ms at 100 Hz, however dt is rounded."""
    return int(0.5 * seconds / dt + 0.5 + SAME)


def averaged(record: Tensor, half: int) -> Tensor:
    """Centred mean over 2 half + 1 samples of a record [..., T], over fewer at its ends."""
    total = torch.cat([torch.zeros_like(record[..., :1]), record.cumsum(-1)], dim=-1)
    place = torch.arange(record.shape[-1])
    first, last = (place - half).clamp(min=0), (place + half + 1).clamp(max=record.shape[-1])
    return (total[..., last] - total[..., first]) / (last - first)


def but_gaps(mean: Callable[[Tensor], Tensor], record: Tensor) -> Tensor:
    """A mean of a record whose gaps are missing: missing where a gap reaches into it."""
    missing = record.isnan()
    return mean(record.nan_to_num(0.0)).masked_fill(mean(missing.to(record.dtype)) > 0.0, torch.nan)
