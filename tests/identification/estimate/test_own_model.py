"""What stands between anybody's model and the records: pure delays of controls, outputs that are angles."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import rotorid_torch as rotorid
from rotorid_torch.identification.own_model import warn_of_turns
from tests.identification.estimate.output_error_cases import ROLL, Roll, roll_flight

DT = 0.02
TIME = DT * np.arange(400)


class Heading(nn.Module):
    """Yaw rate and heading: r' = N r + d u, psi' = r; both are measured."""

    def __init__(self, N: float = -0.5, d: float = 1.0) -> None:
        super().__init__()
        self.N, self.d = (nn.Parameter(torch.tensor(v, dtype=torch.float64)) for v in (N, d))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return torch.stack([self.N * x[..., 0] + self.d * u[..., 0], x[..., 0]], dim=-1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x


def turning(seed: int = 0) -> dict[str, Any]:
    """The exact answer of N = -1, d = 2 to a step of 1: the heading makes two turns."""
    u = np.ones(len(TIME))
    r = 2.0 * (1.0 - np.exp(-TIME))
    psi = 2.5 + 2.0 * (TIME - (1.0 - np.exp(-TIME)))
    noise = np.array([0.02, 0.01]) * np.random.default_rng(seed).standard_normal((len(TIME), 2))
    outputs = np.stack([r, psi], axis=-1) + noise
    return {"time": TIME, "controls": u[:, None], "outputs": outputs, "x0": np.array([0.0, 2.5])}


def half_turns(flight: dict[str, Any]) -> dict[str, Any]:
    """The same with the heading from -180 to 180 degrees."""
    outputs = flight["outputs"].copy()
    outputs[:, 1] = (outputs[:, 1] + np.pi) % (2.0 * np.pi) - np.pi
    return flight | {"outputs": outputs}


@pytest.mark.parametrize("estimator", [rotorid.output_error, rotorid.filter_error])
def test_a_heading_that_wraps_tells_what_one_that_does_not_tells(estimator: Any) -> None:
    flight = turning()
    reference = estimator(Heading(), [flight])
    found = estimator(Heading(), [half_turns(flight)], angles=[1])
    for p, q in zip(reference.parameters, found.parameters, strict=True):
        assert abs(p.value - q.value) < 1e-3 * p.se
        assert q.se == pytest.approx(p.se, rel=1e-3)
    figure = found.plot()[0]
    assert len(figure.axes) == 2
    assert figure.axes[0].lines[0].get_xdata()[-1] == pytest.approx(TIME[-1])
    with pytest.warns(rotorid.WrappedAngle, match="output 1"):
        estimator(Heading(), [half_turns(flight)])
    left = found.residuals[0] if estimator is rotorid.output_error else found.innovations[0]
    assert float(left[:, 1].abs().max()) < 0.1
    assert isinstance(found.model, Heading)


def test_the_unscented_filter_takes_innovations_within_half_a_turn() -> None:
    flight = turning()

    def f(x: Tensor, u: Tensor) -> Tensor:
        return torch.stack([2.0 * u[..., 0] - x[..., 0], x[..., 0] + x[..., 2], 0.0 * x[..., 2]], dim=-1)

    def h(x: Tensor, u: Tensor) -> Tensor:
        return x[..., :2]

    prior = {"x0": [0.0, 2.5, 0.0], "P0": np.diag([1e-4, 1e-2, 0.1]), "Q": np.diag([1e-8, 1e-8, 0.0])}
    noise = {"R": np.diag([4e-4, 1e-4]), "controls": flight["controls"], "dt": DT}
    whole = rotorid.unscented_filter(f, h, **prior, **noise, outputs=flight["outputs"])
    outputs = half_turns(flight)["outputs"]
    outputs[100:110, 1] = np.nan
    wrapped = rotorid.unscented_filter(f, h, **prior, **noise, outputs=outputs, angles=[1])
    with pytest.warns(rotorid.WrappedAngle, match=r"output 1 jumps by a whole turn .* angles=\[1\]"):
        lost = rotorid.unscented_filter(f, h, **prior, **noise, outputs=outputs)
    assert whole.smoothed_means is not None
    assert wrapped.smoothed_means is not None
    assert lost.smoothed_means is not None
    error = float(whole.smoothed_covariances[-1, 2, 2]) ** 0.5  # pyright: ignore[reportOptionalSubscript]
    assert abs(float(wrapped.smoothed_means[-1, 2] - whole.smoothed_means[-1, 2])) < 0.5 * error
    assert abs(float(lost.smoothed_means[-1, 2])) > 10.0 * error
    assert float(wrapped.innovations[:, 1].nan_to_num().abs().max()) < 0.2


@pytest.mark.parametrize("start", [0.0, 0.05])
def test_a_pure_delay_is_a_parameter(start: float) -> None:
    flights: list[dict[str, Any]] = [roll_flight(np.random.default_rng(k), shift=k) for k in range(2)]
    late = [late_by(flight, 3) for flight in flights]
    dt = float(flights[0]["time"][1] - flights[0]["time"][0])
    found = rotorid.output_error(Roll((-0.8, -1.5, 2.0)), late, delays={0: start})
    assert found.converged, found.message
    assert found["delay[0]"].unit == "s"
    assert abs(found["delay[0]"].value - 3.0 * dt) < max(4.0 * found["delay[0]"].se, 1e-3)
    for p, truth in zip(found.parameters, ROLL, strict=False):
        assert abs(p.value - truth) < 4.0 * p.se
    assert isinstance(found.model, Roll)
    options: dict[str, Any] = {"delays": {0: 0.02}, "bounds": {"delay[0]": (0.0, 0.2)}}
    none = rotorid.output_error(Roll((-0.8, -1.5, 2.0)), flights, ["theta"], **options)
    assert none["delay[0]"].value < max(4.0 * none["delay[0]"].se_white, 2e-3)
    assert none["delay[0]"].bounds == (0.0, 0.2)


def test_initial_states_may_be_fixed_in_part() -> None:
    """The second state is believed: what is found is what a model without it as an unknown finds."""
    flight: dict[str, Any] = roll_flight(np.random.default_rng(0)) | {"x0": np.array([0.05, 0.01])}
    part = rotorid.output_error(Roll(), [flight], x0={1: "fixed"})
    assert part.converged
    assert float(part.initial_states[0, 1]) == pytest.approx(0.01, abs=1e-12)
    assert abs(float(part.initial_states[0, 0])) < 0.02  # the truth is zero

    words = rotorid.output_error(Roll(), [flight], x0={"x[0]": "fixed", "x[1]": "fixed"})
    whole = rotorid.output_error(Roll(), [flight], x0="fixed")
    for p, q in zip(words.parameters, whole.parameters, strict=True):
        assert abs(p.value - q.value) < 1e-4 * q.se
        assert p.se == pytest.approx(q.se, rel=0.05)


@pytest.mark.parametrize("engine", ["native", "torch"])
def test_initial_states_stay_within_bounds(engine: str) -> None:
    """On a bound the estimate is that with the state believed there; within wide bounds that with it free."""
    flight: dict[str, Any] = roll_flight(np.random.default_rng(1))
    solver = "rk4" if engine == "native" else "dopri5"
    free = rotorid.output_error(Roll(), [flight], solver=solver)
    wide = rotorid.output_error(Roll(), [flight], x0={0: (-1.0, 1.0)}, solver=solver)
    bound = float(free.initial_states[0, 0]) + 0.02
    held = rotorid.output_error(Roll(), [flight], x0={0: (bound, 1.0)}, solver=solver)
    believed = rotorid.output_error(Roll(), [flight | {"x0": np.array([bound, 0.0])}], x0={0: "fixed"}, solver=solver)
    assert held.converged, held.message
    assert float(held.initial_states[0, 0]) == pytest.approx(bound, abs=1e-9)
    assert "initial states on a bound: x[0] of flight 0" in held.message
    for p, q, r, s in zip(free.parameters, wide.parameters, held.parameters, believed.parameters, strict=True):
        assert abs(p.value - q.value) < 1e-3 * p.se
        assert abs(r.value - s.value) < 1e-2 * s.se


def late_by(flight: dict[str, Any], samples: int) -> dict[str, Any]:
    """The flight with its controls recorded so many samples too early."""
    u = np.asarray(flight["controls"])
    return flight | {"controls": np.concatenate([u[samples:], np.repeat(u[-1:], samples, axis=0)])}


def test_free_initial_states_say_what_held_ones_would_give() -> None:
    """A start that the record contradicts takes parameters along where it is believed; one that agrees does not."""
    flight = turning()
    agreed = rotorid.output_error(Heading(), [flight])
    assert "x0" not in agreed.message
    wrong = flight | {"x0": np.array([0.5, 2.5])}
    free, held = (rotorid.output_error(Heading(), [wrong], x0=x0) for x0 in ("free", "fixed"))
    (N,) = re.findall(r'\(x0="fixed"\) would give N ([-\d.e]+)', free.message)
    assert float(N) == pytest.approx(held["N"].value, rel=0.02)
    assert abs(held["N"].value - free["N"].value) > held["N"].se


def steps_of(size: float, noise: float) -> np.ndarray:
    """0 and `size` by turns, 2 s each."""
    steps = np.where(np.arange(400) // 100 % 2, size, 0.0)
    return steps + noise * np.random.default_rng(0).standard_normal(400)


@pytest.mark.parametrize("size", [6.0, 6.1, 6.5])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.01])
def test_steps_of_about_a_turn_are_no_angle(size: float, noise: float, recwarn: pytest.WarningsRecorder) -> None:
    warn_of_turns(torch.tensor(steps_of(size, noise))[:, None], ())
    assert not len(recwarn)


@pytest.mark.parametrize("rate", [-8.0, 0.0, 0.02, 8.0])
@pytest.mark.parametrize("noise", [1e-3, 0.05])
def test_turns_of_any_rate_are_told(rate: float, noise: float) -> None:
    """From a heading that stands at half a turn to one that turns by a fortieth of one at each sample."""
    psi = np.pi + rate * DT * (np.arange(400) - 200) + noise * np.random.default_rng(0).standard_normal(400)
    with pytest.warns(rotorid.WrappedAngle):
        warn_of_turns(torch.tensor((psi + np.pi) % (2.0 * np.pi) - np.pi)[:, None], ())


class Tied(nn.Module):
    """dx/dt = a x + b u, a and b in one tensor that has two names."""

    def __init__(self) -> None:
        super().__init__()
        self.rate = nn.Parameter(torch.tensor([-1.0, 2.0], dtype=torch.float64))
        self.gain = self.rate

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.rate[0] * x + self.gain[1] * u

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x


def test_a_second_name_of_a_tensor_is_its_name() -> None:
    u = np.sin(TIME)[:, None]
    noise = 0.01 * np.random.default_rng(0).standard_normal(u.shape)
    flight = {"time": TIME, "controls": u, "outputs": np.cumsum(u, axis=0) * DT + noise, "x0": [0.0]}
    found = rotorid.output_error(Tied(), [flight], free=["gain[1]"], bounds={"gain[1]": (0.0, 9.0)})
    assert [p.name for p in found.parameters] == ["rate[1]"]
    assert found["gain[1]"] is found["rate[1]"]
    assert "gain[1]" in found
    assert "gain[0]" not in found
