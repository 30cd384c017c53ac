"""Closing the loop: structure first, then undeclared effects, then what stays without a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from rotorid_torch.core.names import MOMENTS
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.trace.balance import out_of_balance
from rotorid_torch.trace.evidence.critical_values import Null
from rotorid_torch.trace.evidence.fits import Fitted, FittedModel, Flights, refit
from rotorid_torch.trace.evidence.trim_differences import explained_trims
from rotorid_torch.trace.measured.accelerations import MeasuredAccelerations
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.search.decide import VERDICTS, Reason
from rotorid_torch.trace.search.eligible import candidates, untried
from rotorid_torch.trace.search.forward_selection import DrawClean, Say, Search, Trial, of_effects, row_of
from rotorid_torch.trace.search.ordinary_physics import NOT_WANTED, with_structure, without_idle
from rotorid_torch.trace.search.outcome import how_it_ended, with_each_control
from rotorid_torch.trace.search.screening_sizes import with_screening_sizes
from rotorid_torch.trace.search.trajectories import Trajectories
from rotorid_torch.trace.terms.candidate import Candidate
from rotorid_torch.trace.terms.finding import EffectFinding, Unknown


@dataclass(frozen=True, eq=False)
class Tracing:
    """What was traced.

    null : the best model without undeclared effects. final : with those accepted. structure, accepted : their ids.
    findings : one of each effect that was tested. unknown : what stays without a name. spread : standard errors of the
    accepted effects' parameters by their scatter over flights, controls and draws.
    """

    null: Null
    final: Null
    structure: tuple[str, ...]
    accepted: tuple[str, ...]
    findings: tuple[EffectFinding, ...]
    notes: tuple[str, ...] = ()
    unknown: Unknown | None = None
    spread: Mapping[str, float] = field(default_factory=dict)

    def without(self, why: Reason, said: Mapping[str, str]) -> Tracing:
        """The tracing with effects taken back, with words on each; what could not be told from them goes along."""
        gone = {f.id: next((said[e] for e in (f.id, *f.group) if e in said), "") for f in self.findings}
        gone = {e: words for e, words in gone.items() if words and (e in said or e not in self.accepted)}
        findings = (
            replace(f, verdict=VERDICTS[why], reason=gone[f.id], group=()) if f.id in gone else f for f in self.findings
        )
        return replace(
            self,
            final=Null(self.final.spec.without(said), self.final.values),
            structure=tuple(e for e in self.structure if e not in said),
            accepted=tuple(e for e in self.accepted if e not in said),
            findings=tuple(findings),
        )


def trace(
    start: Null, flights: Flights, draw: DrawClean, say: Say = lambda line: None, seed: int = 0, ranks: Ranks = ALONE
) -> Tracing:
    """Which effects a model lacks: by trajectories, of a multirotor by accelerations at measured states.

    start : the model with its parameters as identified.
    draw : statistics of effects on clean aircraft, for the model with its structural effects.
    say : told what happens, a line at a time. seed : as `Search` has it.
    ranks : processes that share the candidates, each of which calls this.
    """
    if start.spec.motors:
        scored = MeasuredAccelerations(flights, ranks=ranks)
        return _of_rotors(start.spec, scored, Search(scored, draw, say, seed))
    shared = Trajectories(flights, tuple(start.held), ranks)
    return _of_trajectories(start, shared, Search(shared, draw, say, seed))


def _of_trajectories(start: Null, shared: Trajectories, search: Search[Fitted]) -> Tracing:
    """Structure first, then undeclared effects, then what has no name."""
    flights = shared.flights
    testable, settled = candidates(start.spec)
    spec, testable, unmoved = with_screening_sizes(start.spec, start.values, flights.dataset, testable)
    tested = _of_role(Role.UNDECLARED, testable)
    null = shared.settled(refit(spec, flights, start.values, start.held))
    null = _placed(search, shared, null, tested)
    placed = [c.effect for c in search.joined]
    null, ordinary = with_structure(search, shared, null, _of_role(Role.STRUCTURE, testable), tested)
    final = search.selected(null, tested)
    outcome, unknown = how_it_ended(search, final, tested)
    named = [c.effect for c in search.joined if c.effect not in placed]
    waiting = [f.id for f in ordinary if f.verdict != "accepted" and (named or registered()[f.id].ordinary)]
    if waiting and (outcome.accepted or not named):  # beside names that are only suspected it would hide these
        final, more = with_structure(search, shared, final, waiting)
        ordinary = [f for f in ordinary if f.id not in waiting] + more
        outcome, null = replace(outcome, final=final), null if named else final
    structure = tuple(f.id for f in ordinary if f.verdict == "accepted")
    outcome = with_each_control(outcome, start.held)
    final, idle = without_idle(search, shared, final, structure)
    if placed:  # the model before has the same structure
        null = refit(null.spec.without(placed), flights, null.values, start.held, near=null)
    tracing = Tracing(
        Null(null.spec.without(idle), null.values),
        _plain(final if outcome.accepted else null),
        structure,
        outcome.accepted,
        (*ordinary, *outcome.findings(tested), *settled, *unmoved),
        (*search.notes, *untried(flights.dataset)),
        unknown,
        outcome.spread,
    )
    return tracing.without(Reason.UNSEEN_WORSE, dict.fromkeys(idle, NOT_WANTED))


def _of_rotors(spec: ModelSpec, shared: MeasuredAccelerations, search: Search[FittedAtStates]) -> Tracing:
    """Undeclared effects of a multirotor, then what the balance of its thrusts shows."""
    dataset = shared.flights.dataset
    testable, settled = candidates(spec)
    null = shared.fitted(spec)
    undeclared = _of_role(Role.UNDECLARED, testable)
    sized, tested, unmoved = with_screening_sizes(null.spec, null.values, dataset, undeclared)
    null = replace(null, spec=sized)
    final = search.selected(null, tested)
    search.settle_groups(final)
    outcome, unknown = how_it_ended(search, final, tested)
    centre, missing = None, None
    if spec.found_places is None:  # of arms that are not known nothing balances
        judged = search.first is not None and search.first.draws.clean  # by accelerations, where rotors explain these
        rows = final.silent if judged else MOMENTS
        centre, missing = out_of_balance(final.model, final.spec, dataset, dataset.unseen, search.seed, rows)
    findings = (*outcome.findings(tested), *settled, *unmoved)
    return Tracing(
        _plain(null),
        _plain(final),
        (),
        outcome.accepted,
        tuple(centre if centre and f.id == centre.id else f for f in findings),
        (*search.notes, *untried(dataset)),
        _both(missing, unknown) if unknown is not None and unknown.judged else missing,
        outcome.spread,
    )


def _both(one: Unknown | None, other: Unknown) -> Unknown:
    """What two residuals show without a name."""
    if one is None:
        return other
    signals = " and ".join(filter(None, (one.goes_with, other.goes_with)))
    (low, high), (slowest, fastest) = one.band_hz, other.band_hz
    band, where = (min(low, slowest), max(high, fastest)), "".join(sorted({*one.where, *other.where}))
    return Unknown(where, band, signals or None, other.since_s, f"{one.sentence} {other.sentence}")


def _of_role(role: Role, effects: Sequence[str]) -> list[str]:
    return [e for e in effects if registered()[e].role is role]


def _plain(fitted: FittedModel) -> Null:
    return Null(fitted.spec, fitted.values)


def _placed(search: Search[Fitted], shared: Trajectories, null: Fitted, effects: Sequence[str]) -> Fitted:
    """The null with what explains how trims differ from flight to flight: without that, no fit of it means much."""
    remaining = list(effects)
    while explained := explained_trims(
        null.spec, of_effects(null.values, [c.effect for c in search.joined]), shared.flights, remaining
    ):
        effect, one = next(iter(explained.items()))
        remaining = [e for e in explained if e != effect]
        values = one.start if not search.joined else of_effects(one.start, [effect])
        start = {n: v for n, v in values.items() if n not in shared.held}
        spec = null.spec.with_effects(effect)
        fitted = refit(spec, shared.flights, {**null.values, **start}, shared.held, near=null)
        candidate = Candidate(effect)
        trial = Trial(candidate, null, fitted, row_of(null, fitted, candidate, drawn=one.scatter))
        search.trials[candidate] = trial
        search.say(f"{effect} explains {100.0 * one.share:.0f} % of what trims of unseen flights differ by; {trial}")
        if trial.stands:
            search.joined.append(candidate)
            search.scatter.update(one.scatter)
            null = fitted
    return null
