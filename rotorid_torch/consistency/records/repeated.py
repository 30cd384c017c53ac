"""What repeats, is cut off, or stands alone in one record."""

from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.records.slow import SLOWEST as SLOWEST_HZ
from rotorid_torch.core.statistics import stretches
from rotorid_torch.data.reading.noise import white_noise
from rotorid_torch.data.reading.spikes import LONGEST, LONGEST_S, running_median

LIVE = 4
"""Channels that must repeat at once to be no chance."""
CLIPPED = 4
"""Samples in a row at a channel's own largest or least value that make a limit."""
STEPS = 2.5
"""Least differences of a record by which one that is stored in steps, and moves slowly, comes to its largest value."""
ALONE = 15.0
"""A sample this many times farther from its neighbours than half of them are stands alone."""
OUTLIERS = 0.7
"""The same as a share of the channel's whole range in the flight."""
FEW_VALUES = 0.1
"""Different values over samples, up to which a record is stored in steps."""
BESIDE = 0.2
"""Share of the distance of a sample that stands alone, which its neighbours are away at most."""
LEAST_VALUES = 4
"""Values that a command may have, which is no record stored in steps; a doublet has three."""
NEXT = 0.9
"""Share of changes that lead to the next value, or come after the usual time, in a record of steps."""
DITHER = 0.5
"""White noise over a step, from which on rounding is one more white noise."""
LEAST_CHANGES = 20
"""Changes of a record whose rhythm can be told."""
ROUNDING = 1e-6
"""Change of slope over a record's range, up to which a line is straight."""
STRAIGHT = 0.3
"""Share of a record on straight lines, from which on it is drawn: every third sample, where each third one was read."""
SLOWEST = 0.25
"""s: longest time for which a recorder holds a value; what stays longer is the command itself."""


@dataclass(frozen=True, eq=False)
class Samples:
    """What repeats in one channel of one flight.

    Share of samples that repeat the one before, longest stretch without a change in s, longest run of samples at the
    largest or least value where nothing else repeats so long, places (n,) of samples that stand alone, how often a
    second the value changes, least step between values where these are few and noise does not carry the record over
    several (else 0), the time for which each value is held where all are held alike (else 0), and that for which
    straight lines go on where all last alike (else 0).
    """

    repeated: float
    longest_s: float
    at_edge: int
    alone: np.ndarray
    renewed_hz: float
    step: float = 0.0
    held_s: float = 0.0
    drawn_s: float = 0.0


def examine(values: np.ndarray, dt: float) -> Samples:
    """Figures of one record (T,), see `Samples`."""
    at = np.flatnonzero(np.isfinite(values))
    x = values[at]
    if len(x) < 16 or np.ptp(x) == 0.0:
        return Samples(1.0, len(x) * dt, 0, np.empty(0, int), 0.0)
    same = np.diff(x) == 0.0
    edges = (x == x.max()) | (x == x.min())
    # what repeats elsewhere is no limit
    usual = max((last - first for first, last in stretches(same & ~edges[1:])), default=0)
    rests = (x == 0.0) & (x.min() == 0.0)  # rotors that do not turn, a pitot without wind
    edge = max(_beyond_steps(x, x == x.max()), _beyond_steps(x, (x == x.min()) & ~rests))
    edge = edge if edge > 2 * (usual + 1) else 0
    changes = int((~same).sum())
    inside = same & ~(edges[1:] if edge >= CLIPPED else rests[1:])  # what is cut off by its range is not frozen
    levels = np.unique(x)
    places = np.flatnonzero(~same)
    return Samples(
        repeated=float(same.mean()),
        longest_s=_beyond_steps(x, inside) * dt,
        at_edge=edge,
        alone=at[_alone(x, dt)] if np.median(np.diff(at)) * dt < 1.0 / SLOWEST_HZ else at[:0],
        renewed_hz=changes / (len(x) * dt),
        step=_step(x, levels),
        held_s=held if len(levels) > LEAST_VALUES and (held := _held(places) * dt) <= SLOWEST else 0.0,
        drawn_s=drawn if (drawn := _drawn(x) * dt) <= SLOWEST else 0.0,
    )


def _beyond_steps(x: np.ndarray, true: np.ndarray) -> int:
    """Longest run that is entered or left by more than the record's least steps: else it is resolution.

    `true` is of each sample, or of each change between two.
    """
    moved = np.abs(np.diff(x))
    least = STEPS * float(moved[moved > 0.0].min())
    after = len(true) - len(moved)  # a run of samples is left by the change before its end
    beyond = [
        b - a
        for a, b in stretches(true)
        if max(moved[a - 1] if a else 0.0, moved[b - after] if b - after < len(moved) else 0.0) > least
    ]
    return int(max(beyond, default=0))


def _alone(x: np.ndarray, dt: float) -> np.ndarray:
    """Places of samples far from the median of their neighbours, by their usual distance and by the record's range.

    What comes and goes over several samples is motion: those next to a sample that stands alone are where they were.
    """
    jumps = np.abs(np.diff(x))
    if jumps.max() < 0.5 * OUTLIERS * np.ptp(x):
        return np.empty(0, int)
    middle = running_median(x, min(LONGEST, max(1, round(LONGEST_S / dt))))
    away, moved = np.abs(x - middle), np.abs(x - running_median(x, LONGEST))
    usual = float(np.median(away[away > 0.0])) if (away > 0.0).any() else 0.0
    far = away > max(ALONE * usual, OUTLIERS * float(np.ptp(middle)))
    places = [np.empty(0, int)]
    for first, last in stretches(far):
        next_to = [moved[k] for k in (first - 1, last) if 0 <= k < len(x)]
        if max(next_to, default=0.0) < BESIDE * away[first:last].max():
            places.append(np.arange(first, last))
    return np.concatenate(places)


def _step(x: np.ndarray, levels: np.ndarray) -> float:
    """Least step between the values of a record that is stored in steps; 0 where it is not, or where noise hides them.

    Noise of half a step carries a record over several of them: rounding then adds a white error of a twelfth of the
    step squared to a quarter of it, and no more. Values that are left for others than the next are commands.

    Source: Widrow and Kollar, Quantization Noise (2008), ch. 4 and 19.
    """
    if not 1 < len(levels) < FEW_VALUES * len(x):
        return 0.0
    step = float(np.median(np.diff(levels)))
    moved = np.abs(np.diff(x))
    moved = moved[moved > 0.0]
    stepped = len(moved) > len(levels) > LEAST_VALUES and float(np.mean(moved < 1.5 * step)) > NEXT
    return step if stepped and not white_noise([x]) > DITHER * step else 0.0


def _drawn(x: np.ndarray) -> int:
    """Samples for which straight lines through a record go on; 0 where it is not drawn between fewer samples."""
    bent = np.abs(np.diff(x, 2)) > ROUNDING * np.ptp(x)
    moving = bent | (np.diff(x)[1:] != 0.0)  # a command that rests is no line
    if bent[moving].mean() > 1.0 - STRAIGHT:
        return 0
    return _held(np.array([first for first, _ in stretches(bent)]))


def _held(places: np.ndarray) -> int:
    """Samples for which each value of a record is held, from the places where it changes; 0 where these are not alike.

    A value that stays the same for once makes an interval of several.
    """
    if len(places) < LEAST_CHANGES:
        return 0
    apart = np.diff(places)
    usual = int(np.median(apart))
    turns = np.round(apart / usual)
    alike = (turns > 0) & (np.abs(apart - turns * usual) <= 1)
    return usual if usual > 2 and float(alike.mean()) > NEXT and float((turns == 1).mean()) > 0.5 else 0
