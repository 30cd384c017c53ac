"""An effect's own states along a measured motion, against exact equations and another integrator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Values
from rotorid_torch.effects.families.mass import SlungLoad
from rotorid_torch.identification.measured_states import MeasuredStates
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.rotor_equations import seen_flights
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.training.measured_motion import DrivenEffect
from rotorid_torch.simulation import fly
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.search.eligible import candidates

G, DT, LENGTH, DAMPING = 9.81, 0.02, 0.6, 0.05


def load() -> tuple[Effect, Values]:
    """A load of no weight below a hook that is moved: it swings and pulls nothing."""
    effect = SlungLoad(G, torch.tensor([0.0, 0.0, -G], dtype=torch.float64), None, 0.1)
    values = {"ratio": 0.0, "length": LENGTH, "damping": DAMPING}
    names = tuple(p.name for p in effect.declared)
    return effect, Values(torch.tensor([[values[n] for n in names]], dtype=torch.float64), names)


def hook(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration ahead and up, m/s²: the load swings by a radian."""
    return 1.5 * np.sin(3.2 * time), 2.0 * np.cos(1.7 * time) - 2.0


def frame(time: torch.Tensor) -> Frame:
    """A level vehicle whose hook moves so."""
    ahead, up = (torch.from_numpy(part) for part in hook(time.numpy()))
    still = torch.zeros_like(time)
    force = torch.stack([ahead, still, -G - up], dim=-1)
    return Frame(dict.fromkeys(("phi", "theta", "q", "r"), still), force=force, moment=torch.zeros_like(force))


def test_a_load_follows_a_moved_hook_as_the_planar_pendulum_does():
    """l a'' = -(g + up) sin a - ahead cos a - 2 zeta sqrt(g l) a', by another integrator."""
    time = torch.arange(400, dtype=torch.float64) * DT
    effect, values = load()
    states = DrivenEffect.of(effect, frame(time), values).states(frame(time), values, DT)

    def moved(t: float, y: np.ndarray) -> list[float]:
        ahead, up = hook(np.array(t))
        damped = 2.0 * DAMPING * np.sqrt(G / LENGTH) * y[1]
        return [y[1], float(-((G + up) * np.sin(y[0]) + ahead * np.cos(y[0])) / LENGTH - damped)]

    angle = solve_ivp(moved, (0.0, 8.0), [0.0, 0.0], t_eval=time.numpy(), rtol=1e-9, atol=1e-10).y[0]
    assert np.abs(angle).max() > 0.5
    np.testing.assert_allclose(states[:, 0].numpy(), np.sin(angle), atol=2e-3)
    np.testing.assert_allclose(states[:, 1].numpy(), 0.0, atol=1e-12)


def test_native_code_follows_as_torch_does():
    time = torch.arange(60, dtype=torch.float64) * DT
    effect, values = load()
    driven = DrivenEffect.of(effect, frame(time), values)
    assert driven.compiled is not None
    native, plain = (one.states(frame(time), values, DT) for one in (driven, replace(driven, compiled=None)))
    torch.testing.assert_close(native, plain, rtol=1e-10, atol=1e-12)


def test_each_set_of_parameters_has_a_motion_of_its_own():
    time = torch.arange(60, dtype=torch.float64) * DT
    effect, values = load()
    driven = DrivenEffect.of(effect, frame(time), values)
    longer = values.vector.clone()
    longer[0, values.names.index("length")] = 2.0
    together = driven.states(frame(time), replace(values, vector=torch.stack([values.vector, longer])), DT)
    for one, vector in zip(together, (values.vector, longer), strict=True):
        torch.testing.assert_close(one, driven.states(frame(time), replace(values, vector=vector), DT))


class Integral(Effect):
    """Its state follows the rate that an earlier effect has published."""

    id = "my.integral"

    def __init__(self) -> None:
        super().__init__((Parameter("size", 1.0),), (State("s", "1", "the integral"),))

    def forward(self, frame: Frame, x: torch.Tensor, p: Values) -> tuple[Frame, torch.Tensor]:
        return frame, (p["size"] * frame.rate("a1")).unsqueeze(-1) + 0.0 * x


def test_rates_that_earlier_effects_publish_drive_a_state():
    time = torch.arange(50, dtype=torch.float64) * DT
    effect, values = Integral(), Values(torch.tensor([[2.0]], dtype=torch.float64), ("size",))
    published = replace(frame(time), rates={"a1": 0.3 + time})
    states = DrivenEffect.of(effect, published, values).states(published, values, DT)
    torch.testing.assert_close(states[:, 0], 2.0 * (0.3 * time + 0.5 * time.square()), rtol=1e-9, atol=1e-12)


class Stacked(Integral):
    """A lag that stacks a signal and its state."""

    id = "my.stacked"

    def forward(self, frame: Frame, x: torch.Tensor, p: Values) -> tuple[Frame, torch.Tensor]:
        signal, state = torch.stack([frame.signals["theta"], x[..., 0]]).unbind(0)
        return frame, (p["size"] * (signal - state)).unsqueeze(-1)


def test_an_effect_may_stack_signals_and_states():
    time = torch.arange(50, dtype=torch.float64) * DT
    effect, values = Stacked(), Values(torch.tensor([[2.0]], dtype=torch.float64), ("size",))
    tilted = frame(time).with_signals(theta=torch.full_like(time, 0.1))
    states = DrivenEffect.of(effect, tilted, values).states(tilted, values, DT)
    torch.testing.assert_close(states[:, 0], torch.full_like(time, 0.1))


@pytest.fixture(scope="module")
def laden() -> FittedAtStates:
    """A quadrotor that carries 12 % of its mass on a rope of five arms, and the model that is told to have one."""
    flown = fly(
        None,
        vehicle="multirotor-22",
        flights=("thrust_p", "roll_p", "pitch_p", "eight_p"),
        effects=[("mass.slung_load", 1.0)],
        seconds=8.0,
        seed=22,
    )
    dataset = flown.dataset()
    reconstruction = reconstruct(dataset)
    return FittedAtStates.of(propose(dataset, reconstruction, ("mass.slung_load",)), Flights(dataset, reconstruction))


def test_accelerations_at_measured_states_tell_a_load_and_its_cable(laden: FittedAtStates):
    """The cable of five arms is 0.4848 m; the rope's drag adds to the damping of 0.05."""
    for name, true in (("ratio", 0.12), ("length", 0.4848), ("hook", 0.0097)):
        value, error = laden.values[f"mass.slung_load.{name}"], laden.error(f"mass.slung_load.{name}")
        assert value == pytest.approx(true, abs=max(3.0 * error, 0.03 * true))
    assert laden.values["mass.slung_load.damping"] == pytest.approx(0.05, abs=0.01)


def test_a_multirotor_is_tested_for_a_load(laden: FittedAtStates):
    spec = propose(laden.flights.dataset, laden.flights.reconstruction, ())
    assert "mass.slung_load" in candidates(spec)[0]
    states = MeasuredStates.of(
        laden.model, list(seen_flights(laden.model, laden.flights.records(laden.model, ["roll_p"])))
    )
    assert float(states.remainders(laden.model.theta.detach())[0]["ay"].std()) < 0.03
