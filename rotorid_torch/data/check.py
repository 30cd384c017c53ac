"""What stands against identifying a model from a data set, in words of flight test, each with what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rotorid_torch.data import examine_controls, examine_kinematics, examine_records, examine_samples
from rotorid_torch.data.alignment import without_large_errors
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.examine_band import band
from rotorid_torch.data.finding import Finding, Severity
from rotorid_torch.data.needs import examinable, needs
from rotorid_torch.data.surroundings import surroundings


@dataclass(frozen=True)
class Check:
    """All findings on a data set, gravest first; `fit` is false where one is an error."""

    dataset: str
    fit: bool
    findings: tuple[Finding, ...]

    def of(self, severity: Severity) -> tuple[Finding, ...]:
        """Findings of one severity."""
        return tuple(found for found in self.findings if found.severity == severity)


Examination = Callable[[Dataset], Iterator[Finding]]
EXAMINATIONS: tuple[Examination, ...] = (
    needs,
    examine_records.dead,
    examine_records.reading,
    examine_samples.stamps,
    examine_records.gaps,
    examine_samples.repeats,
    examine_samples.rows,
    examine_records.units,
    examine_records.gravity,
    examine_kinematics.kinematics,
    examine_kinematics.precedence,
    surroundings,
    examine_records.noise,
    examine_records.vibration,
    examine_records.supply,
    examine_controls.controls,
    band,
    examine_controls.trim,
    examine_controls.length,
)


ALWAYS = (needs, examine_records.dead, examine_records.reading, examine_records.gaps, examine_records.units)
"""Those that hold of records on which nothing else can be said."""
RIGHTED = (examine_records.gravity, examine_kinematics.precedence, surroundings)
"""Those that look at the records with large turns and clock errors taken out: these have one cause, told once."""


def check(dataset: Dataset, examinations: Sequence[Examination] = EXAMINATIONS) -> Check:
    """Examine a data set: needs, clocks, samples, units, kinematics, noise, controls, band, trim and length."""
    whole = examinable(dataset)
    chosen = examinations if whole else [one for one in examinations if one in ALWAYS]
    right = without_large_errors(dataset) if whole and any(one in RIGHTED for one in chosen) else dataset
    found = [finding for examine in chosen for finding in examine(right if examine in RIGHTED else dataset)]
    rank = {"error": 0, "warning": 1, "note": 2, "good": 3}
    found.sort(key=lambda finding: rank[finding.severity])
    return Check(dataset.name, all(f.severity != "error" for f in found), tuple(found))
