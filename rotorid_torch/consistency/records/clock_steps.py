"""Clocks that jump within a flight: samples of one stream were lost there, and all later ones come too early.

Before and after the jump two streams agree, each at a lag of its own; no one lag makes both agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
import torch

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.imu_place import placed_pairs
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.pairs.odd_flights import disagreement
from rotorid_torch.consistency.records.steps import steps, without_steps
from rotorid_torch.consistency.sensor_pairs import (
    Pair,
    attitude_pairs,
    position_pairs,
)
from rotorid_torch.consistency.smoothing import EVERY_S, WIDTH_S, centred, kernel
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

LONGEST_S, LEAST_S = 3.0, 0.08
"""Largest lag that is looked for, and least change of it that is a jump, s."""
WHOLE = 0.01
"""Share of the motion that one lag may leave, below which nothing is looked for."""
ENDS_S = 1.0
"""s at the ends of a flight, besides the lag, in which no jump is looked for."""
LEFT = 0.45
"""Share of what constant lags leave that two may leave, and of what either lag leaves on the other's side."""
EXPLAINED = 0.3
"""Share of the motion before and after the jump that their lags leave at most."""
SWINGS = 2
"""Times that the motion goes through its mean before and after a jump at least: a bend, as of a landing, has no lag."""
SAMPLES = 20_000
"""Samples of a flight that are compared, at most."""
BEGINS = 4.0
"""Widths of the Gaussian after which smoothed records begin."""
UNSURE_S = 0.8
"""s to either side of a jump in which its stream counts as missing: its time is not known better."""
MOST = 3
"""Jumps of one stream in a flight; what jumps more often has no clock."""


@dataclass(frozen=True)
class ClockStep:
    """A stream of a flight whose lag changes by `seconds` at `at` s from the flight's beginning."""

    flight: str
    channels: tuple[str, ...]
    against: str
    at: float
    seconds: float


class _Jump(NamedTuple):
    at: float
    seconds: float


@once
def clock_steps(dataset: Dataset) -> tuple[ClockStep, ...]:
    """Jumps of the clocks of attitude, velocity and position, in this order, for each is compared with those before."""
    opened = without_steps(dataset, steps(dataset))
    jumps = _all_jumps(opened)
    clocks = alignment(opened).delays if jumps else {}
    late = without_errors(opened, clocks) if clocks else opened
    # a stream that is late all along seems to jump where the motion repeats itself
    return () if clocks and disagreement(late) < disagreement(without_clock_steps(opened, jumps)) else jumps


def _all_jumps(dataset: Dataset) -> tuple[ClockStep, ...]:
    groups = (
        (("phi", "theta", "psi"), "the body rates", attitude_pairs()),
        (("u", "v", "w"), "attitude and IMU", placed_pairs(dataset)),
        (("north", "east", "height"), "velocity and attitude", position_pairs()),
    )
    every = list[ClockStep]()
    for flight in dataset.flights.values():
        mended = flight
        for channels, against, pairs in groups:
            for _ in range(MOST):
                jump = _jump(mended, [pair for pair in pairs if mended.has(*pair.channels)])
                if jump is None:
                    break
                every.append(ClockStep(flight.name, channels, against, jump.at, jump.seconds))
                mended = _mended(mended, every[-1])
    return tuple(every)


def without_clock_steps(dataset: Dataset, steps: Sequence[ClockStep]) -> Dataset:
    """The data set with later samples put back where they were taken; itself where there are no jumps."""
    if not steps:
        return dataset
    return dataset.changed(
        lambda flight: reduce(_mended, (step for step in steps if step.flight == flight.name), flight)
    )


def _mended(flight: Flight, step: ClockStep) -> Flight:
    """One flight with what is recorded from the jump on moved by its seconds; missing where that leaves nothing."""
    by, at = round(step.seconds / flight.dt), round(step.at / flight.dt)
    unsure = round(UNSURE_S / flight.dt)
    moved = dict[str, torch.Tensor]()
    for name in (name for name in step.channels if name in flight.channels):
        values = flight.channels[name]
        shifted = torch.full_like(values, torch.nan)
        count = len(values)
        to, of = (slice(0, count - by), slice(by, count)) if by >= 0 else (slice(-by, count), slice(0, count + by))
        shifted[to] = values[of]
        moved[name] = torch.where(torch.arange(count) < at, values, shifted)
        moved[name][max(at - unsure, 0) : at + max(-by, 0) + unsure] = torch.nan
    return Flight(flight.name, flight.dt, {**flight.channels, **moved})


def _jump(flight: Flight, pairs: Sequence[Pair]) -> _Jump | None:
    """The jump of a stream against what kinematics makes of the others; None where one lag is as good as two."""
    sides = [side for pair in pairs if (side := _sides(flight, pair)) is not None]
    if not sides:
        return None
    every = -(-len(sides[0][0]) // SAMPLES)
    left, right = (np.stack(side)[:, ::every] for side in zip(*sides, strict=True))
    step_s, reach = EVERY_S * every, round(LONGEST_S / (EVERY_S * every))
    power = 0.5 * np.cumsum((left**2 + right**2).sum(axis=0))
    if left.shape[1] < 2 * reach or float(_misfit(left, right, 0).sum()) <= WHOLE * power[-1]:
        return None
    misfits = np.array([_misfit(left, right, lag) for lag in range(-reach, reach + 1)])
    before = np.cumsum(misfits, axis=1)
    after = before[:, -1:] - before
    both = before.min(axis=0) + after.min(axis=0)
    at = int(np.argmin(both))
    first, last = int(np.argmin(before[:, at])), int(np.argmin(after[:, at]))
    explained = before[first, at] < EXPLAINED * power[at] and after[last, at] < EXPLAINED * (power[-1] - power[at])
    clear = explained and both[at] < LEFT * _with_constant_lags(left, right, reach)
    ends = ENDS_S / step_s + max(abs(first - reach), abs(last - reach))  # there a lag leaves nothing to compare
    inside = all(0 < lag < 2 * reach for lag in (first, last)) and ends < at < left.shape[1] - ends
    sure = inside and before[first, at] < LEFT * before[last, at] and after[last, at] < LEFT * after[first, at]
    seconds = (last + _summit(after[:, at], last) - first - _summit(before[:, at], first)) * step_s
    sure = sure and min(_swings(left[:, :at]), _swings(left[:, at:])) >= SWINGS
    if not (clear and sure and abs(seconds) >= LEAST_S) or _drifts(misfits, at, first, last) < both[at]:
        return None
    return _Jump(BEGINS * WIDTH_S + (at + 0.5) * step_s, float(seconds))


def _swings(rows: Array) -> int:
    """Times that the strongest of rows (n, T) goes through its mean."""
    row = rows[int(np.argmax(rows.var(axis=1)))]
    above = row > row.mean()
    return int((above[1:] != above[:-1]).sum())


def _with_constant_lags(left: Array, right: Array, reach: int) -> float:
    """What is left where each channel of a stream has one lag of its own: a barometer is later than a receiver."""
    pairs = zip(left[:, None], right[:, None], strict=True)
    return sum(min(float(_misfit(*pair, lag).sum()) for lag in range(-reach, reach + 1)) for pair in pairs)


def _drifts(misfits: Array, at: int, first: int, last: int) -> float:
    """What a lag leaves that runs along the line through those before and after a jump, from misfits (lags, T)."""
    count = misfits.shape[1]
    places = np.arange(count)
    line = first + (last - first) * (places - 0.5 * at) / (0.5 * count)
    return float(misfits[np.clip(np.round(line).astype(int), 0, len(misfits) - 1), places].sum())


def _sides(flight: Flight, pair: Pair) -> tuple[Array, Array] | None:
    """Both sides (T,) of a pair about their means, every `EVERY_S`, zero where missing; None of a short flight."""
    bell, slope = kernel(flight.dt)
    if flight.samples < 4 * len(bell):
        return None
    towards = pair.right(flight)
    missing = flight.stack(pair.channels).isnan().any(dim=1).numpy() | np.isnan(towards)
    gaps = np.convolve(missing.astype(float), np.ones(len(bell)), "valid") > 0.5
    places = np.arange(0.0, len(gaps) - 1, EVERY_S / flight.dt)
    whole = ~gaps[np.round(places).astype(int)]
    rows = (
        np.convolve(pair.left(flight), slope if pair.differentiate else bell, "valid"),
        np.convolve(np.nan_to_num(towards), bell, "valid"),
    )
    both = np.stack([np.interp(places, np.arange(len(gaps)), row) for row in rows], axis=1)
    left, right = centred(both, whole).T
    return left, right


def _misfit(left: Array, right: Array, lag: int) -> Array:
    """Squares (T,) of left less right so many samples earlier, over the pairs (n, T); of left where right ends."""
    moved, count = np.zeros_like(right), right.shape[1] - abs(lag)
    if lag >= 0:
        moved[:, lag:] = right[:, :count]
    else:
        moved[:, :count] = right[:, -lag:]
    return ((left - moved) ** 2).sum(axis=0)


def _summit(values: Array, best: int) -> float:
    """Where between samples the least of values (n,) is, against the least sample, by a parabola."""
    if not 0 < best < len(values) - 1:
        return 0.0
    below, at, above = values[best - 1 : best + 2]
    bend = below - 2.0 * at + above
    return float(0.5 * (below - above) / bend) if bend > 0.0 else 0.0
