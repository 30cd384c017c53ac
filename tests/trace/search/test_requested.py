"""Effects that somebody asks for: what acts earns its place, what does not act does not."""

from __future__ import annotations

import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.effects.registry import EFFECTS, registered
from rotorid_torch.trace.evidence.fits import Fitted, refit
from rotorid_torch.trace.search.requested import earned
from rotorid_torch.trace.search.trajectories import Trajectories
from rotorid_torch.trace.terms.finding import EffectFinding
from tests.effects.own_effects import OwnGain, OwnLag
from tests.trace.hidden_flights import flights, started


@pytest.fixture(autouse=True)
def own_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    registered()
    for own in (OwnLag, OwnGain):
        monkeypatch.setitem(EFFECTS, own.id, own)


def fitted(data: Dataset, *effects: str, **start: float) -> Fitted:
    known, null = started(data)
    values = {**null.values, **{name.replace("__", "."): value for name, value in start.items()}}
    return refit(null.spec.with_effects(*effects), known, values, near=null)


def findings(data: Dataset, *effects: str, **start: float) -> dict[str, EffectFinding]:
    whole = fitted(data, *effects, **start)
    return {f.id: f for f in earned(Trajectories(whole.flights), whole, effects)}


def test_of_two_effects_the_one_that_acts_earns_its_place():
    hidden = flights("control.delay", control__delay__common=0.06)
    found = findings(hidden, "control.delay", "forces.quadratic_damping")
    assert found["control.delay"].verdict == "accepted"
    assert "4 of 4 better" in found["control.delay"].reason
    value, error = found["control.delay"].values["control.delay.common"]
    assert abs(value - 0.06) < 3.0 * error
    assert found["forces.quadratic_damping"].verdict in ("rejected", "below floor", "indistinguishable")


def test_an_own_effect_without_a_typical_size_earns_its_place_where_it_acts():
    hidden = flights("own.lag", own__lag__L=25.0, own__lag__tau=0.4)
    found = findings(hidden, "own.lag", own__lag__L=5.0)["own.lag"]
    assert found.verdict == "accepted", found.reason
    assert found.statistic is not None
    assert found.critical_value is not None
    assert found.statistic > found.critical_value


def test_an_own_effect_earns_none_where_it_does_not_act():
    found = findings(flights(), "own.lag", "own.gain", own__lag__L=1.0)
    assert "accepted" not in {f.verdict for f in found.values()}


def test_what_trajectories_do_not_show_is_left_to_the_loop():
    found = findings(flights(), "environment.turbulence")["environment.turbulence"]
    assert found.verdict == "not testable"
    assert "rotorid close-loop" in found.reason
