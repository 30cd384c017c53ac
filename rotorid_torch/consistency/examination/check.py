"""What stands against identifying a model from a data set, in words of flight test, each with what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.examination import controls, frames, kinematics, records, samples
from rotorid_torch.consistency.examination.acting import acting
from rotorid_torch.consistency.examination.finding import Finding, Severity
from rotorid_torch.consistency.examination.needs import examinable, needs
from rotorid_torch.consistency.examination.surroundings import surroundings
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.pairs.odd_flights import without_odd_flights
from rotorid_torch.consistency.records.clock_steps import clock_steps, without_clock_steps
from rotorid_torch.consistency.records.steps import steps, without_steps
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset


@dataclass(frozen=True)
class Examined:
    """All findings on a data set, gravest first; `fit` is false where one is an error.

    of_pairs : those of them that compare sensors in pairs. gross : whether units or axes are wrong, so that errors of
    sensors are not worth a search. aligned : large errors of sensors by name ("delay.attitude") that findings tell.
    """

    dataset: str
    fit: bool
    findings: tuple[Finding, ...]
    of_pairs: tuple[Finding, ...] = ()
    gross: bool = False
    aligned: tuple[str, ...] = ()

    def of(self, severity: Severity) -> tuple[Finding, ...]:
        """Findings of one severity."""
        return tuple(one for one in self.findings if one.severity == severity)


RANK = {"error": 0, "warning": 1, "note": 2, "good": 3}
Examination = Callable[[Dataset], Iterator[Finding]]
EXAMINATIONS: tuple[Examination, ...] = (
    needs,
    records.dead,
    records.reading,
    samples.stamps,
    records.gaps,
    samples.repeats,
    samples.rows,
    samples.twice,
    samples.clocks_that_jump,
    samples.jumps,
    records.units,
    records.gravity,
    kinematics.each_flight,
    kinematics.kinematics,
    frames.frames,
    kinematics.precedence,
    surroundings,
    records.noise,
    records.vibration,
    records.supply,
    controls.controls,
    controls.rotor_speeds,
    acting,
    controls.band,
    controls.trim,
    controls.length,
)


ALWAYS = (needs, records.dead, records.reading, records.gaps, records.units)
"""Those that hold of records on which nothing else can be said."""
RIGHTED = (records.gravity, frames.frames, kinematics.precedence, surroundings, acting)
"""Those that look at the records with large turns and clock errors taken out: these have one cause, told once."""
PAIRS = (kinematics.kinematics, surroundings)
"""Those that compare sensors in pairs, where an error of one shows in several."""
UNITS_AND_AXES = (surroundings, records.gravity, frames.frames)
"""Those whose errors are of units and axes, gravest first; what else is said of what is compared follows from them."""
FOLLOWS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(names.VELOCITIES, (*names.VELOCITIES, *names.POSITIONS, "")),
    **dict.fromkeys(names.SPECIFIC_FORCES, (*names.SPECIFIC_FORCES, *names.VELOCITIES, "")),
}
"""By channel those that are compared with it; "" are the surroundings as a whole."""


def check(dataset: Dataset, examinations: Sequence[Examination] = EXAMINATIONS) -> Examined:
    """Examine a data set: needs, clocks, samples, units, kinematics, noise, controls, band, trim and length."""
    whole = examinable(dataset)
    chosen = examinations if whole else [one for one in examinations if one in ALWAYS]
    held = _Views(dataset, chosen) if whole else None

    every = [(examine, finding) for examine in chosen for finding in examine(held.of(examine) if held else dataset)]
    causes = [f for examine in UNITS_AND_AXES for by, f in every if by is examine and _is_cause(f)]
    jumped = {step.flight for step in clock_steps(dataset)} if whole else set()
    every = [(examine, f) for examine, f in every if examine is not kinematics.each_flight or f.flight not in jumped]
    first = {c for f in causes[:1] for c in f.channel.split()}
    wrong = first | {c for f in causes for c in f.channel.split()}
    every = [(examine, f) for examine, f in every if not _follows(examine, f, wrong, first)]
    if any(f.severity == "error" and examine in (*PAIRS, *UNITS_AND_AXES) for examine, f in every):
        every = [(examine, f) for examine, f in every if examine is not acting]  # by axes that are wrong
    findings = sorted((f for _, f in every), key=lambda finding: RANK[finding.severity])
    fit = all(f.severity != "error" for f in findings)
    aligned = held.errors if held else {}
    beyond = any(examine is kinematics.kinematics and f.severity == "error" and not aligned for examine, f in every)
    gross = beyond or any(f.severity == "error" for f in causes)
    of_pairs = tuple(f for examine, f in every if examine in PAIRS)
    return Examined(dataset.name, fit, tuple(findings), of_pairs, gross, tuple(aligned))


class _Views:
    """Records as the examinations see them: each without what an examination before it has told."""

    def __init__(self, dataset: Dataset, chosen: Sequence[Examination]) -> None:
        self.recorded = dataset
        self.put_back = without_clock_steps(dataset, clock_steps(dataset))
        self.smooth = without_steps(self.put_back, steps(self.put_back))
        self.alike = without_odd_flights(self.smooth)
        self.errors = alignment(self.alike).errors if any(one in RIGHTED for one in chosen) else {}
        self.righted = without_errors(self.alike, self.errors) if self.errors else self.alike

    def of(self, examine: Examination) -> Dataset:
        """The records that an examination looks at."""
        if examine in RIGHTED:
            return self.righted
        single: dict[Examination, Dataset] = {
            samples.jumps: self.put_back,
            kinematics.each_flight: self.smooth,
            kinematics.kinematics: self.alike,
        }
        return single.get(examine, self.recorded)


def comparable(dataset: Dataset) -> Dataset:
    """The records whose sensors can be compared all at once: clocks that jump put back, no steps, no odd flights."""
    return _Views(dataset, ()).alike


def _is_cause(one: Finding) -> bool:
    """Whether a finding on units and axes is one from which others follow: an error, or a map that is turned."""
    return one.severity == "error" or (one.severity == "warning" and one.channel == "north east")


def _follows(examine: Examination, one: Finding, wrong: set[str], first: set[str]) -> bool:
    """Whether a finding follows from a wrong unit or axis of these channels: one cause is told once.

    first : channels of the gravest cause, from which wrong axes of what is compared with them follow too.
    """
    channels = {*one.channel.split()} or {""}
    compared = wrong | {c for channel in wrong for c in FOLLOWS.get(channel, ())}
    if not wrong or one.severity == "good":
        return False
    if examine in UNITS_AND_AXES and _is_cause(one):
        return channels != first and bool(channels & {c for f in first for c in FOLLOWS.get(f, ())})
    if examine is kinematics.kinematics and one.severity == "error":
        return len(channels) < 3 and bool(channels & compared)
    return examine in (*PAIRS, records.noise) and bool(channels & compared)


def remaining(examined: Examined, corrected: Dataset) -> tuple[Finding, ...]:
    """Findings without those of pairs that errors of sensors explain, which were taken out of the corrected records."""
    doubts = [f for f in examined.of_pairs if f.severity in ("warning", "note")]
    if not doubts:
        return examined.findings
    still = [f for examine in PAIRS for f in examine(corrected) if f.severity in ("warning", "note")]
    alike = [
        f for f in still if any({*f.channel.split()} & {*d.channel.split()} or f.channel == d.channel for d in doubts)
    ]
    findings = [*(f for f in examined.findings if f not in doubts), *alike]
    return tuple(sorted(findings, key=lambda finding: RANK[finding.severity]))
