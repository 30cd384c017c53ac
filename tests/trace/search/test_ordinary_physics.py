"""Ordinary physics that the nominal model leaves out joins by the evidence of flights alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import pytest

from rotorid_torch.trace.evidence.fits import Fitted, refit
from rotorid_torch.trace.search.forward_selection import Search
from rotorid_torch.trace.search.ordinary_physics import _over_short, _with_ordinary, with_structure, without_idle
from rotorid_torch.trace.search.trajectories import Trajectories
from tests.trace.hidden_flights import flights, started

DELAY, DAMPING = "control.delay", "forces.quadratic_damping"


@cache
def late() -> Fitted:
    return started(flights(DELAY, control__delay__common=0.06))[1]


def test_what_flights_ask_for_joins_and_what_they_do_not_ask_for_does_not():
    """By two effects of the library that take the part of ordinary physics here."""
    null = late()
    search = Search(Trajectories(null.flights))
    richer, findings = with_structure(search, Trajectories(null.flights), null, [DELAY, DAMPING])
    assert richer.spec.effects == (*null.spec.effects, DELAY)
    assert richer.values[f"{DELAY}.common"] == pytest.approx(0.06, abs=0.005)
    verdicts = {f.id: f.verdict for f in findings}
    assert verdicts[DELAY] == "accepted"
    assert verdicts[DAMPING] in ("below floor", "rejected")
    told = next(f for f in findings if f.id == DELAY)
    assert told.values[f"{DELAY}.common"][0] == richer.values[f"{DELAY}.common"]


def test_what_every_rotor_has_joins_where_a_fit_gains_by_it(monkeypatch: pytest.MonkeyPatch):
    null = late()
    search = Search(Trajectories(null.flights))
    richer, (told,) = _with_ordinary(search, Trajectories(null.flights), null, [DELAY], [])
    assert told.verdict == "accepted"
    assert richer.cost < null.cost
    monkeypatch.setattr("rotorid_torch.trace.search.ordinary_physics.refit", lambda *given, **named: null)
    same, (told,) = _with_ordinary(search, Trajectories(null.flights), null, [DELAY], [])
    assert same is null
    assert told.verdict == "rejected"
    assert _with_ordinary(search, Trajectories(null.flights), null, [], [DELAY]) == (null, [])


def test_what_every_rotor_has_waits_where_the_control_path_explains_more():
    """By a damping that takes the part of ordinary physics, and imitates the delay that is hidden."""
    null = late()
    search = Search(Trajectories(null.flights))
    richer, (joined,) = _with_ordinary(search, Trajectories(null.flights), null, [DAMPING], [])
    assert joined.verdict == "accepted"
    assert richer.cost < null.cost
    same, (waiting,) = _with_ordinary(search, Trajectories(null.flights), null, [DAMPING], [DELAY])
    assert waiting.verdict == "below floor"
    assert same is null


def test_structure_without_a_certain_size_stays_where_flights_not_fitted_gain_by_it():
    """By a delay that is in the flights and a damping that is not, both of sizes within their errors."""
    null = late()
    shared = Trajectories(null.flights)
    sizes = {f"{DELAY}.common": 0.06, f"{DAMPING}.p": 0.0}
    whole = refit(null.spec.with_effects(DELAY, DAMPING), null.flights, {**null.values, **sizes}, near=null)
    final, left = without_idle(Search(shared), shared, whole, [DELAY, DAMPING])
    assert left == [DAMPING]
    assert final.spec.effects == (*null.spec.effects, DELAY)


@pytest.mark.parametrize("better", [True, False])
def test_a_start_over_short_segments_counts_only_where_it_ends_better(monkeypatch: pytest.MonkeyPatch, better: bool):
    null = late()
    rich = refit(null.spec.with_effects(DELAY), null.flights, {**null.values, f"{DELAY}.common": 0.06}, near=null)
    before, after = (null, rich) if better else (rich, null)

    def made(wanted: Sequence[Any], *rest: Any) -> list[Fitted]:
        assert [one.short_first for one in wanted] == [True]
        return [after]

    monkeypatch.setattr("rotorid_torch.trace.search.ordinary_physics.fits", made)
    assert _over_short(Search(shared := Trajectories(null.flights)), shared, before) is (after if better else before)
