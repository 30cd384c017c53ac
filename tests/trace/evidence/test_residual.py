"""Equations' residuals: what a model leaves over on the measured motion, and the same turned in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, RATES, STICKS, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.effects.spec import RotorSpec
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.trace.evidence.residual import AT_ONCE, _moved, by_chance, left_over
from rotorid_torch.trace.evidence.unattributed import Description, Residuals
from rotorid_torch.trace.search.localisation import localised
from tests.known_models import BODY, body_spec, flown, linear_vehicle, manoeuvres, with_values
from tests.trace.evidence.left_overs import FLIGHTS, ROWS, P, left


def largest(found: dict[str, Description], row: str) -> Description:
    """Of an equation, whatever its kind."""
    return max((one for one in found.values() if one.row == row), key=lambda one: one.statistic)


def test_a_model_has_its_values_back_where_a_moved_parameter_fails():
    model = linear_vehicle()
    before = model.theta.detach().clone()

    def failing() -> None:
        for _ in _moved(model, ["forces"]):
            raise ArithmeticError

    with pytest.raises(ArithmeticError):
        failing()
    assert torch.equal(model.theta.detach(), before)


def test_a_mean_that_is_another_at_rest_than_in_motion_is_no_step():
    """What grows with the square of the motion has one, in every flight from the first input on."""
    model = linear_vehicle()
    data = flown(model, manoeuvres(12.0, 0.02), 0.02, noise=0.005)
    over = left_over(model, data, reconstruct(data), data.identify)
    rest = torch.tensor([0.02 * data.quiet(name) for name in data.identify], dtype=torch.float64)[over.flight]
    assert 0.5 < float(rest.min()) < 4.0
    lifted = replace(over, residual=over.residual + 0.1 * (over.time < rest)[:, None])
    assert largest(Residuals(lifted).descriptions(), "Y").statistic < 0.02
    slipped = replace(over, residual=over.residual + 0.1 * (over.time < 6.0)[:, None])
    told = Residuals(slipped).descriptions()["unattributed Y, step"]
    assert told.regressor == ("time", "", 6.0)
    assert told.statistic > 0.01


def test_turned_residuals_keep_their_size_and_lose_their_place():
    """Noise that no linear term takes up is rolled in time, with a sign, flight by flight."""
    over = left("L", None)
    made = by_chance(over, 3, 0)
    assert made.shape == (*over.residual.shape, 3)
    ratio = made.square().mean(0).sqrt() / over.residual.square().mean(0).sqrt()[:, None]
    assert bool((ratio - 1.0).abs().max() < 0.05)
    assert torch.equal(made, by_chance(over, 3, 0))
    mine = over.flight == 0
    alike = torch.stack([(made[mine, 0, 0] @ over.residual[mine, 0].roll(n)).abs() for n in range(int(mine.sum()))])
    assert float(alike.max()) > 0.9 * float(over.residual[mine, 0].square().sum())
    assert int(alike.argmax()) > 0
    assert len(over.flight.unique()) == FLIGHTS


def test_what_linear_terms_take_up_is_hardly_chance():
    """Turned in time it would look like something that no linear term takes up, and as large."""
    over = left("L", None)
    much = over.residual.clone()
    much[:, ROWS.index("L")] += 9.0 * P
    made = by_chance(replace(over, residual=much), 19, 0)[:, ROWS.index("L")]
    left_of = over.beyond(made, ROWS.index("L")).square().mean(0).sqrt()
    assert float(left_of.max()) < 0.1


@pytest.mark.parametrize("order", [1, 2])
def test_a_slipped_control_run_shows_in_the_flapping_that_follows_it(order: int):
    """Half of the lateral cyclic's deviation is lost from 5 s on; the moments follow the measured flapping.

    A model with second-order flapping takes the measured rates as its own: still they show what its drivers lack.
    """
    columns = (*VELOCITIES, *RATES, *STICKS, *FLAPPING)
    patterns = dict.fromkeys((*FORCES, *MOMENTS, *FLAPPING), columns)
    reference = {**body_spec().reference, **dict.fromkeys(FLAPPING, 0.0)}
    outputs = (*BODY, "ax", "ay", "az", *FLAPPING)
    kind = {"flapping": "first order", "patterns": patterns, "reference": reference, "outputs": outputs}
    model = linear_vehicle(**kind)
    tilts = {f"rotor.{n}.{n}": -8.0 for n in FLAPPING} | {"rotor.a1.lon": 8.0, "rotor.b1.lat": 8.0, "rotor.a0.col": 4.0}
    hubs = {"forces.L.lat": 0.0, "forces.L.b1": 30.0, "forces.M.lon": 0.0, "forces.M.a1": 15.0}
    with_values(model, {**tilts, **hubs})
    asked = manoeuvres(12.0, 0.02)
    late = 0.02 * np.arange(len(asked["f_lat"])) >= 5.0
    asked = {n: c + 0.02 * np.sin(0.05 * np.arange(len(c)))[:, None] for n, c in asked.items()}
    came = {n: np.where(late[:, None] & (np.arange(4) == STICKS.index("lat")), 0.5 * c, c) for n, c in asked.items()}
    data = flown(model, came, 0.02, noise=0.005)
    asked_for = {n: {**f.channels, "lat": asked[n][:, STICKS.index("lat")]} for n, f in data.flights.items()}
    data = Dataset.from_arrays(asked_for, identify=data.identify, channels=data.channel_specs)
    if order == 2:
        rotor = RotorSpec(speed=27.0, blades=4, radius=8.0, chord=0.5)
        richer = linear_vehicle(**kind, rotor=rotor, effects=("rotor.flap_second_order",))
        model = with_values(richer, {**model.named_values, "rotor.flap_second_order.share": 1.0})
    over = left_over(model, data, reconstruct(data), data.identify)
    assert over.rows == (*ROWS, *FLAPPING, *AT_ONCE)
    residuals = Residuals(over)
    found = residuals.descriptions()
    assert (largest(found, "b1").regressor.signal, largest(found, "b1").regressor.since_s) == (
        "lat",
        pytest.approx(5.0, abs=0.5),
    )
    assert largest(found, "b1").statistic > 0.5 * float(over.residual[:, over.rows.index("b1")].square().mean().sqrt())
    assert largest(found, "L").statistic < 0.1 * largest(found, "b1").statistic * 30.0
    some = {n: {c: v for c, v in f.items() if n != "f_ped" or c not in FLAPPING} for n, f in asked_for.items()}
    lacking = Dataset.from_arrays(some, identify=data.identify, channels=data.channel_specs)
    partly = left_over(model, lacking, reconstruct(lacking), data.identify)
    again = Residuals(partly).descriptions()
    assert (largest(again, "b1").regressor.signal, largest(again, "b1").regressor.since_s) == (
        "lat",
        pytest.approx(5.0, abs=0.5),
    )
    assert largest(again, "L").statistic < 0.1 * largest(again, "b1").statistic * 30.0
    bare = {n: {c: v for c, v in f.items() if c not in FLAPPING} for n, f in asked_for.items()}
    without = Dataset.from_arrays(bare, identify=data.identify, channels=data.channel_specs)
    blind = left_over(model, without, reconstruct(without), data.identify)
    assert blind.rows == ROWS
    for unseen in (over, partly, blind):  # a flight whose disc nobody saw speaks neither for it nor against it
        beside = Residuals(over, unseen)
        tilting = [one for one in beside.descriptions().values() if one.row == "b1" and one.statistic > 1e-3]
        assert localised(tilting, beside, {}).where == "b1"
