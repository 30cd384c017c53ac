"""Causes put into records: what acted comes out of what is recorded now, by formulas of this file."""

from importlib import import_module

import numpy as np
import pytest

from rotorid_torch.data import Dataset

TIME = 0.01 * np.arange(2000)
ROTOR = {"blades": 4, "radius": 8.0, "chord": 0.5, "speed": 27.0}


def data() -> Dataset:
    stick = 0.02 * np.sin(0.9 * TIME) + 0.01 * np.sin(2.3 * TIME)
    still = {c: 1e-13 * np.sin(TIME) for c in ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "ax", "ay", "az")}
    flights = {f"f{k}": {"time": TIME, "lat": stick, **still} for k in range(2)}
    return Dataset.from_arrays(
        flights,
        identify=list(flights),
        controls={"lat": {"unit": "rad", "limits": [-0.1, 0.1]}},
        vehicle={"rotor": ROTOR, "mass": 5000.0},
    )


def made(cause: str):
    return import_module("hidden.in_records").CAUSES[cause](data())


def record(dataset: Dataset, channel: str, flight: str = "f1") -> np.ndarray:
    return dataset.flights[flight].channels[channel].numpy()


def played(command: np.ndarray, width: float) -> np.ndarray:
    acts, out = command[0] - 0.5 * width, []
    for x in command:
        acts = min(max(acts, x - 0.5 * width), x + 0.5 * width)
        out.append(acts)
    return np.array(out)


def test_what_passes_the_play_is_what_acted() -> None:
    loose = made("control.backlash")
    width = loose.true["control.backlash.width"]
    assert width > 0.003
    passed = played(record(loose.dataset, "lat"), width)
    assert np.abs(passed - record(data(), "lat"))[50:].max() < 0.03 * width


def test_what_passes_the_lag_is_what_acted() -> None:
    slow = made("control.lag")
    command, tau = record(slow.dataset, "lat"), slow.true["control.lag.common"]
    acts = [0.0]
    for x in command[20:-20]:
        acts.append(acts[-1] + 0.01 / tau * (x - acts[-1]))
    np.testing.assert_allclose(acts[100:-1], record(data(), "lat")[120:-20], atol=4e-4)


def test_a_wind_moves_flights_over_ground_by_heading() -> None:
    blown = made("environment.wind")
    north, east = blown.true["environment.wind.north"], blown.true["environment.wind.east"]
    np.testing.assert_allclose(record(blown.dataset, "u", "f0"), north)
    np.testing.assert_allclose(record(blown.dataset, "v", "f0"), east)
    np.testing.assert_allclose(record(blown.dataset, "u", "f1"), east)  # heading east
    np.testing.assert_allclose(record(blown.dataset, "v", "f1"), -north)


def test_half_of_a_slipped_control_arrives() -> None:
    before, after = record(data(), "lat"), record(made("outside.slipped_control").dataset, "lat")
    late, trim = TIME >= 6.0, before[:50].mean()
    assert np.array_equal(after[~late], before[~late])
    np.testing.assert_allclose(trim + 0.5 * (after - trim)[late] + 0.015 * 0.2, before[late], atol=1e-12)


def test_the_line_is_at_the_passing_of_the_blades() -> None:
    felt = record(made("environment.vibration").dataset, "az")
    spectrum = np.abs(np.fft.rfft(felt)) * 2.0 / len(felt)
    assert np.fft.rfftfreq(len(felt), 0.01)[spectrum.argmax()] == pytest.approx(4 * 27.0 / (2 * np.pi), abs=0.05)
    assert felt.std() * 2.0**0.5 == pytest.approx(0.8, rel=0.01)
