"""Sensors against each other: clocks, scales, biases; sticks against the rates that they command."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from rotorid_torch.data import consistency
from rotorid_torch.data.consistency import Agreement, Pair, agreement
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.finding import Finding, Severity, finding

Group = tuple[str, str, Callable[[Dataset], tuple[Pair, ...]]]

GROUPS: tuple[Group, ...] = (
    ("attitude", "the body rates", lambda _: consistency.attitude_pairs()),
    ("velocity", "attitude, rates and specific force", consistency.velocity_pairs),
    ("position", "velocity", lambda _: consistency.position_pairs()),
)
BIAS = {"rad/s": 0.004, "m/s²": 0.15, "m/s": 0.15}
"""Constant difference that is worth a word."""


def kinematics(dataset: Dataset) -> Iterator[Finding]:
    """Attitude against rates, velocity against specific force, position against velocity."""
    flights = dataset.flights.values()
    lags: dict[str, list[Agreement]] = {}
    for left, right, pairs in GROUPS:
        results = [a for pair in pairs(dataset) if (a := agreement(pair, flights)) is not None]
        seen = [a for a in results if a.r2 > 0.6]
        lags[left] = [a for a in seen if _off(a)]
        if lags[left]:
            yield _late(left, right, lags)
        elif seen:
            told = ", ".join(f"{a.pair.left_name} {a.lag_s:+.3f} s" for a in seen)
            yield finding("good", _channels(seen), f"{left} keeps time with {right} ({told}).")
        for result in seen:
            yield from _drift(result)
        for result in results:
            if result.pair.exact:
                yield from _scale_and_bias(result, dataset)


def _off(a: Agreement) -> bool:
    return abs(a.lag_s) > max(4.0 * a.lag_se, 0.008 if a.pair.exact else 0.06)


def _channels(results: Sequence[Agreement]) -> str:
    return " ".join(a.pair.left_name for a in results)


def _late(left: str, right: str, lags: dict[str, list[Agreement]]) -> Finding:
    late = lags[left]
    told = ", ".join(f"{a.pair.left_name} {abs(a.lag_s):.3f} s {'late' if a.lag_s > 0 else 'early'}" for a in late)
    grave: Severity = "warning" if max(abs(a.lag_s) for a in late) >= 0.02 else "note"
    cause = ""
    if left == "velocity" and any(a.lag_s > 0.02 for a in lags["attitude"]) and sum(a.lag_s for a in late) < 0:
        cause = "Both comparisons say it: the attitude is late."
    early = sum(a.lag_s for a in late) < 0
    who = f"{right} late, or {left} early" if early else f"{left} late, or {right} early"
    advice = f"A clock or a filter is off ({who}): shift the streams onto one clock, or let sensors.delay be estimated."
    return finding(grave, _channels(late), f"{left} against {right}: {told}.", *([cause] if cause else []), advice)


def _drift(a: Agreement) -> Iterator[Finding]:
    """Lags that differ between flights by more than their errors."""
    if len(a.lags_s) < 2:
        return
    (first, first_se), (last, last_se) = min(a.lags_s.values()), max(a.lags_s.values())
    if last - first > max(0.06, 6.0 * (first_se + last_se)):
        told = f"against {a.pair.right_name} the lag runs from {first:+.3f} to {last:+.3f} s from flight to flight:"
        yield finding("warning", a.pair.left_name, told, "the clocks drift, and one common delay cannot repair it.")


def _scale_and_bias(a: Agreement, dataset: Dataset) -> Iterator[Finding]:
    left, right, (low, high) = a.pair.left_name, a.pair.right_name, a.scale
    if a.r2 > 0.9 and (low > 1.04 or high < 0.96):
        told = f"the rate of {left} is {(low + high) / 2:.3f} times what {right} says by kinematics:"
        cause = "a scale factor or unit of one of the two is off. Calibrate, or let sensors.scale be estimated."
        yield finding("warning", left, told, cause)
    threshold = BIAS[a.pair.unit]
    if abs(a.bias) > max(threshold, 4.0 * a.bias_se):
        sensor = left if a.pair.unit == "m/s" else right
        free = dataset.bias(sensor) == "free"
        use = "is estimated per flight" if free else 'is estimated only where bias = "free" is declared'
        told = f"kinematics of {left} want {a.bias:+.3g} {a.pair.unit} on {right}: a sensor bias, which {use}."
        yield finding("warning" if abs(a.bias) > 3.0 * threshold else "note", sensor, told)
    if a.r2 < 0.3:
        told = f"too little motion, or too much noise, to compare {left} with {right} (R² {a.r2:.2f})."
        yield finding("note", left, told)


def sticks(dataset: Dataset) -> Iterator[Finding]:
    """Sticks that are stamped after the rates that they command, and delays that differ between flights."""
    flights = dataset.flights.values()
    for pair in consistency.stick_pairs(dataset):
        a = agreement(pair, flights)
        if a is None or a.r2 < 0.6:
            continue
        yield from _drift(a)
        if a.r2 > 0.7 and a.lag_s < -max(4.0 * a.lag_se, 0.02):
            told = f"the stick {pair.right_name} is stamped {-a.lag_s:.2f} s late against {pair.left_name}:"
            advice = "Shift the sticks earlier, or expect every delay at its bound of zero."
            reason = "the response seems to come first, which no aircraft does."
            yield finding("warning", pair.right_name, told, reason, advice)
