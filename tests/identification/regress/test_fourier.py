"""Finite transforms against exact integrals; nuisance columns, noise floor, smoothing and gaps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.fft import dct, idct
from scipy.ndimage import uniform_filter1d

from rotorid_torch.identification.regress.fourier import (
    as_rows,
    chirp_z,
    derivative_transform,
    end_weights,
    fill_gaps,
    finite_transform,
    kinks,
    noise_floor,
    noise_floor_scatter,
    nuisance_basis,
    smoothed,
)


def exponential(times: torch.Tensor, rate: complex) -> torch.Tensor:
    return torch.exp(rate * times.to(torch.complex128)).real


def exact(rate: complex, omega: torch.Tensor, duration: float) -> torch.Tensor:
    """Integral of Re exp(rate t) exp(-j w t) over the record."""
    parts = [(torch.exp((s - 1j * omega) * duration) - 1.0) / (s - 1j * omega) for s in (rate, rate.conjugate())]
    return 0.5 * (parts[0] + parts[1])


@pytest.mark.parametrize(("dt", "bound"), [(1.0 / 154.0, 1e-11), (0.02, 2e-9), (0.05, 5e-6)])
@pytest.mark.parametrize("oversample", [1, 3])
def test_transform_of_a_record_that_ends_anywhere_is_exact(dt: float, bound: float, oversample: int) -> None:
    times = torch.arange(int(15.0 / dt) + 1, dtype=torch.float64) * dt
    duration, rate = float(times[-1]), complex(-0.1, 2.0 * math.pi * 1.9)
    count = int(2.0 * duration * oversample)
    transform = finite_transform(exponential(times, rate), dt, oversample, count, oversample)
    frequencies = (torch.arange(count, dtype=torch.float64) + oversample) / (duration * oversample)
    omega = 2.0 * math.pi * frequencies
    wanted = exact(rate, omega, duration)
    assert (transform - wanted).abs().max() < bound * wanted.abs().max()

    rates = derivative_transform(exponential(times, rate), transform, frequencies, duration)
    slope = torch.stack([rate * exact_part(rate, w, duration) for w in omega])
    assert (rates - slope).abs().max() < 50.0 * bound * slope.abs().max()


def exact_part(rate: complex, omega: torch.Tensor, duration: float) -> torch.Tensor:
    """Such that rate times it is the transform of Re(rate exp(rate t))."""
    one, other = rate, rate.conjugate()
    first = (torch.exp((one - 1j * omega) * duration) - 1.0) / (one - 1j * omega)
    second = (torch.exp((other - 1j * omega) * duration) - 1.0) / (other - 1j * omega)
    return 0.5 * (one * first + other * second) / rate


def test_end_weights_at_zero_frequency_are_gregorys() -> None:
    weights = 1.0 + end_weights(torch.zeros(1, dtype=torch.float64), order=2)[0]
    assert weights.real.tolist() == pytest.approx([9.0 / 24.0, 28.0 / 24.0, 23.0 / 24.0], abs=1e-14)
    assert weights.imag.abs().max() < 1e-14


def test_chirp_z_is_the_sum_it_stands_for() -> None:
    x = torch.randn(3, 57, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    n, k = torch.arange(57, dtype=torch.float64), torch.arange(80, dtype=torch.float64)
    direct = x.to(torch.complex128) @ torch.exp(-2j * math.pi * torch.outer(n, 0.01 + 0.003 * k))
    assert (chirp_z(x, 0.01, 0.003, 80) - direct).abs().max() < 1e-12


def test_constant_trend_and_ends_lie_in_the_nuisance_columns() -> None:
    dt, count, oversample = 0.02, 60, 2
    times = torch.arange(501, dtype=torch.float64) * dt
    frequencies = (torch.arange(count, dtype=torch.float64) + 2) / (10.0 * oversample)
    basis = nuisance_basis(frequencies, 10.0, ends=True, trend=True)
    assert basis.shape == (2 * count, 4)
    assert (basis.T @ basis - torch.eye(4)).abs().max() < 1e-12
    for record in (torch.ones_like(times), times):
        rows = as_rows(finite_transform(record, dt, 2, count, oversample))
        assert (rows - basis @ (basis.T @ rows)).abs().max() < 1e-9
    harmonics = torch.arange(1, 20, dtype=torch.float64) / 10.0
    assert nuisance_basis(harmonics, 10.0, ends=True, trend=True).shape[1] == 2
    assert nuisance_basis(harmonics, 10.0, ends=False, trend=False).shape[1] == 0


def test_noise_floor_of_noise_on_a_manoeuvre_with_edges() -> None:
    generator = torch.Generator().manual_seed(2)
    times = torch.arange(2311, dtype=torch.float64) / 154.0
    manoeuvre = torch.sin(6.0 * times) + torch.sign(torch.sin(2.0 * times))
    floors = noise_floor(manoeuvre + 0.01 * torch.randn(400, 2311, generator=generator, dtype=torch.float64))
    power = floors.square() / 0.01**2
    assert float(power.mean()) == pytest.approx(1.0, abs=0.04)  # the edges leave a little
    assert float(power.std()) == pytest.approx(noise_floor_scatter(2311), rel=0.15)
    assert float(noise_floor(torch.sin(6.0 * times))) < 1e-9


def manoeuvre(noise: float, seed: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    """A 3-2-1-1 by a hand that takes 0.2 s for each step, sampled at 154 Hz, and the same with noise."""
    times = torch.arange(2311, dtype=torch.float64) / 154.0
    moves = torch.zeros_like(times)
    for at, size in ((2.0, 1.0), (5.0, -2.0), (7.0, 2.0), (8.0, -2.0), (9.0, 1.0)):
        moves += size * 0.5 * (1.0 + torch.tanh((times - at) / 0.1))
    exact = 0.05 * moves + 0.01 * torch.sin(times)
    return exact, exact + noise * torch.randn(2311, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_smoothing_is_the_wiener_filter_of_the_records_cosines() -> None:
    record = manoeuvre(0.002)[1].numpy()
    lines = np.append(np.asarray(dct(record - record.mean(), norm="ortho")), 0.0)
    averaged = uniform_filter1d(lines**2, 9, mode="mirror")
    share = np.clip(1.0 - 0.002**2 / averaged, 0.0, None)
    expected = record.mean() + idct((share * lines)[:-1], norm="ortho")
    found = smoothed(torch.from_numpy(record), torch.tensor(0.002, dtype=torch.float64))
    assert np.abs(found.numpy() - expected).max() < 1e-12


def test_smoothing_takes_noise_away_without_phase_and_nothing_from_what_has_no_noise() -> None:
    exact, record = manoeuvre(0.002)
    noise = torch.tensor(0.002, dtype=torch.float64)
    found = smoothed(record, noise)
    assert float((found - exact).square().mean().sqrt()) < 0.5 * 0.002
    assert float((found[:200] - exact[:200]).abs().max()) < 0.002
    torch.testing.assert_close(smoothed(record.flip(0), noise).flip(0), found, rtol=0.0, atol=1e-12)
    torch.testing.assert_close(smoothed(exact, torch.zeros((), dtype=torch.float64)), exact, rtol=0.0, atol=1e-12)
    both = smoothed(torch.stack([record, exact]), torch.stack([noise, torch.zeros_like(noise)]))
    torch.testing.assert_close(both, torch.stack([found, exact]), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("samples", [1, 2, 5])
def test_short_records_are_smoothed_too(samples: int) -> None:
    assert smoothed(torch.ones(samples, dtype=torch.float64), torch.ones((), dtype=torch.float64)).isfinite().all()


def test_kinks_are_the_edges_of_a_manoeuvre_and_nothing_smooth() -> None:
    times = torch.arange(301, dtype=torch.float64) * 0.05
    smooth = torch.sin(2.0 * math.pi * 1.7 * times) + 0.4 * torch.cos(2.0 * math.pi * 0.9 * times)
    edges = 2.0 * (times > 3.01) - 1.0 * (times > 7.01)
    both = torch.stack((smooth, smooth + edges))
    found = kinks(both, noise_floor(both))
    assert not found[0].any()
    assert found[1].nonzero().flatten().tolist() == [60, 61, 140, 141]
    assert not kinks(both[1], torch.tensor(0.5, dtype=torch.float64)).any()


def test_gaps_are_filled_by_straight_lines_and_held_ends() -> None:
    nan = math.nan
    record = torch.tensor([[nan, 1.0, nan, nan, 4.0, nan], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]], dtype=torch.float64)
    filled, count, longest = fill_gaps(record)
    assert filled[0].tolist() == pytest.approx([1.0, 1.0, 2.0, 3.0, 4.0, 4.0])
    assert torch.equal(filled[1], record[1])
    assert (count, longest) == (4, 2)
