"""The search: what is significant is fitted in full, the best joins, what flights cannot tell from it is its rival."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
import torch

from rotorid_torch.trace.evidence.critical_values import Draws, Null
from rotorid_torch.trace.evidence.family import Family, family
from rotorid_torch.trace.evidence.fits import BEGINNING, CAREFUL, Care, Fitted, Flights, refit
from rotorid_torch.trace.evidence.parallel_fits import Wanted, fits
from rotorid_torch.trace.search.decide import Interval, Row, likelihood_gain
from rotorid_torch.trace.search.forward_selection import Comparison, Search, Trial, row_of
from rotorid_torch.trace.search.trajectories import Trajectories
from rotorid_torch.trace.terms.candidate import Candidate
from rotorid_torch.trace.terms.settings import SETTINGS
from tests.known_models import rate_vehicle
from tests.trace.hidden_flights import flights, started

DELAY, LAG, DAMPING, PLAY = "control.delay", "control.lag", "forces.quadratic_damping", "control.backlash"
SUSPECTS = (DELAY, LAG, DAMPING)


@cache
def nothing() -> tuple[Flights, Fitted]:
    return started(flights())


@cache
def late() -> tuple[Flights, Fitted]:
    return started(flights(DELAY, control__delay__common=0.06))


@cache
def draws_of(hidden: bool) -> Draws:
    known = late() if hidden else nothing()
    return Trajectories(known[0]).draws_by_chance(family(known[1], SUSPECTS), SUSPECTS, 0)


def search_of(known: Flights, draws: Draws | None = None, said: list[str] | None = None) -> Search:
    if draws is None:
        return Search(Trajectories(known))
    return Search(Trajectories(known), lambda null, effects, beside: draws, (said if said is not None else []).append)


def test_fits_go_on_while_they_gain(monkeypatch: pytest.MonkeyPatch):
    known, null = nothing()
    rough = refit(null.spec, known, {}, care=Care(replace(CAREFUL, max_iterations=1)))
    monkeypatch.setattr("rotorid_torch.trace.search.trajectories.CAREFUL", replace(CAREFUL, max_iterations=1))
    monkeypatch.setattr("rotorid_torch.trace.search.trajectories.LONGEST", 30)
    on = Trajectories(known).settled(rough)
    assert rough.cost > null.cost + 10.0
    assert on.cost == pytest.approx(null.cost, abs=1.0)


def test_a_fit_that_has_converged_is_left_alone():
    known, null = nothing()
    end = Trajectories(known).settled(null)
    assert end.fit.minimum.converged
    assert Trajectories(known).settled(end) is end


def test_the_delay_joins_with_its_size_and_what_else_is_significant_was_fitted_too():
    known, null = late()
    said: list[str] = []
    search = search_of(known, draws_of(True), said)
    final = search.forward(null, SUSPECTS)
    assert [c.effect for c in search.joined] == [DELAY]
    assert final.values[f"{DELAY}.common"] == pytest.approx(0.06, abs=0.003)
    assert final.spec.effects == (*null.spec.effects, DELAY)
    first = search.first
    assert first is not None
    assert first.p[DELAY] == pytest.approx(1.0 / (1.0 + SETTINGS.draws))
    assert set(first.family.in_full) == {DELAY, LAG}  # of the control path, of which one is significant
    delay = search.trials[Candidate(DELAY)]
    assert delay.stands
    assert all(
        likelihood_gain(t.null, t.fitted) <= likelihood_gain(delay.null, delay.fitted) for t in search.trials.values()
    )
    assert f"{DELAY} joins" in said
    assert search.rivals[DELAY] == ()
    assert search.null is delay.null
    assert search.tested[DELAY].family.null is null
    assert search.tested[DELAY].p[DELAY] <= SETTINGS.level
    assert search.back(final, SUSPECTS) is final


def test_where_nothing_is_hidden_nothing_joins_and_nothing_is_fitted_in_full():
    known, null = nothing()
    search = search_of(known, draws_of(False))
    assert search.forward(null, SUSPECTS) is null
    assert search.joined == []
    assert search.trials == {}
    assert search.first is not None
    assert not search.first.family.in_full


def test_no_candidate_is_fitted_where_draws_show_as_much():
    """The delay's own statistic, in every draw."""
    known, null = late()
    observed = family(null, [DELAY]).statistics
    loud = {name: torch.full((SETTINGS.draws,), t, dtype=torch.float64) for name, t in observed.items()}
    search = search_of(known, Draws(loud, "", clean=True))
    assert search.forward(null, [DELAY]) is null
    assert search.trials == {}


def test_of_candidates_those_of_largest_evidence_are_fitted_first(monkeypatch: pytest.MonkeyPatch):
    known, null = late()
    search = search_of(known, draws_of(True))
    beside = family(null, SUSPECTS)
    p = dict.fromkeys(beside.statistics, 0.01)
    ranked = search._promising(Comparison(beside, p, Draws({})))
    statistics = [beside.statistics[c.name] for c in ranked]
    assert statistics == sorted(statistics, reverse=True)
    assert {c.effect for c in ranked} == set(SUSPECTS)
    assert len(ranked) == len(SUSPECTS)  # each with one size, or with one of each control, not both
    others = Comparison(beside, {**p, DELAY: 0.2, Candidate(DELAY, True).name: 0.2}, Draws({}))
    assert search._promising(others)[:1] != [Candidate(DELAY)]
    assert Comparison(beside, {LAG: 0.06, f"{DELAY} in forces": 0.05}, Draws({})).significant == {DELAY}
    monkeypatch.setattr("rotorid_torch.trace.search.forward_selection.SETTINGS", replace(SETTINGS, fits=1))
    _, best = search._joining(null, Comparison(beside, p, draws_of(True)), ranked)
    assert best is not None
    assert list(search.trials) == [best.candidate] == ranked[:1]


def test_where_none_of_the_first_stands_the_next_ones_are_fitted(monkeypatch: pytest.MonkeyPatch):
    """The damping first, which does not act, one fit at a time."""
    known, null = late()
    search = search_of(known, draws_of(True))
    tested = search.family_beside(null, SUSPECTS)
    monkeypatch.setattr("rotorid_torch.trace.search.forward_selection.SETTINGS", replace(SETTINGS, fits=1))
    null, best = search._joining(null, tested, [Candidate(DAMPING), Candidate(DELAY)])
    assert best is not None
    assert best.candidate == Candidate(DELAY)
    assert not search.trials[Candidate(DAMPING)].stands


def test_sizes_of_each_control_are_asked_only_where_flights_are_better_predicted_by_them():
    """One control is late, another one early: together they are not late at all."""
    own = {"control__delay__lat": 0.06, "control__delay__lon": -0.06}
    for known, each in ((late(), False), (started(flights(DELAY, **own)), True)):
        beside = family(known[1], [DELAY])
        found = search_of(known[0])._promising(Comparison(beside, dict.fromkeys(beside.statistics, 0.01), Draws({})))
        assert found == [Candidate(DELAY, each)]


def test_an_effect_that_joined_is_taken_out_where_it_is_nothing_in_the_end():
    known, null = nothing()
    search = search_of(known, draws_of(False))
    search.family_beside(null, [DELAY])
    final = refit(null.spec.with_effects(DELAY), known, null.values, near=null)
    search.trials[Candidate(DELAY)] = Trial(Candidate(DELAY), null, final, Row())
    search.joined = [Candidate(DELAY)]
    assert search.back(final, [DELAY]).spec == null.spec
    assert search.joined == []
    assert not search.trials[Candidate(DELAY)].stands


def test_an_effect_that_is_real_in_the_end_stays():
    known, null = late()
    search = search_of(known, draws_of(True))
    search.family_beside(null, [DELAY])
    final = refit(null.spec.with_effects(DELAY), known, {**null.values, f"{DELAY}.common": 0.05}, near=null)
    search.trials[Candidate(DELAY)] = Trial(Candidate(DELAY), null, final, row_of(null, final, Candidate(DELAY)))
    search.joined = [Candidate(DELAY)]
    assert search.back(final, [DELAY]) is final
    assert search.joined == [Candidate(DELAY)]


def test_a_size_that_clean_aircraft_show_as_well_is_none():
    """A delay of 60 ms where sizes of clean aircraft scatter by as much: the interval holds nothing, whatever p is."""
    known, null = late()
    sizes = {f"{DELAY}.common": torch.linspace(-0.1, 0.1, 19, dtype=torch.float64)}
    search = search_of(known, replace(draws_of(True), sizes=sizes))
    assert search.forward(null, [DELAY]) is not None
    assert search.joined == []
    assert search.trials[Candidate(DELAY)].row.estimate is Interval.WITHIN_ERROR


@pytest.mark.parametrize("first", [DELAY, DAMPING])
def test_what_explains_nothing_beside_the_others_goes_whatever_joined_first(first: str):
    """Damping that does not act beside a delay that does."""
    known, null = late()
    search = search_of(known, draws_of(True))
    search.family_beside(null, SUSPECTS)
    spec = null.spec.with_effects(DELAY, DAMPING)
    both = refit(spec, known, {**null.values, f"{DELAY}.common": 0.05, f"{DAMPING}.L": 0.1}, near=null)
    search.joined = [Candidate(first), Candidate(DAMPING if first == DELAY else DELAY)]
    alone = refit(null.spec.with_effects(first), known, both.values, near=both)
    search.trials = {c: Trial(c, null, one, Row()) for c, one in zip(search.joined, (alone, both), strict=True)}
    final = search.back(both, SUSPECTS)
    assert [c.effect for c in search.joined] == [DELAY]
    assert DAMPING not in final.spec.effects
    assert final.values[f"{DELAY}.common"] == pytest.approx(0.06, abs=0.003)


@pytest.mark.parametrize("first", [DELAY, DAMPING])
def test_names_do_not_depend_on_what_joined_first(first: str):
    """A damping that does not act makes room for a delay that does, which then keeps its place."""
    known, null = late()
    search = search_of(known, draws_of(True))
    search.family_beside(null, SUSPECTS)
    start = {**null.values, f"{DELAY}.common": 0.05, f"{DAMPING}.L": 0.1}
    alone = refit(null.spec.with_effects(first), known, start, near=null)
    search.joined = [Candidate(first)]
    search.trials = {Candidate(first): Trial(Candidate(first), null, alone, Row())}
    final = search.selected(alone, SUSPECTS)
    assert [c.effect for c in search.joined] == [DELAY]
    assert [e for e in SUSPECTS if e in final.spec.effects] == [DELAY]
    late_by = [v for n, v in final.values.items() if n.startswith(f"{DELAY}.") and v]
    assert late_by == pytest.approx([0.06] * len(late_by), abs=0.003)


def test_an_effect_that_no_draw_knows_keeps_its_place_and_the_others_are_still_asked():
    """What explained trims stands first, before any family; what joined behind it is taken out all the same."""
    known, null = late()
    drawn = draws_of(True)
    others = {n: t for n, t in drawn.statistics.items() if not n.startswith(DELAY)}
    search = search_of(known, replace(drawn, statistics=others))
    search.family_beside(null, SUSPECTS)
    spec = null.spec.with_effects(DELAY, DAMPING)
    both = refit(spec, known, {**null.values, f"{DELAY}.common": 0.05, f"{DAMPING}.L": 0.1}, near=null)
    search.joined = [Candidate(DELAY), Candidate(DAMPING)]
    alone = refit(null.spec.with_effects(DELAY), known, both.values, near=both)
    search.trials = {c: Trial(c, null, one, Row()) for c, one in zip(search.joined, (alone, both), strict=True)}
    search.back(both, SUSPECTS)
    assert [c.effect for c in search.joined] == [DELAY]


def test_a_candidate_is_no_worse_for_a_flight_in_which_both_models_fly_away():
    """As the null does: three of four unseen flights are better described."""
    known, null = late()
    good = refit(null.spec.with_effects(DELAY), known, {**null.values, f"{DELAY}.common": 0.05}, near=null)
    away = [replace(one) for one in (null, good)]
    for one in away:
        residual = one.unseen.residual.clone()
        residual[one.unseen.flight == 2] = torch.inf
        vars(one)["unseen"] = replace(one.unseen, residual=residual)
    assert row_of(away[0], away[1], Candidate(DELAY)) == Row()
    assert row_of(null, away[1], Candidate(DELAY)).unseen_better is False


def test_what_joins_is_no_rival_of_what_joined_before():
    """One statement cannot say that flights do not tell two effects apart, and that both act."""
    search = search_of(late()[0])
    search.joined, search.rivals = [Candidate(DELAY)], {DELAY: (LAG, DAMPING)}
    search._joins(Candidate(LAG))
    assert search.joined == [Candidate(DELAY), Candidate(LAG)]
    assert search.rivals == {DELAY: (DAMPING,)}


def test_what_a_full_fit_says_of_a_candidate():
    known, null = late()
    good = refit(null.spec.with_effects(DELAY), known, {**null.values, f"{DELAY}.common": 0.05}, near=null)
    assert row_of(null, good, Candidate(DELAY)) == Row()
    assert row_of(good, null, Candidate(DELAY)).fitted is False
    assert row_of(good, null, Candidate(DELAY)).unseen_better is False
    early = refit(null.spec.with_effects(DELAY), known, {**null.values, f"{DELAY}.common": 0.0}, (f"{DELAY}.common",))
    assert row_of(null, early, Candidate(DELAY)).estimate is Interval.WITHIN_ERROR


def test_two_that_explain_the_same_are_rivals_until_one_explains_more_beside_the_other(
    monkeypatch: pytest.MonkeyPatch,
):
    """A delay under two names; and a delay that is far too short, which flights tell from it."""
    known, null = late()
    values, spec = {**null.values, f"{DELAY}.common": 0.05}, null.spec.with_effects(DELAY)
    good = refit(spec, known, values, near=null)
    short = refit(spec, known, {**values, f"{DELAY}.common": 0.03}, (f"{DELAY}.common",), near=null)
    search = search_of(known, draws_of(True))
    each = Candidate(DELAY, True)
    best = search._best(null, {Candidate(DELAY): good, each: replace(good)})
    assert best is not None
    assert search.rivals == {DELAY: (DELAY,)}
    search.rivals = {}
    monkeypatch.setattr("rotorid_torch.trace.search.forward_selection.row_of", lambda *given: Row())  # its size is held
    best = search._best(null, {each: short, Candidate(DELAY): good})
    assert best is not None
    assert (best.candidate, search.rivals) == (Candidate(DELAY), {DELAY: ()})
    search.joined, search.rivals = [best.candidate], {DELAY: (LAG,)}
    search._settle_rivals({DELAY})
    assert search.rivals == {DELAY: (LAG,)}
    search._settle_rivals({LAG})
    assert search.rivals == {DELAY: ()}


def noted_fits(monkeypatch: pytest.MonkeyPatch) -> list[Wanted]:
    """Fits as the search asks for them."""
    asked: list[Wanted] = []

    def noted(wanted: Sequence[Wanted], *rest: Any) -> list[Fitted]:
        asked.extend(wanted)
        return fits(wanted, *rest)

    monkeypatch.setattr("rotorid_torch.trace.search.trajectories.fits", noted)
    return asked


def test_a_candidate_begins_from_each_of_its_sizes_and_once_over_short_segments(monkeypatch: pytest.MonkeyPatch):
    known, null = late()
    asked = noted_fits(monkeypatch)
    sizes = [{f"{DELAY}.common": 0.03}, {f"{DELAY}.common": 0.1}]
    found = Trajectories(known).fitted(null, {Candidate(DELAY): sizes})[Candidate(DELAY)]
    begun = [one for one in asked if one.start.get(f"{DELAY}.common") in (0.03, 0.1)]
    assert [one.short_first for one in begun] == [False, False, True]
    assert found.values[f"{DELAY}.common"] == pytest.approx(0.06, abs=0.003)
    alone = fits(begun[:1], (), BEGINNING, Trajectories(known).ranks)[0]
    assert found.cost <= alone.cost + 1e-6


def test_a_play_begins_once_more_with_derivatives_of_the_measured_motion(monkeypatch: pytest.MonkeyPatch):
    """Far from a straight line the derivatives of a model without it lead astray."""
    known, null = started(flights(PLAY, control__backlash__width=0.012))
    asked = noted_fits(monkeypatch)
    sizes = [{f"{PLAY}.width": 0.01}, {f"{PLAY}.width": 0.005}]
    found = Trajectories(known).fitted(null, {Candidate(PLAY): sizes})[Candidate(PLAY)]
    truth = rate_vehicle().named_values["forces.M.lon"]
    wrong = abs(null.values["forces.M.lon"] - truth)
    assert [abs(one.start["forces.M.lon"] - truth) < wrong for one in asked[:5]] == [False, False, False, True, True]
    assert found.values[f"{PLAY}.width"] == pytest.approx(0.012, rel=0.1)


def test_beside_a_model_that_has_not_converged_evidence_of_a_play_is_that_of_a_fit_in_full():
    """A straight line about it tells nothing; where it has converged the line stands, and nothing is fitted."""
    known, null = started(flights(PLAY, control__backlash__width=0.012))
    shared = Trajectories(known)
    assert not shared.family(shared.settled(null), [PLAY, DAMPING]).fitted
    rough = refit(null.spec, known, {}, care=Care(replace(CAREFUL, max_iterations=1)))
    asked = shared.family(rough, [PLAY, DAMPING])
    assert list(asked.fitted) == [Candidate(PLAY)]
    fitted = asked.fitted[Candidate(PLAY)]
    assert fitted.values[f"{PLAY}.width"] == pytest.approx(0.012, rel=0.1)
    settled = shared.settled(null)  # what the rough model gains by a better start is none of the play's
    assert asked.statistics[PLAY] == pytest.approx(float(settled.log_ratios(fitted).sum()), rel=0.05)
    assert asked.statistics[PLAY] < float(rough.log_ratios(fitted).sum())
    assert shared.candidates(rough, asked, [Candidate(PLAY)])[Candidate(PLAY)] is fitted


def test_what_a_better_start_of_the_null_gains_is_not_the_candidates():
    known, null = late()
    rough = refit(null.spec, known, {}, care=Care(replace(CAREFUL, max_iterations=1)))
    said: list[str] = []
    search = search_of(known, draws_of(True), said)
    good = refit(null.spec.with_effects(DELAY), known, {**null.values, f"{DELAY}.common": 0.05}, near=null)
    again = search.improved(rough, {Candidate(DELAY): good})
    assert again.cost == pytest.approx(search.scored.settled(null).cost, abs=1.0)
    assert "from a better start" in said[-1]
    assert search.improved(again, {Candidate(DELAY): good}) is again


def test_critical_values_of_a_search_alone_come_from_residuals_turned_in_time():
    known, null = nothing()
    search = search_of(known)
    search.family_beside(null, [DELAY])
    assert search.first is not None
    beside, p, draws = search.first.family, search.first.p, search.first.draws
    assert not draws.clean
    assert len(draws.statistics[DELAY]) == SETTINGS.draws
    assert p.keys() <= draws.statistics.keys()
    assert p.keys() >= {DELAY, f"{DELAY} of each control"}
    assert isinstance(beside, Family)
    assert p[DELAY] > SETTINGS.level


def a_delay_and_a_lag() -> tuple[Flights, Fitted, Search[Fitted]]:
    """A long delay and a short lag both act, and draws show as much of the delay as it explains beside the lag."""
    known, null = started(flights(DELAY, LAG, control__delay__common=0.08, control__lag__common=0.02))
    drawn = draws_of(True)
    loud = {
        n: torch.full_like(t, 1e3) if n.startswith(DELAY) else torch.zeros_like(t) for n, t in drawn.statistics.items()
    }
    search = search_of(known, replace(drawn, statistics=loud, clean=True))
    search.family_beside(null, SUSPECTS)
    return known, null, search


def test_no_later_effect_drives_out_an_earlier_one_that_explains_more():
    known, null, search = a_delay_and_a_lag()
    alone = refit(null.spec.with_effects(DELAY), known, {**null.values, f"{DELAY}.common": 0.08}, near=null)
    both = refit(null.spec.with_effects(DELAY, LAG), known, {**alone.values, f"{LAG}.common": 0.02}, near=alone)
    search.joined = [Candidate(DELAY), Candidate(LAG)]
    search.trials = {c: Trial(c, null, one, Row()) for c, one in zip(search.joined, (alone, both), strict=True)}
    assert search.back(both, SUSPECTS) is alone
    assert search.joined == [Candidate(DELAY)]
    assert not search.trials[Candidate(LAG)].stands


def test_the_model_before_a_later_effect_holds_nothing_that_has_left():
    """Damping stood before the delay and is out; the lag behind the delay goes, and damping does not come back."""
    known, null, search = a_delay_and_a_lag()
    damped = null.spec.with_effects(DAMPING, DELAY)
    once = refit(damped, known, {**null.values, f"{DELAY}.common": 0.08, f"{DAMPING}.L": 0.01}, near=null)
    both = refit(null.spec.with_effects(DELAY, LAG), known, {**once.values, f"{LAG}.common": 0.02}, near=null)
    search.joined = [Candidate(DELAY), Candidate(LAG)]
    search.trials = {c: Trial(c, null, one, Row()) for c, one in zip(search.joined, (once, both), strict=True)}
    final = search.back(both, SUSPECTS)
    assert final.spec.effects == (*null.spec.effects, DELAY)
    assert search.joined == [Candidate(DELAY)]


class DrawnWithEffects(Trajectories):
    drawn_with_effects = True


@pytest.mark.parametrize("shown", [False, True])
def test_the_least_goes_where_aircraft_that_have_the_others_show_as_much(shown: bool):
    """A long delay and a short lag act. Aircraft without either show nothing of the lag, those with the delay may."""
    known, null = started(flights(DELAY, LAG, control__delay__common=0.08, control__lag__common=0.02))
    alone = refit(null.spec.with_effects(DELAY), known, {**null.values, f"{DELAY}.common": 0.08}, near=null)
    both = refit(null.spec.with_effects(DELAY, LAG), known, {**alone.values, f"{LAG}.common": 0.02}, near=alone)
    quiet = {n: torch.zeros_like(t) for n, t in draws_of(True).statistics.items()}
    loud = {n: torch.full_like(t, 1e3 if n.startswith(LAG) else 0.0) for n, t in quiet.items()}
    asked: list[Null] = []

    def draw(null: Null, effects: Sequence[str], observed: Family[Fitted]) -> Draws:
        asked.append(null)
        note = f"19 with {' and '.join(null.joined.effects)}" if null.joined.effects else "19 aircraft"
        return Draws(loud if shown and null.joined.effects else quiet, note, clean=True)

    search = Search(DrawnWithEffects(known), draw)
    search.family_beside(null, SUSPECTS)
    search.joined = [Candidate(DELAY), Candidate(LAG)]
    search.trials = {c: Trial(c, null, one, Row()) for c, one in zip(search.joined, (alone, both), strict=True)}
    final = search.back(both, SUSPECTS)
    bare, beside = asked
    assert bare.joined.effects == ()
    assert (beside.joined.effects, beside.joined.candidate) == ((DELAY,), LAG)
    (size,) = {v for v in beside.sizes[DELAY].values() if v}
    assert size == float(f"{size:.1e}") == pytest.approx(0.1, abs=0.02)  # the lag's part too
    assert [c.effect for c in search.joined] == ([DELAY] if shown else [DELAY, LAG])
    assert search.notes == ("19 aircraft", f"of {LAG} 19 with {DELAY}")
    assert search.tested[LAG].p[LAG] == (1.0 if shown else 1.0 / (1.0 + SETTINGS.draws))
    assert LAG in final.spec.effects or shown
