"""Axes and units of velocities and positions: one error, with accelerometers and without them; else silence."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.examination.frames import frames
from rotorid_torch.consistency.pairs.axes import height_frame, path_frame, velocity_frame
from rotorid_torch.data import Dataset
from tests.consistency.sensor_errors.kinematic_cases import motion, read

TRUTH = motion(3, 4, seconds=20.0)
FORCES = ("ax", "ay", "az")


def turned(flight: dict, first: str, second: str, angle: float) -> dict:
    z = (flight[first] + 1j * flight[second]) * np.exp(1j * angle)
    return {first: z.real, second: z.imag}


def over_earth(flight: dict) -> dict:
    z = (flight["u"] + 1j * flight["v"]) * np.exp(1j * (flight["psi"] + 0.7))
    return {"u": z.real, "v": z.imag, "psi": flight["psi"] + 0.7}


CHANGES = {
    "knots": (lambda f: {c: f[c] / 0.514444 for c in "uvw"}, "u v", "(knots?)"),
    "feet a second": (lambda f: {c: f[c] / 0.3048 for c in "uvw"}, "u v", "(ft/s?)"),
    "another yaw": (lambda f: turned(f, "u", "v", -np.radians(30.0)), "u v", "turned by -"),
    "sign": (lambda f: {"v": -f["v"]}, "u v", "v has the wrong sign"),
    "exchanged": (lambda f: {"u": f["v"], "v": f["u"]}, "u v", "u and v are exchanged"),
    "north and east": (over_earth, "u v", "velocities north and east"),
    "height in feet": (lambda f: {"height": f["height"] / 0.3048}, "height", "(ft?)"),
    "height down": (lambda f: {"height": -f["height"]}, "height", "positive down"),
    "places in feet": (lambda f: {c: f[c] / 0.3048 for c in ("north", "east")}, "north east", "(ft?)"),
    "east and north": (lambda f: {"north": f["east"], "east": f["north"]}, "north east", "exchanged"),
    "map": (lambda f: turned(f, "north", "east", np.radians(40.0)), "north east", "turned by +4"),
    "south": (lambda f: {"north": -f["north"]}, "north east", "north has the wrong sign"),
}
"""What is done to a flight, the channels of the error, and what it says."""


def dataset(change=None, without: tuple[str, ...] = ()) -> Dataset:
    made = {}
    for k, truth in enumerate(TRUTH):
        flight = read(truth, {}, seed=k)
        time = flight["time"]
        places = {c: np.interp(time, truth["time"], truth[c]) for c in ("north", "east", "height")}
        noise = np.random.default_rng(k).normal(0.0, 0.1, (3, len(time)))
        flight |= {c: places[c] + noise[i] for i, c in enumerate(places)}
        flight |= {"lat": 0.1 * np.sin(2.0 * time), "lon": 0.1 * np.cos(1.3 * time)}
        flight |= change(flight) if change else {}
        made[f"f{k}"] = {c: v for c, v in flight.items() if c not in without}
    return Dataset.from_arrays(made, identify=[*made])


@pytest.mark.parametrize("without", [(), FORCES])
@pytest.mark.parametrize("name", CHANGES)
def test_another_unit_or_another_frame_is_one_finding(name: str, without: tuple[str, ...]):
    change, channels, words = CHANGES[name]
    (only,) = frames(dataset(change, without))
    assert only.channel == channels
    assert words in only.sentence
    assert only.severity == ("warning" if name == "map" else "error")


@pytest.mark.parametrize("without", [(), FORCES])
def test_right_records_have_none(without: tuple[str, ...]):
    assert not [*frames(dataset(None, without))]


@pytest.mark.parametrize("degrees", [-150.0, -30.0, 8.0, 90.0, 170.0])
def test_a_turn_is_right_to_half_a_degree(degrees: float):
    frame = velocity_frame(dataset(lambda f: turned(f, "u", "v", np.radians(degrees))), felt=True)
    assert frame is not None
    assert frame.form == "plain"
    assert abs(np.degrees(frame.turn) - degrees) < 0.5


def test_factor_is_within_its_errors():
    right = dataset()
    for frame in (velocity_frame(right, True), path_frame(right), height_frame(right)):
        assert frame is not None
        assert abs(frame.scale - 1.0) < max(4.0 * frame.errors[0], 0.01)
        assert abs(frame.turn) < max(4.0 * frame.errors[1], 0.01)


def test_velocities_of_noise_have_no_axes():
    still = dataset(lambda f: {c: 1e-3 * np.random.default_rng(0).standard_normal(len(f["time"])) for c in "uvw"})
    assert not [f for f in frames(still) if "turned" in f.sentence or "exchanged" in f.sentence]


def test_velocities_that_hardly_move_are_not_compared():
    """An estimator makes them of the noise of its accelerometers."""
    chance, dt = np.random.default_rng(0), 0.01
    time, flights = np.arange(0.0, 30.0, dt), {}
    for k in range(2):
        phi, theta = (0.008 * np.sin(w * time + k) for w in (1.3, 1.7))
        felt = {c: 0.02 * chance.standard_normal(len(time)) - 9.8 * (c == "az") for c in FORCES}
        u, v = (0.7 * dt * np.cumsum(change) for change in (-9.8 * theta + felt["ax"], 9.8 * phi + felt["ay"]))
        rates = {"p": np.gradient(phi, dt), "q": np.gradient(theta, dt), "r": 1e-4 * np.cos(time)}
        level = {"phi": phi, "theta": theta, "psi": 1e-4 * np.sin(time), "u": u, "v": v, "w": 0.01 * np.sin(time)}
        flights[f"f{k}"] = {"time": time, "motor1": 0.5 + 0.1 * np.sin(time), **rates, **level, **felt}
    data = Dataset.from_arrays(flights, identify=[*flights])
    assert velocity_frame(data, felt=True) is None
    assert not [f for f in frames(data) if f.channel == "u v"]
