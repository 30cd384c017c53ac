"""The scalar Gauss-Markov filters against dense Gaussian algebra, and the search against known powers."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.identification.reconstruct import gauss_markov as gm

DT, SAMPLES = 0.02, 60


def rows(value: np.ndarray, integral: bool, noise: float) -> gm.Series:
    count = value.shape[1]
    return gm.Series(value, np.full(count, integral), np.full(count, noise), DT)


def simulated(
    rng: np.random.Generator, power: np.ndarray, tau: float, integral: bool, noise: float, trim: float
) -> np.ndarray:
    """Records [T, N] of Gauss-Markov processes with powers [T, N], measured or their integral measured."""
    fine, count = 10, power.shape[1]
    f, s, out = np.sqrt(power[0] * tau / 2) * rng.standard_normal(count), np.zeros(count), []
    h = DT / fine
    for row in power:
        out.append(s if integral else f + trim)
        for _ in range(fine):
            s = s + h * (f + trim)
            f = f - h / tau * f + np.sqrt(row * h) * rng.standard_normal(count)
    return np.array(out) + noise * rng.standard_normal(power.shape)


@pytest.mark.parametrize("integral", [False, True])
def test_likelihood_and_score_are_exact(integral: bool) -> None:
    rng = np.random.default_rng(0)
    value = rng.standard_normal((SAMPLES, 1)).cumsum(axis=0) * 0.05
    value[20:25] = np.nan
    power = rng.uniform(0.5, 2.0, (SAMPLES, 1))
    tau, trim, spread = np.array([0.7]), np.array([0.1]), np.array([0.5])

    def run(q: np.ndarray) -> gm.Pass:
        return gm.smooth_rows(rows(value, integral, 0.03), q, tau, trim, spread)

    got = run(power)
    for k in (5, 22, 50):
        more, less = power.copy(), power.copy()
        more[k] += 1e-4
        less[k] -= 1e-4
        slope = float(run(more).log_likelihood[0] - run(less).log_likelihood[0]) / 2e-4
        assert 0.5 * float(got.realised[k, 0] - got.expected[k, 0]) == pytest.approx(slope, rel=1e-5, abs=1e-9)
    if not integral:
        e = np.exp(-DT / tau[0])
        variance = np.empty(SAMPLES)
        variance[0] = spread[0] ** 2 + 1e-6 * 0.03**2
        for k in range(1, SAMPLES):
            variance[k] = e**2 * variance[k - 1] + power[k, 0] * DT
        i, j = np.indices((SAMPLES, SAMPLES))
        cov = variance[np.minimum(i, j)] * e ** np.abs(i - j) + 0.03**2 * np.eye(SAMPLES)
        known = ~np.isnan(value[:, 0])
        y, S = value[known, 0] - trim[0], cov[np.ix_(known, known)]
        exact = -0.5 * (y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1])
        assert float(got.log_likelihood[0]) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(("integral", "noise"), [(False, 0.05), (True, 0.002)])
def test_power_and_time_constant_of_simulated_records_are_found(integral: bool, noise: float) -> None:
    """A constant power and one that a control switches on; both axes share the time constant."""
    rng = np.random.default_rng(1)
    samples, count, tau, trim = 600, 16, 0.6, 0.4
    activity = np.ones((samples, count, 2))
    activity[:, :, 1] = ((np.arange(samples) % 200) < 60)[:, None]
    theta = np.where(np.arange(count)[:, None] < 8, [[0.05, 1.0]], [[0.2, 0.5]])
    value = simulated(rng, np.einsum("tnj,nj->tn", activity, theta), tau, integral, noise, trim)
    axis = (np.arange(count) >= 8).astype(int)
    spread = np.full(count, 0.5)
    sources = gm.Sources(activity, axis, np.zeros(count, int), spread)
    found, taus = gm.find_power(rows(value, integral, noise), sources)
    assert found[:, 1] == pytest.approx([1.0, 0.5], rel=0.25)
    assert found[:, 0] == pytest.approx([0.05, 0.2], rel=0.4)
    assert 0.3 < taus[0] < 1.2
    got = gm.smooth_rows(
        rows(value, integral, noise),
        sources.power(found),
        taus[axis * 0],
        np.zeros(count),
        spread,
    )
    assert got.trim.mean() == pytest.approx(trim, abs=0.12)


def test_controls_at_rest_make_no_activity() -> None:
    rng = np.random.default_rng(2)
    control = 0.0005 * rng.standard_normal((1500, 2))
    control[700:, 1] += 0.02
    activity = gm.control_activity(control, np.full(2, 0.0005), 1 / 154)
    step = activity[:, 2]
    assert (activity[:, 0] == 1.0).all()
    assert (activity >= 0.0).all()
    assert abs(int(step.argmax()) - 700) < 5
    assert step[:680].max() < 0.1 * step.max()
    assert activity[:, 1].max() < 0.1 * step.max()


def test_compiled_and_numpy_agree() -> None:
    rng = np.random.default_rng(3)
    count = 11
    value = rng.standard_normal((300, count)).cumsum(axis=0) * 0.05
    value[rng.uniform(size=value.shape) < 0.1] = np.nan
    value[:7, 3] = np.nan
    integral = np.arange(count) % 2 == 0
    many = gm.Series(value, integral, rng.uniform(0.01, 0.1, count), DT)
    power, tau = rng.uniform(0.1, 2.0, value.shape), rng.uniform(0.2, 3.0, count)
    trim, spread = rng.standard_normal(count), rng.uniform(0.1, 1.0, count)
    compiled, plain = (gm.smooth_rows(many, power, tau, trim, spread, engine) for engine in ("native", "reference"))
    for name in ("log_likelihood", "realised", "expected", "trim"):
        assert getattr(compiled, name) == pytest.approx(getattr(plain, name), rel=1e-9, abs=1e-12)
