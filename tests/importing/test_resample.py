"""One grid for all: no phase, no aliases, gaps stay gaps; against sines and SciPy."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rotorid_torch.importing import flights
from rotorid_torch.importing.resample import lowpass, on_grid
from rotorid_torch.importing.signals import derive


def fitted(time: np.ndarray, values: np.ndarray, hertz: float) -> tuple[float, float]:
    """Amplitude and phase of a sine of this frequency."""
    columns = np.stack([np.sin(2 * np.pi * hertz * time), np.cos(2 * np.pi * hertz * time)], -1)
    a, b = np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(np.hypot(a, b)), float(np.arctan2(b, a))


@pytest.mark.parametrize("source_hz", [120.0, 250.0, 403.0, 1000.0])
def test_a_sine_keeps_amplitude_and_phase(source_hz: float):
    time = np.arange(0.0, 20.0, 1.0 / source_hz)
    grid = np.arange(1.0, 19.0, 0.01)
    amplitude, phase = fitted(grid, on_grid(time, np.sin(2 * np.pi * 3.0 * time), grid), 3.0)
    assert amplitude == pytest.approx(1.0, abs=0.01)
    assert abs(phase) < 1e-3


@pytest.mark.parametrize("hertz", [60.0, 80.0, 97.0, 143.0, 203.0])
def test_what_the_grid_cannot_hold_does_not_fold_into_it(hertz: float):
    time = np.arange(0.0, 10.0, 1e-3)
    grid = np.arange(1.0, 9.0, 0.01)
    left = on_grid(time, np.sin(2 * np.pi * hertz * time), grid)
    assert np.abs(left).max() < 0.01


def test_the_low_pass_is_symmetric_and_as_documented():
    weights = lowpass(10)
    assert np.array_equal(weights, weights[::-1])
    gain = np.abs(np.fft.rfft(weights, 10_000))  # bins of a thousandth of the grid's rate
    assert gain[0] == pytest.approx(1.0)
    assert gain[400] == pytest.approx(0.5, abs=0.01)
    assert gain[250] > 0.99
    assert gain[550:].max() < 0.01


def test_jittered_stamps_are_no_noise():
    rng = np.random.default_rng(0)
    time = np.sort(np.arange(0.0, 10.0, 2e-3) + rng.uniform(-8e-4, 8e-4, 5000))
    grid = np.arange(1.0, 9.0, 0.01)
    assert np.abs(on_grid(time, np.sin(time * 6.0), grid) - np.sin(grid * 6.0)).max() < 1e-3


@pytest.mark.parametrize("source_hz", [50.0, 100.0, 400.0])
def test_gaps_and_ends_stay_missing_and_their_edges_are_not_bent(source_hz: float):
    time = np.arange(2.0, 10.0, 1.0 / source_hz)
    time = time[(time < 5.0) | (time > 5.5)]
    grid = np.arange(0.0, 12.0, 0.01)
    values = on_grid(time, 3.0 + 0.0 * time, grid)
    missing = (grid < 1.97) | (grid > 10.0) | ((grid > 5.03) & (grid < 5.47))
    assert np.isnan(values[missing]).all()
    there = (grid > 2.0) & (grid < 9.97) & ((grid < 4.97) | (grid > 5.53))
    assert np.allclose(values[there], 3.0)


def test_missing_samples_have_no_weight():
    time = np.arange(0.0, 10.0, 2e-3)
    values = np.sin(time)
    values[::7] = np.nan
    grid = np.arange(1.0, 9.0, 0.01)
    assert np.abs(on_grid(time, values, grid) - np.sin(grid)).max() < 1e-3
    assert np.isnan(on_grid(time, np.full(len(time), np.nan), grid)).all()


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_angles_and_body_velocity_agree_with_scipy(phi: float, theta: float, psi: float):
    turned = Rotation.from_euler("ZYX", [psi, theta, phi])
    angles = derive.euler(*(np.array([x]) for x in turned.as_quat(scalar_first=True)))
    assert np.allclose(Rotation.from_euler("ZYX", np.ravel(angles)[::-1]).as_matrix(), turned.as_matrix(), atol=1e-9)
    body = derive.to_body(*(np.array([x]) for x in (3.0, -2.0, 1.0, phi, theta, psi)))
    assert np.allclose(np.ravel(body), turned.inv().apply([3.0, -2.0, 1.0]))


def test_a_quaternion_of_no_length_is_missing():
    assert all(np.isnan(angle).all() for angle in derive.euler(*np.zeros((4, 3))))


def test_north_and_east_of_latitude_and_longitude():
    # a minute of latitude is a nautical mile; at 60 degrees one of longitude is half of that, but for the flattening
    minute = np.radians(1.0 / 60.0)
    latitude, longitude = np.radians(60.0) + np.array([0.0, minute]), np.array([0.2, 0.2 + minute])
    north, east = derive.local(latitude, longitude)
    assert north[1] == pytest.approx(1852.0 * 1.0027, rel=2e-3)
    assert east[1] == pytest.approx(926.0 * 1.0027, rel=3e-3)
    assert derive.unwrapped(np.array([3.1, np.nan, -3.1]))[2] == pytest.approx(2 * np.pi - 3.1)


def test_a_slow_channel_reaches_from_before_a_flight_to_after_it():
    times = {50.0: np.arange(0.0, 120.0, 0.02), 0.1: np.arange(0.0, 121.0, 10.0)}
    fast, slow = (SimpleNamespace(time=t, values=0.01 * t, hertz=h) for h, t in times.items())
    record: Any = SimpleNamespace(signals={"p": fast, "voltage": slow}, file="log", cuts=())
    found, _ = flights._gridded(record, 36.0, 44.0, 50.0)
    np.testing.assert_allclose(found["voltage"], 0.01 * (36.0 + found["time"]), atol=1e-9)


@pytest.mark.parametrize(("smooth", "least", "most"), [(False, 0.85, 0.9), (True, 0.97, 1.01)])
def test_a_slow_velocity_keeps_what_lines_between_its_samples_lose(smooth: bool, least: float, most: float):
    time, grid = np.arange(0.0, 20.0, 0.2), np.arange(0.0, 19.0, 0.01)
    known = np.sin(2 * np.pi * 1.0 * time + 0.3)
    drawn, wanted = on_grid(time, known, grid, smooth), np.sin(2 * np.pi * 1.0 * grid + 0.3)
    assert least < (drawn @ wanted) / (wanted @ wanted) < most


def test_a_position_that_is_reset_stays_between_its_values():
    time = np.arange(50) / 5.0
    values = np.where(time < 5.0, 0.0, 5.0) + 0.01 * np.sin(time)
    drawn = on_grid(time, values, np.arange(0.0, 9.8, 0.02), smooth=True)
    assert np.nanmin(drawn) > -0.02
    assert np.nanmax(drawn) < 5.02


def test_cubics_draw_a_slow_record_of_a_swing():
    time, grid = np.arange(50) / 5.0, np.arange(1.0, 8.0, 0.02)
    drawn = on_grid(time, np.sin(2.0 * np.pi * time), grid, smooth=True)
    np.testing.assert_allclose(drawn, np.sin(2.0 * np.pi * grid), atol=0.06)
