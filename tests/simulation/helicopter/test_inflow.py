"""Dynamic inflow: momentum theory in hover, the published matrices in forward flight."""

import numpy as np
import pytest

from rotorid_torch.simulation.helicopter.inflow import inflow_rates, wake_sweep


def steady(loading: np.ndarray, advance: np.ndarray, climb: float) -> np.ndarray:
    """Inflow at which the rates vanish, by relaxation."""
    inflow = np.array([[0.05], [0.0], [0.0]])
    for _ in range(4000):
        over_tip = np.array([*advance, climb])[:, None]
        rate, _ = inflow_rates(inflow, loading[:, None], over_tip, np.array([27.0]))
        inflow = inflow + 2e-3 * rate
    return inflow[:, 0]


def test_hover_is_momentum_theory():
    """Mean sqrt(CT / 2); a gradient of the loading makes a gradient of inflow C / lambda0 (annuli of the disc)."""
    mean, aft, right = steady(np.array([0.0057, 1e-5, -2e-5]), np.zeros(2), 0.0)
    assert mean == pytest.approx(np.sqrt(0.0057 / 2.0), rel=1e-6)
    assert aft == pytest.approx(1e-5 / mean, rel=1e-6)
    assert right == pytest.approx(-2e-5 / mean, rel=1e-6)


@pytest.mark.parametrize("course", [0.0, 0.7, 2.5])
def test_forward_flight_is_pitt_and_peters_in_any_direction(course):
    """Against L written out in wind axes (Pitt and Peters 1981), turned to the course."""
    loading, mu, climb = np.array([0.0057, 3e-5, 2e-5]), 0.12, 0.01
    # Flying towards `course` from straight ahead: the hub moves against aft.
    advance = -mu * np.array([np.cos(course), np.sin(course)])
    mean, aft, right = steady(loading, advance, climb)
    through = mean + climb
    total = np.hypot(mu, through)
    x = np.tan(0.5 * np.arctan2(mu, through))
    k = 15.0 * np.pi / 64.0
    matrix = np.array([[0.5, -k * x, 0.0], [k * x, 2.0 * (1.0 - x * x), 0.0], [0.0, 0.0, 2.0 * (1.0 + x * x)]])
    flow = (mu**2 + through * (through + mean)) / total
    turn = np.array([[1, 0, 0], [0, np.cos(course), np.sin(course)], [0, -np.sin(course), np.cos(course)]])
    wind = (matrix @ turn @ loading) / [total, flow, flow]
    np.testing.assert_allclose(turn @ [mean, aft, right], wind, rtol=1e-5, atol=1e-9)
    assert (turn @ [mean, aft, right])[1] > 0.0, "more downwash at the rear"


def test_sweep_is_half_the_skew_angle():
    """45 degrees of skew."""
    sweep = wake_sweep(np.array([[-0.05], [0.0]]), np.array([0.05]))
    np.testing.assert_allclose(sweep[:, 0], [np.tan(np.pi / 8), 0.0], rtol=1e-12)
