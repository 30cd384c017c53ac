"""Induced velocity: momentum theory solved, its known limits, its derivatives; the state that follows the thrust."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from torch import Tensor

from rotorid_torch.effects.momentum import induced_velocity
from rotorid_torch.model.derivatives import FOLLOWED
from rotorid_torch.model.inflow import CYCLIC, INDUCED, Inflow, trim_velocity
from tests.known_models import INERTIA, ROTOR, helicopter, points, with_values

HOVER = math.sqrt(7257.0 * 9.80665 / (2.0 * 1.225 * math.pi * 8.18**2))


def tensor(*values: float) -> tuple[Tensor, ...]:
    return tuple(torch.tensor(v, dtype=torch.float64) for v in values)


@given(st.floats(5.0, 400.0))
def test_hover_is_the_square_root_of_the_disc_loading(thrust: float):
    zero = torch.zeros((), dtype=torch.float64)
    assert float(induced_velocity(*tensor(thrust), zero, zero)) == pytest.approx(math.sqrt(thrust), rel=1e-9)


@given(st.floats(20.0, 300.0), st.floats(-60.0, 80.0), st.floats(-15.0, 15.0), st.floats(-12.0, 4.0))
def test_equation_is_solved_in_climb_and_slow_descent(thrust: float, u: float, v: float, w: float):
    vi = float(induced_velocity(*tensor(thrust, u * u + v * v, -w)))
    assert vi * math.sqrt(u * u + v * v + (vi - w) ** 2) == pytest.approx(thrust, rel=1e-6)
    assert vi > 0.0


@given(st.floats(20.0, 300.0), st.floats(15.0, 80.0), st.floats(-12.0, 12.0))
def test_solution_is_the_root_that_brackets_find(thrust: float, u: float, w: float):
    found = float(induced_velocity(*tensor(thrust, u * u, -w)))
    root = brentq(lambda vi: vi * math.hypot(u, vi - w) - thrust, 0.0, 100.0, xtol=1e-13)
    assert found == pytest.approx(root, rel=1e-4)  # a fixed number of iterations


@given(st.floats(-1e13, 1e13), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_nothing_makes_it_undefined(thrust: float, u: float, v: float, w: float):
    assert math.isfinite(float(induced_velocity(*tensor(thrust, u * u + v * v, -w))))


def test_gradient_is_right():
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(6, 3, generator=generator, dtype=torch.float64) * torch.tensor([20.0, 50.0, 2.0])
    arguments = [c.contiguous().requires_grad_() for c in (rows + torch.tensor([150.0, 200.0, 1.0])).unbind(-1)]
    assert torch.autograd.gradcheck(induced_velocity, arguments)


def test_trim_velocity_is_that_of_the_weight():
    reference = dict.fromkeys(("u", "v", "w"), 0.0)
    assert trim_velocity(ROTOR, 1.225, 7257.0, reference, 9.80665) == pytest.approx(HOVER, rel=1e-9)


def test_time_constant_is_that_of_momentum_theory_in_hover():
    reference = {"u": 0.0, "v": 0.0, "w": 0.0, INDUCED: HOVER}
    effect = Inflow(ROTOR, 1.225, 7257.0, torch.tensor(INERTIA, dtype=torch.float64), reference, 9.80665)
    tau = next(p for p in effect.declared if p.name == "tau")
    assert tau.value == pytest.approx(8.0 / (3.0 * math.pi) * 8.18 / (4.0 * HOVER))
    assert tau.bounds[0] < tau.value < tau.bounds[1]


def test_state_tends_to_the_velocity_of_the_thrust():
    model = with_values(helicopter(), {"tailplane.Z.uw": 0.0})  # all lift is the rotor's
    x, u = points(model, 4)
    frame, _ = model.frame(model.theta.detach(), x, u)
    assert frame.force is not None
    disc = 7257.0 / (2.0 * 1.225 * math.pi * 8.18**2)
    rest = induced_velocity(-disc * frame.force[:, 2], x[:, :2].square().sum(-1), -x[:, 2])
    tau = model.theta.detach()[model.parameter_set.index("inflow.tau")]
    at = model.layout.names.index(INDUCED)
    torch.testing.assert_close(model(torch.tensor(0.0), x, u)[:, at].detach(), (rest - x[:, at]) / tau)


def test_more_thrust_in_climb_turns_the_nose_against_the_rotor():
    model = helicopter()
    theta, (x, u) = model.theta.detach(), points(model, 1, spread=0.0)
    collective = model.body.controls.index("col")
    u[0, collective] -= 1.0 / float(theta[model.parameter_set.index("forces.Z.col")])  # 1 m/s2 more downwards
    x[0, model.layout.names.index(INDUCED)] += 1.0
    more = theta.clone()
    more[model.parameter_set.index("inflow.N")] += 1.0
    turn = float((model.rates(more, x, u) - model.rates(theta, x, u))[0, 5])
    frame, _ = model.frame(theta, x, u)
    assert frame.force is not None
    thrust = float(-frame.force[0, 2] + model.reference["Z.trim"])
    about_z = float(torch.linalg.inv(torch.tensor(INERTIA, dtype=torch.float64))[2, 2])
    assert turn == pytest.approx(7257.0 * thrust * 1.0 / 27.0 * about_z)  # torque is power over speed


def test_states_that_no_channel_tells_are_known_from_the_motion_before():
    model = helicopter(cyclic_inflow=True)
    unmeasured = [s for s in model.layout.states if s.name not in model.body.outputs]
    assert {s.name for s in unmeasured} == {INDUCED, *CYCLIC, FOLLOWED}
    assert all(math.isfinite(s.spread) for s in unmeasured)
