"""Constant errors of gyros and accelerometers: which are the same in all flights, beyond what each flight may have."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.sensor_errors.normal_equations import Point
from rotorid_torch.consistency.sensor_errors.sensor_finding import SensorParameter
from rotorid_torch.core.names import unit
from rotorid_torch.core.statistics import student_quantile, variance_between, weighted_mean
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.families.sensors import SensorBias


@dataclass(frozen=True)
class Constant:
    """Mean over flights of a channel's constant, m its standard error and the spread from flight to flight.

    quantile : how many standard errors make a finding; least : size that means something.
    """

    channel: str
    value: float
    se: float
    between: float
    quantile: float
    least: float
    allowed: bool

    @property
    def accepted(self) -> bool:
        """Whether all flights share a constant that nothing declares."""
        beyond = abs(self.value) > max(self.quantile * self.se, self.least + 2.0 * self.se)
        return beyond and not self.allowed

    def parameter(self) -> SensorParameter:
        """As a parameter of sensors.bias."""
        statistic = (self.value / self.se) ** 2
        visible = max(self.quantile * self.se, self.least + 2.0 * self.se)
        name = f"{SensorBias.id}.{self.channel}"
        return SensorParameter(name, self.value, self.se, unit(self.channel), self.accepted, statistic, visible)


def constants(dataset: Dataset, point: Point, critical_value: float, least: Mapping[str, float]) -> list[Constant]:
    """Constants of the drifting channels at a point of the search, pooled over flights.

    A channel whose bias is declared "free" may have one in each flight, the same one too. Where nothing is declared, a
    common constant must stand out of the spread between flights; where "none" is declared, out of the errors alone.
    """
    flights = dict.fromkeys(part.flight for part in point.parts)
    channels = dict.fromkeys(c for part in point.parts for c in part.constants)
    findings = []
    for channel in channels:
        each = [_of_flight(point, flight, channel) for flight in flights]
        estimates = [e for e in each if e is not None]
        if estimates:
            findings.append(_pooled(dataset, channel, estimates, critical_value, least.get(unit(channel), 0.0)))
    return findings


def _of_flight(point: Point, flight: str, channel: str) -> tuple[float, float] | None:
    """Value and standard error of a channel's constant in a flight, pooled over its pieces."""
    parts = [p.constants[channel] for p in point.parts if p.flight == flight and channel in p.constants]
    sure = [(value, se) for value, se in parts if se > 0.0]
    return weighted_mean(*zip(*sure, strict=True)) if sure else None


def _pooled(
    dataset: Dataset, channel: str, each: Sequence[tuple[float, float]], critical_value: float, least: float
) -> Constant:
    (values, errors), count = np.array(each).T, len(each)
    between = variance_between(values, errors) ** 0.5
    value, se = weighted_mean(values, np.hypot(errors, between))
    spec = dataset.channel_specs.get(channel)
    declared = spec.bias if spec is not None else None
    if declared == "none":
        quantile = math.sqrt(critical_value)
    else:
        # the spread between flights is known from so many flights only
        quantile = student_quantile(math.sqrt(critical_value), count - 1) if count > 1 else math.inf
    return Constant(channel, value, se, between, quantile, least, declared == "free")
