"""What stands against identifying a model from a data set, in words of flight test, each with what to do."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

from rotorid_torch.consistency.conventions import convention, in_usual_convention
from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.examination import controls, frames, kinematics, records, samples
from rotorid_torch.consistency.examination.acting import acting
from rotorid_torch.consistency.examination.finding import Finding, Severity
from rotorid_torch.consistency.examination.needs import examinable, needs
from rotorid_torch.consistency.examination.surroundings import air, surroundings
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.pairs.drawn_attitude import drawn
from rotorid_torch.consistency.pairs.odd_flights import without_odd_flights
from rotorid_torch.consistency.pairs.signs import right_signs
from rotorid_torch.consistency.pairs.time_base import on_right_base, time_base
from rotorid_torch.consistency.records.clock_steps import clock_steps, without_clock_steps
from rotorid_torch.consistency.records.ground import in_the_air
from rotorid_torch.consistency.records.slow import drawn_between, slow_channels
from rotorid_torch.consistency.records.steps import steps, without_steps
from rotorid_torch.consistency.sensor_errors.drift import drifts, without_drifts
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight


@dataclass(frozen=True)
class Examined:
    """All findings on a data set, gravest first; `fit` is false where one is an error.

    flown : records in the air, slow channels drawn. comparable : those whose sensors can be compared all at once,
    without what findings tell; None where records are too short. of_pairs : findings that compare sensors in pairs;
    of_noise : those on a noise that is not the declared one.
    gross : whether units, axes or sensors are wrong, so that errors of sensors are not worth a search. aligned : large
    errors of sensors by name ("delay.attitude") that findings tell.
    """

    dataset: str
    fit: bool
    findings: tuple[Finding, ...]
    flown: Dataset
    comparable: Dataset | None = None
    of_pairs: tuple[Finding, ...] = ()
    of_noise: tuple[Finding, ...] = ()
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
    records.inverted,
    samples.stamps,
    records.gaps,
    samples.repeats,
    samples.rows,
    samples.twice,
    frames.conventions,
    kinematics.attitude,
    samples.clocks_that_jump,
    samples.jumps,
    frames.time,
    records.units,
    records.gravity,
    kinematics.each_flight,
    kinematics.drifting,
    kinematics.kinematics,
    frames.frames,
    kinematics.precedence,
    surroundings,
    air,
    records.noise,
    records.vibration,
    records.supply,
    records.speeds,
    controls.controls,
    controls.grounded,
    controls.rotor_speeds,
    acting,
    controls.band,
    controls.trim,
    controls.length,
)


ALWAYS = (needs, records.dead, records.reading, records.gaps, records.units)
"""Those that hold of records on which nothing else can be said."""
CAUSES = (surroundings, records.gravity, frames.frames, air)
"""Those that find wrong units, axes and clocks of whole vectors, gravest first: the next look at records without it."""
RIGHTED = (*CAUSES, kinematics.precedence, acting)
"""Those that look at the records with large turns and clock errors taken out: these have one cause, told once."""
PAIRS = (kinematics.kinematics, surroundings, air)
"""Those that compare sensors in pairs, where an error of one shows in several."""
VECTORS = (names.RATES, names.ATTITUDES, names.VELOCITIES, names.SPECIFIC_FORCES, names.POSITIONS)
"""Channels that nothing is compared with where one of them is wrong."""


def check(dataset: Dataset, examinations: Sequence[Examination] = EXAMINATIONS) -> Examined:
    """Examine a data set: needs, clocks, samples, units, kinematics, noise, controls, band, trim and length."""
    whole = examinable(dataset)
    chosen = examinations if whole else [one for one in examinations if one in ALWAYS]
    views = _Views(dataset) if whole else None
    causes = [(by, cause) for by, cause in views.causes if by in chosen] if views else []
    every = causes + [(examine, f) for examine in chosen for f in examine(views.of(examine) if views else dataset)]
    jumped = {one.flight for one in (*views.jumps, *views.steps)} if views else set()
    common = {f.channel for _, f in every if f.severity == "error" and not f.flight}
    implied = [(examine, f) for examine, f in every if f.flight in jumped or f.channel in common]
    every = [one for one in every if one[0] is not kinematics.each_flight or one not in implied]
    compared = (frames.time, frames.conventions, kinematics.attitude, *CAUSES, kinematics.kinematics)
    errors = [(examine, f) for examine, f in every if f.severity == "error" and examine in compared]
    shifted = any(f.severity == "error" for examine, f in every if examine is kinematics.precedence)
    if errors or shifted:
        every = [(examine, f) for examine, f in every if examine is not acting]  # by axes that are wrong
    findings = sorted((f for _, f in every), key=lambda finding: RANK[finding.severity])
    aligned = views.errors if views else {}
    return Examined(
        dataset=dataset.name,
        fit=all(f.severity != "error" for f in findings),
        findings=tuple(findings),
        flown=views.flown if views else dataset,
        comparable=views.steady if views else None,
        of_pairs=tuple(f for examine, f in every if examine in PAIRS),
        of_noise=tuple(f for examine, f in every if examine is records.noise and f.severity == "warning"),
        gross=any(examine is not kinematics.kinematics or not aligned for examine, _ in errors),
        aligned=tuple(aligned),
    )


class _Views:
    """Records as the examinations see them: each without what an examination before it has told.

    causes : findings on units, axes and clocks by who tells them, one after the other, each on records without the
    channels of those before.
    """

    def __init__(self, dataset: Dataset) -> None:
        self.raw = dataset
        self.recorded = drawn_between(dataset)
        self.usual = usual = in_usual_convention(self.recorded, convention(self.recorded))
        self.flown = in_the_air(usual)
        self.independent = _without(usual, names.ATTITUDES) if drawn(usual) else usual
        self.jumps = clock_steps(self.independent)
        self.put_back = without_clock_steps(self.independent, self.jumps)
        self.steps = steps(self.put_back)
        self.smooth = without_steps(self.put_back, self.steps)
        self.timed = on_right_base(self.smooth, time_base(self.smooth))
        self.alike = without_odd_flights(self.timed)
        signed, _ = right_signs(self.alike)
        self.errors = alignment(signed).errors if signed is self.alike else alignment(signed).delays
        self.righted = without_errors(signed, self.errors) if self.errors else signed
        self.each = without_errors(self.timed, self.errors) if self.errors else self.timed
        self.causes = list[tuple[Examination, Finding]]()
        while causes := next(filter(None, map(self._causes, CAUSES)), None):
            self.causes += causes
            wrong = {channel for _, cause in causes for channel in cause.channel.split()}
            views = (self.each, self.alike, self.righted)
            self.each, self.alike, self.righted = (_without(view, wrong) for view in views)
        self.steady = without_drifts(self.alike, drifts(self.alike))
        self.sampled = _dropped(self.alike, {*slow_channels(dataset)})  # what is drawn has less noise than its sensor

    def _causes(self, by: Examination) -> list[tuple[Examination, Finding]]:
        return [(by, cause) for cause in by(self.righted) if _is_cause(cause)]

    def of(self, examine: Examination) -> Dataset:
        """The records that an examination looks at."""
        if examine in ALWAYS:
            return self.raw
        if examine in RIGHTED:
            return in_the_air(self.righted) if examine is acting else self.righted
        single: dict[Examination, Dataset] = {
            kinematics.attitude: self.usual,
            samples.clocks_that_jump: self.independent,
            samples.jumps: self.put_back,
            frames.time: self.smooth,
            kinematics.each_flight: self.each,
            kinematics.drifting: self.alike,
            kinematics.kinematics: self.steady,
            records.noise: self.sampled,
            controls.band: self.flown,
        }
        return single.get(examine, self.recorded)


def _is_cause(one: Finding) -> bool:
    """Whether a finding on units, axes and clocks is one from which others follow."""
    of_positions = bool(one.channel) and {*one.channel.split()} <= {*names.POSITIONS}
    return one.severity == "error" or (one.severity == "warning" and of_positions)


def _without(dataset: Dataset, channels: Collection[str]) -> Dataset:
    """The data set without the vectors that hold these channels."""
    return _dropped(dataset, {*channels} | {c for vector in VECTORS if {*channels} & {*vector} for c in vector})


def _dropped(dataset: Dataset, channels: Collection[str]) -> Dataset:
    """The data set without these channels; itself where there are none of them."""
    if not channels:
        return dataset

    def of(flight: Flight) -> Flight:
        return Flight(flight.name, flight.dt, {c: x for c, x in flight.channels.items() if c not in channels})

    return dataset.changed(of)


def remaining(examined: Examined, corrected: Dataset) -> tuple[Finding, ...]:
    """Findings, those of pairs on records without the errors of sensors that all channels together show."""
    doubts = [f for f in examined.of_pairs if f.severity in ("warning", "note")]
    if not doubts:
        return examined.findings
    again = [f for examine in PAIRS for f in examine(corrected) if f.severity in ("warning", "note")]
    findings = [*(f for f in examined.findings if f not in doubts), *again]
    return tuple(sorted(findings, key=lambda finding: RANK[finding.severity]))
