"""Delay, lag, rate limit and backlash between recorded control and swashplate, each against its exact answer."""

import numpy as np
import pytest

from rotorid_torch.simulation.helicopter.control_path import ControlPath, History, follow

DT = 1.0 / 308.0
TIME = DT * np.arange(924)


def driven(path: ControlPath, control: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Output of the path for a control over time (and its rate), by the midpoint rule."""
    state = np.zeros((path.states, 1))
    out = []
    for k in range(len(control) - 1):
        value, slope = follow(path, state, np.full((4, 1), control[k]), np.full((4, 1), rate[k]))
        out.append(value[0, 0])
        middle = 0.5 * (control[k] + control[k + 1]), 0.5 * (rate[k] + rate[k + 1])
        half = state + 0.5 * DT * slope
        state = state + DT * follow(path, half, np.full((4, 1), middle[0]), np.full((4, 1), middle[1]))[1]
    return np.array(out)


def test_lag_is_first_order():
    """A ramp arrives late by the lag, after exp(-t/lag) of it."""
    out = driven(ControlPath(lag=0.08), 0.1 * TIME, np.full_like(TIME, 0.1))
    exact = 0.1 * (TIME - 0.08 * -np.expm1(-TIME / 0.08))
    np.testing.assert_allclose(out, exact[:-1], atol=2e-6)


def test_rate_limit_bites_and_catches_up():
    """A slow control passes unchanged; a fast one is followed at the limit until it is met again."""
    slow = 0.01 * np.sin(TIME)
    np.testing.assert_allclose(driven(ControlPath(rate_limit=0.25), slow, 0.01 * np.cos(TIME)), slow[:-1], atol=1e-7)
    fast = 0.1 * np.tanh(TIME / 0.05)
    out = driven(ControlPath(rate_limit=0.25), fast, 2.0 / np.cosh(TIME / 0.05) ** 2)
    np.testing.assert_allclose(out[TIME[:-1] < 0.35], 0.25 * TIME[TIME < 0.35], atol=1e-3)
    assert np.abs(np.diff(out)).max() <= 0.25 * DT * 1.01
    assert out[-1] == pytest.approx(0.1, abs=1e-6)


def test_backlash_holds_at_reversals():
    """Play of 0.02: the output trails by 0.01, and stands still while the input crosses the play."""
    control, rate = 0.05 * np.sin(2 * TIME), 0.1 * np.cos(2 * TIME)
    out = driven(ControlPath(play=0.02), control, rate)
    gap = out - control[:-1]
    assert np.abs(gap).max() < 0.0102
    crossing = np.abs(gap) < 0.0095
    np.testing.assert_allclose(np.diff(out)[crossing[:-1] & crossing[1:]], 0.0, atol=1e-8)
    assert out.max() == pytest.approx(0.04, abs=2e-4)


@pytest.mark.parametrize("delay", [0.06, 0.001])
def test_delayed_control_is_the_control_a_delay_ago(delay):
    """At all stages of a step; where the delay is shorter than the step, by the last rate."""
    history = History(delay, DT)
    for time in TIME[:200]:
        history.keep(np.full((4, 1), np.sin(3.0 * time)))
        history.rate = np.full((4, 1), 3.0 * np.cos(3.0 * time))
        for part in (0.0, 0.5, 1.0):
            then = max(time + part * DT - delay, 0.0)
            value, rate = history.read(part)
            assert value[0, 0] == pytest.approx(np.sin(3.0 * then), abs=6e-5)
            if then > 0.0:
                assert rate[0, 0] == pytest.approx(3.0 * np.cos(3.0 * then), abs=0.03)


def test_nothing_is_nothing():
    """A path without pieces has no states and changes nothing."""
    value, rates = follow(ControlPath(), np.zeros((0, 3)), np.ones((4, 3)), np.ones((4, 3)))
    np.testing.assert_array_equal(value, 1.0)
    assert rates.shape == (0, 3)
