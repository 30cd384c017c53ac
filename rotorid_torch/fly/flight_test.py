"""The flight test: aircraft, trim, augmentation, manoeuvres and sensors make a data set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rotorid_torch.data import Dataset
from rotorid_torch.data.write import refuse_unless_free, write_dataset
from rotorid_torch.errors import InputError
from rotorid_torch.fly.aircraft import CONTROL_NAMES, Aircraft
from rotorid_torch.fly.augmentation import Augmentation, design
from rotorid_torch.fly.flight import Progress, fly_batch, with_heading
from rotorid_torch.fly.linear import linearise
from rotorid_torch.fly.manoeuvres import LISTS, chosen
from rotorid_torch.fly.rotor import LOCK_SLOPE
from rotorid_torch.fly.sensors import MEASURED, NOISE, Channels, measured_channels, true_channels
from rotorid_torch.fly.trim import Trim, find_trim
from rotorid_torch.fly.vehicle import load_aircraft

EFFECTS: dict[str, Callable[[Aircraft, float], Aircraft]] = {}
"""Undeclared physics that can be switched on: id -> a changed copy of the aircraft."""


@dataclass(frozen=True)
class FlightTest:
    """A flown data set: `declaration` is its dataset.toml; `flights` are measured, `truth` is without noise.

    `aircraft`, `trim` and `augmentation` are what flew.
    """

    name: str
    declaration: dict[str, Any]
    flights: dict[str, Channels]
    truth: dict[str, Channels]
    aircraft: Aircraft
    trim: Trim
    augmentation: Augmentation

    def dataset(self) -> Dataset:
        """Return the measured flights as a data set in memory."""
        tables = {
            key: self.declaration[key] for key in ("kind", "description", "vehicle", "controls", "channels", "model")
        }
        return Dataset.from_arrays(self.flights, name=self.name, **self.declaration["flights"], **tables)


def fly(
    out: Path | None,
    *,
    speed: float = 0.0,
    heading: float = 0.0,
    height: float = 27.4,
    vehicle: Path | None = None,
    flights: Sequence[str] | None = None,
    seed: int = 0,
    effects: Sequence[tuple[str, float]] = (),
    progress: Progress | None = None,
    seconds: float = 15.0,
) -> FlightTest:
    """Fly the built-in flight-test aircraft and write the data set.

    Parameters
    ----------
    out : folder to write, or None to keep the result in memory only.
    speed, heading, height : of the trimmed flight: m/s, rad, m.
    vehicle : a vehicle file (see `vehicle`); without one the UH-60.
    flights : names of manoeuvres (see `manoeuvres.FLIGHTS`); without them all thirteen.
    seed : of the sensor noise.
    effects : pairs of id and size.
    progress : called with samples done and in all.
    seconds : length of each flight.

    Raises
    ------
    InputError : an unknown flight or effect, a bad vehicle file, no trim, something in the way of `out`.
    """
    out = None if out is None else Path(out)
    if out is not None:
        refuse_unless_free(out.absolute())
    names = chosen(flights)
    _check_numbers(speed, heading, height, seconds)
    aircraft = load_aircraft(None if vehicle is None else Path(vehicle))
    for effect, size in effects:
        aircraft = _changed(aircraft, effect, size)
    trim = find_trim(aircraft, speed, height)
    augmentation = design(linearise(aircraft, trim))
    sense = -1.0 if aircraft.clockwise else 1.0
    record = fly_batch(aircraft, with_heading(trim, sense * heading), augmentation, names, seconds, progress)
    truth = {name: true_channels(aircraft, record, k) for k, name in enumerate(names)}
    channels = MEASURED if aircraft.governor.held else (*MEASURED, "omega")
    measured = {name: measured_channels(truth[name], channels, name, seed) for name in names}
    label = out.name if out is not None else f"{aircraft.name}-{speed:g}"
    declaration = declare(aircraft, label, names, channels, speed, height)
    if out is not None:
        _write(out, declaration, measured, truth)
    return FlightTest(label, declaration, measured, truth, aircraft, trim, augmentation)


def _write(out: Path, declaration: dict[str, Any], measured: Mapping[str, Any], truth: Mapping[str, Any]) -> None:
    """The flown set as a data set with its truth; an earlier data set there is replaced."""
    keys = ("name", "kind", "description", "vehicle", "controls", "channels", "model")
    tables: dict[str, Any] = {key: declaration.get(key) for key in keys}
    write_dataset(out, measured, **declaration["flights"], **tables, truth=truth)


def _check_numbers(speed: float, heading: float, height: float, seconds: float) -> None:
    """Refuse a flight that nobody can fly."""
    if not (np.isfinite(speed) and 0.0 <= speed <= 150.0):
        raise InputError("usage", "speed", f"is {speed}", "a speed of 0 to 150 m/s")
    if not np.isfinite(heading):
        raise InputError("usage", "heading", f"is {heading}", "an angle in rad")
    if not (np.isfinite(height) and height > 0.0):
        raise InputError("usage", "height", f"is {height}", "a height above ground in m")
    if not (np.isfinite(seconds) and seconds > 0.0):
        raise InputError("usage", "seconds", f"is {seconds}", "a positive time in s")


def _changed(aircraft: Aircraft, effect: str, size: float) -> Aircraft:
    """The aircraft with an effect switched on."""
    if effect not in EFFECTS:
        available = ", ".join(EFFECTS) or "none (this aircraft flies without undeclared effects)"
        raise InputError(
            "usage", "effect", f"the flight-test aircraft has no effect '{effect}'", f"one of: {available}"
        )
    return EFFECTS[effect](aircraft, size)


def declare(
    aircraft: Aircraft, name: str, flights: Sequence[str], channels: Sequence[str], speed: float, height: float
) -> dict[str, Any]:
    """The data set's dataset.toml."""
    rotor, sense = aircraft.rotor, -1.0 if aircraft.clockwise else 1.0
    mirror = np.array([1.0, sense, 1.0])
    side, nose = ("right", "right") if aircraft.clockwise else ("left", "left")
    positive = {"lon": "nose up", "lat": f"{side} side down", "col": "climb", "ped": f"nose {nose}"}
    state = f"flight at {speed:g} m/s" if speed else "hover"
    lock = aircraft.air_density * LOCK_SLOPE * rotor.chord * rotor.radius**4 / rotor.flap_inertia
    return {
        "format": 1,
        "name": name,
        "kind": "helicopter",
        "description": f"Built-in flight-test aircraft ({aircraft.name}), {state} at {height:g} m, rate and attitude "
        "augmentation active. Nothing undeclared.",
        "vehicle": {
            "mass": aircraft.mass,
            "inertia": (aircraft.inertia_matrix * np.outer(mirror, mirror)).tolist(),
            "mass_excludes": ["blades"],
            "gravity": aircraft.gravity,
            "air_density": aircraft.air_density,
            "hub": (np.asarray(rotor.hub) * mirror).tolist(),
            "imu": (np.asarray(aircraft.imu) * mirror).tolist(),
            "rotor": {
                "blades": rotor.blades,
                "radius": rotor.radius,
                "chord": rotor.chord,
                "speed": rotor.speed,
                "direction": "cw" if aircraft.clockwise else "ccw",
                "hinge_offset": rotor.hinge_offset,
                "lock_number": round(lock, 3),
            },
        },
        "controls": {
            control: {"unit": "rad", "limits": list(limits), "noise": NOISE[control], "positive": positive[control]}
            for control, limits in zip(CONTROL_NAMES, aircraft.limits, strict=True)
        },
        "channels": {c: {"noise": NOISE[c]} for c in channels if c != "time" and c not in CONTROL_NAMES},
        "flights": {key: [flight for flight in names if flight in flights] for key, names in LISTS.items()},
        "model": {"reference": f"{speed:g} m/s" if speed else "hover"},
    }
