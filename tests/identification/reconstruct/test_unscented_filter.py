"""The unscented filter and smoother against the exact linear ones, and as a parameter estimator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorid_torch.core.integrate import simulate
from rotorid_torch.errors import InputError
from rotorid_torch.identification.reconstruct import unscented_filter as filter_module
from rotorid_torch.identification.reconstruct.unscented_filter import unscented_filter


@pytest.fixture(autouse=True, params=["torch", "native"])
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test here runs on both engines."""
    monkeypatch.setattr(filter_module, "WORTH_COMPILING", 0 if request.param == "native" else 10**9)


A = np.array([[-0.8, 1.5, 0.2], [-2.0, -0.6, 0.4], [0.1, 0.0, -0.05]])
B = np.array([[0.3, 0.0], [1.0, -0.4], [0.0, 0.2]])
C = np.array([[1.0, 0.0, 0.0], [0.2, 1.0, 0.5]])
D = np.array([[0.0, 0.1], [0.3, 0.0]])
Q = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 0.5]]) * 1e-3
R = np.array([[4.0, 1.0], [1.0, 2.0]]) * 1e-2
P0 = np.array([[1.0, 0.7, -0.5], [0.7, 2.0, 0.3], [-0.5, 0.3, 1.5]])
X0 = np.array([0.5, -1.0, 0.2])
DT = 0.02


def linear(matrix_x: np.ndarray, matrix_u: np.ndarray):
    mx, mu = torch.tensor(matrix_x), torch.tensor(matrix_u)
    return lambda x, u: x @ mx.mT + u @ mu.mT


def record(rng: np.random.Generator, samples: int, gaps: bool) -> tuple[np.ndarray, np.ndarray]:
    controls = rng.standard_normal((samples, 2)).cumsum(axis=0) * 0.1
    outputs = rng.standard_normal((samples, 2)).cumsum(axis=0) * 0.2
    if gaps:
        outputs[rng.random((samples, 2)) < 0.2] = np.nan
        outputs[10:25] = np.nan
        outputs[0, 1] = np.nan
    return controls, outputs


def discrete() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x1 = F x0 + G0 u0 + G1 u1 of one Runge-Kutta step with linear controls: series in A dt."""
    eye, a = np.eye(3), A * DT
    F = eye + a + a @ a / 2 + a @ a @ a / 6 + a @ a @ a @ a / 24
    whole = (eye + a / 2 + a @ a / 6 + a @ a @ a / 24) @ B * DT
    ramp = (eye / 2 + a / 6 + a @ a / 24) @ B * DT
    return F, whole - ramp, ramp


def exact_kalman(controls: np.ndarray, outputs: np.ndarray) -> dict[str, np.ndarray]:
    F, G0, G1 = discrete()
    x, P, steps, log_likelihood = X0, P0, [], 0.0
    for k, y in enumerate(outputs):
        if k:
            x, P = F @ x + G0 @ controls[k - 1] + G1 @ controls[k], F @ P @ F.T + Q
        ahead = (x, P)
        rows = np.flatnonzero(~np.isnan(y))
        if rows.size:
            H, v = C[rows], (y - C @ x - D @ controls[k])[rows]
            S = H @ P @ H.T + R[np.ix_(rows, rows)]
            K = P @ H.T @ np.linalg.inv(S)
            x, P = x + K @ v, P - K @ S @ K.T
            log_likelihood -= 0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * np.pi * S)[1])
        steps.append((*ahead, x, P))
    back = [(x, P)]
    for k in range(len(outputs) - 2, -1, -1):
        (xa, Pa), (xf, Pf) = steps[k + 1][:2], steps[k][2:]
        gain = Pf @ F.T @ np.linalg.inv(Pa)
        x, P = xf + gain @ (x - xa), Pf + gain @ (P - Pa) @ gain.T
        back.append((x, P))
    return {
        "means": np.array([s[2] for s in steps]),
        "covariances": np.array([s[3] for s in steps]),
        "smoothed_means": np.array([b[0] for b in back[::-1]]),
        "smoothed_covariances": np.array([b[1] for b in back[::-1]]),
        "log_likelihood": np.array(log_likelihood),
    }


def relative(a: object, b: np.ndarray) -> float:
    return float(np.abs(np.asarray(a) - b).max() / np.abs(b).max())


@pytest.mark.parametrize("gaps", [False, True])
def test_linear_case_is_the_exact_kalman_filter_and_smoother(gaps: bool) -> None:
    rng = np.random.default_rng(1)
    records = [record(rng, 120, gaps) for _ in range(3)]
    controls, outputs = (np.stack(part) for part in zip(*records, strict=True))
    got = unscented_filter(linear(A, B), linear(C, D), X0, P0, Q, R, controls, outputs, DT)
    for flight, (u, y) in enumerate(records):
        for name, exact in exact_kalman(u, y).items():
            assert relative(getattr(got, name)[flight], exact) < 1e-9, name


def test_linear_case_agrees_with_filterpy() -> None:
    controls, outputs = record(np.random.default_rng(2), 200, gaps=False)
    controls = np.zeros_like(controls)
    got = unscented_filter(linear(A, B), linear(C, D), X0, P0, Q, R, controls, outputs, DT)
    kalman = KalmanFilter(dim_x=3, dim_z=2)
    kalman.x, kalman.P, kalman.F, kalman.H, kalman.Q, kalman.R = X0, P0, discrete()[0], C, Q, R
    means, covariances, _, _ = kalman.batch_filter(list(outputs), update_first=True)
    smoothed, smoothed_covariances, _, _ = kalman.rts_smoother(means, covariances)
    assert relative(got.means, means) < 1e-9
    assert relative(got.smoothed_means, smoothed) < 1e-9
    assert relative(got.smoothed_covariances, smoothed_covariances) < 1e-9


def test_a_missing_channel_is_as_if_it_were_not_there() -> None:
    controls, outputs = record(np.random.default_rng(3), 80, gaps=False)
    outputs[:, 1] = np.nan
    got = unscented_filter(linear(A, B), linear(C, D), X0, P0, Q, R, controls, outputs, DT)
    alone = unscented_filter(linear(A, B), linear(C[:1], D[:1]), X0, P0, Q, R[:1, :1], controls, outputs[:, :1], DT)
    assert torch.allclose(got.smoothed_means, alone.smoothed_means, rtol=1e-12, atol=1e-14)
    assert torch.allclose(got.log_likelihood, alone.log_likelihood, rtol=1e-12)
    assert got.innovations[:, 1].isnan().all()


def test_an_exactly_known_state_stays_known() -> None:
    controls, outputs = record(np.random.default_rng(4), 60, gaps=False)
    known = np.diag([1.0, 2.0, 0.0])
    dynamics = A.copy()
    dynamics[2] = 0.0
    noise = np.diag([1e-3, 1e-3, 0.0])
    got = unscented_filter(
        linear(dynamics, B * [[1], [1], [0]]), linear(C, D), X0, known, noise, R, controls, outputs, DT
    )
    assert torch.allclose(got.smoothed_means[:, 2], torch.full((60,), 0.2, dtype=torch.float64), atol=1e-12)
    assert got.smoothed_covariances[:, 2, 2].abs().max() < 1e-15


def test_covariances_stay_positive_definite_over_a_long_run() -> None:
    """A constant that is learnt ever better, a slow state and a fast one, variances over twelve decades."""
    samples = 3_000
    rng = np.random.default_rng(5)
    dynamics = np.diag([-50.0, -0.01, 0.0])
    noise = np.diag([1e-2, 1e-14, 0.0])
    sensor = np.array([[1.0, 1.0, 1.0]])
    outputs = rng.standard_normal((samples, 1)) + 3.0
    got = unscented_filter(
        linear(dynamics, np.zeros((3, 0))),
        linear(sensor, np.zeros((1, 0))),
        np.zeros(3),
        np.diag([1.0, 1e-4, 1e6]),
        noise,
        np.eye(1),
        np.zeros((samples, 0)),
        outputs,
        0.01,
    )
    for cov in (got.covariances, got.smoothed_covariances):
        assert cov is not None
        assert torch.equal(cov, cov.mT)
        scale = cov.diagonal(dim1=-2, dim2=-1).sqrt()
        assert torch.linalg.eigvalsh(cov / scale[..., None] / scale[..., None, :]).min() > 1e-9
    expected = outputs.mean()
    assert abs(float(got.means[-1, 2]) - expected) < 0.08


@settings(deadline=None, max_examples=25, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from([(1, 1), (2, 3), (4, 2)]))
def test_any_covariance_is_symmetric_positive_definite_and_smoothing_never_adds_doubt(
    seed: int, size: tuple[int, int]
) -> None:
    nx, ny = size
    rng = np.random.default_rng(seed)

    def covariance(n: int) -> np.ndarray:
        root = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(-3, 3, (n, 1))
        return root @ root.T + np.diag(np.diag(root @ root.T)) * 1e-3

    turn, sensor = rng.standard_normal((nx, nx)), rng.standard_normal((ny, nx))
    turn_t, sensor_t = torch.tensor(turn), torch.tensor(sensor)
    outputs = rng.standard_normal((2, 30, ny))
    outputs[rng.random(outputs.shape) < 0.3] = np.nan
    got = unscented_filter(
        lambda x, u: torch.sin(x @ turn_t.mT),
        lambda x, u: x @ sensor_t.mT + 0.1 * torch.cos(x[..., :1]),
        rng.standard_normal(nx),
        covariance(nx),
        covariance(nx) * 1e-2,
        covariance(ny),
        np.zeros((2, 30, 0)),
        outputs,
        0.05,
    )
    for cov in (got.covariances, got.innovation_covariances, got.smoothed_covariances):
        assert cov is not None
        assert torch.equal(cov, cov.mT)
        assert torch.linalg.cholesky_ex(cov)[1].max() == 0
    assert got.log_likelihood.shape == (2,)


@pytest.mark.parametrize("flights", [(), (2,)])
def test_without_process_noise_the_smoother_is_the_recursion_of_least_squares(flights: tuple[int, ...]) -> None:
    """What is left to learn is the first state: the information of all samples, carried back to it."""
    controls, outputs = record(np.random.default_rng(6), 50, gaps=False)
    got = unscented_filter(
        linear(A, B), linear(C, D), X0, P0, np.zeros((3, 3)), R,
        np.tile(controls, (*flights, 1, 1)), np.tile(outputs, (*flights, 1, 1)), DT,
    )  # fmt: skip
    F, _, _ = discrete()
    information, passage = np.linalg.inv(P0), np.eye(3)
    for _ in range(50):
        information = information + passage.T @ C.T @ np.linalg.inv(R) @ C @ passage
        passage = F @ passage
    assert got.smoothed_covariances is not None
    first = got.smoothed_covariances[..., 0, :, :]
    assert relative(first, np.broadcast_to(np.linalg.inv(information), first.shape)) < 1e-9


def test_controls_come_in_the_shape_of_the_states() -> None:
    """So that a column of each can stand beside the other in one stack."""
    controls, outputs = record(np.random.default_rng(7), 30, gaps=False)

    def f(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return torch.stack([x[..., 1], u[..., 0] - x[..., 0], 0.0 * x[..., 2]], dim=-1)

    def h(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return torch.stack([x[..., 0] * x[..., 2], u[..., 1]], dim=-1)

    got = unscented_filter(f, h, X0, P0, np.diag([1e-3, 1e-3, 0.0]), R, controls, outputs, DT)
    assert torch.allclose(got.innovations[:, 1], torch.tensor(outputs - controls)[:, 1])


SHORT_PERIOD = torch.tensor([-1.4249, -1.4768, -6.2632, 0.2163, -3.7067, -12.784], dtype=torch.float64)
FORWARD_SPEED = 44.57
FEEDBACK = torch.tensor([0.025, 0.0], dtype=torch.float64)


def short_period_rates(x: torch.Tensor, elevator: torch.Tensor, theta: torch.Tensor) -> torch.Tensor:
    """d(w, q)/dt of an unstable aircraft. Source: Jategaonkar, Flight Vehicle System Identification, ch. 9."""
    lift, moment = short_period_forces(x, elevator, theta)
    return torch.stack([lift + FORWARD_SPEED * x[..., 1], moment], dim=-1)


def short_period_forces(x: torch.Tensor, elevator: torch.Tensor, theta: torch.Tensor) -> tuple[torch.Tensor, ...]:
    zw, zq, ze, mw, mq, me = theta.unbind(-1)
    w, q, e = x[..., 0], x[..., 1], elevator[..., 0]
    return zw * w + zq * q + ze * e, mw * w + mq * q + me * e


def short_period_flight(samples: int, dt: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Recorded elevator (pilot's 3-2-1-1 plus the feedback that keeps it flyable) and measured w, q, az."""
    generator = torch.Generator().manual_seed(seed)
    time = torch.arange(samples, dtype=torch.float64) * dt
    pilot = torch.zeros(samples, 1, dtype=torch.float64)
    for start in (0.5, 8.0, 15.0):
        for sign, begin, end in ((1, 0.0, 0.9), (-1, 0.9, 1.5), (1, 1.5, 1.8), (-1, 1.8, 2.1)):
            pilot[(time >= start + begin) & (time < start + end)] = 0.05 * sign
    closed = simulate(
        lambda t, x, u: short_period_rates(x, u + x @ FEEDBACK[:, None], SHORT_PERIOD),
        torch.zeros(2, dtype=torch.float64),
        pilot,
        dt,
    )
    elevator = pilot + closed @ FEEDBACK[:, None]
    az = short_period_forces(closed, elevator, SHORT_PERIOD)[0]
    clean = torch.cat([closed, az[:, None]], dim=-1)
    noise = torch.randn(clean.shape, generator=generator, dtype=torch.float64)
    return elevator, clean + noise * torch.tensor([0.1, 0.002, 0.05], dtype=torch.float64)


def estimate_short_period(elevator: torch.Tensor, outputs: torch.Tensor, dt: float) -> torch.Tensor:
    """Six derivatives as states with a rate of zero, started 50 % off and with signs unknown."""

    def f(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        motion = short_period_rates(x[..., :2], u, x[..., 2:])
        return torch.cat([motion, torch.zeros_like(x[..., 2:])], dim=-1)

    def h(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return torch.cat([x[..., :2], short_period_forces(x[..., :2], u, x[..., 2:])[0].unsqueeze(-1)], dim=-1)

    x0 = torch.cat([torch.zeros(2, dtype=torch.float64), torch.tensor([-0.5, 0.0, 0.0, 0.0, -1.0, -5.0]).double()])
    spread = torch.tensor([0.5, 0.05, 2.0, 5.0, 10.0, 0.5, 5.0, 15.0], dtype=torch.float64)
    Q = torch.diag(torch.tensor([1e-8, 1e-12] + [0.0] * 6, dtype=torch.float64))
    R = torch.diag(torch.tensor([0.1, 0.002, 0.05], dtype=torch.float64).square())
    got = unscented_filter(f, h, x0, torch.diag(spread.square()), Q, R, elevator, outputs, dt)
    assert got.smoothed_means is not None
    return got.smoothed_means[-1, 2:]


@pytest.mark.parametrize("seed", [0, 1])
def test_derivatives_of_an_unstable_short_period_come_out_as_augmented_states(seed: int) -> None:
    elevator, outputs = short_period_flight(1001, 0.02, seed)
    error = estimate_short_period(elevator, outputs, 0.02) / SHORT_PERIOD - 1.0
    assert error.abs().max() < 0.01, error


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"R": np.eye(3)}, "R: has shape"),
        ({"Q": np.eye(2)}, "Q: has shape"),
        ({"P0": np.diag([1.0, 1.0, -1.0])}, "P0: has eigenvalue"),
        ({"P0": np.arange(9.0).reshape(3, 3)}, "P0: is not symmetric"),
        ({"x0": [np.nan, 0.0, 0.0]}, "x0: holds NaN"),
        ({"controls": np.zeros((4, 2))}, "controls: has shape"),
        ({"outputs": np.zeros(5)}, "outputs: has shape"),
        ({"dt": 0.0}, "dt: is 0"),
        ({"f": lambda x, u: x[..., :2]}, "f: returns shape"),
        ({"f": lambda x, u: torch.stack([x[1], x[0], x[2]])}, r"f: returns shape .* write x\[..., 0\]"),
        ({"h": lambda x, u: x[:2] @ torch.eye(2).double()}, "h: fails: "),
        ({"x0": np.zeros((2, 3)), "P0": np.stack([np.eye(3)] * 3)}, "x0, P0, controls, outputs: have leading"),
    ],
)
def test_wrong_input_is_told_in_one_line(change: dict[str, object], word: str) -> None:
    arguments: dict[str, object] = {
        "f": linear(A, B), "h": linear(C, D), "x0": X0, "P0": P0, "Q": Q, "R": R,
        "controls": np.zeros((5, 2)), "outputs": np.zeros((5, 2)), "dt": DT,
    }  # fmt: skip
    with pytest.raises(InputError, match=word):
        unscented_filter(**(arguments | change))


def test_a_batch_of_one_flight_with_one_state_is_a_batch() -> None:
    def rate(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return u - x

    controls, outputs = torch.ones(2, 20, 1), torch.linspace(0.0, 1.0, 20)[:, None].expand(2, 20, 1)
    covariance = 0.1 * torch.eye(1)

    def filtered(flights: int) -> torch.Tensor:
        flown = controls[:flights], outputs[:flights]
        x0 = torch.zeros(flights, 1)
        return unscented_filter(rate, lambda x, u: x, x0, covariance, covariance, covariance, *flown, DT).means

    assert torch.equal(filtered(1), filtered(2)[:1])


def answer_to_a_ramp(pole: float, time: np.ndarray) -> np.ndarray:
    """Of x' = pole (x - t) from rest."""
    return time + (1.0 - np.exp(pole * time)) / pole


@pytest.mark.parametrize("pole", [-60.0, -500.0])
def test_a_pole_too_fast_for_a_step_a_sample_is_followed(pole: float) -> None:
    """0.02 s are 1.2 and 10 time constants: one Runge-Kutta step is wrong there, and then unstable."""
    time = DT * np.arange(50.0)
    exact = answer_to_a_ramp(pole, time)[:, None]
    silent = np.full((50, 1), np.nan)
    silent[0] = 0.0
    got = unscented_filter(
        lambda x, u: pole * (x - u), lambda x, u: x, [0.0], [[1e-12]], [[0.0]], [[1.0]], time[:, None], silent, DT
    )
    assert np.abs(got.means.numpy() - exact).max() < 1e-4 * DT


def test_a_pole_that_becomes_fast_on_the_way_is_followed() -> None:
    """x' = u (1 - x) with a gain u that rises from 1 to 200 1/s: x is one minus the exponential of its integral."""
    time = DT * np.arange(100.0)
    gain = 100.0 * time
    silent = np.full((100, 1), np.nan)
    silent[0] = 0.0
    got = unscented_filter(
        lambda x, u: u * (1.0 - x), lambda x, u: x, [0.0], [[1e-12]], [[0.0]], [[1.0]], gain[:, None], silent, DT
    )
    assert np.abs(got.means[:, 0].numpy() - (1.0 - np.exp(-50.0 * time**2))).max() < 1e-4


def test_a_pole_that_no_step_follows_is_refused() -> None:
    arguments = ([0.0], [[1.0]], [[0.0]], [[1.0]], np.zeros((9, 0)), np.zeros((9, 1)), DT)
    with pytest.raises(InputError, match=r"f: the pole -1e\+05 1/s is too fast .* higher sample rate"):
        unscented_filter(lambda x, u: -1e5 * x, lambda x, u: x, *arguments)


def test_states_at_the_end_are_a_table() -> None:
    controls, outputs = record(np.random.default_rng(8), 30, gaps=False)
    one, two = (
        unscented_filter(linear(A, B), linear(C, D), X0, P0, Q, R, controls, records, DT)
        for records in (outputs, np.stack([outputs, 2.0 * outputs]))
    )
    assert one["x[2]"].value == float(one.means[-1, 2])
    assert two.to_dict()["x[1,2]"]["se"] == pytest.approx(float(two.covariances[1, -1, 2, 2].sqrt()))
    assert list(two.to_dict()) == [f"x[{flight},{state}]" for flight in range(2) for state in range(3)]
    assert "x[2]" in one
    assert "x[2]" in str(one.table())
    assert "x[2]" in repr(one)
    assert "x[2]" in one._repr_html_()


@dataclass
class Damped:
    """Without a hash; its rate at rest says nothing of the damping."""

    damping: float

    def rates(self, x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return u - self.damping * x

    def outputs(self, x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return x


class Keyed(Damped):
    """With a hash, so that its code may be kept."""

    __hash__ = object.__hash__


@pytest.mark.parametrize("kind", [Damped, Keyed])
def test_a_model_that_changes_between_calls_is_seen(kind: type[Damped]) -> None:
    one, u = np.eye(1), np.sin(0.1 * np.arange(50.0))[:, None]

    def likelihood(model: Damped) -> float:
        got = unscented_filter(model.rates, model.outputs, np.zeros(1), one, 1e-4 * one, 1e-2 * one, u, 0.1 * u, DT)
        return float(got.log_likelihood)

    model = kind(0.5)
    first = likelihood(model)
    model.damping = 5.0
    assert likelihood(model) == likelihood(kind(5.0))
    assert abs(likelihood(model) - first) > 1.0
