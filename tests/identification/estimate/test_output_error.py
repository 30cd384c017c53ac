"""Output error on known systems: unstable short period, rate loop; derivatives, noise, bounds, priors, bad input."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from rotorid_torch.errors import InputError
from rotorid_torch.identification.estimate.output_error import Settings, fit, output_error
from rotorid_torch.identification.estimate.progressive_fit import _Stages
from rotorid_torch.identification.estimate.segments import cut, records_from
from rotorid_torch.identification.estimate.sensitivity import Near, corrected, sensitivities, simulated, traced
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.filter_error.method import filter_error
from tests.identification.estimate.output_error_cases import (
    RATE_LOOP,
    ROLL,
    SHORT_PERIOD,
    Named,
    RateLoop,
    Roll,
    ShortPeriod,
    flown,
    roll_flight,
    steps,
    unstable_flight,
)


def scaled(factor: float) -> ShortPeriod:
    return ShortPeriod(**{name: factor * value for name, value in SHORT_PERIOD.items()})


@pytest.mark.parametrize(
    ("seconds", "factor"), [(10.0, 2.5), (10.0, 0.4), (10.0, -1.0), (20.0, 3.0), (20.0, 1.0), (20.0, 0.0)]
)
def test_unstable_short_period_without_help(seconds: float, factor: float) -> None:
    flight = unstable_flight(seconds, noise=(0.003, 0.00015, 0.003), seed=3)
    found = output_error(scaled(factor), [flight])
    assert found.converged, found.stages
    for p in found.parameters:
        assert abs(p.value / SHORT_PERIOD[p.name] - 1.0) < 0.005, (p.name, p.value)
        assert abs(p.value - SHORT_PERIOD[p.name]) < 4.0 * p.se
    assert float((found.model_error_ratio - 1.0).abs().max()) < 0.2


def test_rate_loop_with_unmeasured_motors() -> None:
    rng, flights = np.random.default_rng(5), []
    for k in range(2):
        time = 0.008 * np.arange(400)
        controls = 0.05 * steps(time, (0.3, 0.6, 0.8, 0.9 + 0.1 * k, 1.1, 2.0, 2.4), (1, -1, 1, -1, 0, 1))[:, None]
        _, clean = flown(RateLoop(**RATE_LOOP), time, controls, (0.1, 0.0))
        outputs = clean.numpy() + 0.02 * rng.standard_normal((400, 1))
        flights.append({"time": time, "controls": controls, "outputs": outputs, "x0": np.zeros(2)})
    start = RateLoop(lag=0.15, gain=40.0, damping=0.0, bias=0.0)
    found = output_error(start, flights, bounds={"lag": (0.005, 0.5)})
    assert found.converged, found.stages
    for p in found.parameters:
        assert abs(p.value - RATE_LOOP[p.name]) < 4.0 * p.se, (p.name, p.value, p.se)
    assert abs(found.parameters[0].value / 0.05 - 1.0) < 0.05
    assert float(start.gain.detach()) == 40.0  # the caller's module is left as it is  # pyright: ignore[reportCallIssue]


class WithTape(nn.Module):
    """Nonlinear, matrix-valued parameters, a control path that depends on them, time in the rates."""

    def __init__(self) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(0)
        self.A = nn.Parameter(0.3 * torch.randn(3, 3, generator=generator, dtype=torch.float64) - torch.eye(3))
        self.B = nn.Parameter(torch.randn(3, 2, generator=generator, dtype=torch.float64))
        self.shift = nn.Parameter(torch.tensor(0.3, dtype=torch.float64))

    def tape(self, controls: Tensor, dt: float) -> Tensor:
        before = torch.cat([controls[..., :1, :], controls[..., :-1, :]], dim=-2)
        return controls + self.shift * (before - controls)

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return x @ self.A.mT + u @ self.B.mT - 0.1 * x**3 + 0.1 * torch.sin(t)[..., None]

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return torch.cat([x[..., :2], (x[..., 2:] * self.B[0, 0]).sin() + u[..., :1]], dim=-1)


def tape_problem():
    model, generator = WithTape(), torch.Generator().manual_seed(1)
    flights = []
    for samples in (60, 45):
        controls = torch.randn(samples, 2, generator=generator, dtype=torch.float64).cumsum(0) * 0.3
        flights.append(
            {
                "time": 0.05 * torch.arange(samples),
                "controls": controls,
                "outputs": torch.zeros(samples, 3),
                "x0": np.zeros(3),
            }
        )
    system, records = System(model), records_from(flights)
    segments = cut(records, 30)
    x0 = torch.randn(len(segments), 3, generator=generator, dtype=torch.float64)
    return system, records, segments, x0


def test_sensitivities_against_autograd_and_differences() -> None:
    system, records, segments, x0 = tape_problem()
    run = simulated(system, system.theta, records, segments, x0)
    blocks = list(sensitivities(system, run, records, segments))
    slopes = torch.cat([b.outputs for b in blocks]).transpose(0, 1)
    theta = system.theta.clone().requires_grad_()
    start = x0.clone().requires_grad_()
    outputs = traced(system, theta, records, segments, start).outputs
    for s, k, c in ((0, 29, 0), (2, 15, 2), (3, 21, 1)):
        by_start, by_theta = torch.autograd.grad(outputs[s, k, c], (start, theta), retain_graph=True)
        torch.testing.assert_close(slopes[s, k, c, 3:], by_theta, rtol=1e-9, atol=1e-11)
        torch.testing.assert_close(slopes[s, k, c, :3], by_start[s], rtol=1e-9, atol=1e-11)
    j, h = system.names.index("shift"), 1e-6
    step = h * torch.eye(len(theta), dtype=torch.float64)[j]
    more, less = (simulated(system, system.theta + sign * step, records, segments, x0).outputs for sign in (1, -1))
    torch.testing.assert_close(slopes[..., 3 + j], (more - less) / (2 * h), rtol=1e-6, atol=1e-8)


def test_corrected_trajectories_are_the_simulated_ones() -> None:
    system, records, segments, x0 = tape_problem()
    run = simulated(system, system.theta, records, segments, x0)
    transitions = torch.cat([b.transitions for b in sensitivities(system, run, records, segments)])
    theta, start = 1.03 * system.theta, x0 + 0.02
    truth = simulated(system, theta, records, segments, start).states
    inside = segments.inside
    for near, along in ((run.states, transitions), (x0[:, None].expand_as(run.states), None)):
        found = corrected(system, theta, records, segments, start, Near(near, along))
        assert found is not None
        torch.testing.assert_close(found.states[inside], truth[inside], rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("noise", ["diagonal", "full"])
def test_missing_samples_are_left_out_exactly(noise: str) -> None:
    flights = [roll_flight(np.random.default_rng(0)), roll_flight(np.random.default_rng(1), seconds=12.0)]
    holes = [dict(f) for f in flights]
    for f in holes:
        f["outputs"] = np.array(f["outputs"])
        f["outputs"][40:80, 0] = math.nan
        f["outputs"][::7, 1] = math.nan
    found = output_error(Roll((-0.5, -1.0, 1.0)), holes, noise=noise)
    assert found.converged
    for p, truth in zip(found.parameters, ROLL, strict=True):
        assert abs(p.value - truth) < 4.0 * p.se
    assert [p.name for p in found.parameters] == ["theta[0]", "theta[1]", "theta[2]"]
    assert [tuple(r.shape) for r in found.residuals] == [(300, 2), (240, 2)]
    assert bool(found.residuals[0][40:80, 0].isnan().all())
    np.testing.assert_allclose(found.noise.diagonal().sqrt().numpy(), [0.01, 0.02], rtol=0.15)


def test_both_optimisers_agree_and_noise_can_be_held() -> None:
    flights = [roll_flight(np.random.default_rng(4), seconds=5.0)]
    first = output_error(Roll((-0.8, -1.5, 2.0)), flights, segment_lengths=[math.inf])
    other = output_error(Roll((-0.8, -1.5, 2.0)), flights, segment_lengths=[math.inf], optimiser="lbfgs")
    for a, b in zip(first.parameters, other.parameters, strict=True):
        assert abs(a.value - b.value) < 0.05 * a.se
    matrix = torch.diag(torch.tensor([1e-4, 4e-4], dtype=torch.float64))
    held = output_error(Roll((-0.8, -1.5, 2.0)), flights, noise=matrix)
    assert torch.equal(held.noise, matrix)
    assert held.converged


def test_bounds_fixed_states_and_parameters_without_effect() -> None:
    class More(Roll):
        def __init__(self) -> None:
            super().__init__((-0.8, -1.5, 2.0))
            self.idle = nn.Parameter(torch.tensor(0.7, dtype=torch.float64))

    flights = [roll_flight(np.random.default_rng(6))]
    found = output_error(More(), flights, ["theta", "idle"], x0="fixed", bounds={"theta[0]": (-1.0, 0.0)})
    by_name = {p.name: p for p in found.parameters}
    assert by_name["theta[0]"].at_bound
    assert by_name["theta[0]"].value == -1.0
    assert by_name["idle"].status == "not identifiable"
    assert by_name["idle"].value == 0.7
    assert "not identifiable: idle" in found.message
    assert "on a bound: theta[0]" in found.message
    held = [found.parameters.index(by_name[name]) for name in ("theta[0]", "idle")]
    others = [i for i in range(len(found.parameters)) if i not in held]
    for i in held:
        assert math.isnan(found.parameters[i].se)
        assert bool(found.covariance[i].isnan().all())
        assert bool(found.covariance[:, i].isnan().all())
    assert bool(found.covariance[others][:, others].isfinite().all())
    rows = {line.split()[0]: line for line in found.text().splitlines()}
    assert rows["theta[0]"].endswith("on a bound")
    assert rows["idle"].endswith("not identifiable")
    assert rows["theta[1]"].endswith("free")
    assert torch.equal(found.initial_states, torch.zeros(1, 2, dtype=torch.float64))


@pytest.mark.parametrize("how", [{}, {"solver": "dopri5"}, {"optimiser": "lbfgs"}])
@pytest.mark.parametrize("seconds", [1.05, 1.2, 1.7])
def test_a_gain_that_the_initial_state_takes_over_stays_where_it_is(seconds: float, how: dict[str, Any]) -> None:
    """After the stick has come to rest, a free initial state explains what its gain would."""
    time = 0.02 * np.arange(100)
    decay = 0.8 * np.exp(-2.0 * (time - 1.0)) + 1e-3 * np.random.default_rng(0).standard_normal(100)
    outputs = np.where(time < seconds, math.nan, decay)[:, None]
    stick = np.where((time > 0.2) & (time < 1.0), 1.0, 0.0)[:, None]

    class Rate(Named):
        def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
            return self.L * x + self.d * u

        def output(self, x: Tensor, u: Tensor) -> Tensor:
            return x

    model = Rate(L=-1.0, d=1.0)
    found = output_error(model, [{"time": time, "controls": stick, "outputs": outputs, "x0": [0.0]}], **how)
    assert found["d"].status == "not identifiable"
    assert found["d"].value == 1.0
    assert math.isnan(found["d"].se)
    assert found["L"].value == pytest.approx(-2.0, abs=4.0 * found["L"].se)


def test_errors_are_told_with_and_without_colour() -> None:
    """A constant gust of a second's memory is no white noise: what white residuals would give is smaller."""
    rng, flight = np.random.default_rng(3), roll_flight(np.random.default_rng(2))
    gust = np.zeros(300)
    for k in range(1, 300):
        gust[k] = 0.95 * gust[k - 1] + 0.02 * rng.standard_normal()
    found = output_error(Roll(), [flight | {"outputs": np.asarray(flight["outputs"]) + gust[:, None]}])
    for p in found.parameters:
        assert p.se > 1.5 * p.se_white > 0.0


def test_fewer_values_than_unknowns_are_refused() -> None:
    flight = roll_flight(np.random.default_rng(0))
    outputs = np.where(np.arange(300)[:, None] < 2, np.asarray(flight["outputs"]), math.nan)
    with pytest.raises(InputError, match="hold 4 values for 5 unknowns"):
        output_error(Roll(), [flight | {"outputs": outputs}])


@pytest.mark.parametrize("estimator", [output_error, filter_error])
@pytest.mark.parametrize("mark", [-9999.0, 0.37, 1e38])
def test_a_value_that_stands_for_a_missing_sample_is_named_and_no_motion_is(mark: float, estimator: Any) -> None:
    flight, lost = roll_flight(np.random.default_rng(0)), np.random.default_rng(1).random(300) < 0.05
    outputs = np.array(flight["outputs"])
    outputs[lost, 1] = mark
    with pytest.raises(InputError, match=rf"outputs: jump to {mark:g}".replace("+", r"\+") + " and back in column 1"):
        estimator(Roll(), [flight | {"outputs": outputs}])
    found = estimator(Roll(), [flight | {"outputs": np.where(outputs == mark, math.nan, outputs)}], max_iterations=3)
    assert found.parameters


def test_prior_and_noise_floor() -> None:
    records = records_from([roll_flight(np.random.default_rng(7 + k), shift=k) for k in range(3)])
    inf = torch.full((3,), math.inf, dtype=torch.float64)
    tight = Settings(
        prior_mean=torch.tensor([-2.0, 0.0, 0.0], dtype=torch.float64),
        prior_sd=inf.index_fill(0, torch.tensor([0]), 1e-4),
    )
    assert abs(float(fit(System(Roll()), records, settings=tight).theta[0]) + 2.0) < 1e-2
    floor = torch.tensor([0.05, 0.05], dtype=torch.float64)
    coarse = fit(
        System(Roll()), records_from([roll_flight(np.random.default_rng(9))]), settings=Settings(sensor_noise=floor)
    )
    np.testing.assert_allclose(coarse.model_error_ratio.numpy(), [0.2, 0.4], rtol=0.2)


def test_a_start_that_diverges_is_brought_nearer_to_the_prior() -> None:
    records = records_from([roll_flight(np.random.default_rng(10))])
    prior = Settings(
        lengths=(2.0,),
        prior_mean=torch.zeros(3, dtype=torch.float64),
        prior_sd=torch.full((3,), 50.0, dtype=torch.float64),
    )
    found = fit(System(Roll((3e3, 2e6, 2.0))), records, settings=prior)
    assert float((found.theta - torch.tensor(ROLL)).abs().max()) < 0.2


def test_a_stage_that_diverges_from_the_one_before_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = _Stages.open

    def diverging(self: _Stages, theta: Tensor, states: Tensor, samples: int, fixed: bool = False):
        problem, start = opened(self, theta, states, samples, fixed)
        return problem, replace(start, cost=math.inf) if samples > 60 else start

    monkeypatch.setattr(_Stages, "open", diverging)
    records = records_from([roll_flight(np.random.default_rng(10))])
    found = fit(System(Roll()), records, settings=Settings(lengths=(50 * records.dt, math.inf)))
    assert "diverge, not tried" in found.stages[1]
    assert float((found.theta - torch.tensor(ROLL)).abs().max()) < 0.2


def test_monitor_and_the_cost_that_falls() -> None:
    seen: list[tuple[int, float]] = []
    flights = [roll_flight(np.random.default_rng(0))]
    found = output_error(Roll((0.0, 0.0, 0.0)), flights, monitor=lambda i, cost, theta: seen.append((i, cost)))
    assert [i for i, _ in seen] == list(range(1, len(seen) + 1))
    assert found.history == sorted(found.history, reverse=True)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"time": np.zeros(300)}, "time"),
        ({"controls": np.zeros((10, 1))}, "controls"),
        ({"outputs": np.zeros(300)}, "outputs"),
        ({"outputs": np.zeros((300, 5))}, "output"),
        ({"x0": np.full(2, math.nan)}, "x0"),
        ({"x0": None}, "x0"),
        ({"controls": np.full((300, 1), math.nan)}, "controls"),
    ],
)
def test_bad_flights_are_named(change: dict[str, Any], key: str) -> None:
    flight = roll_flight(np.random.default_rng(0)) | change
    with pytest.raises(InputError) as caught:
        output_error(Roll(), [flight])
    assert caught.value.key == key


@pytest.mark.parametrize(
    "more",
    [
        {"free": ["thetta"]},
        {"free": ["theta", "theta[0]"]},
        {"x0": "guess"},
        {"noise": "white"},
        {"noise": torch.eye(5)},
    ],
)
def test_bad_arguments_are_named(more: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        output_error(Roll(), [roll_flight(np.random.default_rng(0))], **more)


class _Corner(nn.Module):
    """At rest its output is zero, the root of a square, which has no derivative there."""

    def __init__(self) -> None:
        super().__init__()
        self.lag = nn.Parameter(torch.tensor(0.5, dtype=torch.float64))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return (u - x) / self.lag

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return torch.sqrt(x * x)


def test_derivatives_that_are_not_finite_are_told() -> None:
    time = 0.1 * np.arange(20)
    flight = {"time": time, "controls": np.zeros((20, 1)), "outputs": np.full((20, 1), 0.1), "x0": np.zeros(1)}
    settings = Settings(engine="native", lengths=(math.inf,))
    with pytest.raises(InputError, match="not their derivatives by"):
        fit(System(_Corner()), records_from([flight]), settings=settings)
