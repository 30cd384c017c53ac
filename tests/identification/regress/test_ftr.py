"""Fourier transform regression on known linear systems: exact when smooth, honest when noisy, plain when refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rotorid_torch.errors import InputError
from rotorid_torch.identification.regress.ftr import regress
from tests.identification.regress.known_systems import NOISE, ROLL_PITCH_YAW, LinearSystem, coverage, flights, noisy

DT = 1.0 / 154.0


@pytest.mark.parametrize("dt", [DT, 0.02, 0.05])
@pytest.mark.parametrize("kind", ["derivative", "value"])
def test_smooth_record_without_noise_gives_the_system(dt: float, kind: str) -> None:
    records = flights(ROLL_PITCH_YAW, [12.0, 9.0], dt)
    for state in range(3):
        truth = ROLL_PITCH_YAW.row(state)
        response = [r[:, state] if kind == "derivative" else r @ truth for r in records]
        result = regress(response, records, dt, kind=kind)
        assert ((result.coefficients - truth).abs() / truth.abs()).max() < 1e-5
        assert result.r2 > 1.0 - 1e-9
        assert result.notes == ()


@given(seed=st.integers(0, 10_000), size=st.integers(1, 4), duration=st.floats(8.0, 20.0))
@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
def test_recovers_a_random_stable_linear_system(seed: int, size: int, duration: float) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(size, size))
    a -= (np.linalg.eigvals(a).real.max() + rng.uniform(0.3, 3.0)) * np.eye(size)
    system = LinearSystem(a, 3.0 * rng.normal(size=(size, size)))
    records = flights(system, [duration, duration], 0.01, seed)
    for state in range(size):
        truth = system.row(state)
        result = regress([r[:, state] for r in records], records, 0.01)
        assert (result.coefficients - truth).abs().max() < 1e-5 * truth.abs().max()


@pytest.mark.parametrize(("dt", "bound"), [(DT, 1e-6), (0.02, 1e-5)])
def test_edges_of_a_manoeuvre_are_straight_lines_between_samples(dt: float, bound: float) -> None:
    system = LinearSystem(np.array([[-1.0, 0.95], [-4.0, -1.5]]), np.array([[-0.1], [-6.0]]))
    times = np.arange(round(15.0 / dt) + 1) * dt
    edges = np.searchsorted([1.0, 2.8, 4.0, 4.6, 5.2], times, side="right")
    controls = 0.03 * np.array([0.0, 1.0, -1.0, 1.0, -1.0, 0.0])[edges][:, None]
    record = torch.cat((system.follow(controls, dt), torch.tensor(controls)), dim=-1)
    for state in range(2):
        truth = system.row(state)
        result = regress(record[:, state], record, dt)
        assert ((result.coefficients - truth) / truth).abs().max() < bound
    sensed = noisy([record], 0.01 * record.std(0), 200, seed=1)[0]
    result = regress(sensed[..., 1], sensed, dt)
    inside = (result.coefficients - system.row(1)).abs() < 1.96 * result.standard_errors
    assert float(inside.to(torch.float64).mean(0).min()) > 0.9


@pytest.mark.parametrize("oversample", [1, 3])
def test_values_that_go_together_at_the_samples_do_so_to_rounding(oversample: int) -> None:
    """Whatever lies between them: straight lines with kinks, a jump, a wave."""
    time, rng = np.arange(0.0, 20.0, 0.02), np.random.default_rng(1)
    lines = [np.interp(time, np.linspace(0.0, 20.0, n), rng.standard_normal(n)) for n in (9, 14)]
    columns = np.stack([*lines, np.where(time > 7.0, 1.0, 0.0), np.cos(2.3 * time)], axis=-1)
    truth = np.array([1.0, -2.0, 0.5, 0.3])
    found = regress(columns @ truth, columns, 0.02, kind="value", oversample=oversample)
    assert np.abs(found.coefficients.numpy() - truth).max() < 1e-12


def test_constant_and_trend_of_every_flight_are_nuisance() -> None:
    records = flights(ROLL_PITCH_YAW, [10.0, 14.0], 0.02)
    truth = ROLL_PITCH_YAW.row(1)
    times = [torch.arange(len(r), dtype=torch.float64) * 0.02 for r in records]
    bent = [r[:, 1] + 0.3 + s * t for r, t, s in zip(records, times, (0.1, -0.2), strict=True)]
    assert torch.allclose(regress(bent, records, 0.02).coefficients, truth, rtol=1e-5)
    values = [r @ truth + 2.0 - s * t for r, t, s in zip(records, times, (0.1, -0.2), strict=True)]
    assert torch.allclose(regress(values, records, 0.02, kind="value").coefficients, truth, rtol=1e-5)
    shifted = [r + torch.linspace(-1.0, 1.0, 5, dtype=torch.float64) for r in records]
    assert torch.allclose(regress(bent, shifted, 0.02).coefficients, truth, rtol=1e-5)


def test_flights_may_differ_in_length_and_sample_interval() -> None:
    records = flights(ROLL_PITCH_YAW, [12.0], 0.02) + flights(ROLL_PITCH_YAW, [7.0], 0.01, seed=3)
    result = regress([r[:, 0] for r in records], records, [0.02, 0.01])
    assert torch.allclose(result.coefficients, ROLL_PITCH_YAW.row(0), rtol=1e-5)
    assert len(result.frequencies) == result.residual.shape[-1]


@pytest.mark.parametrize("given_noise", [True, False])
@pytest.mark.parametrize("level", [1.0, 3.0])
def test_intervals_cover_with_noise_on_response_and_regressors(level: float, given_noise: bool) -> None:
    records = flights(ROLL_PITCH_YAW, [15.0, 15.0], DT)
    share = coverage(ROLL_PITCH_YAW, records, DT, level * NOISE, 200, given_noise, seed=1)
    assert 0.93 < float(share.mean()) < 0.975
    assert float(share.min()) > 0.89


@pytest.mark.slow
@pytest.mark.parametrize("durations", [[15.0], [15.0] * 4, [8.0, 12.0]])
@pytest.mark.parametrize("level", [1.0, 3.0, 10.0])
def test_a_thousand_noisy_runs_are_covered(level: float, durations: list[float]) -> None:
    records = flights(ROLL_PITCH_YAW, durations, DT)
    share = coverage(ROLL_PITCH_YAW, records, DT, level * NOISE, 1000, given=False)
    assert 0.93 < float(share.mean()) < 0.97
    assert float(share.min()) > 0.90


def test_noise_of_regressors_no_longer_biases_slopes() -> None:
    records = flights(ROLL_PITCH_YAW, [15.0], DT)
    noise = 20.0 * NOISE
    runs = noisy(records, noise, 200, seed=2)
    truth = ROLL_PITCH_YAW.row(0)
    values = [(records[0] @ truth).expand(200, -1)]
    biased = regress(values, runs, DT, kind="value", noise="none")
    right = regress(values, runs, DT, kind="value", noise=noise)

    def bias(result: torch.Tensor) -> torch.Tensor:
        return (result - truth).mean(0) / result.std(0) * math.sqrt(len(result))

    assert bias(biased.coefficients).abs().max() > 8.0
    assert bias(right.coefficients).abs().max() < 3.5
    assert 0.5 < float(right.reliability[:, 1].mean()) < 0.98


def test_derivative_of_a_regressor_is_not_biased_by_their_common_noise() -> None:
    # the noise of p enters dp/dt in quadrature, so only its power on the regressor's side is taken out
    system = LinearSystem(np.array([[-1.5]]), np.array([[4.0]]))
    runs = noisy(flights(system, [15.0], DT), torch.tensor([0.02, 0.0], dtype=torch.float64), 400, seed=4)
    result = regress([r[..., 0] for r in runs], runs, DT, noise=[0.02, 0.0])
    error = result.coefficients - system.row(0)
    assert (error.mean(0) / error.std(0)).abs().max() < 3.0 / math.sqrt(400)
    assert torch.allclose(result.standard_errors.mean(0), error.std(0), rtol=0.15)


@pytest.mark.parametrize("pole", [0.9])
def test_intervals_cover_coloured_residuals(pole: float) -> None:
    records = flights(ROLL_PITCH_YAW, [15.0, 15.0], 0.02)
    generator, truth, values = torch.Generator().manual_seed(5), ROLL_PITCH_YAW.row(2), []
    for record in records:
        white = torch.randn(len(record) + 300, 200, generator=generator, dtype=torch.float64)
        coloured = torch.zeros_like(white)
        for k in range(1, len(white)):
            coloured[k] = pole * coloured[k - 1] + white[k]
        values.append(record @ truth + 0.01 * coloured[300:].T)
    result = regress(values, records, 0.02, kind="value", noise="none")
    coverage = ((result.coefficients - truth).abs() < 1.96 * result.standard_errors).to(torch.float64).mean(0)
    assert 0.91 < float(coverage.mean()) < 0.98
    assert float(coverage.min()) > 0.88


def test_finer_points_do_not_count_as_data() -> None:
    runs = noisy(flights(ROLL_PITCH_YAW, [15.0], DT), NOISE, 20, seed=6)
    plain = regress([r[..., 0] for r in runs], runs, DT)
    fine = regress([r[..., 0] for r in runs], runs, DT, oversample=8)
    assert fine.frequencies.numel() > 7 * plain.frequencies.numel()
    assert fine.information < plain.information + 4.0
    ratio = fine.standard_errors / plain.standard_errors
    assert float(ratio.mean()) == pytest.approx(1.05, abs=0.15)


def test_batch_gives_what_single_runs_give() -> None:
    runs = noisy(flights(ROLL_PITCH_YAW, [10.0], 0.02), NOISE, 3, seed=7)[0]
    batch = regress(runs[..., 0], runs, 0.02)
    for i, run in enumerate(runs):
        single = regress(run[:, 0], run, 0.02)
        assert torch.allclose(batch.coefficients[i], single.coefficients, rtol=1e-9)
        assert torch.allclose(batch.covariance[i], single.covariance, rtol=1e-7)
        assert torch.allclose(batch.r2[i], single.r2)


def test_scale_of_units_changes_nothing_else() -> None:
    run = noisy(flights(ROLL_PITCH_YAW, [15.0], DT), NOISE, 1, seed=8)[0][0]
    scale = torch.tensor([57.3, 1e-4, 1e5, 1.0, 3.0], dtype=torch.float64)
    one, other = regress(run[:, 0], run, DT), regress(run[:, 0], run * scale, DT)
    assert torch.allclose(other.coefficients * scale, one.coefficients, rtol=1e-8)
    assert torch.allclose(other.standard_errors * scale, one.standard_errors, rtol=1e-8)
    assert torch.allclose(other.condition, one.condition)


def test_what_the_data_cannot_tell_has_an_infinite_error() -> None:
    record = flights(ROLL_PITCH_YAW, [10.0], 0.02)[0]
    constant = torch.full((len(record), 1), 3.0, dtype=torch.float64)
    doubled = torch.cat((record, 2.0 * record[:, 3:4], constant), dim=-1)
    result = regress(record[:, 0], doubled, 0.02, noise="none")
    assert torch.isinf(result.standard_errors).tolist() == [False, False, False, True, False, True, True]
    assert torch.allclose(result.coefficients[:3], ROLL_PITCH_YAW.row(0)[:3], rtol=1e-4)
    assert float(result.coefficients[-1]) == 0.0


def test_broad_band_regressor_is_not_taken_for_noise() -> None:
    generator = torch.Generator().manual_seed(9)
    regressor = torch.randn(2000, 1, generator=generator, dtype=torch.float64)
    result = regress(3.0 * regressor[:, 0], regressor, 0.01, kind="value")
    assert float(result.coefficients[0]) == pytest.approx(3.0, rel=1e-9)
    assert "broad-band" in result.notes[0]


def test_missing_samples_are_filled_and_noted() -> None:
    record = flights(ROLL_PITCH_YAW, [15.0], DT)[0]
    record[200:203, 1] = math.nan
    result = regress(record[:, 0], record, DT)
    assert torch.allclose(result.coefficients, ROLL_PITCH_YAW.row(0), rtol=1e-3)
    assert "3 missing samples" in result.notes[0]


def test_collinear_regressors_are_told_and_have_no_coefficient() -> None:
    record = flights(ROLL_PITCH_YAW, [20.0], 0.02)[0]
    twice = torch.cat([record, record[:, :1] + 2.0 * record[:, 3:4], torch.zeros_like(record[:, :1])], dim=-1)
    plain, found = regress(record[:, 0], record, DT), regress(record[:, 0], twice, DT)
    lost = [0, 3, record.shape[1], record.shape[1] + 1]
    others = [i for i in range(record.shape[1]) if i not in lost]
    assert bool(found.standard_errors[lost].isinf().all())
    assert bool(found.uncorrected_errors[lost].isinf().all())
    assert torch.equal(found.coefficients[lost], torch.zeros(len(lost), dtype=torch.float64))
    torch.testing.assert_close(found.coefficients[others], plain.coefficients[others], rtol=1e-6, atol=1e-8)
    assert float(found.r2) == pytest.approx(float(plain.r2), abs=1e-9)
    assert f"regressors {lost}: do not move in the band, or are combinations" in " ".join(found.notes)
    assert sum(line.endswith("not identifiable") for line in found.text().splitlines()) == len(lost)


def test_errors_without_colour_are_those_of_plain_least_squares() -> None:
    """White noise on the response: both errors are the textbook's. Coloured: the uncorrected one is too small."""
    rng, time = np.random.default_rng(0), DT * np.arange(3000)
    turns = (0.1 + 0.01 * time) * time, (0.2 + 0.008 * time) * time
    x = np.stack([np.sin(2.0 * np.pi * turns[0]), np.cos(2.0 * np.pi * turns[1])], axis=-1)
    white = 0.1 * rng.standard_normal(len(time))
    coloured = np.convolve(white, np.exp(-DT * np.arange(200) / 0.3), mode="same")
    band = (0.1, 1.5)
    one = regress(x @ [1.0, -2.0] + white, x, DT, band, kind="value", noise="none")
    two = regress(x @ [1.0, -2.0] + coloured, x, DT, band, kind="value", noise="none")
    expected = torch.as_tensor(np.sqrt(np.diag(np.linalg.inv(x.T @ x))) * 0.1)
    torch.testing.assert_close(one.uncorrected_errors, expected, rtol=0.2, atol=0.0)
    torch.testing.assert_close(one.standard_errors, expected, rtol=0.4, atol=0.0)
    assert float((two.standard_errors / two.uncorrected_errors).max()) > 1.15


@pytest.mark.parametrize(("gain", "told"), [(0.0, False), (1.0, True)])
def test_strong_feedback_is_told(gain: float, told: bool) -> None:
    """x' = -1.5 x + 6 u + d, u = pilot - gain x: the control follows what d has done."""
    for seed in range(3):
        rng, time = np.random.default_rng(seed), 0.02 * np.arange(2000)
        x, u, d = np.zeros(2000), np.zeros(2000), 0.0
        for k in range(1999):
            u[k] = 0.3 * np.sin(2.0 * np.pi * (0.1 + 0.02 * time[k]) * time[k]) - gain * x[k]
            d = 0.95 * d + 0.6 * rng.standard_normal()
            x[k + 1] = x[k] + 0.02 * (-1.5 * x[k] + 6.0 * u[k] + d)
        found = regress(x + 0.02 * rng.standard_normal(2000), np.stack([x, u], axis=-1), 0.02, band=(0.05, 2.0))
        assert any("follows the residual" in note for note in found.notes) == told


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "integral"}, '"derivative" or "value"'),
        ({"band": (2.0, 1.0)}, "a lower and a higher frequency"),
        ({"band": (0.1, 80.0)}, "less than 25"),
        ({"band": (1.01, 1.09)}, "a wider band or a longer record"),
        ({"band": (0.1, 0.35)}, "fewer regressors"),
        ({"dt": 0.0}, "the sample interval"),
        ({"dt": [0.02, 0.02]}, "one number"),
        ({"noise": "guess"}, '"estimated" or "none"'),
        ({"oversample": 0}, "at least 1"),
        ({"response": torch.zeros(400)}, "expected (..., 400, n)"),
        ({"response": torch.full((501,), math.inf)}, "holds infinity"),
        ({"response": torch.full((501,), math.nan)}, "at most 25%"),
    ],
)
def test_bad_arguments_are_refused_in_plain_words(change: dict[str, Any], words: str) -> None:
    record = flights(ROLL_PITCH_YAW, [10.0], 0.02)[0]
    arguments: dict[str, object] = {"response": record[:, 0], "regressors": record, "dt": 0.02}
    with pytest.raises(InputError) as caught:
        regress(**{**arguments, **change})  # pyright: ignore[reportArgumentType]
    assert words in str(caught.value)


def test_coefficients_are_there_by_name_with_both_errors() -> None:
    time = np.arange(0.0, 20.0, 0.02)
    columns = np.stack([np.sin(time), np.cos(2.3 * time), 0.0 * time], axis=-1)
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(time))
    found = regress(columns @ [1.0, -2.0, 0.0] + noise, columns, 0.02, kind="value")
    first, blind = found["0"], found["2"]
    assert first.value == float(found.coefficients[0])
    assert (first.se, first.se_white) == (float(found.standard_errors[0]), float(found.uncorrected_errors[0]))
    assert blind.status == "not identifiable"
    assert math.isnan(blind.se)
    assert list(found.to_dict()) == ["0", "1", "2"]
    assert "not identifiable" in found._repr_html_()
    with pytest.raises(KeyError, match="there are 0, 1, 2"):
        found["q"]
