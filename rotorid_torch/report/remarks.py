"""What a user must know about an identification: one sentence per kind, what it means and what to do next."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from rotorid_torch.arguments import listed
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.examination.grade import graded
from rotorid_torch.consistency.examination.records import condensed
from rotorid_torch.consistency.pairs.late_controls import late_controls
from rotorid_torch.consistency.records.excitation import moves
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.identification.model_estimation import ModelEstimate
from rotorid_torch.identification.model_regression import ModelRegression
from rotorid_torch.report.records import FitRecord
from rotorid_torch.report.short_horizon import short_horizon
from rotorid_torch.report.summary import GRADED, at_an_edge, at_once, worse_lists
from rotorid_torch.validate.declared_vehicle import of_declaration

OWN_SHARE = 0.1
"""Share of a control's own motion below which its derivatives and the states' are told only together."""
COMPARED = 20
"""Flights that are checked, and on which the clocks of controls and responses are compared."""
SHOWN = 6
"""Names that a sentence lists; report.json's parameters hold all of them."""
MEANINGS = {
    "noise fills a combination of the regressors": "their sum or difference hardly moved in these flights, so the prior"
    " sets it; fly inputs that move one control at a time",
    "does not hold even up to": "look for a wrong sign, a time shift between channels, gusts or motion too large to be"
    " linear; the fit begins from weak values there",
}
"""What a remark of the regressions means to somebody who identifies a vehicle, by its beginning."""


def regression_table(regressions: ModelRegression) -> list[str]:
    """One line per equation of step 2: band, R2, condition number, worst variance inflation and reliability."""
    return [
        f"{row}: band {r.band[0]:.2f} to {r.band[1]:.2f} Hz, R2 {float(r.r2):.4f}, condition {float(r.condition):.0f},"
        f" variance inflation up to {float(r.vif.max()):.0f}, reliability from {float(r.reliability.min()):.2f}"
        for row, r in regressions.by_row.items()
    ]


def of_reading(dataset: Dataset) -> Iterator[str]:
    """What was changed or left out when the data set was read; all flights in one sentence."""
    for flight, sentence in condensed(dataset.warnings):
        yield f"flight {flight}: {sentence}" if flight else sentence
    for dead in dataset.dead:
        yield f"{dead.channel} {dead.sentence}"


@once
def _first_flights(dataset: Dataset) -> Dataset:
    names = dataset.identify[:COMPARED]
    flights, facts = ({n: whole[n] for n in names} for whole in (dataset.flights, dataset.facts))
    return replace(dataset, flights=flights, facts=facts, identify=names, validate=(), acid=()).recorded()


def of_flights(dataset: Dataset) -> tuple[str, ...]:
    """What the flights themselves say, whatever is made of them."""
    return (*of_check(dataset), *of_reading(dataset), *of_clocks(dataset))


def of_check(dataset: Dataset) -> tuple[str, ...]:
    """The grade of the data set where it is not ready, and what `check` calls an error, by the first flights."""
    few = _first_flights(dataset)
    examined = check(few)
    findings = (*examined.findings, *of_declaration(examined))
    grade = graded(few, findings)
    errors = [one for one in findings if one.severity == "error"]
    said = (f"{one.channel}: {one.sentence}" if one.channel else one.sentence for one in errors)
    return (*([] if grade.grade == "ready" else [f"{GRADED}{grade.sentence}"]), *said)


def of_clocks(dataset: Dataset) -> tuple[str, ...]:
    """Controls whose record is late, by the first identify flights."""
    late = late_controls(_first_flights(dataset))
    if late is None:
        return ()
    return (
        f"controls are recorded at least {late.seconds * 1e3:.0f} ± {late.se * 1e3:.1f} ms late: {late.clearest}"
        " comes first, which no vehicle does; lags and damping are biased by that time; rotorid"
        " close-loop takes that time out",
    )


def of_controls(dataset: Dataset, own_share: Mapping[str, float]) -> Iterator[str]:
    """Controls that the identify flights leave alone, and those that mostly follow the states."""
    still = [control for control, movement in moves(dataset, dataset.controls).items() if not movement.flights]
    if still:
        yield (
            f"{listed(still, SHOWN)} hardly moves in any identify flight: what that control does stays unknown; fly a"
            " doublet or a 3-2-1-1"
        )
    low = {control: share for control, share in own_share.items() if share < OWN_SHARE and control not in still}
    if low:
        shares = ", ".join(f"{control} ({share:.0%})" for control, share in low.items())
        yield (
            f"little of {shares} is its own motion, the rest is feedback of the states: its derivatives"
            " and theirs are told only in combination; fly inputs on that control, or with the augmentation off"
        )


def of_regressions(regressions: ModelRegression) -> Iterator[str]:
    """What step 2 remarked: every kind of remark once, with the equations that it is about."""
    rows: dict[str, list[str]] = {}
    for row, regression in regressions.by_row.items():
        for note in regression.notes:
            rows.setdefault(note.removeprefix(f"{row}: "), []).append(row)
    for note, where in rows.items():
        meaning = next((m for beginning, m in MEANINGS.items() if note.startswith(beginning)), None)
        sentence = f"{note.partition(';')[0]}: {meaning}" if meaning else note
        yield f"regression, equation{'s' if len(where) > 1 else ''} of {' '.join(where)}: {sentence}"


def of_estimate(estimate: ModelEstimate, fit: FitRecord) -> Iterator[str]:
    """What leaves the estimate of step 3 in doubt."""
    if not estimate.fit.minimum.converged:
        yield (
            f"the fit did not converge ({estimate.fit.minimum.message}): take the standard errors with care;"
            " longer flights, or test inputs on every control, would help"
        )
    worse = "" if short_horizon(fit) else worse_lists(fit)
    if worse:
        yield f"the model is {worse}: do not use the model; look at the data with rotorid check first"
    bound = at_an_edge(fit.parameters)
    if bound:
        yield (
            f"at a bound: {listed(bound, SHOWN)}; the value is the bound's, not the data's: check units, signs of the"
            " controls and the declared vehicle"
        )
    fast = at_once(fit.parameters)
    if fast:
        yield f"shorter than these records resolve: {listed(fast, SHOWN)}; what stands behind acts as good as at once"
    blind = [p.name for p in fit.parameters if p.status == "not identifiable"]
    if blind:
        said = f"not identifiable from these flights, held: {listed(blind, SHOWN)}"
        yield f"{said}; fly a manoeuvre that moves what they multiply"
