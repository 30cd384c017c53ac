"""Declarations and samples that no aircraft has, by the ranges of `core.ranges`.

Declared numbers beyond their ranges, alone and together, and lists of flights are refused. Samples beyond theirs are
missing samples from reading on, or an error where they are many.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from rotorid_torch.core import names
from rotorid_torch.core.ranges import DECLARED, DERIVED, ChannelRange, Range, of_channel
from rotorid_torch.data.refusal import shown
from rotorid_torch.data.schema import ChannelSpec, ControlSpec, FlightLists, Rotor, Vehicle
from rotorid_torch.errors import InputError, nearest

FEW = 0.01
"""Share of a channel's samples that may be impossible; where there are more, the unit or the sensor is wrong."""


def _numbers(value: Any, key: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _numbers(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _numbers(item, f"{key}[{index}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key, value


def check_finite(document: Mapping[str, Any], file: str | Path) -> None:
    """Refuse nan and inf anywhere in a document."""
    for key, number in _numbers(document, ""):
        if isinstance(number, float) and not math.isfinite(number):
            raise InputError(file, key, f"is {number}", "a finite number")


def check_vehicle(vehicle: Vehicle, file: str | Path) -> None:
    """Refuse numbers that no vehicle has, alone or together, see `core.ranges`."""
    for key, value in _numbers(msgspec.to_builtins(vehicle), "vehicle"):
        if not key.startswith("vehicle.inertia"):
            _require(DECLARED[re.sub(r"\[\d+\]", "", key)], value, key, file)
    if vehicle.inertia is not None:
        check_inertia(np.array(vehicle.inertia), file)
        _check_gyration(vehicle, file)
    rotor = vehicle.rotor or Rotor()
    for key in ("chord", "hinge_offset"):
        size = getattr(rotor, key)
        if rotor.radius is not None and size is not None and size >= rotor.radius:
            raise InputError(
                file, f"vehicle.rotor.{key}", f"is {size:g} m", f"less than the radius of {rotor.radius:g} m"
            )
    if rotor.radius is not None and rotor.speed is not None:
        tip, allowed = rotor.radius * rotor.speed, DERIVED["tip speed"]
        if not allowed.holds(tip):
            text = f"is {rotor.speed:g} rad/s, a tip speed of {tip:.4g} m/s (in rpm?)"
            raise InputError(file, "vehicle.rotor.speed", text, f"rad/s that make {allowed} at the tip")


def _require(allowed: Range, value: float, key: str, file: str | Path) -> None:
    if not allowed.holds(value):
        raise InputError(file, key, f"is {shown(value)}", str(allowed))


def check_inertia(inertia: np.ndarray, file: str | Path) -> None:
    """A tensor that some body has: symmetric, positive definite, no principal moment above the sum of the others.

    A slack of 0.1 % allows for rounded digits.

    Source: Goldstein, Classical Mechanics, ch. 5: I1 + I2 - I3 = 2 ∫ z² dm ≥ 0.
    """
    key, size, allowed = "vehicle.inertia", float(np.abs(inertia).max()), DECLARED["vehicle.inertia"]
    if size > allowed.high:
        raise InputError(file, key, f"holds {size:g} kg m²", f"principal moments of {allowed}")
    if np.abs(inertia - inertia.T).max() > 1e-6 * size:
        raise InputError(
            file, key, "is not symmetric", "[[Ixx, -Ixy, -Ixz], [-Ixy, Iyy, -Iyz], [-Ixz, -Iyz, Izz]] in kg m²"
        )
    principal = np.linalg.eigvalsh((inertia + inertia.T) / 2)
    text = ", ".join(f"{moment:.6g}" for moment in principal)
    if principal[0] <= 0:
        raise InputError(file, key, f"has principal moments {text} kg m²", "all of them positive")
    if principal[2] > (principal[0] + principal[1]) * 1.001:
        wish = "none larger than the sum of the other two (no body has this)"
        raise InputError(file, key, f"has principal moments {text} kg m²", wish)
    for moment in principal.tolist():
        if not allowed.holds(moment):
            raise InputError(file, key, f"has principal moments {text} kg m²", f"each of them {allowed}")


def _check_gyration(vehicle: Vehicle, file: str | Path) -> None:
    """Radii of gyration that a body of this mass and size can have: (principal moment / mass)^½."""
    if vehicle.mass is None:
        return
    radii = np.sqrt(np.linalg.eigvalsh(np.array(vehicle.inertia)) / vehicle.mass).tolist()
    arms = [math.hypot(*motor.position) for motor in vehicle.motors]
    rotor = vehicle.rotor.radius if vehicle.rotor and vehicle.rotor.radius else 0.0
    size = max(rotor, *arms, 0.0)
    for radius in radii:
        text = f"and mass {vehicle.mass:g} kg make a radius of gyration of {radius:.3g} m"
        allowed = DERIVED["radius of gyration"]
        if not allowed.holds(radius):
            raise InputError(file, "vehicle.inertia", text, str(allowed))
        share = DERIVED["radius of gyration over size"]
        if size > 0.0 and not share.holds(radius / size):
            raise InputError(file, "vehicle.inertia", text, f"{share} times the rotor's radius or arm of {size:.3g} m")


def check_thrust(vehicle: Vehicle, inputs: Sequence[float], file: str | Path) -> None:
    """Refuse declared thrusts that no vehicle of this mass has; `inputs` are the largest commands, or rotor speeds."""
    curves = [motor.thrust for motor in vehicle.motors if motor.thrust is not None]
    if vehicle.mass is None or not curves or len(curves) < len(inputs):
        return
    thrust = sum(c0 + c1 * m + c2 * m**2 for (c0, c1, c2), m in zip(curves, inputs, strict=True))
    share, allowed = thrust / (vehicle.mass * vehicle.gravity), DERIVED["thrust over weight"]
    if not allowed.holds(share):
        text = f"make {thrust:.3g} N at the largest inputs, {share:.3g} times the weight of {vehicle.mass:g} kg"
        raise InputError(file, "vehicle.motors.thrust", text, f"{allowed} times the weight")


def check_controls(controls: Mapping[str, ControlSpec], file: str | Path) -> None:
    """Refuse unknown controls, reversed limits, and limits and noise beyond the control's ranges."""
    for name, spec in controls.items():
        key = f"controls.{name}"
        if not names.is_control(name):
            hint = nearest(name, (*names.STICKS, "motor1"))
            raise InputError(file, key, f"no such control{hint}", "lon, lat, col, ped or motor1, motor2, ...")
        ranges = of_channel(name, spec.unit)
        _check_noise(ranges, spec.noise, key, file)
        if spec.limits is None:
            continue
        if spec.limits[0] >= spec.limits[1]:
            raise InputError(file, f"{key}.limits", f"is {list(spec.limits)}", "[lower, upper] with lower below upper")
        if not all(map(ranges.samples.holds, spec.limits)):
            guess = " (degrees?)" if spec.unit == "rad" else " (another unit?)"
            raise InputError(file, f"{key}.limits", f"is {list(spec.limits)}{guess}", f"within {ranges.samples}")


def check_channels(channels: Mapping[str, ChannelSpec], file: str | Path) -> None:
    """Refuse declarations of a sensor for a control or for time, and noise that no sensor has."""
    for name, spec in channels.items():
        if names.is_control(name):
            raise InputError(file, f"channels.{name}", "is a control", f"its noise in [controls.{name}]")
        if name == "time":
            raise InputError(file, "channels.time", "time has no sensor", "no [channels.time]")
        _check_noise(of_channel(name), spec.noise, f"channels.{name}", file)


def _check_noise(ranges: ChannelRange, noise: float | None, key: str, file: str | Path) -> None:
    if noise is not None and ranges.noise is not None:
        _require(ranges.noise, noise, f"{key}.noise", file)


def check_lists(lists: FlightLists, file: str | Path) -> None:
    """Refuse an empty identify list, a flight in two lists, and a name that leaves the data set's folder."""
    if not lists.identify:
        raise InputError(file, "flights.identify", "is empty", "at least one flight to fit")
    listed: dict[str, str] = {}
    for key in ("identify", "validate", "acid"):
        for name in getattr(lists, key):
            _check_flight_name(name, f"flights.{key}", file)
            if name in listed:
                where = f"flights.{listed[name]}" if listed[name] != key else "the same list"
                raise InputError(
                    file, f"flights.{key}", f"flight '{name}' is also in {where}", "each flight once, in one list"
                )
            listed[name] = key


def _check_flight_name(name: str, key: str, file: str | Path) -> None:
    leaves = not name or name.startswith(".") or re.search(r"[/\\:\x00-\x1f]", name) or len(name) > 200
    if leaves:
        wish = "NAME of a file flights/NAME.npz inside the data set"
        raise InputError(file, key, f"flight {shown(name)} is not a plain name", wish)


def without_impossible(
    channel: str, values: np.ndarray, allowed: Range, file: str | Path, key: str
) -> tuple[np.ndarray, str]:
    """Samples (T,) of a channel with those outside the range as NaN, and a sentence; empty where there are none.

    `file` and `key` are named in errors.

    Raises InputError where more than one, and more than `FEW` of the samples, lie outside, or half of them.
    """
    measured = int((~np.isnan(values)).sum())
    outside = (values < allowed.low) | (values > allowed.high)
    count = int(outside.sum())
    if not count:
        return values, ""
    worst = float(values[outside][np.abs(values[outside]).argmax()])
    reaches, many = f"reaches {worst:.5g} {allowed.unit}".rstrip(), "1 sample" if count == 1 else f"{count} samples"
    if count > max(1, FEW * measured) or 2 * count >= measured:
        guess = "degrees, or another unit" if allowed.unit.startswith("rad") else "another unit"
        guess += ", or a mark that should be NaN" if (values[outside] == worst).all() else ""
        text = f"{reaches}, {count} of {measured} samples outside {allowed} ({guess}?)"
        raise InputError(file, key, text, f"{allowed}, but for {FEW:.0%} of the samples")
    return np.where(
        outside, math.nan, values
    ), f"{channel} {reaches}: {many} outside {allowed} taken as missing samples"
