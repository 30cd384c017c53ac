"""The extended Kalman filter against an independent one in NumPy, its two engines against each other, its smoother."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.linalg import expm
from torch import Tensor

from rotorid_torch.errors import InputError
from rotorid_torch.identification.estimate.segments import records_from
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.filter_error.extended_kalman import FilterProblem, form
from rotorid_torch.identification.filter_error.innovations import (
    InnovationLikelihood,
    NativeFilter,
    TorchFilter,
    filter_engine,
)
from rotorid_torch.identification.filter_error.smoother import smoothed_states
from tests.identification.estimate.output_error_cases import ROLL, Roll
from tests.identification.estimate.test_output_error import WithTape
from tests.identification.filter_error.gust_cases import gusty_roll

PHI_P = ("phi", "p")
PSI = torch.tensor([*ROLL, 2e-3, 1e-2, 0.3, 1e-4, 4e-4, -0.2], dtype=torch.float64)
"""Of the roll axis: parameters, process noise (d, d, l), noise (d, d, l)."""


def roll_problem(flights: Sequence[dict[str, object]], P0: Tensor | None = None) -> FilterProblem:
    process, noise = form("process_noise", "full", PHI_P, ("", "")), form("noise", "full", PHI_P, ("", ""))
    P0 = torch.diag(torch.tensor([1e-4, 4e-4], dtype=torch.float64)) if P0 is None else P0
    return FilterProblem(System(Roll()), records_from(flights), process, noise, P0)


def short(flight: dict[str, object], dt: float) -> dict[str, object]:
    """The first samples of a flight, as if they lay closer; some are missing."""
    outputs = np.array(flight["outputs"])[:80]
    outputs[10:20, 0], outputs[30:33], outputs[40, 1] = np.nan, np.nan, np.nan
    return flight | {"time": dt * np.arange(80), "controls": np.array(flight["controls"])[:80], "outputs": outputs}


def log_likelihood(psi: NDArray, flight: dict[str, NDArray], x: NDArray, P: NDArray) -> complex:
    """Of one flight of the roll axis, in exact discrete time; psi may be complex, to differentiate by its steps."""
    damping, stiffness, power, q1, q2, ql, r1, r2, rl = psi
    A, B = np.array([[0, 1], [stiffness, damping]]), np.array([[0], [power]])
    L, M = np.array([[1, 0], [ql, 1]]), np.array([[1, 0], [rl, 1]])
    Q, R = L @ np.diag([q1, q2]) @ L.T, M @ np.diag([r1, r2]) @ M.T
    dt = flight["time"][1] - flight["time"][0]
    whole = expm(np.block([[A, B, 0 * B], [np.array([[0, 0, 0, 1 / dt], [0, 0, 0, 0]])]]) * dt)
    pair = expm(np.block([[-A, Q], [np.zeros((2, 2)), A.T]]) * dt)
    Ad, Qd = pair[2:, 2:].T, pair[2:, 2:].T @ pair[:2, 2:]
    total = 0.0
    for k, (u, y) in enumerate(zip(flight["controls"][:, 0], flight["outputs"], strict=True)):
        measured = ~np.isnan(y)
        if measured.any():
            H = np.eye(2)[measured]
            e, S = y[measured] - H @ x, H @ P @ H.T + R[np.ix_(measured, measured)]
            K = P @ H.T @ np.linalg.inv(S)
            x, P = x + K @ e, P - K @ S @ K.T
            total = total - 0.5 * (e @ np.linalg.solve(S, e) + np.log(2 * np.pi) * measured.sum())
            total = total - 0.5 * np.log(np.linalg.det(S))
        if k + 1 < len(flight["time"]):
            x = whole[:2] @ np.concatenate([x, [u, flight["controls"][k + 1, 0] - u]])
            P = Ad @ P @ Ad.T + Qd
    return total


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_likelihood_and_gradient_are_those_of_an_exact_discrete_filter(engine: str) -> None:
    flights = [short(gusty_roll(np.random.default_rng(k)), 0.001) for k in range(2)]
    problem = roll_problem(flights)
    x0 = torch.tensor([[0.01, -0.02], [0.0, 0.03]], dtype=torch.float64)
    likelihood = InnovationLikelihood(filter_engine(problem, PSI, engine), x0, free=False)
    place = likelihood.evaluate(PSI)
    A, b, _ = likelihood.linearise(place)

    def other(psi: NDArray) -> complex:
        starts = [x.numpy() + 0j for x in x0]
        return sum(log_likelihood(psi, f, x, problem.P0.numpy() + 0j) for f, x in zip(flights, starts, strict=True))

    steps = 1e-30j * np.eye(len(PSI))
    gradient = np.array([other(PSI.numpy() + step).imag / 1e-30 for step in steps])
    mine = -place.cost - 0.5 * problem.samples * np.log(2 * np.pi)
    assert abs(mine / other(PSI.numpy() + 0j).real - 1.0) < 1e-9
    np.testing.assert_allclose((A.mT @ b).numpy(), gradient, rtol=1e-9)


def tape_problem() -> tuple[FilterProblem, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    flights = []
    for samples in (25, 18):
        outputs = 0.3 * draw(samples, 3)
        outputs[4:7, 1], outputs[10] = torch.nan, torch.nan
        time, controls = 0.05 * torch.arange(samples), 0.3 * draw(samples, 2).cumsum(0)
        flights.append({"time": time, "controls": controls, "outputs": outputs, "x0": np.zeros(3)})
    names = ("a", "b", "c")
    process, noise = form("process_noise", ["a", "c"], names, [""] * 3), form("noise", "full", names, [""] * 3)
    problem = FilterProblem(System(WithTape()), records_from(flights), process, noise, torch.diag(draw(3).square()))
    noises = torch.tensor([0.1, 0.2, 0.1, 0.2, 0.1, 0.3, -0.2, 0.1], dtype=torch.float64)
    return problem, torch.cat([problem.system.theta, noises[: problem.process.count + problem.noise.count]]), draw(2, 3)


def test_both_engines_agree_on_a_nonlinear_model_with_a_control_path() -> None:
    problem, psi, x0 = tape_problem()
    native, reference = NativeFilter.of(problem, psi), TorchFilter(problem)
    one, other = native.filter(psi, x0), reference.filter(psi, x0)
    torch.testing.assert_close(one.cost, other.cost, rtol=1e-11, atol=0.0)
    torch.testing.assert_close(native.cost(psi, x0), other.cost, rtol=1e-11, atol=0.0)
    inside = problem.segments.inside
    for mine, its in ((one.states, other.states), (one.covariances, other.covariances), (one.spreads, other.spreads)):
        torch.testing.assert_close(mine[inside], its[inside], rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(one.innovations, other.innovations, rtol=1e-10, atol=1e-12, equal_nan=True)
    rows, expected = native.rows(psi, x0), reference.rows(psi, x0)
    size = expected.abs().amax(dim=(0, 1, 2))
    assert float(((rows - expected).abs() / size.clamp_min(1e-300)).max()) < 1e-9
    H, other_H = native.normal_equations(psi, x0), reference.normal_equations(psi, x0)
    scale = other_H.diagonal(dim1=-2, dim2=-1).sqrt()
    assert float(((H - other_H).abs() / scale[..., None] / scale[..., None, :]).max()) < 1e-9


def test_a_filter_without_unknowns_filters_alike() -> None:
    problem, psi, x0 = tape_problem()
    one, other = (NativeFilter.of(problem, psi, held).filter(psi, x0) for held in (len(psi), 0))
    for name in ("cost", "innovations", "states", "covariances"):
        torch.testing.assert_close(getattr(one, name), getattr(other, name), rtol=1e-12, atol=1e-14, equal_nan=True)


def test_rows_are_the_derivatives_of_the_likelihood() -> None:
    problem, psi, x0 = tape_problem()
    native = NativeFilter.of(problem, psi)
    likelihood = InnovationLikelihood(native, x0, free=False)
    A, b, _ = likelihood.linearise(likelihood.evaluate(psi))
    gradient = -(A.mT @ b)
    for j in range(len(psi)):
        step = 1e-6 * torch.eye(len(psi), dtype=torch.float64)[j]
        difference = (native.cost(psi + step, x0) - native.cost(psi - step, x0)).sum() / 2e-6
        assert abs(float(difference - gradient[j])) < 1e-6 * (1.0 + float(gradient.abs().max()))


def test_smoothed_states_are_the_conditional_means_given_all_samples() -> None:
    samples, dt = 7, 0.002
    flight = gusty_roll(np.random.default_rng(0))
    outputs = np.array(flight["outputs"])[:samples]
    outputs[2, 0] = np.nan
    flight |= {"time": dt * np.arange(samples), "controls": np.zeros((samples, 1)), "outputs": outputs}
    problem = roll_problem([flight])
    problem = replace(problem, P0=torch.zeros(2, 2, dtype=torch.float64))  # a singular start must do
    x0 = torch.tensor([[0.01, -0.02]], dtype=torch.float64)
    run = TorchFilter(problem).filter(PSI, x0)
    states, covariances = smoothed_states(problem, PSI, x0, run)
    _, Q, R = problem.split(PSI)
    A = torch.tensor([[0.0, 1.0], [ROLL[1], ROLL[0]]], dtype=torch.float64)
    pair = torch.tensor(expm(np.block([[-A.numpy(), Q.numpy()], [np.zeros((2, 2)), A.numpy().T]]) * dt))
    Ad, Qd = pair[2:, 2:].T, pair[2:, 2:].T @ pair[:2, 2:]
    mean, joint = [x0[0]], torch.zeros(2 * samples, 2 * samples, dtype=torch.float64)
    spread = torch.zeros(2, 2, dtype=torch.float64)
    for _ in range(1, samples):
        mean.append(Ad @ mean[-1])
    for i in range(samples):  # Cov(x_j, x_i) = Ad^(j - i) Cov(x_i)
        block = spread
        for j in range(i, samples):
            joint[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = block
            joint[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block.T
            block = Ad @ block
        spread = Ad @ spread @ Ad.T + Qd
    y = torch.as_tensor(outputs).flatten()
    measured, expected = ~y.isnan(), torch.cat(mean)
    S = (joint + torch.block_diag(*[R] * samples))[measured][:, measured]
    gain = joint[:, measured] @ torch.linalg.inv(S)
    torch.testing.assert_close(states[0].flatten(), expected + gain @ (y - expected)[measured], rtol=1e-9, atol=1e-12)
    after = joint - gain @ joint[measured]
    blocks = torch.stack([after[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(samples)])
    torch.testing.assert_close(covariances[0], blocks, rtol=1e-7, atol=1e-14)


def test_a_covariance_is_positive_semi_definite_whatever_its_numbers() -> None:
    full = form("process_noise", "full", ("a", "b", "c"), ("", "", ""))
    assert full.count == 6
    numbers = torch.tensor([1.0, 0.0, 2.0, 3.0, -50.0, 7.0], dtype=torch.float64)
    assert float(torch.linalg.eigvalsh(full.at(numbers)).min()) > -1e-11
    some = form("process_noise", ["c", "a"], ("a", "b", "c"), ("", "", ""))
    variances = torch.tensor([4.0, 9.0, 16.0], dtype=torch.float64)
    assert torch.equal(some.at(some.numbers(variances)), torch.diag(torch.tensor([4.0, 0.0, 16.0]).double()))


@pytest.mark.parametrize(
    "wanted",
    [
        "some",
        ["d"],
        [1.0, "a"],
        torch.eye(2),
        torch.diag(torch.tensor([1.0, -1.0, 0.0])),
        torch.full((3, 3), torch.nan),
        torch.tensor([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    ],
)
def test_bad_noises_are_named(wanted: object) -> None:
    with pytest.raises(InputError) as caught:
        form("process_noise", wanted, ("a", "b", "c"), ("", "", ""))  # pyright: ignore[reportArgumentType]
    assert caught.value.key == "process_noise"
    assert "\n" not in str(caught.value)
