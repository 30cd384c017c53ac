"""A delay of each control is found by itself; controls that agree add nothing to the error, others do."""

from __future__ import annotations

import math

import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.trace.evidence.fits import refit
from rotorid_torch.trace.loop import Tracing
from rotorid_torch.trace.search.by_control import ByControl, by_control
from tests.trace.hidden_flights import flights, started, traced

DELAY = "control.delay"
PLAY = "control.backlash"


def delayed(**seconds: float) -> Dataset:
    return flights(DELAY, **{f"control__delay__{c}": s for c, s in seconds.items()})


def test_controls_that_are_late_by_different_times_are_told_one_by_one():
    known, null = started(delayed(common=0.03, lat=0.04))
    spec = type(null.spec).from_plain({**null.spec.plain(), "effects": [DELAY]})
    late = refit(spec, known, {**null.values, f"{DELAY}.common": 0.05})
    found = by_control(late, DELAY, ())
    assert found is not None
    value, error = found.sizes["lat"]
    assert abs(value - 0.07) < 3.0 * error + 1e-3
    value, error = found.sizes["lon"]
    assert abs(value - 0.03) < 3.0 * error + 1e-3
    assert found.between > 0.01
    assert "lat" in str(found)


def test_controls_that_differ_have_sizes_of_their_own_and_those_that_agree_a_common_one():
    apart, alike = traced(delayed(common=0.03, lat=0.04)), traced(delayed(common=0.06))
    assert apart.accepted == alike.accepted == (DELAY,)
    assert (apart.final.spec.each_control, alike.final.spec.each_control) == ((DELAY,), ())
    for control, seconds in (("lat", 0.07), ("lon", 0.03)):
        told = next(f for f in apart.findings if f.id == DELAY).values[f"{DELAY}.{control}"]
        assert told[0] == pytest.approx(seconds, abs=3.0 * told[1] + 1e-3)
    assert alike.spread[f"{DELAY}.common"] < 0.01
    assert "control by control" in next(f for f in alike.findings if f.id == DELAY).reason


def test_an_effect_without_controls_of_its_own_has_nothing_to_compare():
    _, null = started(delayed(common=0.0))
    assert by_control(null, "forces.quadratic_damping", ()) is None


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_between_is_that_of_random_effects(scale: float):
    """Equal errors: the sample variance less theirs."""
    own = {c: (scale * v, scale) for c, v in {"lon": 1.0, "lat": 5.0, "col": 9.0}.items()}
    found = ByControl("x", "s", own)
    assert found.between == pytest.approx(scale * math.sqrt(16.0 - 1.0))
    assert found.spread == pytest.approx(found.between / math.sqrt(3.0))
    sure = ByControl("x", "s", {"lon": (1.0, 1.0), "lat": (21.0, 20.0), "col": (-19.0, 20.0)})
    assert sure.spread == pytest.approx(sure.between, rel=0.01)  # as good as one control's alone
    assert ByControl("x", "s", {"lon": (1.0, 1.0), "lat": (1.5, 1.0)}).between == 0.0
    assert ByControl("x", "s", {"lon": (1.0, math.inf), "lat": (9.0, 1.0)}).spread == 0.0


def test_controls_that_show_none_of_it_count():
    late = ByControl("x", "s", {"lon": (50.0, 1.0), "lat": (50.0, 1.0), "col": (0.0, math.inf), "ped": (0.0, math.inf)})
    assert late.between > 20.0
    assert "col 0 (at its bound)" in str(late)


def with_play(**values: float) -> Tracing:
    return traced(flights(PLAY, noise=0.01, **{f"control__backlash__{n}": v for n, v in values.items()}))


def test_plays_that_differ_are_told_of_each_control():
    found = with_play(lon=0.016, lat=0.008)
    assert found.accepted == (PLAY,)
    assert found.final.values[f"{PLAY}.lon"] == pytest.approx(0.016, abs=0.003)
    assert found.final.values[f"{PLAY}.lat"] == pytest.approx(0.008, abs=0.003)


def test_a_play_that_stands_at_one_side_is_told_with_its_width():
    places = {"lon": 0.9, "lat": -0.8, "ped": 0.9}
    found = with_play(width=0.012, **{f"place__{c}": place for c, place in places.items()})
    assert found.accepted == (PLAY,)
    assert found.final.values[f"{PLAY}.width"] == pytest.approx(0.012, rel=0.1)
    for control, place in places.items():
        assert found.final.values[f"{PLAY}.place.{control}"] == pytest.approx(place, abs=0.25)
    told = next(f for f in found.findings if f.id == PLAY)
    assert not [name for name in told.values if ".place." in name]
