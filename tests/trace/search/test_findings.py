"""What is said of each effect that was tested: verdict, reason, values, group, smallest visible size."""

from __future__ import annotations

from functools import cache

import pytest
import torch

from rotorid_torch.effects.registry import registered
from rotorid_torch.trace.evidence.critical_values import Draws
from rotorid_torch.trace.evidence.family import Family, family
from rotorid_torch.trace.evidence.fits import Fitted, refit
from rotorid_torch.trace.search.decide import Interval, Row
from rotorid_torch.trace.search.forward_selection import Comparison, Search, Trial
from rotorid_torch.trace.search.outcome import Outcome
from rotorid_torch.trace.search.trajectories import Trajectories
from rotorid_torch.trace.terms.candidate import Candidate
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.settings import SETTINGS
from tests.trace.hidden_flights import flights, started

DELAY, LAG, DAMPING = "control.delay", "control.lag", "forces.quadratic_damping"
TESTED = (DELAY, LAG, DAMPING)
NAME = f"{DELAY}.common"
GOOD = Row()


@cache
def late() -> tuple[Fitted, Fitted, Family, Draws]:
    """Null, model with the delay, the family beside the null and draws by chance."""
    known, null = started(flights(DELAY, control__delay__common=0.06))
    fitted = refit(null.spec.with_effects(DELAY), known, {**null.values, NAME: 0.05}, near=null)
    beside = family(null, TESTED)
    return null, fitted, beside, Trajectories(known).draws_by_chance(beside, TESTED, 0)


def outcome(share: float | None = None, row: Row | None = GOOD, p: float = 0.05, **rivals: tuple[str, ...]) -> Outcome:
    """A search in which the delay was tried with this row, and joined where nothing speaks against it."""
    null, fitted, beside, draws = late()
    search = Search(Trajectories(null.flights))
    adjusted = {name: 0.9 for name in beside.statistics if name in draws.statistics} | {DELAY: p}
    search.first = Comparison(beside, adjusted, draws)
    if row is not None:
        trial = Trial(Candidate(DELAY), null, fitted, row)
        search.trials[Candidate(DELAY)] = trial
        search.joined += [Candidate(DELAY)] if trial.stands else []
    search.rivals = {name.replace("__", "."): others for name, others in rivals.items()}
    return Outcome(search, fitted, share, {DELAY: "; control by control"}, {NAME: 0.5})


def of(found: Outcome, effect: str = DELAY) -> EffectFinding:
    (one,) = found.findings([effect])
    return one


def test_what_joined_is_accepted_with_its_values_p_and_how_controls_differ():
    _, fitted, beside, draws = late()
    told = of(outcome())
    assert (told.verdict, told.role, told.group) == ("accepted", "undeclared", ())
    assert (told.p, told.statistic, told.critical_value) == (
        0.05,
        beside.statistics[DELAY],
        draws.critical_values(beside.statistics)[DELAY],
    )
    assert told.statistic is not None
    assert told.critical_value is not None
    assert told.statistic > told.critical_value
    assert told.values[NAME] == (fitted.values[NAME], 0.5)  # no smaller than its scatter
    assert told.reason.endswith("; control by control")


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (Row(fitted=False), "explains nothing"),
        (Row(estimate=Interval.WITHIN_ERROR), f"{NAME} = 0.06"),
        (Row(estimate=Interval.ACTIVE_BOUND), "at the edge of its range"),
        (Row(unseen_better=False), "4 of 4 better"),
    ],
)
def test_what_was_fitted_in_full_and_refused_is_rejected_with_its_reason_and_values(row: Row, said: str):
    told = of(outcome(row=row))
    assert told.verdict == "rejected"
    assert said in told.reason
    assert told.values[NAME][0] == late()[1].values[NAME]


def test_what_is_no_more_than_where_nothing_is_missing_is_below_its_floor():
    told = of(outcome(row=None, p=0.4))
    assert (told.verdict, told.values) == ("below floor", {})
    size, unit = told.smallest_visible or pytest.fail("no size")
    assert 0.0 < size < 0.06
    assert unit == "s"


def test_the_smallest_visible_size_is_expected_to_reach_the_critical_value_in_four_of_five_cases():
    _, _, beside, draws = late()
    size, _ = of(outcome(row=None, p=0.4)).smallest_visible or pytest.fail("no size")
    typical = next(s for s in beside.screen.signatures if s.effect == DELAY).step
    reached = draws.statistics[DELAY] + beside.screen.expected(DELAY, size / typical)
    assert float((reached >= draws.critical_values(beside.statistics)[DELAY]).double().mean()) == pytest.approx(
        0.8, abs=0.06
    )


def test_where_chance_shows_nothing_at_all_there_is_no_smallest_visible_size():
    """Any size would be above a critical value of zero, which says nothing of four cases of five."""
    null, _, beside, draws = late()
    search = Search(Trajectories(null.flights))
    silent = Draws({n: 0.0 * t for n, t in draws.statistics.items()}, "", clean=True)
    search.first = Comparison(beside, dict.fromkeys(silent.statistics, 0.9), silent)
    told = of(Outcome(search, null, None, {}, {}))
    assert told.critical_value == 0.0
    assert told.smallest_visible is None


def test_what_these_flights_would_not_show_at_its_usual_size_is_told_with_what_takes_its_place():
    null, _, beside, draws = late()
    loud = Draws({n: t + 1e6 for n, t in draws.statistics.items()}, "", clean=True)
    loud.statistics[DELAY][0] = 3e6  # type: ignore[index]
    search = Search(Trajectories(null.flights))
    search.first = Comparison(beside, dict.fromkeys(loud.statistics, 0.9), loud)
    told = of(Outcome(search, null, None, {}, {}))
    assert told.verdict == "indistinguishable"
    assert told.group == beside.screen.imitators(DELAY)
    assert told.reason.endswith(f"{registered()[DELAY].separated_by} would tell")
    assert told.smallest_visible is None


def test_what_the_one_that_joined_explains_better_is_rejected():
    _, _, beside, draws = late()
    found = outcome()
    assert found.search.first is not None
    found.search.first = Comparison(beside, {**found.search.first.p, LAG: 0.05}, draws)
    told = of(found, LAG)
    assert (told.verdict, told.values) == ("rejected", {})
    assert told.reason == f"what it would explain, {DELAY} explains better"


def test_those_that_flights_cannot_tell_apart_are_a_group_of_which_only_the_one_in_the_model_has_values():
    found = outcome(control__delay=(LAG,))
    assert found.search.first is not None
    beside, p, draws = found.search.first.family, found.search.first.p, found.search.first.draws
    found.search.first = Comparison(beside, {**p, LAG: 0.05}, draws)
    delay, lag = found.findings([DELAY, LAG])
    assert (delay.verdict, delay.group) == ("indistinguishable", (LAG,))
    assert (lag.verdict, lag.group) == ("indistinguishable", (DELAY,))
    assert delay.values
    assert not lag.values
    assert DELAY in lag.reason
    assert LAG in delay.reason


@pytest.mark.parametrize(
    ("share", "verdict"),
    [
        (None, "accepted"),
        (0.7, "accepted"),
        (0.5, "accepted"),
        (0.49, "suspected"),
        (0.3, "suspected"),
        (-0.2, "suspected"),
    ],
)
def test_a_name_that_leaves_most_without_a_name_is_suspected(share: float | None, verdict: str):
    found = outcome(share)
    told = of(found)
    assert told.verdict == verdict
    assert found.adequate == (verdict == "accepted")
    if share is not None and verdict == "suspected":
        assert f"explains {100.0 * max(share, 0.0):.0f} %" in told.reason


def test_what_joined_beside_another_effect_is_accepted_though_alone_it_was_hidden():
    """Its p beside the null is large: p, gain and floor are told of where it joined."""
    found = outcome(p=0.6)
    _, fitted, beside, draws = late()
    there = family(fitted, [LAG, DAMPING])
    found.search.tested[LAG] = Comparison(there, {LAG: 0.05}, draws)
    found.search.joined = [Candidate(LAG)]
    found.search.trials[Candidate(LAG)] = Trial(Candidate(LAG), fitted, fitted, GOOD)
    found.search.first = Comparison(beside, {LAG: 0.6}, draws)
    told = of(found, LAG)
    assert (told.verdict, told.p) == ("accepted", 0.05)
    assert (told.statistic, told.critical_value) == (
        there.statistics[LAG],
        draws.critical_values(there.statistics)[LAG],
    )


def test_an_effect_that_was_placed_before_the_family_has_a_finding_too():
    """Of a wind that explains trims the family knows nothing: it is in the model already."""
    null, fitted, _, _ = late()
    search = Search(Trajectories(null.flights))
    beside = family(null, [LAG])
    drawn = Draws({n: torch.zeros(SETTINGS.draws) for n in beside.statistics}, "", clean=True)
    search.first = Comparison(beside, dict.fromkeys(drawn.statistics, 0.9), drawn)
    search.trials[Candidate(DELAY)] = Trial(Candidate(DELAY), null, fitted, Row())
    search.joined = [Candidate(DELAY)]
    told = of(Outcome(search, fitted, None, {}, {}))
    assert (told.verdict, told.p) == ("accepted", None)
    assert told.values[NAME][0] == fitted.values[NAME]
