"""Values that stand for a missing sample (-9999, -1, 0), taken as missing samples on reading.

The record jumps to such a value and back, exactly to the same one each time, and goes on between as if nothing were.
"""

from collections.abc import Mapping

import numpy as np

from rotorid_torch.core import names
from rotorid_torch.core.ranges import Range, of_channel
from rotorid_torch.core.statistics import stretches
from rotorid_torch.data.plausible import FEW
from rotorid_torch.data.reading.read import Arrays

LEAST = 4
"""Stretches at a value, and other samples, from which on a value can be told to be a mark."""
JUMP, QUIET = 25.0, 0.2
"""Times a small change from sample to sample, that of this share, from which on a change may lead to a mark."""
FARTHER = 1.5
"""Times the largest change between other samples, or their whole range, that a mark is away."""
BESIDE = 0.5
"""Share of the way to the mark, which the record may have moved when it comes back."""
NEARLY_ALL = 0.9
"""Share of the stretches at a mark that a record jumps to."""
RARE = 0.2
"""Share of a mark's samples that any other value has at most, where motion often comes near the mark."""
MARKS = 2
"""Different marks of one channel, at most."""


def without_marks(arrays: Arrays, units: Mapping[str, str] | None = None) -> tuple[Arrays, list[str]]:
    """Channels (T,) with marks as NaN, and a sentence on each mark; `units` are those of the controls.

    Controls move by steps and come back: theirs is a mark only where no control can have the value.
    """
    result, marked = dict(arrays), dict[float, dict[str, int]]()
    for channel in arrays:
        allowed = of_channel(channel, (units or {}).get(channel, "")).samples
        for _ in range(MARKS if channel != "time" and names.channel(channel) is not None else 0):
            with np.errstate(over="ignore"):  # what overflows is no motion
                mark = _mark(channel, result[channel], allowed)
            if mark is None:
                break
            at = result[channel] == mark
            result[channel] = np.where(at, np.nan, result[channel])
            marked.setdefault(mark, {})[channel] = int(at.sum())
    return result, [_sentence(mark, counts) for mark, counts in marked.items()]


def mark_of(values: np.ndarray) -> float | None:
    """The value that stands for a missing sample in a record (T,) of somebody's own; None where none does."""
    with np.errstate(over="ignore"):
        return _mark("", values, of_channel("").samples)


def _sentence(mark: float, counts: Mapping[str, int]) -> str:
    most = max(counts.values())
    up_to = "up to " if len({*counts.values()}) > 1 else ""
    reason = "the record jumps there and back"
    taken = f"{up_to}{most} samples taken as missing"
    return f"{' '.join(counts)}: {mark:g} stands for a missing sample ({reason}); {taken}"


def _mark(channel: str, values: np.ndarray, allowed: Range) -> float | None:
    """The value that stands for a missing sample in one channel (T,); None where none does."""
    x = values[np.isfinite(values)]
    moved = _apart(channel, x[1:], x[:-1])
    if not len(moved) or not moved.any():
        return None
    far = np.flatnonzero(moved > JUMP * np.quantile(moved[moved > 0.0], QUIET))
    if not len(far):
        return None
    reached, counts = np.unique(np.concatenate([x[far], x[far + 1]]), return_counts=True)
    candidates = reached[np.argsort(-counts, kind="stable")[:MARKS]]
    return next((float(mark) for mark in candidates if _stands_for_none(channel, x, float(mark), allowed)), None)


def _stands_for_none(channel: str, x: np.ndarray, mark: float, allowed: Range) -> bool:
    """Whether a value is none of the motion in a record (T,) without gaps."""
    at = x == mark
    if allowed.holds(mark):
        return not names.is_control(channel) and _jumped_to(channel, x, at)
    return _beyond_all(x, at, mark)


def _beyond_all(x: np.ndarray, at: np.ndarray, mark: float) -> bool:
    """Whether a value that no such channel has is farther from all others than these are from each other.

    It needs no jump back, for no motion leads there; one stretch may be a sensor that broke, or another unit.
    """
    others = x[~at]
    several = len(list(stretches(at))) >= LEAST <= len(others) and at.mean() > FEW
    return bool(several and np.abs(others - mark).min() > FARTHER * np.ptp(others))


def _jumped_to(channel: str, x: np.ndarray, at: np.ndarray) -> bool:
    """Whether a record (T,) jumps to and from a value that it may also have, at (T,), and goes on as before.

    Motion comes to such a value and goes on from there: only the way there and back tells the two apart.
    """
    ends = np.array([(first, last) for first, last in stretches(at) if first > 0 and last < len(x)])
    if min(len(ends), int((~at).sum())) < LEAST:
        return False
    first, last = ends.T
    moved = _apart(channel, x[1:], x[:-1])
    jump = np.minimum(moved[first - 1], moved[last - 1])
    elsewhere = float(moved[~at[1:] & ~at[:-1]].max(initial=0.0))
    jumps = (jump > FARTHER * elsewhere) & (_apart(channel, x[last], x[first - 1]) < BESIDE * jump)
    if jumps.sum() < LEAST:
        return False
    others = np.unique(x[~at], return_counts=True)[1]
    return bool(jumps.mean() >= NEARLY_ALL or others.max() < RARE * at.sum())


def _apart(channel: str, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Distances (n,) of values, of angles the shorter way round."""
    turned = np.abs(left - right)
    return np.abs((turned + np.pi) % (2.0 * np.pi) - np.pi) if names.unit(channel) == "rad" else turned
