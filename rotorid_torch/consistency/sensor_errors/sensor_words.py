"""Verdicts on sensors in plain words."""

from collections.abc import Mapping, Sequence

import numpy as np

from rotorid_torch.consistency.equations import usable
from rotorid_torch.consistency.sensor_errors.sensor_finding import SensorParameter
from rotorid_torch.core import names
from rotorid_torch.core.names import Verdict
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.families.sensors import DAMPED, PERIOD, SMOOTHED


def unit(kind: str, member: str) -> str:
    """Unit of a sensor error."""
    if kind == "filter" and member.endswith((DAMPED, SMOOTHED)):
        return "1" if member.endswith(DAMPED) else "s²"
    fixed = {"delay": "s", "filter": "s", "scale": "1", "misalignment": "rad", "lever_arm": "m"}
    return fixed.get(kind) or names.unit(member)


def size_words(parameter: SensorParameter, others: Sequence[SensorParameter] = ()) -> str:
    """One error with its value and standard error; a filter's frequency with the damping among the others."""
    _, kind, member = parameter.name.split(".")
    value, se = parameter.value, parameter.se
    if member.endswith(PERIOD):
        return _second_order(parameter, others)
    if member.endswith(SMOOTHED):
        where = f"{member.removesuffix(SMOOTHED)} smoothed without phase (a symmetric window, after the flight)"
        return f"{where}: half power at {half_power_hz(value):.2g} Hz" if value > 0.0 else f"{where}: none"
    return {
        "delay": f"{member} {abs(value) * 1e3:.0f} ms {'late' if value > 0 else 'early'} (± {se * 1e3:.1f})",
        "filter": f"{member} through a lag of {value * 1e3:.0f} ms (± {se * 1e3:.1f})",
        "scale": f"{member} reads {100 * value:+.2f} % (± {100 * se:.2f})",
        "misalignment": f"IMU turned about {member} by {np.degrees(value):.2f}° (± {np.degrees(se):.2f})",
        "lever_arm": f"IMU {value:+.3f} m along {member} (± {se:.3f})",
        "bias": f"{member} off by {value:+.3g} {parameter.unit} (± {se:.1g})",
    }[kind]


def _second_order(period: SensorParameter, others: Sequence[SensorParameter]) -> str:
    """A filter of second order: a natural frequency needs a value of the period."""
    unit = period.name.removesuffix(PERIOD)
    damping = next((p for p in others if p.name == f"{unit}{DAMPED}"), None)
    said = f"{unit.split('.')[2]} through a filter of second order"
    if period.value <= 0.0:
        return f"{said}: none"
    omega = 1.0 / period.value
    said += f", natural frequency {omega:.3g} rad/s (± {omega**2 * period.se:.2g})"
    return f"{said}, damping {damping.value:.2f} (± {damping.se:.2g})" if damping else said


def half_power_hz(variance: float) -> float:
    """Frequency in Hz at which a Gaussian window of this variance, s², leaves half of the power."""
    return float(np.sqrt(np.log(2.0) / variance) / (2.0 * np.pi))


def alternative(name: str, value: float) -> str:
    """Another error of the same effect that could be the cause, with its value."""
    kind, _, member = name.partition(".")
    if member.endswith(PERIOD):
        return f"{member.removesuffix(PERIOD)} through a filter of second order, {1.0 / value:.3g} rad/s"
    if member.endswith(SMOOTHED):
        return f"{member.removesuffix(SMOOTHED)} smoothed without phase, half power at {half_power_hz(value):.2g} Hz"
    return f"{member} by {value:+.3g} {unit(kind, member)}"


def unsteady(flights: float | None = None) -> str:
    """Why a value is not the same in all flights; of one that drifts, so many flights tell too little."""
    if flights is not None and flights < 3.5:
        return f"{round(flights)} flights that show it do not tell that it is the same in all"
    return "its value differs from flight to flight by more than its size allows"


def too_small(kind: str, least: float) -> str:
    """Why a size that the data show means nothing."""
    if kind in ("delay", "filter"):
        return f"less than a sample interval ({least * 1e3:.1f} ms) is how samples are taken, not a sensor's error"
    return f"less than {least:g} is what gravity, mounting and rounding leave open"


def verdict(
    kind: str,
    parameters: Sequence[SensorParameter],
    group: Sequence[str],
    critical_value: float,
    rejections: Mapping[str, tuple[Verdict, str]],
) -> tuple[Verdict, str]:
    """Verdict on an effect and its reason, from its parameters, its rivals, and what was rejected after a trial."""
    accepted = [p for p in parameters if p.accepted]
    if accepted:
        leading = [p for p in accepted if not p.name.endswith(DAMPED)]
        listed = "; ".join(size_words(p, accepted) for p in sorted(leading, key=lambda p: -p.statistic))
        if group:
            return "indistinguishable", f"{listed}; the data cannot tell it from {' or '.join(group)}"
        return "accepted", f"{listed}: the channels contradict each other without it"
    if group:
        return "indistinguishable", f"explains the data as well as {' or '.join(group)}, which was taken"
    tried = {p.name.removeprefix("sensors."): p for p in parameters if p.name.removeprefix("sensors.") in rejections}
    if tried:
        name, best = max(tried.items(), key=lambda item: item[1].statistic)
        return rejections[name][0], f"{size_words(best)}: {rejections[name][1]}"
    best = max(parameters, key=lambda p: p.statistic)
    if best.statistic > critical_value:
        return "rejected", f"{size_words(best)}: its sign, range or size is not that of a constant error"
    return (
        "below floor",
        f"the channels agree; {size_words(best)} is chance"
        if best.value > 0 or kind != "filter"
        else "the channels agree",
    )


def untestable(dataset: Dataset, kind: str) -> str:
    """Why kinematics cannot test an effect on this data set."""
    recorded = {channel for name in dataset.identify for channel in dataset.facts[name].spreads}
    if not usable(recorded):
        lacking = "rates and attitude" if not set(names.RATES) <= recorded else "attitude, or angular accelerations,"
        return f"no two channels are tied by kinematics: {lacking} would be needed together"
    if kind == "lever_arm":
        return "velocities, attitude, rates and specific force would be needed together, with rotation"
    if kind == "bias":
        return "gyros or accelerometers would be needed beside attitude or velocity"
    return "the flights are too short, or nothing moves beyond its noise"
