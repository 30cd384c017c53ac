"""The filter error method on flights in moving air, and on calm ones, where output error says the same."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from rotorid_torch.identification.estimate.output_error import output_error
from rotorid_torch.identification.filter_error.method import filter_error
from rotorid_torch.identification.filter_error.result import FilterError
from tests.identification.estimate.output_error_cases import (
    ROLL,
    SHORT_PERIOD,
    Roll,
    ShortPeriod,
    roll_flight,
    unstable_flight,
)
from tests.identification.filter_error.gust_cases import (
    BIASES,
    JET,
    LATERAL,
    LATERAL_GUSTS,
    LATERAL_NOISE,
    Jet,
    gusty_roll,
    jet_flight,
    lateral_flight,
    lateral_model,
)


@pytest.fixture(scope="module")
def lateral() -> FilterError:
    flights = [lateral_flight(np.random.default_rng([0, k])) for k in range(3)]
    return rotorid.filter_error(lateral_model(0.5), flights)


def test_roll_and_yaw_derivatives_in_turbulence(lateral: FilterError) -> None:
    assert lateral.converged
    for p in lateral.parameters:
        truth = (LATERAL | BIASES)[p.name]
        assert abs(p.value - truth) < max(2.5 * p.se, 0.05 * abs(truth)), (p.name, p.value, p.se)
    lp = lateral.parameters[0]
    assert lp.se < 0.05
    assert [p.name for p in lateral.process_noise] == ["p", "r"]
    for p, truth in zip(lateral.process_noise, LATERAL_GUSTS, strict=True):
        assert abs(p.value - truth) < 3.0 * p.se < 0.15 * truth
    assert float(lateral.whiteness.p.min()) > 0.01


@pytest.mark.parametrize(
    ("start", "asked"),
    [
        (0.5, {}),
        (1.5, {"x0": "fixed"}),
        (0.5, {"process_noise": "full", "noise": "full"}),
        (0.0, {}),
        (0.7, {"process_noise": ["V", "alpha", "q"], "gain": "held"}),
    ],
)
def test_a_jets_coefficients_in_turbulence_whatever_is_asked_for(start: float, asked: dict[str, Any]) -> None:
    flight = jet_flight(np.random.default_rng(3))
    if asked.get("x0") != "fixed":
        flight["outputs"][np.random.default_rng(4).uniform(size=flight["outputs"].shape) < 0.2] = np.nan
    result = rotorid.filter_error(Jet(**{n: start * v for n, v in JET.items()}), [flight], **asked)
    assert result.converged
    for p in result.parameters:
        assert abs(p.value - JET[p.name]) < max(2.5 * p.se, 0.05 * abs(JET[p.name])), (p.name, p.value, p.se)


def test_output_error_takes_turbulence_for_the_vehicles_own_motion(lateral: FilterError) -> None:
    flights = [lateral_flight(np.random.default_rng([1, k])) for k in range(3)]
    calm, gusty = output_error(lateral_model(0.5), flights), filter_error(lateral_model(0.5), flights)
    assert "filter_error tells more" in calm.message
    assert abs(calm.parameters[0].value - LATERAL["Lp"]) > 5.0 * calm.parameters[0].se
    assert abs(gusty.parameters[0].value - LATERAL["Lp"]) < 2.5 * gusty.parameters[0].se


def test_gains_that_are_held_lead_to_the_same_parameters_and_errors(lateral: FilterError) -> None:
    flights = [lateral_flight(np.random.default_rng([0, k])) for k in range(3)]
    held = filter_error(lateral_model(0.5), flights, gain="held")
    assert held.converged
    assert abs(held.log_likelihood - lateral.log_likelihood) < 2.0
    for p, q in zip(held.parameters + held.process_noise, lateral.parameters + lateral.process_noise, strict=True):
        assert abs(p.value - q.value) < q.se, (p.name, p.value, q.value)
        assert 0.9 < p.se / q.se < 1.5


class Biased(nn.Module):
    """A lag whose output has a bias that its drift and initial state can take the place of."""

    def __init__(self) -> None:
        super().__init__()
        for name, value in {"a": -1.0, "b": 1.0, "drift": 0.0, "bias": 0.0}.items():
            setattr(self, name, nn.Parameter(torch.tensor(value)))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.a * x + self.b * u + self.drift

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x + self.bias


@pytest.mark.parametrize("estimator", [output_error, filter_error])
def test_a_direction_that_nothing_tells_leaves_the_errors_of_all_else_as_they_are(estimator: Any) -> None:
    rng, time = np.random.default_rng(0), 0.05 * np.arange(300)
    u, x = np.sign(np.sin(time))[:, None], np.zeros((300, 1))
    for k in range(299):
        x[k + 1] = x[k] + 0.05 * (-2.0 * x[k] + 3.0 * u[k] + 0.5)
    outputs = x + 0.2 + 0.05 * rng.standard_normal((300, 1))
    flight = {"time": time, "controls": u, "outputs": outputs, "x0": [0.0]}
    free = ["a", "b", "drift", "bias"]
    every, enough = estimator(Biased(), [flight], free=free), estimator(Biased(), [flight], free=free[:3])
    assert [p.status for p in every.parameters] == ["free", "free", "not identifiable", "not identifiable"]
    assert all(np.isnan(p.se) for p in every.parameters[2:])
    for p, q in zip(every.parameters[:2], enough.parameters[:2], strict=True):
        assert abs(p.value - q.value) < 1e-2 * q.se
        assert abs(p.se / q.se - 1.0) < 1e-2


@pytest.mark.parametrize("gain", ["exact", "held"])
def test_noises_that_may_be_correlated_explain_no_less_and_correlations_have_signs(gain: str) -> None:
    flight = lateral_flight(np.random.default_rng([0, 0]))
    flight["outputs"][:, 2] -= 8.0 * np.random.default_rng(1).standard_normal(len(flight["time"])) * LATERAL_NOISE[2]
    flight["outputs"][:, 1] += 8.0 * np.random.default_rng(1).standard_normal(len(flight["time"])) * LATERAL_NOISE[1]
    alone = filter_error(lateral_model(), [flight], gain=gain)
    pair = filter_error(lateral_model(), [flight], process_noise="full", noise="full", gain=gain)
    assert pair.converged
    assert pair.log_likelihood > alone.log_likelihood + 100.0
    correlation = next(p for p in pair.measurement_noise if p.name == "y[2], y[1]")
    assert -1.0 < correlation.value < -0.9


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (2.0, 3.0, -4.0), (-9.0, -20.0, 30.0)])
def test_any_start_leads_to_the_same_optimum(start: tuple[float, ...]) -> None:
    flights = [gusty_roll(np.random.default_rng(k), shift=0.5 * k) for k in range(3)]
    best, result = filter_error(Roll(), flights), filter_error(Roll(start), flights)
    assert result.converged
    for p, q in zip(result.parameters + result.process_noise, best.parameters + best.process_noise, strict=True):
        assert abs(p.value - q.value) < 0.05 * q.se
    for p, truth in zip(result.parameters, ROLL, strict=True):
        assert abs(p.value - truth) < 3.0 * p.se


@pytest.mark.parametrize("gain", ["exact", "held"])
@pytest.mark.parametrize("most", [0, 1, 3])
def test_a_search_takes_no_more_iterations_than_it_may(gain: str, most: int) -> None:
    """All its parts together; where it may take none, parameters stay where they are."""
    steps, start = [], (-4.0, -5.0, 8.0)
    flight = gusty_roll(np.random.default_rng(0))
    watch = lambda iteration, cost, theta: steps.append(iteration)  # noqa: E731
    result = filter_error(Roll(start), [flight], gain=gain, max_iterations=most, monitor=watch)
    assert steps == list(range(1, most + 1))
    assert not result.converged
    assert f"stopped after {most} " in result.message
    assert ([p.value for p in result.parameters] == list(start)) == (most == 0)
    assert all(np.isfinite(p.se) for p in result.parameters)


@pytest.mark.parametrize("x0", ["free", "fixed"])
def test_without_process_noise_it_is_output_error(x0: str) -> None:
    flights = [roll_flight(np.random.default_rng(k)) for k in range(2)]
    calm = output_error(Roll((-0.5, -1.0, 1.0)), flights, x0=x0)
    result = filter_error(Roll((-0.5, -1.0, 1.0)), flights, process_noise=torch.zeros(2, 2), x0=x0)
    assert [p.value for p in result.parameters] == [p.value for p in calm.parameters]
    assert torch.equal(result.covariance, calm.covariance)
    assert torch.equal(result.innovations[0], calm.residuals[0])
    assert result.process_noise == []
    assert "filter_error" not in calm.message
    residual = np.concatenate([r.numpy() for r in calm.residuals])
    sd = np.sqrt((residual**2).mean(axis=0))
    expected = -np.log(sd * np.sqrt(2 * np.pi)).sum() * len(residual) - len(residual)
    assert abs(result.log_likelihood - expected) < 0.5


def test_calm_air_has_no_process_noise_and_the_same_parameters() -> None:
    flights = [roll_flight(np.random.default_rng(k)) for k in range(2)]
    calm, result = output_error(Roll(), flights), filter_error(Roll((-0.5, -1.0, 1.0)), flights)
    for p, q in zip(result.parameters, calm.parameters, strict=True):
        assert abs(p.value - q.value) < 0.1 * q.se
        assert 0.9 < p.se / q.se < 1.1
    for p in result.process_noise:
        assert p.value < 0.002
    np.testing.assert_allclose(result.noise.diagonal().sqrt(), [0.01, 0.02], rtol=0.1)


def test_an_unstable_vehicle_needs_no_care() -> None:
    flight = unstable_flight(20.0, noise=(0.003, 0.00015, 0.003), seed=3)
    for factor in (3.0, -1.0, 0.0):
        result = filter_error(ShortPeriod(**{n: factor * v for n, v in SHORT_PERIOD.items()}), [flight])
        assert result.converged
        for p in result.parameters:
            assert abs(p.value - SHORT_PERIOD[p.name]) < 3.5 * p.se, (p.name, p.value)


def test_missing_samples_full_noises_bounds_and_what_comes_back() -> None:
    flights = [gusty_roll(np.random.default_rng(k), seconds=12.0 + k) for k in range(3)]
    flights[1]["outputs"][40:80, 0] = np.nan
    flights[1]["outputs"][::5, 1] = np.nan
    result = filter_error(
        Roll((-0.5, -1.0, 1.0)),
        flights,
        process_noise="full",
        noise="full",
        bounds={"theta[0]": (-0.9, 0.0)},
    )
    by_name = {p.name: p for p in result.parameters}
    assert by_name["theta[0]"].at_bound
    assert by_name["theta[0]"].value == -0.9
    assert float(torch.linalg.eigvalsh(result.process_covariance).min()) > -1e-15
    assert [p.name for p in result.process_noise] == ["x[0]", "x[1]", "x[1], x[0]"]
    assert [p.name for p in result.measurement_noise] == ["y[0]", "y[1]", "y[1], y[0]"]
    assert [p.unit for p in result.process_noise] == ["/sqrt(s)", "/sqrt(s)", ""]
    assert [tuple(e.shape) for e in result.innovations] == [(240, 2), (260, 2), (280, 2)]
    assert [tuple(e.shape) for e in result.states] == [(240, 2), (260, 2), (280, 2)]
    assert bool(result.innovations[1][40:80, 0].isnan().all())
    assert bool(torch.stack([e.isfinite().all() for e in result.states + result.state_errors]).all())


def test_smoothed_states_lie_nearer_to_the_truth_than_what_is_measured() -> None:
    rng = np.random.default_rng(5)
    flight = gusty_roll(rng, noise=(0.0, 0.0))
    truth = flight["outputs"]
    flight |= {"outputs": truth + rng.standard_normal(truth.shape) * (0.01, 0.02)}
    result = filter_error(Roll(), [flight], process_noise=["x[1]"])
    wrong = (result.states[0] - torch.as_tensor(truth)) / result.state_errors[0]
    assert float((wrong.abs() < 1.96).double().mean()) > 0.85
    rms = (result.states[0] - torch.as_tensor(truth)).square().mean(dim=0).sqrt()
    assert bool((rms < torch.tensor([0.004, 0.016])).all())


class Runaway(nn.Module):
    """A state that doubles every 2 ms."""

    states = ("lag",)

    def __init__(self) -> None:
        super().__init__()
        self.rate = nn.Parameter(torch.tensor(400.0, dtype=torch.float64))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.rate * (x - u)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return 0.0 * x + u


def test_a_filter_that_diverges_says_where_and_with_which_state() -> None:
    flight = roll_flight(np.random.default_rng(0)) | {"outputs": np.random.default_rng(1).standard_normal((300, 1))}
    with pytest.raises(InputError, match=r"flights\[0\]: lag: the filter diverges at .* s"):
        filter_error(Runaway(), [flight | {"x0": np.zeros(1)}])


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ({"process_noise": ["q"]}, "process_noise"),
        ({"process_noise": -torch.eye(2)}, "process_noise"),
        ({"process_noise": "white"}, "process_noise"),
        ({"noise": torch.zeros(2, 2)}, "noise"),
        ({"noise": "white"}, "noise"),
        ({"noise_floor": [1.0]}, "noise_floor"),
        ({"x0": "guess"}, "x0"),
        ({"engine": "fast"}, "engine"),
        ({"gain": "none"}, "gain"),
        ({"free": ["thetta"]}, "free"),
    ],
)
def test_bad_arguments_are_named(more: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError) as caught:
        filter_error(Roll(), [roll_flight(np.random.default_rng(0))], **more)  # pyright: ignore[reportArgumentType]
    assert caught.value.key == key
    assert "\n" not in str(caught.value)
