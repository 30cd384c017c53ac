"""A step that a control makes by itself is told of that control."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from rotorid_torch.core.names import FORCES, MOMENTS
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.residual import AT_ONCE
from rotorid_torch.trace.evidence.unattributed import Residuals
from rotorid_torch.trace.search.localisation import deflected, localised, slipped
from tests.known_models import DERIVATIVES, helicopter_spec, linear_vehicle, rate_vehicle, with_values
from tests.trace.evidence.left_overs import ROWS, after, left

PED, LAT = {"Y": 3.0, "L": 1.0, "N": -8.0}, {"Y": 1.0, "L": 6.0, "N": 0.5}
DOES = {name: {row: own.get(row, 0.0) for row in ROWS} for name, own in {"ped": PED, "lat": LAT}.items()}


def stepped(steps: dict[str, float], onset: float = 6.0):
    over = left("L", None, 0.3)
    moved = torch.tensor([steps.get(row, 0.0) for row in ROWS], dtype=torch.float64)
    return replace(over, residual=over.residual + after(onset)[:, None] * moved)


def of(control: dict[str, float], size: float) -> dict[str, float]:
    return {row: size * value for row, value in control.items()}


@pytest.mark.parametrize(
    ("steps", "said"), [(of(PED, 0.2), "ped"), (of(LAT, -0.3), "lat"), ({"N": 1.0, "L": 1.0}, "time")]
)
def test_a_step_is_told_of_the_control_that_makes_it_in_all_equations(steps: dict[str, float], said: str):
    over = stepped(steps)
    residuals = Residuals(over, over)
    told = localised([one for one in residuals.descriptions().values() if one.statistic > 0.05], residuals, DOES)
    assert (told.goes_with, told.since_s) == (said, 6.0)
    assert ("that it would make" in told.sentence) == (said != "time")


def test_unseen_flights_must_show_the_same_control_and_sign():
    here = stepped(of(PED, 0.2))
    assert slipped("N", 6.0, here, stepped(of(PED, 0.1)), DOES) == "ped"
    assert slipped("N", 6.0, here, stepped(of(PED, -0.2)), DOES) is None
    assert slipped("N", 6.0, here, stepped(of(LAT, 0.2)), DOES) is None
    assert slipped("N", 6.0, here, stepped(of(PED, 0.2), onset=99.0), DOES) is None


def test_a_model_without_controls_that_do_anything_tells_none():
    here = stepped(of(PED, 0.2))
    assert slipped("N", 6.0, here, here, {}) is None
    assert slipped("N", 6.0, here, here, {"ped": {}}) is None


def test_where_two_controls_make_it_alike_none_is_told():
    here = stepped(of(PED, 0.2))
    both = DOES | {"tail": of(PED, -0.5)}
    assert slipped("N", 6.0, here, here, both) is None
    alone = {name: {"N": own["N"]} for name, own in DOES.items() if name == "ped"}
    assert slipped("N", 6.0, here, here, alone) is None


def test_a_step_of_the_disc_is_told_by_the_disc_alone():
    here = stepped(of(PED, 0.2))
    tilted = torch.cat([here.residual, left("L", None, 0.3).residual[:, :3]], dim=1)
    tilted[:, 8] += after(6.0)
    disc = replace(here, rows=(*ROWS, *AT_ONCE), residual=tilted, named=tilted.new_zeros(*tilted.shape, 0))
    none = dict.fromkeys(AT_ONCE, 0.0)
    does = {"ped": {**DOES["ped"], **none}, "lat": {**DOES["lat"], **none, "b1 at once": 20.0}}
    assert slipped("b1", 6.0, disc, disc, does) == slipped("b1 at once", 6.0, disc, disc, does) == "lat"
    assert slipped("N", 6.0, disc, disc, does) == "ped"


def test_what_controls_do_are_the_derivatives_of_the_model():
    does = deflected(linear_vehicle())
    for name, value in DERIVATIVES.items():
        row, by = name.split(".")
        if by in does:
            assert does[by][row] == pytest.approx(value, rel=1e-6)
    assert does["ped"]["L"] == pytest.approx(0.0, abs=1e-9)
    assert {row for row, value in deflected(rate_vehicle())["lon"].items() if abs(value) > 1e-9} == {"M"}


def test_controls_drive_the_disc_of_a_model_whose_flapping_lags():
    spec = helicopter_spec()
    second = spec.with_effects("rotor.flap_second_order"), {"rotor.flap_second_order.share": 1.0}
    for known, values in ((spec, {}), second):
        does = deflected(with_values(build(known), {"rotor.b1.lat": 8.0, **values}))
        assert {*does["lat"]} == {*FORCES, *MOMENTS, *AT_ONCE}
        assert does["lat"]["b1 at once"] == pytest.approx(8.0)
