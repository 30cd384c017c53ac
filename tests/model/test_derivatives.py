"""Tilted thrust and tail rotor: the physical size and sign of what they add beyond the tangent."""

from __future__ import annotations

import math

import pytest
import torch

from rotorid_torch.effects.base import Frame, Values
from rotorid_torch.model.derivatives import FELT, TailInflow, TailRotor, ThrustTilt
from tests.known_models import INERTIA

HUB, MASS = (0.1, 0.05, -2.1), 7257.0
REFERENCE = {"a1": 0.03, "b1": -0.02, "ped": 0.2, "v": -1.0, "r": 0.05}


def tensor(values: object) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float64)


def tilt(spin: float, a1: float, b1: float, lift: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Specific force and angular acceleration that the effect adds."""
    effect = ThrustTilt(tensor(HUB), MASS, tensor(INERTIA), spin, REFERENCE, 9.8)
    force, none = tensor([0.0, 0.0, -lift]), torch.zeros(3, dtype=torch.float64)
    frame = Frame({"a1": tensor(REFERENCE["a1"] + a1), "b1": tensor(REFERENCE["b1"] + b1)}, force=force, moment=none)
    after, _ = effect(frame, none[:0], Values(torch.ones(4, dtype=torch.float64), ("X", "Y", "L", "M")))
    assert after.force is not None
    assert after.moment is not None
    return after.force - force, after.moment


@pytest.mark.parametrize("spin", [1.0, -1.0])
def test_more_thrust_pulls_along_the_disc_s_axis(spin: float):
    force, turn = tilt(spin, 0.02, 0.01, 9.8 + 2.0)
    assert force.tolist() == pytest.approx([-2.0 * 0.02, spin * 2.0 * 0.01, 0.0])
    moment = torch.linalg.cross(tensor(HUB), MASS * force)
    torch.testing.assert_close(turn, torch.linalg.solve(tensor(INERTIA), moment))
    assert turn[1] > 0  # thrust tilted backwards above the centre of gravity: nose up


def test_nothing_is_added_at_trim_thrust_or_trim_tilt():
    for arguments in ((0.02, 0.01, 9.8), (0.0, 0.0, 11.0)):
        force, turn = tilt(1.0, *arguments)
        torch.testing.assert_close(force, torch.zeros_like(force), atol=1e-15, rtol=0)
        torch.testing.assert_close(turn, torch.zeros_like(turn), atol=1e-15, rtol=0)


def test_tail_rotor_s_quadratic_terms():
    effect = TailRotor(9.8, REFERENCE, {})
    rows = tensor([[1.0, 2.0, 3.0], [0.0, 0.0, 4.0], [5.0, 0.0, 0.0]])
    names = tuple(p.name for p in effect.declared)
    assert names[:4] == ("Y.pedal_speed", "Y.speed_speed", "Y.pedal_pedal", "L.pedal_speed")
    signals = {"ped": tensor(0.2 + 0.1), "v": tensor(-1.0 + 2.0), "r": tensor(0.05 + 0.5)}
    nothing = torch.zeros(3, dtype=torch.float64)
    after, _ = effect(Frame(signals, force=nothing, moment=nothing), nothing[:0], Values(rows.flatten(), names))
    assert after.force is not None
    assert after.moment is not None
    speed = 2.0 - 9.8 * 0.5  # side speed of the tail
    side = 0.1 * speed + 2.0 * speed * abs(speed) + 3.0 * 0.01
    assert after.force.tolist() == pytest.approx([0.0, side, 0.0])
    assert after.moment.tolist() == pytest.approx([4.0 * 0.01, 0.0, 5.0 * 0.1 * speed])


def test_a_pedal_does_more_until_the_tail_s_inflow_has_followed():
    """After a step of the pedal what is added decays as the inflow builds up, and nothing is left of it."""
    effect = TailInflow(REFERENCE, {}, "rad")
    values = Values(tensor([0.05, 0.8]), ("tau", "overshoot"))
    step, dt, x = 0.1, 1e-4, tensor([0.0])
    frame = Frame({"ped": tensor(REFERENCE["ped"] + step)})
    for k in range(2001):
        after, rate = effect(frame, x, values)
        if k in (0, 500, 2000):
            more = 0.8 * step * math.exp(-k * dt / 0.05)
            assert float(after.signals["ped"]) == REFERENCE["ped"] + step  # what was measured stays
            assert float(after.signals[FELT]) == pytest.approx(REFERENCE["ped"] + step + more, rel=1e-3)
        x = x + dt * rate
