"""Every effect that a helicopter can hide: what it changes, at a factor of its typical size.

An effect of size zero leaves the aircraft as it is. What a clean aircraft is, what each effect makes of it and why it
can be told apart or not stands in docs/flight-test.md.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from rotorid_torch.simulation.changes import Change, Hidden, more_inertia, raised, sensor_error
from rotorid_torch.simulation.helicopter.aircraft import Aircraft
from rotorid_torch.simulation.helicopter.atmosphere import Turbulence
from rotorid_torch.simulation.helicopter.control_path import ControlPath
from rotorid_torch.simulation.helicopter.sensor_errors import GYROS, VibrationLine
from rotorid_torch.simulation.helicopter.slung_load import SlungLoad
from rotorid_torch.simulation.rigid import three


def _rate_limit(aircraft: Aircraft, size: float) -> Aircraft:
    """The larger, the slower."""
    path = replace(aircraft.path or ControlPath(), rate_limit=RATE_LIMIT / size if size else np.inf)
    return replace(aircraft, path=path)


RATE_LIMIT = 0.25  # rad/s


def _flap(aircraft: Aircraft, size: float) -> Aircraft:
    """Springs at the flap hinges: at typical size the blades flap at about 1.06/rev."""
    rotor = aircraft.rotor
    spring = 0.06 * rotor.flap_inertia * rotor.speed**2 * size
    return replace(aircraft, rotor=replace(rotor, flap_spring=rotor.flap_spring + spring))


def _lead_lag(aircraft: Aircraft, size: float) -> Aircraft:
    """Worn lag dampers."""
    rotor = aircraft.rotor
    return replace(aircraft, rotor=replace(rotor, lag_damper=rotor.lag_damper / (1.0 + 2.0 * size)))


def _speed(aircraft: Aircraft, size: float) -> Aircraft:
    """A governor that does not hold: the speed droops in proportion to the size."""
    if not size:
        return aircraft
    g = aircraft.governor
    gains = {name: getattr(g, name) / size for name in ("proportional", "integral", "derivative")}
    return replace(aircraft, governor=replace(g, held=False, **gains))


def _stall(aircraft: Aircraft, size: float) -> Aircraft:
    """Blades whose lift breaks down at a smaller angle of attack (ice, wear)."""
    rotor = aircraft.rotor
    section = replace(rotor.section, stall=rotor.section.stall / (1.0 + 0.6 * size))
    return replace(aircraft, rotor=replace(rotor, section=section))


def _drag(aircraft: Aircraft, size: float) -> Aircraft:
    """Stores in the air stream: drag area by the size of the aircraft, m^2."""
    x, y, z = aircraft.fuselage.drag_area
    areas = (x + 1.5 * size * x, y + 0.2 * size * y, z)
    return replace(aircraft, fuselage=replace(aircraft.fuselage, drag_area=areas))


def _quadratic_damping(aircraft: Aircraft, size: float) -> Aircraft:
    """Plates far out: 1.5 rad/s^2 at 1 rad/s in roll and yaw, 1 in pitch."""
    each = np.diag(aircraft.inertia_matrix) * [1.5, 1.0, 1.5] * size
    return replace(aircraft, quadratic_damping=three(each) if size else aircraft.quadratic_damping)


def _tail_interference(aircraft: Aircraft, size: float) -> Aircraft:
    """A wake that hangs lower at the tail: it blows on tail rotor and tailplane, and turns as it does so."""
    plane = replace(aircraft.tailplane, wake_factor=aircraft.tailplane.wake_factor + 1.2 * size)
    tail = replace(aircraft.tail, wake_factor=aircraft.tail.wake_factor + size)
    return replace(aircraft, tailplane=plane, tail=tail, swirl=aircraft.swirl + 0.5 * size)


def _wind(aircraft: Aircraft, size: float) -> Aircraft:
    """6 m/s from 40 degrees, right of a nose that points north."""
    sense = -1.0 if aircraft.clockwise else 1.0
    to = WIND * size * np.array([-np.cos(np.deg2rad(40.0)), -sense * np.sin(np.deg2rad(40.0)), 0.0])
    return replace(aircraft, wind=three(np.asarray(aircraft.wind or (0.0, 0.0, 0.0)) + to) if size else aircraft.wind)


WIND = 6.0  # m/s


def _turbulence(aircraft: Aircraft, size: float) -> Aircraft:
    """Gusts of 1 m/s in each direction."""
    return replace(aircraft, turbulence=Turbulence(size) if size else aircraft.turbulence)


def _vibration(aircraft: Aircraft, size: float) -> Aircraft:
    """Lines at 1/rev (track and balance) and at N/rev."""
    if not size:
        return aircraft
    once = VibrationLine(1, three(size * np.array([0.12, 0.18, 0.15])), three(size * np.array([0.006, 0.004, 0.003])))
    passing = three(size * np.array([0.35, 0.45, 0.7])), three(size * np.array([0.010, 0.007, 0.006]))
    lines = (*aircraft.sensors.vibration, once, VibrationLine(aircraft.rotor.blades, *passing))
    return replace(aircraft, sensors=replace(aircraft.sensors, vibration=lines))


def all_mass(aircraft: Aircraft) -> float:
    """Mass of body and blades, kg."""
    return aircraft.mass + aircraft.rotor.blades * aircraft.rotor.blade_mass


def _payload(aircraft: Aircraft, size: float) -> Aircraft:
    """8 % more mass at the centre of gravity."""
    return replace(aircraft, mass=aircraft.mass + 0.08 * size * all_mass(aircraft))


def _cg(aircraft: Aircraft, size: float) -> Aircraft:
    """Centre of gravity forward of the declared one by 2 % of the radius, and a quarter of that to the right."""
    shift = np.array([0.02, 0.005, 0.0]) * aircraft.rotor.radius * size

    def moved(part: Any, name: str) -> Any:
        return replace(part, **{name: three(np.asarray(getattr(part, name)) - shift)})

    parts = {name: moved(getattr(aircraft, name), "position") for name in ("tail", "fuselage", "fin", "tailplane")}
    parts["rotor"] = moved(aircraft.rotor, "hub")
    if aircraft.load is not None:
        parts["load"] = moved(aircraft.load, "hook")
    return moved(moved(replace(aircraft, **parts), "imu"), "reference")


def _slung_load(aircraft: Aircraft, size: float) -> Aircraft:
    """8 % of the mass on a cable as long as the rotor's radius, hooked on below the declared centre of gravity."""
    if not size:
        return aircraft
    radius = aircraft.rotor.radius
    hook = three(np.add(aircraft.reference, (0.0, 0.0, 0.15 * radius)))
    load = SlungLoad(0.08 * size * all_mass(aircraft), radius, hook, drag_area=0.02 * radius**2, damping=0.05)
    return replace(aircraft, load=load)


def _low_pass(aircraft: Aircraft, size: float) -> Aircraft:
    """Gyros behind a filter of second order: the larger, the lower its natural frequency."""
    if not size:
        return aircraft
    frequency, damping = LOW_PASS
    low_pass = {**aircraft.sensors.low_pass, **dict.fromkeys(GYROS, (frequency / size, damping))}
    return replace(aircraft, sensors=replace(aircraft.sensors, low_pass=low_pass))


LOW_PASS = (25.0, 0.7)  # rad/s and damping: 56 ms late at low frequencies
TILT = 0.035  # rad: 2 degrees

HIDDEN: dict[str, Hidden] = {
    "control.delay": Hidden(raised("path", ControlPath(), delay=0.06)),
    "control.lag": Hidden(raised("path", ControlPath(), lag=0.08)),
    "control.rate_limit": Hidden(_rate_limit),
    "control.backlash": Hidden(raised("path", ControlPath(), play=0.007)),
    "rotor.inflow": Hidden(raised("wake", apparent_mass=1.0)),
    "rotor.flap_second_order": Hidden(_flap),
    "rotor.lead_lag": Hidden(_lead_lag),
    "rotor.wake_distortion": Hidden(raised("wake", distortion=1.5)),
    "rotor.speed": Hidden(_speed),
    "rotor.stall": Hidden(_stall, "speeds"),
    "forces.drag": Hidden(_drag, "speeds"),
    "forces.quadratic_damping": Hidden(_quadratic_damping),
    "forces.translational_lift": Hidden(raised("wake", translation=0.5), "speeds"),
    "forces.tail_interference": Hidden(_tail_interference, "speeds"),
    "environment.ground": Hidden(raised("wake", ground=1.0), flights="heights"),
    "environment.wind": Hidden(_wind, flights="headings"),
    "environment.turbulence": Hidden(_turbulence),
    "environment.vibration": Hidden(_vibration),
    "mass.payload": Hidden(_payload),
    "mass.cg": Hidden(_cg),
    "mass.inertia": Hidden(more_inertia(0.15)),
    "mass.slung_load": Hidden(_slung_load),
    "sensors.bias": Hidden(sensor_error("bias", {"p": 0.01, "q": -0.007, "r": 0.005})),
    "sensors.scale": Hidden(sensor_error("scale", dict.fromkeys(GYROS, 0.05))),
    "sensors.misalignment": Hidden(sensor_error("rotation", (TILT / 3, 2 * TILT / 3, 2 * TILT / 3))),
    "sensors.lever_arm": Hidden(sensor_error("lever_arm", (0.3, 0.1, -0.25))),
    "sensors.delay": Hidden(sensor_error("delay", dict.fromkeys(GYROS, 0.06))),
    "sensors.filter": Hidden(sensor_error("lag", dict.fromkeys(GYROS, 0.05))),
}
"""Physics that can be switched on, by id."""
FORMS = {"sensors.filter.second_order": "sensors.filter"}
"""Further forms of an effect: name -> the effect."""
EVERY_FORM: dict[str, Change] = {
    **{name: hidden.change for name, hidden in HIDDEN.items()},
    "sensors.filter.second_order": _low_pass,
}
"""All that can be switched on."""


def differences(clean: Any, altered: Any, place: str = "") -> dict[str, tuple[Any, Any]]:
    """What an effect changed: value before and after by its place in the aircraft, such as `fuselage.drag_area`."""
    changed: dict[str, tuple[Any, Any]] = {}
    for one in dataclasses.fields(clean):
        before, after, name = getattr(clean, one.name), getattr(altered, one.name), place + one.name
        if dataclasses.is_dataclass(before) and dataclasses.is_dataclass(after):
            changed |= differences(before, after, f"{name}.")
        elif before != after:
            changed[name] = _plain(before), _plain(after)
    return changed


def _plain(value: Any) -> Any:
    """Numbers and containers of them, as JSON has them; a limit that does not exist is null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain({one.name: getattr(value, one.name) for one in dataclasses.fields(value)})
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
