"""What no body, control or list can be, beyond the range of a single number."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rotorid_torch.core import names
from rotorid_torch.data.refusal import shown
from rotorid_torch.data.schema import ChannelSpec, ControlSpec, FlightLists, Rotor, Vehicle
from rotorid_torch.errors import InputError


def _numbers(value: Any, key: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _numbers(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _numbers(item, f"{key}[{index}]")
    elif isinstance(value, float):
        yield key, value


def check_finite(document: Mapping[str, Any], file: str | Path) -> None:
    """Refuse nan and inf anywhere in a document."""
    for key, number in _numbers(document, ""):
        if not math.isfinite(number):
            raise InputError(file, key, f"is {number}", "a finite number")


def check_vehicle(vehicle: Vehicle, file: str | Path) -> None:
    """Refuse an inertia that no body has, and a chord or hinge beyond the rotor's radius."""
    if vehicle.inertia is not None:
        _check_inertia(np.array(vehicle.inertia), file)
    rotor = vehicle.rotor or Rotor()
    for key in ("chord", "hinge_offset"):
        size = getattr(rotor, key)
        if rotor.radius is not None and size is not None and size >= rotor.radius:
            raise InputError(
                file, f"vehicle.rotor.{key}", f"is {size:g} m", f"less than the radius of {rotor.radius:g} m"
            )


def _check_inertia(inertia: np.ndarray, file: str | Path) -> None:
    """A tensor that some body has: symmetric, positive definite, no principal moment above the sum of the others.

    A slack of 0.1 % allows for rounded digits.

    Source: Goldstein, Classical Mechanics, ch. 5: I1 + I2 - I3 = 2 ∫ z² dm ≥ 0.
    """
    key, size = "vehicle.inertia", float(np.abs(inertia).max())
    if np.abs(inertia - inertia.T).max() > 1e-6 * size:
        raise InputError(
            file, key, "is not symmetric", "[[Ixx, -Ixy, -Ixz], [-Ixy, Iyy, -Iyz], [-Ixz, -Iyz, Izz]] in kg m²"
        )
    principal = np.linalg.eigvalsh((inertia + inertia.T) / 2)
    told = ", ".join(f"{moment:.6g}" for moment in principal)
    if principal[0] <= 0:
        raise InputError(file, key, f"has principal moments {told} kg m²", "all of them positive")
    if principal[2] > (principal[0] + principal[1]) * 1.001:
        raise InputError(
            file,
            key,
            f"has principal moments {told} kg m²",
            "none larger than the sum of the other two (no body has this)",
        )


def check_controls(controls: Mapping[str, ControlSpec], file: str | Path) -> None:
    """Refuse unknown controls, reversed limits, and limits in degrees."""
    for name, spec in controls.items():
        if not names.is_control(name):
            known = (*names.STICKS, "motor1")
            raise InputError(
                file,
                f"controls.{name}",
                f"no such control{names.nearest(name, known)}",
                "lon, lat, col, ped or motor1, motor2, ...",
            )
        if spec.limits is None:
            continue
        if spec.limits[0] >= spec.limits[1]:
            raise InputError(
                file, f"controls.{name}.limits", f"is {list(spec.limits)}", "[lower, upper] with lower below upper"
            )
        if spec.unit == "rad" and max(map(abs, spec.limits)) > math.pi:
            raise InputError(
                file, f"controls.{name}.limits", f"is {list(spec.limits)} (degrees?)", "radians for a control in rad"
            )


def check_channels(channels: Mapping[str, ChannelSpec], file: str | Path) -> None:
    """Refuse declarations of a sensor for a control or for time."""
    for name in channels:
        if names.is_control(name):
            raise InputError(file, f"channels.{name}", "is a control", f"its noise in [controls.{name}]")
        if name == "time":
            raise InputError(file, "channels.time", "time has no sensor", "no [channels.time]")


def check_lists(lists: FlightLists, file: str | Path) -> None:
    """Refuse an empty identify list, a flight in two lists, and a name that leaves the data set's folder."""
    if not lists.identify:
        raise InputError(file, "flights.identify", "is empty", "at least one flight to fit")
    seen: dict[str, str] = {}
    for key in ("identify", "validate", "acid"):
        for name in getattr(lists, key):
            _check_flight_name(name, f"flights.{key}", file)
            if name in seen:
                where = f"flights.{seen[name]}" if seen[name] != key else "the same list"
                raise InputError(
                    file, f"flights.{key}", f"flight '{name}' is also in {where}", "each flight once, in one list"
                )
            seen[name] = key


def _check_flight_name(name: str, key: str, file: str | Path) -> None:
    leaves = not name or name.startswith(".") or re.search(r"[/\\:\x00-\x1f]", name) or len(name) > 200
    if leaves:
        raise InputError(
            file,
            key,
            f"flight {shown(name)} is not a plain name",
            "NAME of a file flights/NAME.npz inside the data set",
        )
