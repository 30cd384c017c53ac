"""Closing the loop: structure first, then undeclared effects, then what stays without a name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from rotorid_torch.core.names import FLAPPING
from rotorid_torch.core.ranks import ALONE, Ranks
from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.nominal import rows
from rotorid_torch.trace.candidates import candidates, untried
from rotorid_torch.trace.decide import nothing, told
from rotorid_torch.trace.finding import Finding, Unknown
from rotorid_torch.trace.findings import findings
from rotorid_torch.trace.fits import Fitted, Flights, refit
from rotorid_torch.trace.floor import Floors, Null, family_wise, p_values
from rotorid_torch.trace.residual import AT_ONCE, chance, left_over, scan
from rotorid_torch.trace.screening_sizes import with_screening_sizes
from rotorid_torch.trace.search import Say, Search
from rotorid_torch.trace.slips import deflected
from rotorid_torch.trace.unexplained import unknown

UNJUDGED = "No clean aircraft tells how much of this is ordinary."
UNCONFIRMED = "No flight was kept back that could confirm it."
STILL = "which fly in still air, far from the ground: what is left over without a name can not be judged by them"


class Named(Protocol):
    """A model by its structure and its parameters' values."""

    @property
    def spec(self) -> ModelSpec:
        """Its structure."""
        ...

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by its full name."""
        ...


@dataclass(frozen=True, eq=False)
class Bare:
    """A model without the effects whose size is nothing in the end."""

    spec: ModelSpec
    values: dict[str, float]


@dataclass(frozen=True, eq=False)
class Tracing:
    """What was traced.

    null : the best model without undeclared effects. final : with those accepted. structure, accepted : their ids.
    groups : for an accepted effect the others that explain as much. findings : one of each effect that was tested.
    unknown : what is left over without a name; unknown_before : what is by the null.
    spread : standard errors of the accepted effects' parameters by their scatter over flights and controls.
    sure : whether flight by flight the final model describes segments better than the null by more than chance.
    """

    null: Named
    final: Named
    structure: tuple[str, ...]
    accepted: tuple[str, ...]
    groups: Mapping[str, tuple[str, ...]]
    findings: tuple[Finding, ...]
    notes: tuple[str, ...] = ()
    unknown: Unknown | None = None
    unknown_before: Unknown | None = None
    spread: Mapping[str, float] = field(default_factory=dict)
    sure: bool = True


def trace(
    spec: ModelSpec,
    start: Mapping[str, float],
    held: Sequence[str],
    flights: Flights,
    floors: Callable[[Null, Sequence[str]], Floors],
    say: Say = lambda line: None,
    seed: int = 0,
    ranks: Ranks = ALONE,
) -> Tracing:
    """Which effects the model of a spec lacks.

    Parameters
    ----------
    start : its parameters as identified. held : those that keep their values.
    floors : gains of these effects on clean aircraft, for the model with its structural effects.
    say : told what happens, a line at a time. seed : of the shuffled residuals.
    ranks : processes that share the candidates, each of which calls this.
    """
    testable, found = candidates(spec)
    spec, testable, unmoved = with_screening_sizes(spec, start, flights.dataset, testable)
    found += unmoved
    search = Search(flights, tuple(held), Floors({}, ""), say, seed, ranks, dict(start))
    tested = [e for e in testable if registered()[e].role is Role.UNDECLARED]
    null = search.place(refit(spec, flights, start, held), tested)
    null = search.structure(null, [e for e in testable if registered()[e].role is Role.STRUCTURE])
    placed = list(search.placed)
    structure = tuple(e for e in null.spec.effects if e not in (*spec.effects, *placed))
    undeclared = [e for e in tested if e not in placed]
    search.floors = _in_still_air(null, placed, search.held, undeclared, floors)
    first, _ = search.screened_both(null, undeclared)
    usual = search.floors.of(first, undeclared)
    p = p_values(search.evidence(null, undeclared), search.floors)
    final, joined = search.undeclared(null, undeclared)
    known = {e: floor for e, (_, floor) in (search.placed | search.gained).items()}
    final, accepted = search.confirmed(final, [*placed, *joined], known)
    if placed:  # the model before has the same structure
        null = refit(null.spec.without(placed), flights, null.values, held, near=null)
    search.compare_clean(final, accepted)
    search.compare_controls(final, accepted)
    before = _missing(null, (), flights, search.floors, seed)
    # with nothing accepted, what the search made of the null imitates what is missing as well as it can
    missing = _missing(final, accepted, flights, search.floors, seed) if accepted else before
    idle = {e: why for e in structure if (why := nothing(final.model, final.error, e)) is not None}
    for e, why in idle.items():
        search.refuse(e, why, final)
    structure = tuple(e for e in structure if e not in idle)
    tested = findings(search, final, structure, accepted, undeclared, first, usual)
    found = [replace(f, p=p.get(f.id)) for f in tested] + found
    return Tracing(
        _bare(null, idle),
        _bare(final, idle),
        structure,
        tuple(accepted),
        search.groups,
        tuple(found),
        (search.floors.note, *untried(flights.dataset)),
        missing,
        before,
        search.spread,
        not accepted or told(final, null),
    )


def _bare(fitted: Fitted, idle: Collection[str]) -> Named:
    """The model without these effects."""
    return Bare(fitted.spec.without(idle), fitted.values) if idle else fitted


def _in_still_air(
    null: Fitted,
    placed: Sequence[str],
    held: Sequence[str],
    effects: Sequence[str],
    floors: Callable[[Null, Sequence[str]], Floors],
) -> Floors:
    """Floors by clean aircraft in still air far from the ground; what wind or ground leave over these cannot tell."""
    found = floors(Null(null.spec.without(placed), null.values, tuple(held)), effects)
    return replace(found, traces={}, note=f"{found.note}, {STILL}") if placed and found.gains else found


def _missing(fitted: Fitted, accepted: Sequence[str], flights: Flights, floors: Floors, seed: int) -> Unknown | None:
    """What a model leaves over without a name, beyond chance, and beyond clean aircraft where any could be drawn.

    Nothing where clean aircraft flew, but not where this one does.
    """
    usual = floors.of_traces()
    if floors.gains and not usual:
        return None
    over, unseen = (
        left_over(fitted.model, flights.dataset, flights.reconstruction, listed, accepted)
        for listed in (flights.dataset.identify, flights.dataset.unseen)
    )
    traces, by_chance = scan(over), family_wise(chance(over, seed))
    asked = usual or {k: 0.0 for k, t in traces.items() if t.row in (*rows(fitted.spec), *FLAPPING, *AT_ONCE)}
    levels = {key: max(floor, by_chance[key]) for key, floor in asked.items() if key in by_chance}
    found = unknown(traces, levels, over, unseen, seed, deflected(fitted.model))
    if found is None:
        return None
    doubts = [*([] if usual else [UNJUDGED]), *([] if flights.dataset.validate else [UNCONFIRMED])]
    return replace(found, sentence=" ".join([found.sentence, *doubts]), judged=bool(usual))
