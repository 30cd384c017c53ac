"""Scores against cases worked by hand, and the properties that make them comparable between aircraft."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple

from rotorid_torch.data import load
from rotorid_torch.validate import scores
from tests.helpers import shared

DT = 0.1
finite = st.floats(-5.0, 5.0, allow_nan=False, width=64)


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)[:, None]


def random_flight(seed: int, samples: int = 60, channels: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    measured = torch.randn(samples, channels, dtype=torch.float64, generator=generator)
    return measured, measured + 0.3 * torch.randn(samples, channels, dtype=torch.float64, generator=generator)


def test_J_of_two_channels_by_hand():
    error = torch.tensor([[1.0, 0.0], [1.0, 4.0]], dtype=torch.float64)
    scale = torch.tensor([1.0, 2.0], dtype=torch.float64)
    assert scores.flight_J(error, scale).item() == pytest.approx(math.sqrt((1 + 1 + 0 + 4) / 4))


def test_J_counts_valid_samples_only():
    scale = torch.tensor([1.0, 2.0], dtype=torch.float64)
    error = torch.tensor([[1.0, math.nan], [3.0, math.nan]], dtype=torch.float64)
    assert scores.flight_J(error, scale).item() == pytest.approx(math.sqrt(5.0))
    assert scores.flight_J(torch.full((4, 2), math.nan), scale).isnan()


def test_J_broadcasts_over_leading_dimensions():
    errors = torch.arange(24, dtype=torch.float64).reshape(2, 4, 3)
    scale = torch.tensor([1.0, 2.0, 4.0], dtype=torch.float64)
    each = torch.stack([scores.flight_J(e, scale) for e in errors])
    assert torch.equal(scores.flight_J(errors, scale), each)


def test_noise_J_is_the_noise_over_the_scale():
    noise, scale = torch.tensor([0.1, 0.3]), torch.tensor([1.0, 1.0])
    assert scores.noise_J(torch.zeros(9, 2), noise, scale).item() == pytest.approx(math.sqrt((0.01 + 0.09) / 2))
    absent = torch.tensor([[0.0, math.nan]] * 9)
    assert scores.noise_J(absent, noise, scale).item() == pytest.approx(0.1)


def test_trim_J_holds_the_first_half_second():
    measured = column(2.0, 4.0, 3.0, 3.0, 3.0, 6.0, 0.0, 3.0, 3.0, 3.0)
    expected = math.sqrt((1 + 1 + 9 + 9) / 10) / 2.0
    assert scores.trim_J(measured, torch.tensor([2.0]), DT).item() == pytest.approx(expected)


def test_list_score_is_the_rms_of_its_flights():
    assert scores.list_score(torch.tensor([3.0, 4.0, math.nan])).item() == pytest.approx(math.sqrt(12.5))


def test_r2_by_hand_and_with_a_gap():
    measured, model = column(1.0, 2.0, 3.0, 4.0), column(1.0, 2.0, 3.0, 6.0)
    assert scores.r2(model - measured, measured).item() == pytest.approx(1 - 4 / 5)
    gap = column(1.0, 2.0, 3.0, 4.0, math.nan)
    assert scores.r2(column(1.0, 2.0, 3.0, 6.0, 9.0) - gap, gap).item() == pytest.approx(1 - 4 / 5)


def test_rmse_by_hand():
    assert scores.rmse(column(3.0, math.nan, 4.0)).item() == pytest.approx(math.sqrt(12.5))


def test_theil_of_a_pure_bias_a_pure_gain_and_a_pure_shift():
    quiet = torch.zeros(5, dtype=torch.float64)
    wave = torch.sin(torch.arange(40, dtype=torch.float64) * (math.pi / 10))
    measured = torch.cat((quiet, wave))[:, None]
    bias = scores.theil(measured + 0.5, measured, DT)
    assert torch.allclose(bias.parts, torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64), atol=1e-12)
    gain = scores.theil(2.0 * measured, measured, DT)
    assert torch.allclose(gain.parts, torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64), atol=1e-12)
    assert gain.coefficient.item() == pytest.approx(1 / 3)
    opposite = scores.theil(-measured, measured, DT)
    assert opposite.coefficient.item() == pytest.approx(1.0)
    assert opposite.parts[0, 2].item() == pytest.approx(1.0)


def test_theil_of_a_perfect_model_has_no_shares():
    measured, _ = random_flight(0)
    perfect = scores.theil(measured, measured, DT)
    assert torch.equal(perfect.coefficient, torch.zeros(3, dtype=torch.float64))
    assert bool(perfect.parts.isnan().all())


@given(st.integers(0, 10_000))
def test_theil_shares_add_up_to_one(seed: int):
    measured, model = random_flight(seed)
    result = scores.theil(model, measured, DT)
    assert torch.allclose(result.parts.sum(-1), torch.ones(3, dtype=torch.float64), atol=1e-12)
    assert bool(((result.coefficient > 0) & (result.coefficient < 1)).all())


@given(st.integers(0, 10_000), st.lists(st.floats(1e-3, 1e3), min_size=3, max_size=3))
def test_a_change_of_units_leaves_the_scores_alone(seed: int, units: list[float]):
    measured, model = random_flight(seed)
    unit, scale = torch.tensor(units, dtype=torch.float64), torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    J = scores.flight_J(model - measured, scale)
    assert torch.allclose(scores.flight_J((model - measured) * unit, scale * unit), J, rtol=1e-10)
    J_trim = scores.trim_J(measured, scale, DT)
    assert torch.allclose(scores.trim_J(measured * unit, scale * unit, DT), J_trim, rtol=1e-10)
    assert torch.allclose(
        scores.theil(model * unit, measured * unit, DT).coefficient, scores.theil(model, measured, DT).coefficient
    )
    assert torch.allclose(scores.r2((model - measured) * unit, measured * unit), scores.r2(model - measured, measured))


@given(st.integers(0, 10_000), st.floats(0.05, 0.6))
def test_missing_samples_score_as_if_they_were_not_there(seed: int, share: float):
    measured, model = random_flight(seed, channels=1)
    keep = torch.rand(60, generator=torch.Generator().manual_seed(seed + 1)) > share
    keep[:6] = True
    holed = measured.masked_fill(~keep[:, None], math.nan)
    scale = torch.ones(1, dtype=torch.float64)
    assert torch.allclose(scores.flight_J(model - holed, scale), scores.flight_J((model - measured)[keep], scale))
    assert torch.allclose(scores.r2(model - holed, holed), scores.r2((model - measured)[keep], measured[keep]))
    assert torch.allclose(
        scores.theil(model, holed, DT).coefficient, scores.theil(model[keep], measured[keep], DT).coefficient
    )


@pytest.mark.parametrize(
    ("seconds", "dt", "expected"), [(15.0, 1 / 154, 8), (8.0, 0.1, 1), (3.0, 0.1, 1), (10.0, 0.1, 3)]
)
def test_windows_start_each_second_while_eight_seconds_are_left(seconds: float, dt: float, expected: int):
    samples = round(seconds / dt)
    starts = scores.window_starts(samples, dt)
    assert len(starts) == expected
    assert [round(s * dt) for s in starts] == list(range(expected))
    if expected > 1:
        assert starts[-1] + scores.horizon_samples(dt) <= samples


def test_window_statistics_are_numpys_percentiles():
    J = torch.tensor([0.4, 0.1, math.nan, 0.2, 0.9], dtype=torch.float64)
    known = J[~J.isnan()].numpy()
    assert astuple(scores.window_statistics(J)) == pytest.approx(tuple(np.percentile(known, [50, 10, 90])))


@pytest.mark.parametrize(
    ("name", "J_trim", "J_noise"),
    [
        ("uh60-hover", (1.34, 0.90, 1.19), 0.067),
        ("uh60-60kt", (1.34, 0.93, 0.81), 0.057),
        ("ah1-hover", (1.34, 0.89, 1.04), 0.088),
        ("uh60b-hover", (1.27, 0.84, 1.19), 0.063),
    ],
)
def test_yardsticks_of_the_reference_sets(name: str, J_trim: tuple[float, float, float], J_noise: float):
    data = load(shared("flightdata", name))
    channels = data.scored()
    scale = torch.tensor([data.scales()[c] for c in channels], dtype=torch.float64)
    noise = torch.tensor([data.noise(c) for c in channels], dtype=torch.float64)
    for flights, expected in zip((data.identify, data.validate, data.acid), J_trim, strict=True):
        records = [data.flights[flight] for flight in flights]
        measured = [f.stack(channels)[: scores.horizon_samples(f.dt)] for f in records]
        held = torch.stack([scores.trim_J(y, scale, f.dt) for y, f in zip(measured, records, strict=True)])
        assert scores.list_score(held).item() == pytest.approx(expected, abs=0.006)
        floor = torch.stack([scores.noise_J(y, noise, scale) for y in measured])
        assert scores.list_score(floor).item() == pytest.approx(J_noise, abs=0.0006)
