"""The search goes on with fits while they gain what matters."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from rotorid_torch.trace.fits import CAREFUL, Fitted, refit
from rotorid_torch.trace.floor import Floors
from rotorid_torch.trace.search import Search
from rotorid_torch.trace.spread import Wanted, fits
from tests.known_models import rate_vehicle
from tests.trace.hidden_flights import flights, started


def test_fits_go_on_while_they_gain_what_matters_to_each(monkeypatch: pytest.MonkeyPatch):
    known, null = started(flights())
    rough = refit(null.spec, known, {}, options=replace(CAREFUL, max_iterations=1))
    monkeypatch.setattr("rotorid_torch.trace.search.CAREFUL", replace(CAREFUL, max_iterations=1))
    monkeypatch.setattr("rotorid_torch.trace.search.LONGEST", 30)
    search = Search(known, (), Floors({}, ""), lambda line: None, 0)
    on = search.gone_on({"careful": rough, "easy": rough}, {"careful": 0.0, "easy": math.inf})
    assert on["careful"].cost == pytest.approx(null.cost, abs=1.0)
    assert on["careful"].cost + 10.0 < on["easy"].cost < rough.cost


def test_an_effect_that_joined_is_taken_out_where_it_is_nothing_in_the_end():
    known, null = started(flights())
    late = refit(null.spec.with_effects("control.delay"), known, null.values, near=null)
    search = Search(known, (), Floors({}, ""), lambda line: None, 0)
    final, accepted = search.confirmed(late, ["control.delay"], {"control.delay": -math.inf})
    assert (accepted, final.spec.effects) == ([], null.spec.effects)
    assert "standard errors from nothing" in search.rejected["control.delay"][0]


def test_an_effect_that_is_real_in_the_end_stays():
    known, null = started(flights("control.delay", control__delay__common=0.06))
    late = refit(null.spec.with_effects("control.delay"), known, {**null.values, "control.delay.common": 0.05})
    search = Search(known, (), Floors({}, ""), lambda line: None, 0)
    assert search.confirmed(late, ["control.delay"], {"control.delay": 1e-3}) == (late, ["control.delay"])


def test_a_fit_that_is_lost_begins_again_over_short_segments(monkeypatch: pytest.MonkeyPatch):
    known, null = started(flights("control.delay", control__delay__common=0.06))
    asked: list[list[bool]] = []

    def lost_at_first(wanted: list[Wanted], *rest: Any) -> list[Fitted]:
        asked.append([one.short_first for one in wanted])
        found = zip(wanted, fits(wanted, *rest), strict=True)
        return [one if w.short_first else replace(one, fit=null.fit) for w, one in found]

    monkeypatch.setattr("rotorid_torch.trace.search.fits", lost_at_first)
    search = Search(known, (), Floors({}, ""), lambda line: None, 0)
    starts = {"control.delay": [{"control.delay.common": 0.03}, {"control.delay.common": 0.1}]}
    found = search.with_each(null, starts, {"control.delay": -1.0})["control.delay"]
    assert [one for one in asked if one][:2] == [[False, False], [True, True]]
    assert found.values["control.delay.common"] == pytest.approx(0.06, abs=0.003)


def test_a_model_that_lost_its_way_is_found_again_over_short_segments():
    known, null = started(flights())
    astray = refit(null.spec, known, {}, options=replace(CAREFUL, max_iterations=1))
    search = Search(known, (), Floors({}, ""), lambda line: None, 0)
    assert search.over_short(astray).cost == pytest.approx(null.cost, abs=1.0)
    assert search.over_short(null).cost <= null.cost


@pytest.mark.parametrize(
    ("unseen", "kept"),
    [((0.1, -0.02, 0.05, 0.0), True), ((-0.3, -0.31, -0.5, -0.22), False), ((-math.inf, -0.3, -0.4, -0.3), False)],
)
def test_a_model_that_describes_unseen_flights_worse_is_no_better_start(
    monkeypatch: pytest.MonkeyPatch, unseen: tuple[float, ...], kept: bool
):
    known, null = started(flights())
    astray = refit(null.spec, known, {}, options=replace(CAREFUL, max_iterations=1))
    told = torch.tensor(unseen, dtype=torch.float64)
    monkeypatch.setattr("rotorid_torch.trace.search.unseen_gain", lambda before, after: told)
    found = Search(known, (), Floors({}, ""), lambda line: None, 0).over_short(astray)
    assert (found is not astray) is kept


def test_errors_of_a_named_delay_hold_what_delays_seem_to_be_on_clean_aircraft():
    """Of a parameter that was estimated."""
    known, null = started(flights("control.delay", control__delay__common=0.06))
    late = refit(null.spec.with_effects("control.delay"), known, {**null.values, "control.delay.common": 0.06})
    seemed = torch.tensor([-0.02, 0.01, -0.01, 0.0], dtype=torch.float64)
    sizes = {"control.delay.common": seemed, "control.delay.lon": seemed}
    search = Search(known, (), Floors({}, "", sizes=sizes), lambda line: None, 0)
    search.compare_clean(late, ["control.delay"])
    assert search.spread["control.delay.common"] >= float(seemed.std())
    assert "control.delay.lon" not in search.spread


def test_ordinary_physics_that_gains_nothing_is_told(monkeypatch: pytest.MonkeyPatch):
    known, null = started(flights())
    monkeypatch.setattr("rotorid_torch.trace.search.screen", lambda *a, **k: SimpleNamespace(sizes=lambda effects: {}))
    monkeypatch.setattr("rotorid_torch.trace.search.refit", lambda *a, **k: null)
    monkeypatch.setattr("rotorid_torch.trace.search.fits", lambda *a, **k: [null])
    search = Search(known, (), Floors({}, ""), lambda line: None, 0)
    assert search.structure(null, ["rotor.lead_lag"]) is null
    assert search.ordinary["rotor.lead_lag"].verdict == "rejected"


def test_a_fit_that_fails_on_unseen_flights_begins_again_from_what_was_identified(monkeypatch: pytest.MonkeyPatch):
    known, null = started(flights("control.delay", control__delay__common=0.06))
    asked: list[Wanted] = []

    def stuck_at_first(wanted: list[Wanted], *rest: Any) -> list[Fitted]:
        asked.extend(wanted)
        one_step = replace(CAREFUL, max_iterations=1)
        again = iter(fits([one for one in wanted if one.short_first], *rest))
        return [next(again) if w.short_first else refit(w.spec, known, w.start, options=one_step) for w in wanted]

    monkeypatch.setattr("rotorid_torch.trace.search.fits", stuck_at_first)
    monkeypatch.setattr("rotorid_torch.trace.search.LONGEST", 0)
    start = {"control.delay": [{"control.delay.common": 0.01}]}

    def found(identified: dict[str, float], fails: bool) -> Fitted:
        monkeypatch.setattr("rotorid_torch.trace.search.helps", lambda better: not fails)
        search = Search(known, (), Floors({}, ""), lambda line: None, 0, identified=identified)
        return search.with_each(null, start, {"control.delay": 0.0})["control.delay"]

    stuck = found({}, fails=True)
    assert found(null.values, fails=False).cost == stuck.cost
    assert not any(one.short_first for one in asked)
    elsewhere = {n: 0.9 * v for n, v in null.values.items()}
    freed = found(elsewhere, fails=True)
    assert asked[-1].short_first
    assert elsewhere.items() <= asked[-1].start.items()
    assert asked[-1].start["control.delay.common"] == stuck.values["control.delay.common"]
    assert freed.cost < stuck.cost
    assert freed.values["control.delay.common"] == pytest.approx(0.06, abs=0.005)


def test_plays_are_sought_on_the_measured_motion_with_derivatives_beside_them():
    play = "control.backlash"
    known, null = started(flights(play, control__backlash__width=0.012))
    search = Search(known, (), Floors({}, ""), lambda line: None, 0, each_floor={play: 0.001, "control.lag": 0.001})
    found = search._loose_or_slow(null, (), {})
    assert set(found) == set(search.alone) == {play}
    for control in ("lon", "lat", "ped"):
        assert found[play].values[f"{play}.{control}"] == pytest.approx(0.012, rel=0.05)
    assert search._loose_or_slow(null, (), found) == {}
    alike = refit(null.spec.with_effects(play), known, {**null.values, f"{play}.width": 0.012}, near=null)
    assert search._loose_or_slow(null, (), {play: alike}) == {}  # more sizes explain no more
    known, null = started(flights())
    assert search._loose_or_slow(null, (), {}) == {}


def test_a_play_begins_once_more_with_derivatives_beside_it():
    play = "control.backlash"
    _, null = started(flights(play, control__backlash__width=0.012))
    search = Search(null.flights, (), Floors({}, ""), lambda line: None, 0)
    starts = {play: [{f"{play}.width": 0.01}], "control.lag": [{"control.lag.common": 0.1}]}
    found = search._with_derivatives(null, starts, [])
    assert found["control.lag"] == starts["control.lag"]
    first, again = found[play]
    assert (first, again[f"{play}.width"]) == ({f"{play}.width": 0.01}, 0.01)
    truth = rate_vehicle().named_values["forces.M.lon"]
    assert abs(again["forces.M.lon"] - truth) < abs(null.values["forces.M.lon"] - truth)


def test_beside_a_slew_limit_another_effect_of_the_control_path_is_to_explain_more_than_its_shape():
    known, _ = started(flights())
    search = Search(known, (), Floors({}, ""), lambda line: None, 0, gained={"control.rate_limit": (0.2, 0.001)})
    floors = {"control.lag": 0.001, "control.delay": 0.02, "mass.slung_load": 0.001}
    assert search._beside(["control.rate_limit"], floors) == floors | {"control.lag": pytest.approx(0.01)}
    assert search._beside(["mass.slung_load"], floors) == floors
