"""p and critical values hold the share of false alarms over all candidates together, where draws stop early too."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.trace.evidence.critical_values import Draws
from rotorid_torch.trace.terms.settings import SETTINGS

NAMES = ("a", "b", "c", "d")
SCALES = torch.tensor([1.0, 100.0, 1e-3, 5.0], dtype=torch.float64)
LEVEL = SETTINGS.level


def families(count: int, draws: int, seed: int, shift: float = 0.0) -> list[tuple[dict[str, float], dict[str, Tensor]]]:
    """Correlated statistics of very different scales: those of the data, `shift` e-folds larger, and those of draws."""
    chance = torch.Generator().manual_seed(seed)
    found = []
    for _ in range(count):
        common = torch.randn(1 + draws, 1, generator=chance, dtype=torch.float64)
        table = (common + torch.randn(1 + draws, 4, generator=chance, dtype=torch.float64)).exp() * SCALES
        observed = {e: float(t) * float(np.exp(shift)) for e, t in zip(NAMES, table[0], strict=True)}
        found.append((observed, {e: table[1:, k] for k, e in enumerate(NAMES)}))
    return found


def standard_error(share: float, count: int) -> float:
    return (share * (1.0 - share) / count) ** 0.5


def test_p_holds_its_level_for_correlated_effects_of_any_scale():
    """Exchangeable data and draws: at most 5 % of the families have any p of 5 % or less."""
    alarms = [min(Draws(one[1]).adjusted_p(one[0]).values()) <= LEVEL for one in families(600, 39, 0)]
    assert sum(alarms) / 600 < LEVEL + 3.0 * standard_error(LEVEL, 600)


def test_p_counts_draws_and_steps_down():
    clean = {"a": torch.arange(19.0).double(), "b": torch.arange(19.0).double()}
    p = Draws(clean).adjusted_p({"a": 1e3, "b": 9.5})
    assert p["a"] == pytest.approx(1 / 20)
    assert p["b"] == pytest.approx((1 + 9) / 20)  # once a is set aside, b is compared with its own draws alone


def test_p_is_monotone_in_the_statistic():
    clean = {e: torch.linspace(-1, 1, 9).double() for e in "abc"}
    p = Draws(clean).adjusted_p({"a": 0.9, "b": 0.1, "c": -0.5})
    assert p["a"] <= p["b"] <= p["c"] <= 1.0


def test_no_p_is_smaller_than_one_in_all_draws_and_the_data():
    """With 1 / level - 1 draws the smallest p is the level."""
    drawn = {e: torch.zeros(SETTINGS.draws, dtype=torch.float64) for e in NAMES}
    assert min(Draws(drawn).adjusted_p(dict.fromkeys(NAMES, 1e9)).values()) == pytest.approx(LEVEL)
    assert Draws({}).adjusted_p({}) == {}


def test_p_is_that_of_the_largest_statistics_by_the_textbook():
    """Westfall and Young's free step-down, written out, in units of mean sizes over data and draws, and the median."""
    for observed, drawn in families(20, 19, 5, shift=1.0):
        everything = {e: np.array([observed[e], *drawn[e].tolist()]) for e in NAMES}
        sizes = {e: np.abs(t).mean() for e, t in everything.items()}
        usual = sorted(sizes.values())[(len(sizes) - 1) // 2]
        scaled = {e: t / (sizes[e] + usual) for e, t in everything.items()}
        order, p, least = sorted(NAMES, key=lambda e: -scaled[e][0]), {}, 0.0
        for k, e in enumerate(order):
            largest = [max(scaled[o][1 + d] for o in order[k:]) for d in range(19)]
            least = max(least, (1 + sum(one >= scaled[e][0] for one in largest)) / 20)
            p[e] = least
        assert Draws(drawn).adjusted_p(observed) == pytest.approx(p)


def test_a_member_that_is_nothing_in_all_draws_but_one_hides_no_cause():
    """In units of its own mean alone that draw, 0.1 / (0.1 / 20), would be as extreme as a statistic can be."""
    drawn = {name: torch.zeros(19, dtype=torch.float64) for name in ("cause", "never", "once")}
    drawn |= {f"ordinary {k}": torch.linspace(0.01, 0.02 * k, 19).double() for k in range(1, 5)}
    drawn["cause"][3], drawn["once"][7] = 0.001, 0.1
    observed = dict.fromkeys(drawn, 0.0) | {"cause": 0.5}
    least = dict.fromkeys(drawn, 1e-4)
    assert Draws(drawn, least=least).adjusted_p(observed)["cause"] == pytest.approx(1 / 20)


def test_a_statistic_smaller_than_that_of_any_parameter_is_not_magnified():
    """A member that is nothing in every draw is not named by next to nothing, where its least size is told."""
    drawn = {"never": torch.zeros(19, dtype=torch.float64), "often": torch.linspace(0.1, 2.0, 19).double()}
    observed = {"never": 1e-6, "often": 1.0}
    assert Draws(drawn).adjusted_p(observed)["never"] == pytest.approx(1 / 20)
    assert Draws(drawn, least={"never": 0.5}).adjusted_p(observed)["never"] > 0.4
    nothing = dict.fromkeys(drawn, 0.0)
    assert Draws(drawn).critical_values(nothing)["never"] < 1e-200
    assert Draws(drawn, least={"never": 0.5}).critical_values(nothing)["never"] > 0.1


@pytest.mark.parametrize("shift", [0.0, 1.0, 3.0])
def test_a_statistic_is_above_its_critical_value_where_hardly_a_draw_shows_as_much(shift: float):
    """Single-step, in the same units: above it at most 5 % of the draws' largest statistics are no smaller."""
    least, above = dict.fromkeys(NAMES, 0.01), 0
    for observed, drawn in families(60, SETTINGS.draws, 8, shift):
        critical = Draws(drawn, least=least).critical_values(observed)
        p = Draws(drawn, least=least).adjusted_p(observed)
        best = min(p, key=lambda e: p[e])
        first = max(observed, key=lambda e: observed[e] / critical[e])
        assert (observed[first] > critical[first]) == (p[best] <= LEVEL)
        above += observed[first] > critical[first]
    assert above > 30 if shift == 3.0 else above < 60


@pytest.mark.parametrize("shift", [0.0, 1.0, 3.0])
def test_each_statistic_is_above_its_critical_value_just_where_p_is_at_most_the_level(shift: float):
    """Step-down too: what stands out beside a member that stands out more is compared without that one's draws."""
    for observed, drawn in families(200, SETTINGS.draws, 11, shift):
        p, critical = Draws(drawn).adjusted_p(observed), Draws(drawn).critical_values(observed)
        assert {e: observed[e] > critical[e] for e in NAMES} == {e: p[e] <= LEVEL for e in NAMES}
    drawn = {"a": torch.tensor([0.9, *[0.1 / 18] * 18], dtype=torch.float64), "b": torch.full((19,), 0.05).double()}
    observed = {"a": 1.0, "b": 0.5}  # the one large draw of a is no draw of b
    assert Draws(drawn).adjusted_p(observed) == pytest.approx({"a": LEVEL, "b": LEVEL})
    assert all(observed[e] > one for e, one in Draws(drawn).critical_values(observed).items())


def test_what_predicts_flights_worse_is_no_evidence_however_much_worse_draws_are():
    drawn = {"a": torch.full((SETTINGS.draws,), -2.0, dtype=torch.float64)}
    assert Draws(drawn).adjusted_p({"a": -1.0})["a"] == 1.0
    assert Draws(drawn).critical_values({"a": -1.0})["a"] >= 0.0
    assert Draws(drawn).adjusted_p({"a": 0.1})["a"] == pytest.approx(LEVEL)


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -float("inf")])
def test_a_statistic_that_is_no_number_tells_nothing_of_the_others(wrong: float):
    drawn = {e: torch.linspace(0.1, 2.0, SETTINGS.draws).double() for e in "ab"}
    drawn["a"][3] = wrong
    assert Draws(drawn).adjusted_p({"a": 0.5, "b": 0.5})["b"] > 0.5
    assert Draws(drawn).adjusted_p({"a": wrong, "b": 0.5})["b"] > 0.5
    assert Draws(drawn).adjusted_p({"a": wrong, "b": 0.5})["a"] == 1.0
    assert Draws(drawn).critical_values({"a": 0.5, "b": 0.5})["b"] > 0.5


def test_the_critical_value_of_a_single_member_is_the_largest_draw_where_data_reach_it():
    drawn = torch.arange(1.0, 20.0, dtype=torch.float64)
    assert Draws({"a": drawn}).critical_values({"a": 19.0})["a"] == pytest.approx(19.0)
    assert Draws({"a": drawn}).critical_values({"a": 18.0})["a"] > 18.0
    assert Draws({"a": drawn}).critical_values({"a": 20.0})["a"] < 20.0
    assert Draws({}).critical_values({}) == {}


def test_effects_of_the_library_are_a_family_and_what_has_no_name_is_compared_with_all():
    """What ordinary aircraft leave over without a name costs no name its place."""
    chance = torch.Generator().manual_seed(9)
    library = {e: torch.rand(19, generator=chance, dtype=torch.float64) for e in NAMES}
    nameless = {f"unattributed {e}": 9.0 ** torch.rand(19, generator=chance, dtype=torch.float64) for e in NAMES}
    observed = dict.fromkeys(library, 1.1) | dict.fromkeys(nameless, 1.0)
    found, together = Draws(library | nameless).p_values(observed), Draws(library | nameless).adjusted_p(observed)
    assert {e: found[e] for e in library} == Draws(library).adjusted_p({e: observed[e] for e in library})
    assert {e: found[e] for e in nameless} == {e: together[e] for e in nameless}
    assert Draws(library).p_values({"a": 1.0, "else": 1.0}).keys() == {"a"}
    draws = Draws(library | nameless, "", clean=True)
    assert draws.critical_values(observed) == Draws(library).critical_values({e: observed[e] for e in NAMES})


def stopped(observed: Mapping[str, float], drawn: Mapping[str, Tensor]) -> int:
    """Draws after which the search stops."""
    count = len(drawn["a"])
    return next((n for n in range(1, count) if Draws({e: t[:n] for e, t in drawn.items()}).clear(observed)), count)


def test_stopping_early_keeps_the_level_and_nearly_all_names():
    """Where draws stop no p is small, so no name is added; the scales of heavy tails may still change, and lose one."""
    early = alarms = lost = 0
    for observed, drawn in families(300, SETTINGS.draws, 1):
        n = stopped(observed, drawn)
        whole = min(Draws(drawn).adjusted_p(observed).values())
        some = min(Draws({e: t[:n] for e, t in drawn.items()}).adjusted_p(observed).values())
        assert n == SETTINGS.draws or some > LEVEL
        early += n < SETTINGS.draws
        alarms += some <= LEVEL
        lost += some > LEVEL >= whole
    assert alarms / 300 < LEVEL + 3.0 * standard_error(LEVEL, 300)
    assert lost / 300 < 0.02
    assert early > 200  # what it is for


def test_draws_stop_when_the_effect_that_is_asked_for_is_clear():
    """Whatever the others show."""
    members = ("a", "b", "b of each control", "b2")
    drawn = {e: torch.linspace(1.0, 2.0, SETTINGS.earliest, dtype=torch.float64) for e in members}
    observed = {"a": 1e3, "b": 0.5, "b of each control": 0.5, "b2": 1e3}
    assert Draws(drawn).clear(observed, effect="b")
    assert not Draws(drawn).clear(observed, effect="a")
    assert not Draws(drawn).clear(observed)


def test_a_large_statistic_asks_for_all_draws():
    for observed, drawn in families(40, SETTINGS.draws, 2, shift=6.0):
        assert stopped(observed, drawn) == SETTINGS.draws
        assert min(Draws(drawn).adjusted_p(observed).values()) == pytest.approx(1.0 / (1.0 + SETTINGS.draws))


def test_the_answer_of_one_member_is_settled_as_soon_as_draws_stop():
    """Draws that exceed the data can only become more: p is then at least (1 + exceeding) / (1 + all draws)."""
    chance = torch.Generator().manual_seed(3)
    for _ in range(100):
        drawn = {"a": torch.rand(SETTINGS.draws, generator=chance, dtype=torch.float64)}
        observed = {"a": float(torch.rand((), generator=chance, dtype=torch.float64))}
        if stopped(observed, drawn) < SETTINGS.draws:
            assert Draws(drawn).adjusted_p(observed)["a"] >= (1 + SETTINGS.exceeding) / (1 + SETTINGS.draws)


def test_a_few_draws_settle_nothing_nor_do_those_that_hold_other_members():
    few = {"a": torch.ones(SETTINGS.earliest - 1, dtype=torch.float64)}
    assert not Draws(few).clear({"a": 0.0})
    assert Draws({"a": torch.ones(SETTINGS.earliest, dtype=torch.float64)}).clear({"a": 0.0})
    assert not Draws({"a": torch.ones(SETTINGS.draws, dtype=torch.float64)}).clear({"b": 0.0})
    assert not Draws({}).clear({"a": 0.0})
    fewer = torch.tensor([1.0] * (SETTINGS.exceeding - 1) + [0.0] * SETTINGS.earliest, dtype=torch.float64)
    assert not Draws({"a": fewer}).clear({"a": 0.5})
    assert Draws({"a": torch.cat([fewer, torch.ones(1, dtype=torch.float64)])}).clear({"a": 0.5})


def test_an_effect_is_visible_where_it_lifts_what_nothing_gives_over_its_critical_value():
    """Nothing gives a statistic above the lower fifth in 80 % of cases, and the effect adds its own."""
    chance = torch.Generator().manual_seed(6)
    draws = Draws({"a": torch.randn(400, generator=chance, dtype=torch.float64)}, "", clean=True)
    wanted = draws.visible("a", 3.0)
    again = torch.randn(4000, generator=chance, dtype=torch.float64) + wanted
    assert float((again >= 3.0).double().mean()) == pytest.approx(1.0 - SETTINGS.missed, abs=0.05)


def test_whatever_delays_seem_to_be_on_clean_aircraft_is_error():
    """Their mean too: an aircraft without a delay on which one of 8 ms is found every time tells nothing of 8 ms."""
    seemed = torch.tensor([0.007, 0.008, 0.009, 0.008], dtype=torch.float64)
    sizes = {"control.delay.common": seemed, "control.lag.common": 0.0 * seemed, "mass.cg.x": seemed[:1]}
    draws = Draws({}, "", clean=True, sizes=sizes)
    late = {"control.delay.common": 0.06, "mass.cg.x": 0.1}
    assert draws.errors(late) == {"control.delay.common": pytest.approx(0.008, rel=0.01)}  # one aircraft tells little


def test_what_clean_aircraft_show_the_other_way_is_no_error_of_a_size():
    seemed = torch.tensor([-0.007, -0.008, -0.009, -0.008], dtype=torch.float64)
    draws = Draws({}, "", clean=True, sizes={"control.delay.common": seemed})
    error = {"control.delay.common": pytest.approx(seemed.numpy().std(ddof=1))}
    assert draws.errors({"control.delay.common": 0.06}) == error
