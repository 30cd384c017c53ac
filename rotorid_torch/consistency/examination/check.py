"""What stands against identifying a model from a data set, in words of flight test, each with what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.examination import breaks, controls, frames, kinematics, records, samples
from rotorid_torch.consistency.examination.finding import Finding, Severity
from rotorid_torch.consistency.examination.needs import examinable, needs
from rotorid_torch.consistency.examination.surroundings import surroundings
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.records.steps import steps, without_steps
from rotorid_torch.data.dataset import Dataset


@dataclass(frozen=True)
class Examined:
    """All findings on a data set, gravest first; `fit` is false where one is an error."""

    dataset: str
    fit: bool
    findings: tuple[Finding, ...]

    def of(self, severity: Severity) -> tuple[Finding, ...]:
        """Findings of one severity."""
        return tuple(one for one in self.findings if one.severity == severity)


Examination = Callable[[Dataset], Iterator[Finding]]
EXAMINATIONS: tuple[Examination, ...] = (
    needs,
    records.dead,
    records.reading,
    samples.stamps,
    records.gaps,
    samples.repeats,
    samples.rows,
    breaks.twice,
    breaks.jumps,
    records.units,
    records.gravity,
    kinematics.kinematics,
    frames.frames,
    kinematics.precedence,
    surroundings,
    records.noise,
    records.vibration,
    records.supply,
    controls.controls,
    controls.rotor_speeds,
    controls.band,
    controls.trim,
    controls.length,
)


ALWAYS = (needs, records.dead, records.reading, records.gaps, records.units)
"""Those that hold of records on which nothing else can be said."""
RIGHTED = (records.gravity, frames.frames, kinematics.precedence, surroundings)
"""Those that look at the records with large turns and clock errors taken out: these have one cause, told once."""


def check(dataset: Dataset, examinations: Sequence[Examination] = EXAMINATIONS) -> Examined:
    """Examine a data set: needs, clocks, samples, units, kinematics, noise, controls, band, trim and length."""
    whole = examinable(dataset)
    chosen = examinations if whole else [one for one in examinations if one in ALWAYS]
    smooth = without_steps(dataset, steps(dataset)) if whole else dataset
    errors = alignment(smooth).errors if whole and any(one in RIGHTED for one in chosen) else {}
    right = without_errors(smooth, errors) if errors else smooth

    def as_seen_by(examine: Examination) -> Dataset:
        return right if examine in RIGHTED else smooth if examine is kinematics.kinematics else dataset

    findings = [finding for examine in chosen for finding in examine(as_seen_by(examine))]
    rank = {"error": 0, "warning": 1, "note": 2, "good": 3}
    findings.sort(key=lambda finding: rank[finding.severity])
    return Examined(dataset.name, all(f.severity != "error" for f in findings), tuple(findings))
