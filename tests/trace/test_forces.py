"""A pendulum is seen in the forces on the measured motion with about its size; where there is none, nothing is seen."""

from __future__ import annotations

import pytest

from rotorid_torch.identification.reconstruct import reconstruct
from rotorid_torch.identification.step2 import regress_model
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.fits import Fitted, Flights, refit
from rotorid_torch.trace.forces import seen_in_forces
from tests.known_models import flown, linear_vehicle, manoeuvres, with_values

DT = 0.02
LOAD = "mass.slung_load"


def without_load(ratio: float) -> Fitted:
    """What is fitted, knowing of no load, to flights of a vehicle that carries one."""
    truth = with_values(linear_vehicle(effects=(LOAD,)), {f"{LOAD}.ratio": ratio, f"{LOAD}.length": 6.0})
    data = flown(truth, manoeuvres(12.0, DT), DT, noise=0.02)
    found = reconstruct(data)
    model = build(propose(data, found))
    start = dict(zip(model.parameter_set.names, regress_model(model, data, found).theta.tolist(), strict=True))
    return refit(propose(data, found), Flights(data, found), start)


def test_a_load_is_seen_with_its_cable_and_about_its_size():
    found = seen_in_forces(without_load(0.1), (), [LOAD, "control.delay"], 0)
    assert set(found) == {LOAD}
    assert found[LOAD][f"{LOAD}.length"] == 6.0
    assert found[LOAD][f"{LOAD}.ratio"] == pytest.approx(0.1, rel=0.4)


def test_no_load_is_seen_where_there_is_none():
    assert seen_in_forces(without_load(0.0), (), [LOAD], 0) == {}
