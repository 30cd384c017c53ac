"""Flights of different rates on one rate: times, values, gaps, and what is told."""

import numpy as np
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.data.one_rate import at_one_rate
from tests.helpers import small_flight


def ramps(dt: float, samples: int) -> dict[str, np.ndarray]:
    """Straight lines, which averaging and interpolation keep exactly."""
    time = dt * np.arange(samples)
    return {"time": time, "lat": 0.001 * time, "p": 0.01 * time, "q": 0.02 - 0.01 * time, "r": 0.0 * time}


def test_one_rate_is_left_as_it_is():
    dataset = Dataset.from_arrays({"a": small_flight(), "b": small_flight(seed=1)}, identify=["a", "b"])
    assert at_one_rate(dataset) is dataset


def test_faster_flights_come_down_to_the_slowest_and_straight_lines_stay_straight():
    arrays = {"slow": ramps(0.02, 200), "fast": ramps(0.002, 1999), "odd": ramps(0.013, 300)}
    slowed = at_one_rate(Dataset.from_arrays(arrays, identify=["slow", "fast"], validate=["odd"]))
    assert {flight.dt for flight in slowed.flights.values()} == {0.02}
    for name, flight in slowed.flights.items():
        assert float(flight.time[-1]) <= arrays[name]["time"][-1] + 1e-9
        inner = slice(1, -1)
        torch.testing.assert_close(flight.channels["p"][inner], 0.01 * flight.time[inner], rtol=0.0, atol=1e-12)
    assert "50 to 500 Hz" in slowed.warnings[-1]


def test_gaps_stay_gaps():
    arrays = {"slow": ramps(0.02, 200), "fast": ramps(0.005, 800)}
    arrays["fast"]["q"][400:440] = np.nan
    fast = at_one_rate(Dataset.from_arrays(arrays, identify=["slow", "fast"])).flights["fast"]
    missing = fast.channels["q"].isnan()
    assert missing[100:110].all()
    assert int(missing.sum()) <= 13
