"""Steps and samples: models too fast for a step, flights of several sample intervals, controls held or linear."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.signal import lsim
from torch import Tensor, nn

import rotorid_torch as rotorid
from rotorid_torch.identification.estimate.progressive_fit import Settings, fit
from rotorid_torch.identification.estimate.segments import records_from
from rotorid_torch.identification.estimate.system import System
from tests.identification.estimate.output_error_cases import (
    ROLL,
    SHORT_PERIOD,
    Roll,
    ShortPeriod,
    roll_flight,
    unstable_flight,
)


class Loop(nn.Module):
    """A rate loop behind an actuator: s' = a (u - s), p' = L p + d s; p is measured."""

    def __init__(self, a: float, L: float = -2.0, d: float = 5.0) -> None:
        super().__init__()
        self.a, self.L, self.d = (nn.Parameter(torch.tensor(v, dtype=torch.float64)) for v in (a, L, d))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return torch.stack([self.a * (u[..., 0] - x[..., 0]), self.L * x[..., 1] + self.d * x[..., 0]], dim=-1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x[..., 1:]


def loop_flight(a: float, dt: float = 0.02, seed: int = 0, hold: bool = False) -> dict[str, Any]:
    """The answer of a = `a`, L = -3, d = 8 to a doublet, by another integrator, with noise of 0.01."""
    time = np.arange(0.0, 6.0, dt)
    u = np.where((time > 1) & (time < 2), 0.5, 0.0) + np.where((time >= 2) & (time < 3), -0.5, 0.0)

    def control(t: float) -> float:
        return u[min(int(t / dt + 1e-9), len(u) - 1)] if hold else float(np.interp(t, time, u))

    def rates(t: float, x: np.ndarray) -> list[float]:
        return [a * (control(t) - x[0]), -3.0 * x[1] + 8.0 * x[0]]

    how: dict[str, Any] = {"method": "LSODA", "rtol": 1e-8, "atol": 1e-10, "max_step": dt / 2}
    found = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, **how)
    outputs = found.y[1] + 0.01 * np.random.default_rng(seed).standard_normal(len(time))
    return {"time": time, "controls": u[:, None], "outputs": outputs[:, None], "x0": np.zeros(2)}


class Oscillator(nn.Module):
    """x'' = -w² x - 2 z w x' + u."""

    def __init__(self, w: float, z: float) -> None:
        super().__init__()
        self.w, self.z = (nn.Parameter(torch.tensor(v, dtype=torch.float64)) for v in (w, z))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        pull = self.w**2 * x[..., 0] + 2.0 * self.z * self.w * x[..., 1]
        return torch.stack([x[..., 1], u[..., 0] - pull], dim=-1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x


@pytest.mark.parametrize("w", [30.0, 60.0, 150.0])
def test_an_oscillation_keeps_its_damping_whatever_the_step(w: float) -> None:
    """Steps that are only stable add damping of their own: of 60 rad/s at 0.02 s 0.05 had become 0.035."""
    time = 0.02 * np.arange(400)
    u = np.sign(np.sin(2.0 * np.pi * 0.7 * time))
    system = np.array([[0.0, 1.0], [-(w**2), -0.1 * w]]), np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))
    _, y, _ = lsim(system, u, time)
    noise = 1e-2 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y.shape)
    flight = {"time": time, "controls": u[:, None], "outputs": y + noise, "x0": np.zeros(2)}
    found = rotorid.output_error(Oscillator(0.9 * w, 0.1), [flight], x0="fixed")
    assert found.converged, found.message
    assert found["w"].value == pytest.approx(w, rel=2e-3)
    assert found["z"].value == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize(("start", "solver"), [(10.0, "rk4"), (300.0, "rk4")])
def test_a_pole_that_is_too_fast_for_a_step_is_followed(start: float, solver: str) -> None:
    """One step a sample is unstable beyond 139 1/s: it had found 137 ± 2."""
    found = rotorid.output_error(Loop(start), [loop_flight(300.0)], solver=solver)
    assert found.converged, found.message
    for name, truth in (("a", 300.0), ("L", -3.0), ("d", 8.0)):
        assert abs(found[name].value - truth) < 3.5 * found[name].se, (name, found[name])
    assert "steps, for the pole -" in found.message
    assert float(found.noise[0, 0]) ** 0.5 == pytest.approx(0.01, rel=0.1)
    assert len(found.residuals[0]) == 300


def test_a_pole_that_no_step_follows_is_refused_with_its_name() -> None:
    with pytest.raises(rotorid.InputError, match=r"pole -1e\+05 1/s is too fast for 128 steps"):
        rotorid.output_error(Loop(1e5), [loop_flight(300.0)])


def test_a_start_that_diverges_is_refused_in_one_line() -> None:
    with pytest.raises(rotorid.InputError, match="diverges where it starts; its fastest pole there is 400 1/s"):
        rotorid.output_error(Loop(-400.0), [loop_flight(20.0)], x0="fixed", segment_lengths=[math.inf])


def test_steps_that_are_short_enough_change_nothing() -> None:
    flights = [roll_flight(np.random.default_rng(k), shift=k) for k in range(2)]
    records = records_from(flights)
    system = System(Roll())
    one, three = (fit(system, which, settings=Settings()) for which in (records, records.refined(3)))
    errors = one.uncertainty.standard_errors
    assert float(((one.theta - three.theta) / errors).abs().max()) < 1e-2
    torch.testing.assert_close(three.uncertainty.standard_errors, errors, rtol=0.03, atol=0.0)
    torch.testing.assert_close(three.noise, one.noise, rtol=1e-3, atol=0.0)
    torch.testing.assert_close(three.model_error_ratio, one.model_error_ratio, rtol=1e-3, atol=0.0)


@pytest.mark.parametrize("intervals", [(0.02, 0.05), (0.04, 0.02)])
def test_flights_may_have_several_sample_intervals(intervals: tuple[float, float]) -> None:
    flights = [loop_flight(20.0, dt, seed) for seed, dt in enumerate(intervals)]
    found = rotorid.output_error(Loop(10.0), flights)
    alone = rotorid.output_error(Loop(10.0), flights[:1])
    assert found.converged, found.message
    for name, truth in (("a", 20.0), ("L", -3.0), ("d", 8.0)):
        assert abs(found[name].value - truth) < 3.5 * found[name].se, (name, found[name])
        assert found[name].se < 1.05 * alone[name].se
    assert [len(r) for r in found.residuals] == [len(f["time"]) for f in flights]
    assert not any(bool(r.isnan().any()) for r in found.residuals)


def test_sample_intervals_without_a_common_step_are_refused() -> None:
    flights = [loop_flight(20.0), loop_flight(20.0, 0.0217)]
    with pytest.raises(rotorid.InputError, match="multiples of a step"):
        rotorid.output_error(Loop(10.0), flights)


def test_filter_error_takes_several_intervals_and_short_steps() -> None:
    flights = [loop_flight(120.0, 0.02, 1), loop_flight(120.0, 0.04, 2)]
    model = Loop(120.0)
    found = rotorid.filter_error(model, flights, free=["L", "d"], process_noise=["x[1]"], x0="fixed")
    for name, truth in (("L", -3.0), ("d", 8.0)):
        assert abs(found[name].value - truth) < 3.5 * found[name].se, (name, found[name])
    assert [len(part) for part in found.innovations] == [300, 150]
    assert "steps, for the pole -" in found.message


@pytest.mark.parametrize("solver", ["rk4", "dopri5"])
def test_controls_are_held_or_linear_between_samples(solver: str) -> None:
    """At ten samples a second the difference is 50 ms of delay; torch and native code agree."""
    flight = loop_flight(20.0, 0.1, hold=True)
    held = rotorid.output_error(Loop(10.0), [flight], controls="held", solver=solver, x0="fixed")
    linear = rotorid.output_error(Loop(10.0), [flight], x0="fixed")
    for name, truth in (("a", 20.0), ("L", -3.0), ("d", 8.0)):
        assert abs(held[name].value - truth) < 3.5 * held[name].se, (name, held[name])
    assert float(held.noise[0, 0]) < 0.3 * float(linear.noise[0, 0])
    reference = rotorid.output_error(Loop(10.0), [flight], controls="held", x0="fixed")
    assert abs(held["a"].value - reference["a"].value) < 0.05 * held["a"].se


def test_segments_that_are_asked_for_are_taken() -> None:
    flight = unstable_flight(10.0, noise=(0.003, 0.00015, 0.003), seed=3)
    short = rotorid.output_error(ShortPeriod(**SHORT_PERIOD), [flight], segment_lengths=[2.0])
    whole = rotorid.output_error(ShortPeriod(**SHORT_PERIOD), [flight], segment_lengths=[2.0, math.inf])
    assert short.segment_seconds == pytest.approx(2.0, abs=0.05)
    assert "found over segments of 2 s" in short.message
    assert whole.segment_seconds == math.inf
    assert "found over" not in whole.message
    assert [r.shape for r in short.whole.residuals] == [r.shape for r in short.residuals]
    torch.testing.assert_close(whole.whole.residuals[0], whole.residuals[0], rtol=1e-6, atol=1e-9)
    assert bool((short.whole.ratio > 1.0).all())


def test_roll_is_found_as_before() -> None:
    found = rotorid.output_error(Roll((-0.5, -1.0, 1.0)), [roll_flight(np.random.default_rng(0))])
    for p, truth in zip(found.parameters, ROLL, strict=True):
        assert abs(p.value - truth) < 4.0 * p.se
    assert "steps" not in found.message
