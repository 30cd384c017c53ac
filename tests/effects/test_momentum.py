"""Momentum theory against brackets of its equation: all speeds and climbs of a multirotor and a helicopter."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from rotorid_torch.effects.momentum import induced_velocity
from tests.core.native.graph.evaluation import traced_jacobian, traced_value

ACROSS, CLIMB = (
    torch.tensor(a) for a in np.meshgrid(np.linspace(0.0, 4.0, 161), np.linspace(-3.0, 3.0, 241), indexing="ij")
)
"""In units of the induced velocity in hover, 1/40 apart."""


@pytest.mark.parametrize("hover", [1.0, 4.5, 12.0])
def test_equation_is_solved_wherever_it_has_one_solution(hover: float):
    v = induced_velocity(torch.tensor(hover**2), (hover * ACROSS) ** 2, hover * CLIMB) / hover
    one = (CLIMB >= -1.0) | (ACROSS**2 >= 0.5 * CLIMB**2)
    left = v * torch.sqrt(ACROSS**2 + (v + CLIMB) ** 2) - 1.0
    assert float(left[one].abs().max()) < 1e-7


def test_solution_is_the_one_that_brackets_find():
    for across, climb in ((0.0, -0.9), (0.0, 3.0), (0.7, -0.95), (2.0, -2.5), (4.0, -3.0), (1.0, 2.0)):
        v = float(induced_velocity(*(torch.tensor(a, dtype=torch.float64) for a in (1.0, across**2, climb))))
        low = 0.0 if climb > -1.0 or across else -climb
        root = brentq(lambda v, a=across, c=climb: v * math.hypot(a, v + c) - 1.0, low, 4.0, xtol=1e-13)
        assert v == pytest.approx(root, abs=1e-7)


def test_velocity_is_bounded_and_continuous_in_every_descent():
    v = induced_velocity(torch.tensor(1.0, dtype=torch.float64), ACROSS**2, CLIMB)
    assert 0.0 < float(v.min())
    assert float(v.max()) < 1.7  # momentum theory alone: 1.62 at a descent of 1
    assert max(float(v.diff(dim=axis).abs().max()) for axis in (0, 1)) < 0.12
    fine = torch.linspace(-3.0, 0.0, 30001, dtype=torch.float64)
    for across in (0.0, 0.3, 0.675, 1.0, 1.5):
        line = induced_velocity(torch.tensor(1.0, dtype=torch.float64), torch.tensor(across**2), fine)
        assert float(line.diff().abs().max()) < 5e-4


def test_native_code_has_the_same_values_and_slopes():
    number = lambda a: torch.tensor([a], dtype=torch.float64)  # noqa: E731
    for across, climb in ((0.0, 0.0), (0.5, -1.95), (1.0, -1.2), (9.0, -2.5), (0.1, 2.0)):
        at = {"thrust": number(1.2), "across": number(across), "climb": number(climb)}
        wanted = induced_velocity(*at.values())
        start = {"thrust": number(1.0), "across": number(1.0), "climb": number(0.5)}
        torch.testing.assert_close(traced_value(induced_velocity, start, at), wanted)
        slopes = torch.autograd.functional.jacobian(induced_velocity, tuple(at.values()))
        for mine, true in zip(traced_jacobian(induced_velocity, at).values(), slopes, strict=True):
            torch.testing.assert_close(mine, true)


@given(st.floats(0.0, 1e3), st.floats(0.0, 1e6), st.floats(-1e3, 1e3))
def test_value_and_slopes_are_finite_everywhere(thrust: float, across: float, climb: float):
    at = [torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in (thrust, across, climb)]
    v = induced_velocity(*at)
    slopes = torch.autograd.grad(v, at)
    assert all(math.isfinite(float(a)) for a in (v.detach(), *slopes))
