"""Sensors against each other: which of them are late, slow, off scale, turned, displaced or biased.

Needs no aerodynamics: exact kinematics of inertial motion over ground, in which wind and gusts do not enter.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.equations import GRAVITY_RANGE, UNITS, of_part_of_a_vector, unit_of
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.sensor_errors import sensor_words
from rotorid_torch.consistency.sensor_errors.constants import Constant, constants
from rotorid_torch.consistency.sensor_errors.normal_equations import Point, Search
from rotorid_torch.consistency.sensor_errors.pieces import HIGHEST_HZ, Piece, pieces
from rotorid_torch.consistency.sensor_errors.selection import Case, drifts, kind_of, least, select, significant, spread
from rotorid_torch.consistency.sensor_errors.sensor_finding import KinematicFinding, KinematicFindings, SensorParameter
from rotorid_torch.consistency.sensor_errors.weighted_fit import DRIFTING, Setting
from rotorid_torch.consistency.smoothing import EVERY_S
from rotorid_torch.core.names import RATES
from rotorid_torch.core.statistics import normal_quantile
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.families.sensors import DAMPED, FILTER_ENDINGS, SMOOTHED, SensorDelay

FALSE_ALARMS = 0.005
"""Share of data sets without sensor errors in which chance alone may name one, over all candidates together."""
MOVING = 10.0
"""Least ratio of a channel's power to its noise in the band at which its clock, filter and scale can show."""
KINDS = ("bias", "scale", "misalignment", "lever_arm", "delay", "filter")
EARTH = 7.3e-5
"""Earth's rotation, rad/s: gyros read it, and the equations leave it out."""


def kinematic_findings(dataset: Dataset, largest: float = math.inf) -> KinematicFindings:
    """Sensor errors that are common to all identify flights, each with its evidence, or why it is not one.

    Bias, scale, misalignment and lever arm of the IMU, delay and filter are estimated jointly from the exact kinematics
    of the channels that there are. An error is accepted where the data gain more than chance gives any of them, where
    it is the same from piece to piece of the flights, larger than a sample interval or than what declarations leave
    open, and where it is still needed beside the others. Constants of gyros and accelerometers are free in every
    flight; they count only where all flights share one. A delay is that of one unit against the others: what all
    share cannot be seen.

    largest : level of misfit, in powers of the noise, above which errors are not searched for; there are no findings
    then.
    """
    by = alignment(dataset)
    dataset = without_errors(dataset, by.delays) if by.clocks else dataset
    cut = pieces(dataset, turned=by.angle > 0.0)
    candidates = _candidates(dataset, cut)
    search = Search(cut, Setting(dataset.vehicle.gravity, np.array(dataset.vehicle.imu or (0.0, 0.0, 0.0))))
    tests = len(candidates) + sum(any(c in piece.channels for piece in cut) for c in DRIFTING)
    critical_value = normal_quantile(FALSE_ALARMS / 2.0 / max(tests, 1)) ** 2
    if not candidates:
        return KinematicFindings(tuple(_untested(dataset, kind, critical_value) for kind in KINDS), {})
    case = Case(dataset, search, candidates, critical_value, by)
    point, findings = select(case, largest), ()
    if point is not None:
        biases = constants(dataset, point, critical_value, _least_constants(dataset))
        findings = tuple(_finding(case, kind, point, biases) for kind in KINDS)
    return KinematicFindings(findings, {name: float(values.max()) for name, values in search.levels.items()})


def _candidates(dataset: Dataset, cut: Sequence[Piece]) -> tuple[str, ...]:
    """Errors that these channels can show; constants of what drifts are weighed apart."""
    channels = dict.fromkeys(channel for piece in cut for channel in piece.channels)
    equations = {name for piece in cut for name in piece.equations}
    moving = {channel for channel in channels if _moves(cut, channel)}
    units = [unit for unit in UNITS if moving & set(UNITS[unit])]
    effects = [f"{kind}.{unit}" for kind in ("delay", "filter") for unit in units]
    effects += [f"filter.{unit}{ending}" for ending in FILTER_ENDINGS for unit in units]
    effects += [f"scale.{c}" for c in channels if c in moving and (unit_of(c) or c.endswith("dot"))]
    level: list[str] = ["psi"] if {"north", "east"} <= equations else []
    if moving & set(RATES) and equations & {"phi", "u", "v", "w"}:
        effects += [f"misalignment.{axis}" for axis in "xyz" if not of_part_of_a_vector(channels)]
        level += ["phi", "theta"]
        if equations & {"u", "v", "w"}:
            effects += [f"lever_arm.{axis}" for axis in "xyz"]
            level += ["u", "v", "w"]
    return (*effects, *(f"bias.{c}" for c in level if c in channels and dataset.bias(c) == "none"))


def _moves(cut: Sequence[Piece], channel: str) -> bool:
    """Whether a channel does more in the band than its noise."""
    power = noise = 0.0
    for piece in cut:
        if channel in piece.channels:
            row = piece.channels.index(channel)
            values = piece.readings[row, piece.margin : -piece.margin]
            ramp = np.linspace(values[0], values[-1], len(values))
            spectrum = np.abs(np.fft.rfft(values - ramp)[1 : int(HIGHEST_HZ * len(values) * piece.dt)]) ** 2
            power, noise = power + spectrum.sum() / len(values), noise + len(spectrum) * piece.noise[row] ** 2
    return power > MOVING * noise


def _least_constants(dataset: Dataset) -> dict[str, float]:
    """By unit, constants that the rotating Earth and local gravity give to sensors without error."""
    spreads = [dataset.facts[name].spreads for name in dataset.identify]
    speeds = [abs(edge) for s in spreads for c in ("u", "v", "w") if c in s for edge in (s[c].low, s[c].high)]
    coriolis = 2.0 * EARTH * max(speeds, default=0.0)
    return {"rad/s": EARTH, "m/s²": coriolis + 0.5 * GRAVITY_RANGE * dataset.vehicle.gravity}


def _untested(dataset: Dataset, kind: str, critical_value: float) -> KinematicFinding:
    return KinematicFinding(
        f"sensors.{kind}", "not testable", sensor_words.untestable(dataset, kind), 0.0, critical_value, (), None, ()
    )


def _finding(case: Case, kind: str, point: Point, biases: Sequence[Constant]) -> KinematicFinding:
    names = [n for n in case.candidates if kind_of(n) == kind and (n in case.fitted or not n.endswith(DAMPED))]
    parameters = [_parameter(case, name, point) for name in names]
    parameters = [_with_clock(case, parameter) for parameter in parameters]
    if kind == "bias":
        parameters += [constant.parameter() for constant in biases]
    if not parameters:
        return _untested(case.dataset, kind, case.critical_value)
    best = max([p for p in parameters if p.accepted] or parameters, key=lambda p: p.statistic)
    group = _group(case, kind)
    verdict, reason = sensor_words.verdict(kind, parameters, group, case.critical_value, case.rejections)
    reason += _alternatives(case, kind)
    visible = min(p.smallest_visible for p in parameters if p.unit == best.unit), best.unit
    return KinematicFinding(
        f"sensors.{kind}", verdict, reason, best.statistic, case.critical_value, tuple(parameters), visible, group
    )


def _with_clock(case: Case, parameter: SensorParameter) -> SensorParameter:
    """A delay with what was set right before the search: that much is certain."""
    seconds = case.by.clocks.get(parameter.name.removeprefix(f"{SensorDelay.id}."), 0.0)
    if not seconds:
        return parameter
    value = seconds + (parameter.value if parameter.name.removeprefix("sensors.") in case.fitted else 0.0)
    error = parameter.se if math.isfinite(parameter.se) else EVERY_S
    return replace(parameter, value=value, se=error, accepted=True, statistic=(value / error) ** 2)


def _group(case: Case, kind: str) -> tuple[str, ...]:
    """Effects that can stand in the place of this one, or this one in theirs, without the data objecting."""
    pairs = [(kind_of(name), kind_of(rival)) for name, rivals in case.rivals.items() for rival in rivals]
    others = {b for a, b in pairs if a == kind} | {a for a, b in pairs if b == kind}
    return tuple(f"sensors.{other}" for other in KINDS if other in others - {kind})


def _alternatives(case: Case, kind: str) -> str:
    """Other sensors of the same effect that could be the cause."""
    others = [(n, v) for name, rivals in case.rivals.items() for n, v in rivals.items() if kind_of(name) == kind_of(n)]
    sizes = [sensor_words.alternative(n, v) for n, v in others if kind_of(n) == kind]
    return f"; it could also be {' or '.join(sizes)}" if sizes else ""


def _parameter(case: Case, name: str, point: Point) -> SensorParameter:
    kind, _, member = name.partition(".")
    flown, smallest = spread(point, name, case.fitted), least(case.dataset, kind)
    error = flown.value
    value = flown.mean if drifts(case.dataset, name) or name not in case.fitted else point.errors[name]
    statistic = case.statistics.get(name, (value / error) ** 2) if name in case.fitted else (value / error) ** 2
    smallest = smallest**2 if name.endswith(SMOOTHED) else smallest
    least_error = math.sqrt(case.critical_value) * error
    visible = float(max(least_error, significant(case.dataset, name, flown), smallest + 2.0 * error))
    unit, named = sensor_words.unit(kind, member), name in case.named
    return SensorParameter(f"sensors.{name}", value, error, unit, named, statistic, visible)
