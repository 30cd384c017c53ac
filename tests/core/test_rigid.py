"""Rigid-body equations against conservation laws, SciPy's rotations, and differentiated positions."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from torch import Tensor

from rotorid_torch.core import rigid

INERTIA = torch.tensor([[7600.0, 300.0, -2260.0], [300.0, 52000.0, 150.0], [-2260.0, 150.0, 49900.0]]).double()
SMALL = st.floats(-1.0, 1.0)
TRIPLE = st.tuples(SMALL, SMALL, SMALL)
GRAVITY = 9.80665


def tensor(values: object) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float64)


def to_body(attitude: Tensor) -> np.ndarray:
    """Earth (north, east, down) to body, 3-2-1."""
    return Rotation.from_euler("ZYX", attitude.flip(-1).numpy()).as_matrix().T


def motion(state: Tensor, specific_force: Tensor) -> Tensor:
    """d(position, velocity, rates, attitude)/dt of a body without external moment."""
    velocity, rates, attitude = state[3:6], state[6:9], state[9:12]
    return torch.cat([
        rigid.position_rates(velocity, attitude),
        rigid.velocity_rates(velocity, rates, attitude, specific_force, GRAVITY),
        rigid.gyroscopic(rates, INERTIA),
        rigid.euler_rates(rates, attitude),
    ])  # fmt: skip


def flown(state: Tensor, seconds: float, specific_force: Tensor) -> Tensor:
    found = solve_ivp(
        lambda _, s: motion(tensor(s), specific_force).numpy(), (0, seconds), state.numpy(), rtol=1e-11, atol=1e-12
    )
    return tensor(found.y[:, -1])


@settings(max_examples=15)
@given(velocity=TRIPLE, rates=TRIPLE, attitude=TRIPLE)
def test_free_body_keeps_energy_and_angular_momentum(velocity: tuple, rates: tuple, attitude: tuple):
    start = torch.cat([tensor((0.0, 0.0, 100.0)), 20 * tensor(velocity), 0.5 * tensor(rates), tensor(attitude)])
    end = flown(start, 1.0, torch.zeros(3).double())

    def energy(s: Tensor) -> float:
        kinetic = 0.5 * s[3:6].square().sum() + 0.5 * (s[6:9] @ INERTIA @ s[6:9]) / 7257.0
        return float(kinetic + GRAVITY * s[2])

    def momentum(s: Tensor) -> np.ndarray:
        return to_body(s[9:12]).T @ (INERTIA @ s[6:9]).numpy()

    assert energy(end) == pytest.approx(energy(start), rel=1e-9)
    np.testing.assert_allclose(momentum(end), momentum(start), rtol=1e-7, atol=1e-6 * 52000)


@settings(max_examples=15)
@given(velocity=TRIPLE, rates=TRIPLE, attitude=TRIPLE)
def test_free_fall_is_a_parabola_whatever_the_body_does(velocity: tuple, rates: tuple, attitude: tuple):
    start = torch.cat([torch.zeros(3).double(), 20 * tensor(velocity), 0.5 * tensor(rates), tensor(attitude)])
    end = flown(start, 1.0, torch.zeros(3).double())
    north, east, down = to_body(start[9:12]).T @ start[3:6].numpy()
    np.testing.assert_allclose(end[:3].numpy(), [north, east, -down - GRAVITY / 2], atol=1e-7)


@given(attitude=TRIPLE)
def test_gravity_is_down_turned_into_the_body(attitude: tuple):
    found = rigid.gravity_in_body(tensor(attitude), GRAVITY)
    np.testing.assert_allclose(found.numpy(), to_body(tensor(attitude)) @ [0, 0, GRAVITY], atol=1e-12)


@given(attitude=TRIPLE, velocity=TRIPLE)
def test_position_follows_the_turned_velocity(attitude: tuple, velocity: tuple):
    north, east, down = to_body(tensor(attitude)).T @ np.array(velocity)
    found = rigid.position_rates(tensor(velocity), tensor(attitude))
    np.testing.assert_allclose(found.numpy(), [north, east, -down], atol=1e-12)


@given(attitude=TRIPLE, rates=TRIPLE)
def test_euler_rates_are_those_of_the_turning_matrix(attitude: tuple, rates: tuple):
    h = 1e-5
    after, before = (
        Rotation.from_matrix(to_body(tensor(attitude)).T) * Rotation.from_rotvec(s * h * np.array(rates))
        for s in (1, -1)
    )
    wanted = (after.as_euler("ZYX") - before.as_euler("ZYX"))[::-1] / (2 * h)
    np.testing.assert_allclose(rigid.euler_rates(tensor(rates), tensor(attitude)).numpy(), wanted, atol=1e-7)


def test_specific_force_at_a_point_is_what_a_mass_there_feels():
    point, force = tensor((0.8, -0.3, 0.5)), tensor((0.5, -0.2, -9.0))
    start = torch.cat([tensor((0.0, 0.0, 50.0, 12.0, -3.0, 2.0, 0.4, -0.7, 0.5, 0.2, -0.3, 0.9))])
    acceleration = rigid.gyroscopic(start[6:9], INERTIA)

    def place(t: float) -> np.ndarray:
        s = flown(start, t, force) if t > 0 else start
        return s[:3].numpy() * [1, 1, -1] + to_body(s[9:12]).T @ point.numpy()

    h = 2e-3
    first, second, third, fourth = place(0.0), place(h), place(2 * h), place(3 * h)
    earth = (2 * first - 5 * second + 4 * third - fourth) / h**2
    wanted = to_body(start[9:12]) @ (earth - [0, 0, GRAVITY])
    found = rigid.specific_force_at(point, force, start[6:9], acceleration)
    np.testing.assert_allclose(found.numpy(), wanted, atol=2e-3)
    assert torch.equal(rigid.specific_force_at(torch.zeros(3).double(), force, start[6:9], acceleration), force)


def test_gyroscopic_moment_solves_eulers_equation():
    rates = torch.randn(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    found = rigid.gyroscopic(rates, INERTIA)
    wanted = [-np.linalg.solve(INERTIA.numpy(), np.cross(w, INERTIA.numpy() @ w)) for w in rates.numpy()]
    np.testing.assert_allclose(found.numpy(), wanted, atol=1e-12)


def test_parts_broadcast_against_each_other():
    a, b = torch.randn(4, 1, 3).double(), torch.randn(5, 3).double()
    assert rigid.cross(a, b).shape == (4, 5, 3)
    assert torch.allclose(rigid.cross(a, b), torch.linalg.cross(a.expand(4, 5, 3), b.expand(4, 5, 3)))
    assert rigid.vec(a[..., 0], b[..., 0]).shape == (4, 5, 2)
    assert rigid.velocity_rates(a, b, b, a, GRAVITY).shape == (4, 5, 3)
    assert rigid.euler_rates(a, b).shape == (4, 5, 3)
