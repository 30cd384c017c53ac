"""Time grids: uniform, jittering, with gaps; angles without jumps; missing samples."""

import numpy as np
import pytest
import torch

from rotorid_torch.data.reading.grid import make_flight
from rotorid_torch.errors import InputError


def flight_of(time, **channels):
    return make_flight("f", {"time": np.asarray(time, dtype=float), **channels}, "f.npz")


def test_uniform_time_is_left_alone():
    time = 3.0 + 0.01 * np.arange(200) + 2e-5 * np.sin(np.arange(200))
    values = np.random.default_rng(0).standard_normal(200)
    flight, told = flight_of(time, p=values)
    assert told == []
    assert flight.dt == pytest.approx(0.01, rel=1e-3)
    assert np.array_equal(flight.channels["p"].numpy(), values)


def test_float32_time_becomes_uniform():
    time = (np.arange(2311) / 154.0).astype(np.float32)
    flight, told = flight_of(time, p=np.zeros(2311, dtype=np.float32))
    assert told == []
    assert flight.dt == pytest.approx(1 / 154.0, rel=1e-6)


def test_jitter_is_resampled_linearly():
    rng = np.random.default_rng(1)
    time = np.cumsum(0.01 * (1 + 0.3 * rng.uniform(-1, 1, 500)))
    flight, told = flight_of(time, p=2.0 * time + 1.0, lat=np.sin(time))
    assert "resampled linearly" in told[0]
    start = time[0]
    assert torch.allclose(flight.channels["p"], 2.0 * (flight.time + start) + 1.0)
    assert torch.allclose(flight.channels["lat"], torch.sin(flight.time + start), atol=1e-4)
    assert torch.allclose(flight.time, flight.dt * torch.arange(flight.samples, dtype=torch.float64))


def test_slow_drift_of_the_clock_is_resampled_too():
    time = np.cumsum(0.01 * (1 + 0.009 * np.linspace(-1, 1, 4000)))
    flight, told = flight_of(time, p=time)
    assert "resampled" in told[0]
    assert torch.allclose(flight.channels["p"], flight.time + time[0])


def test_gaps_and_missing_samples_stay_missing():
    time = 0.01 * np.arange(300)
    keep = (time < 1.0) | (time > 1.3)
    values = np.sin(time)
    values[200] = np.nan
    flight, told = flight_of(time[keep], p=values[keep], lat=np.cos(time[keep]))
    assert "1 gap of up to 0.3" in told[1]
    missing = flight.time[flight.channels["p"].isnan()].numpy()
    assert missing.min() == pytest.approx(1.0, abs=0.011)
    assert 2.0 == pytest.approx(missing.max(), abs=0.011)
    assert len(missing) == pytest.approx(31, abs=2)
    assert torch.allclose(flight.bridged(["lat"])[:, 0], torch.cos(flight.time), atol=0.02)


def test_headings_do_not_jump_even_over_missing_samples():
    psi = np.linspace(3.0, 12.0, 100)
    wrapped = (psi + np.pi) % (2 * np.pi) - np.pi
    wrapped[[7, 50]] = np.nan
    flight, _ = flight_of(0.1 * np.arange(100), psi=wrapped)
    known = ~flight.channels["psi"].isnan().numpy()
    assert known.sum() == 98
    assert np.allclose(flight.channels["psi"].numpy()[known], psi[known])


def test_stack_and_bridge():
    flight, _ = flight_of([0.0, 0.1, 0.2, 0.3], p=np.array([np.nan, 1.0, np.nan, 3.0]))
    columns = flight.stack(["p", "absent"])
    assert columns.shape == (4, 2)
    assert columns[:, 1].isnan().all()
    assert flight.bridged(["p"])[:, 0].tolist() == [1.0, 1.0, 2.0, 3.0]
    assert flight.stack([]).shape == (4, 0)
    assert flight.lead(0.15) == slice(0, 2)


def test_a_pause_of_hours_makes_two_flights():
    time = 0.01 * np.arange(100)
    time[50:] += 7200.0
    with pytest.raises(InputError, match=r"time: jumps by 7200 s at sample 50; expected one flight"):
        flight_of(time)
