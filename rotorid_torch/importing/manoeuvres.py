"""Cut a flight into manoeuvres by what its controls do, and share flights out to identify, validate and acid."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorid_torch.core import names
from rotorid_torch.core.statistics import stretches

SLOW_S, QUICK_S = 4.0, 0.1
"""A control is active where its mean over QUICK_S leaves that over SLOW_S, which is the trim that drifts along."""
ACTIVE = 0.25
"""Share of a control's strongest usual activity (95th percentile over the flight) above which it is active."""
BEFORE_S, AFTER_S = 1.0, 2.0
"""What belongs to a manoeuvre: the trim before it and the response after it."""
SHORTEST_S, LONGEST_S = 3.0, 30.0
"""Shorter ones are left out, longer ones cut."""
MOVED = 0.5
"""Share of a control's largest motion in a flight with which it is moved in another one."""
FOLLOWS = 0.5**0.5
"""Half the power of what a flight moves most, both by their largest motion: a control below that only follows it."""
SHARES = {"identify": 0.6, "validate": 0.2, "acid": 0.2}
"""Shares of the lists, by time."""


@dataclass(frozen=True)
class Manoeuvre:
    """Samples [start, stop) of a flight, and which control (or, for motors, body rate) does most in it."""

    start: int
    stop: int
    kind: str


def cut(arrays: Mapping[str, np.ndarray], dt: float) -> list[Manoeuvre]:
    """Manoeuvres of a flight on a uniform grid, in order and apart from each other; empty where nothing moves.

    arrays : controls and, where known, body rates (T,), NaN where missing.
    dt : s between samples.
    """
    sticks = names.acting(arrays)
    motors = all(names.is_motor(name) or names.is_rotor_speed(name) for name in sticks)
    activities = {name: activity(arrays[name], dt) for name in sticks}
    strongest = {name: float(np.quantile(a, 0.95)) for name, a in activities.items()}
    moving = [name for name in sticks if strongest[name] > 0.0]
    if not moving:
        return []
    active = np.any([activities[name] > ACTIVE * strongest[name] for name in moving], axis=0)
    judges = [name for name in names.RATES if name in arrays] if motors else moving
    judged = {name: activities.get(name, arrays[name] * 0.0) for name in judges}
    judged |= {name: activity(arrays[name], dt) for name in judges if name not in activities}
    size = {name: float(np.quantile(values, 0.95)) or 1.0 for name, values in judged.items()}
    before, after = round(BEFORE_S / dt), round(AFTER_S / dt)
    spans = _merged(stretches(active), before, after, len(active))
    pieces = (part for span in spans for part in _parts(*span, round(LONGEST_S / dt)))
    kinds = {name: values / size[name] for name, values in judged.items()}
    return [Manoeuvre(a, b, _kind(kinds, a, b)) for a, b in pieces if (b - a) * dt >= SHORTEST_S]


def activity(values: np.ndarray, dt: float) -> np.ndarray:
    """How far a control (T,) is from its slow mean, smoothed; a missing sample counts as no activity."""
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros(len(values))
    filled = np.interp(np.arange(len(values)), np.flatnonzero(finite), values[finite])
    return np.abs(_mean(filled, round(QUICK_S / dt)) - _mean(filled, round(SLOW_S / dt)))


def _mean(values: np.ndarray, width: int) -> np.ndarray:
    """Centred mean over 2 (width // 2) + 1 samples, over what there is at the ends."""
    half = width // 2
    total = np.concatenate([[0.0], np.cumsum(values)])
    at = np.arange(len(values))
    low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, len(values))
    return (total[high] - total[low]) / (high - low)


def _merged(runs: Sequence[tuple[int, int]], before: int, after: int, end: int) -> list[tuple[int, int]]:
    """Runs with what belongs to them; those that then touch are one."""
    merged: list[tuple[int, int]] = []
    for a, b in runs:
        a, b = max(0, a - before), min(end, b + after)
        if merged and a <= merged[-1][1]:
            merged[-1] = (merged[-1][0], b)
        else:
            merged.append((a, b))
    return merged


def _parts(start: int, stop: int, longest: int) -> list[tuple[int, int]]:
    """A span in equal parts that are not too long."""
    count = -(-(stop - start) // longest)
    edges = [start + (stop - start) * i // count for i in range(count + 1)]
    return list(pairwise(edges))


def _kind(judged: Mapping[str, np.ndarray], start: int, stop: int) -> str:
    return max(judged, key=lambda name: float((judged[name][start:stop] ** 2).sum())) if judged else ""


def moved(flights: Mapping[str, Mapping[str, np.ndarray]], dt: float) -> dict[str, frozenset[str]]:
    """Which controls (or, for motors, body rates) each of some whole flights (T,) moves, beside the one most moved."""
    sizes: dict[str, dict[str, float]] = {}
    for name, arrays in flights.items():
        sticks = names.acting(arrays)
        motors = all(names.is_motor(n) or names.is_rotor_speed(n) for n in sticks)
        judges = [n for n in names.RATES if n in arrays] if motors else sticks
        sizes[name] = {n: float(np.sqrt(np.mean(activity(arrays[n], dt) ** 2))) for n in judges}
    largest = {n: max(one.get(n, 0.0) for one in sizes.values()) for some in sizes.values() for n in some}
    shares = {name: {n: size / (largest[n] or 1.0) for n, size in some.items()} for name, some in sizes.items()}
    return {
        name: frozenset(n for n, share in some.items() if share >= max(MOVED, FOLLOWS * max(some.values())))
        for name, some in shares.items()
    }


def share_out(flights: Sequence[tuple[str, frozenset[str], float]]) -> dict[str, list[str]]:
    """Lists of the flights given as name, kinds of motion in it and seconds, in order.

    Identify has every kind: the first flight of each. Each further one goes where most is missing of the list's share
    of time, relative to that share, so that three flights of all kinds are one in each list.
    """
    lists: dict[str, list[str]] = {name: [] for name in SHARES}
    total = sum(seconds for *_, seconds in flights) or 1.0
    have, covered, later = dict.fromkeys(SHARES, 0.0), set[str](), []
    for name, kinds, seconds in flights:
        if lists["identify"] and kinds <= covered:
            later.append((name, seconds))
            continue
        covered |= kinds
        lists["identify"].append(name)
        have["identify"] += seconds
    for name, seconds in later:
        place = min(SHARES, key=lambda key: have[key] / (SHARES[key] * total))
        lists[place].append(name)
        have[place] += seconds
    order = [name for name, *_ in flights]
    return {key: sorted(chosen, key=order.index) for key, chosen in lists.items()}
