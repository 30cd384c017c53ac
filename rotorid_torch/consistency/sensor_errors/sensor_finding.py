"""What kinematics says of the sensors, and the data set with what it found taken out."""

from collections.abc import Mapping
from dataclasses import dataclass

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.core.names import Verdict
from rotorid_torch.data.dataset import Dataset


@dataclass(frozen=True)
class SensorParameter:
    """One sensor error: full name ("sensors.delay.attitude"), estimate beside what is accepted, standard error, unit.

    `statistic` : how much of the whitened sum of squares it explains beside the others. `smallest_visible` : the size
    from which on these flights would have shown it.
    """

    name: str
    value: float
    se: float
    unit: str
    accepted: bool
    statistic: float
    smallest_visible: float


@dataclass(frozen=True)
class KinematicFinding:
    """Verdict on one effect of the sensors, with its reason in words.

    statistic, critical_value : fall of the whitened sum of squares by its strongest parameter, and what decides;
    smallest_visible : least size and unit among its parameters, None where it cannot be tested; group : effects that
    explain the data as well.
    """

    id: str
    verdict: Verdict
    reason: str
    statistic: float
    critical_value: float
    parameters: tuple[SensorParameter, ...]
    smallest_visible: tuple[float, str] | None
    group: tuple[str, ...]


@dataclass(frozen=True)
class KinematicFindings:
    """All verdicts. `levels` : per channel, the largest ratio of unexplained to expected power of its rate."""

    findings: tuple[KinematicFinding, ...]
    levels: Mapping[str, float]

    def __getitem__(self, effect: str) -> KinematicFinding:
        return next(finding for finding in self.findings if finding.id == effect)

    @property
    def values(self) -> dict[str, float]:
        """Accepted errors by full name, those of a group's best member included."""
        return {p.name: p.value for finding in self.findings for p in finding.parameters if p.accepted}

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects with an accepted error, those of a group's best member included."""
        return tuple(finding.id for finding in self.findings if any(p.accepted for p in finding.parameters))

    def corrected(self, dataset: Dataset) -> Dataset:
        """A copy of the data set whose records have the accepted errors removed; itself where there are none."""
        errors = {name.removeprefix("sensors."): value for name, value in self.values.items()}
        return without_errors(dataset, errors) if errors else dataset
