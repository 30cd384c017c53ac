"""Rows of a multirotor's equations and their derivatives: native code, torch, and automatic differentiation agree."""

from __future__ import annotations

from functools import cache

import pytest
import torch
from torch import Tensor

from rotorid_torch import fly
from rotorid_torch.data import Dataset
from rotorid_torch.identification.model_estimation import records
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction, reconstruct
from rotorid_torch.identification.rotor_equations import RotorEquations, seen_flights
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build

WIND, DRAG, INFLOW = "environment.wind", "propulsion.rotor_drag", "propulsion.axial_inflow"
INERTIA, DELAY, LAG, LOAD = "propulsion.rotor_inertia", "control.delay", "propulsion.motor_lag", "mass.slung_load"


@cache
def flown() -> tuple[Dataset, Reconstruction]:
    """A short flight of the built-in quadrotor."""
    data = fly(None, vehicle="quad", flights=["eight_p"], seconds=4.0).dataset()
    return data, reconstruct(data)


@cache
def equations(*effects: str) -> RotorEquations:
    """Of this flight, every parameter a little off what it is declared to be."""
    data, reconstruction = flown()
    model = build(propose(data, reconstruction, effects))
    moved = 0.05 * (1.0 + model.theta.abs()) * torch.cos(torch.arange(1.0, len(model.theta) + 1.0)).abs()
    model.put(model.parameter_set.clamp((model.theta + moved).detach()))
    return RotorEquations(model, tuple(seen_flights(model, records(model, data, reconstruction))))


@pytest.mark.parametrize("effects", [(WIND, DRAG, INFLOW), (INERTIA, DELAY), (LAG, INERTIA, DRAG)])
def test_rows_and_derivatives_are_those_of_the_model_in_torch(effects):
    given = equations(*effects)
    model, (flight,) = given.model, given.flights
    theta, names = model.theta.detach(), model.parameter_set.names

    def rows(values: Tensor) -> Tensor:
        return given.accelerations.rows(values, flight.states, model.tape(flight.controls, flight.dt), flight.dt)

    (linear,) = given.linear(theta, names)
    assert given.accelerations.compiled is not None
    torch.testing.assert_close(linear.values, rows(theta), rtol=1e-11, atol=1e-11)
    inner = [k for k, name in enumerate(names) if not name.startswith(("control.", "propulsion.motor_lag"))]
    jacobian = torch.func.jacfwd(rows)(theta).movedim(-1, 0)
    torch.testing.assert_close(linear.slopes[inner], jacobian[inner], rtol=1e-9, atol=1e-9)


def test_a_parameter_of_the_control_path_moves_all_that_the_controls_do():
    given = equations(INERTIA, DELAY)
    theta, names = given.model.theta.detach(), given.model.parameter_set.names
    place, step = names.index("control.delay.common"), 1e-5
    (linear,) = given.linear(theta, names)
    moved = theta.clone()
    moved[place] += step
    ((before,), (after,)) = given.at(theta), given.at(moved)
    for row in ("pdot", "qdot", "az"):
        change = (after[row] - before[row]) / step
        assert (
            float((linear.columns(row)[place] - change).norm() / change.norm()) < 0.15
        )  # records are interpolated by polynomials


def test_a_load_that_swings_after_the_motion_is_differenced_in_torch():
    given = equations(DRAG, LOAD)
    assert given.accelerations.compiled is None
    theta, names = given.model.theta.detach(), [f"{DRAG}.x", f"{LOAD}.ratio"]
    (linear,) = given.linear(theta, [n for n in names if n in given.model.parameter_set.names])
    assert bool(linear.columns("ax").any(dim=-1).all())
