"""Gusts: variance, scale, independence and reproducibility."""

import numpy as np
import pytest

from rotorid_torch.simulation.helicopter.atmosphere import Passage, Turbulence, gusts, scale_lengths

DT = 1.0 / 308.0


def flown(flight: str = "a", seed: int = 0, steps: int = 4620) -> np.ndarray:
    """15 s of gusts of 1.5 m/s at 20 m/s and 27.4 m."""
    return gusts(Turbulence(1.5), Passage(27.4, 20.0), DT, steps, flight, seed)


def test_scale_lengths_are_the_specification():
    """MIL-F-8785C at 90 ft: w 90 ft, u and v 473 ft."""
    assert scale_lengths(90 * 0.3048) == pytest.approx((473 * 0.3048, 473 * 0.3048, 90 * 0.3048), rel=5e-3)


def test_gusts_have_their_variance_from_the_first_sample():
    """Over 60 flights; the first sample alone, and the last."""
    many = np.stack([flown(str(k), steps=300) for k in range(400)])
    for sample in (0, 300):
        np.testing.assert_allclose(many[:, :, sample].std(axis=0), 1.5, rtol=0.12)


def test_gusts_are_correlated_over_their_scale():
    """Autocorrelation of u is exp(-V t / L), of w exp(-x)(1 - x/2) with x = V t / L."""
    many = np.stack([flown(str(k), steps=154) for k in range(600)])
    x = 20.0 * 0.5 / np.array(scale_lengths(27.4))
    expected = np.exp(-x) * [1.0, 1.0 - 0.5 * x[1], 1.0 - 0.5 * x[2]]
    found = (many[:, :, 0] * many[:, :, 154]).mean(axis=0) / 1.5**2
    np.testing.assert_allclose(found, expected, atol=0.12)


def test_flight_seed_and_length():
    """The same flight again is the same; another flight or seed is another; a longer one begins alike."""
    np.testing.assert_array_equal(flown(), flown())
    np.testing.assert_allclose(flown(steps=100), flown()[:, :101], atol=1e-12)
    assert np.abs(flown("b") - flown()).max() > 0.5
    assert np.abs(flown(seed=1) - flown()).max() > 0.5
