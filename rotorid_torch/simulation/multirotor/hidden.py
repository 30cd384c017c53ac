"""Every effect that a multirotor can hide: how it changes the vehicle, at a factor of its typical size.

An effect of size zero leaves the vehicle as it is. What a clean vehicle is and what each effect makes of it stands in
docs/flight-test.md. `of_size` gives a vehicle effects of the sizes that a model of it has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from rotorid_torch.simulation.changes import Hidden, Sized, more_inertia, raised, sensor_error
from rotorid_torch.simulation.helicopter.sensor_errors import GYROS
from rotorid_torch.simulation.helicopter.slung_load import SlungLoad
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.multirotor.flight import Fleet
from rotorid_torch.simulation.multirotor.rotor import Flow, lift_for
from rotorid_torch.simulation.rigid import three

LAG, DELAY = 0.05, 0.03
"""s: of motors, of commands."""
WIND, GUSTS = 1.0, 0.25
"""Wind and standard deviation of gusts over the vehicle's own speed."""
WEAK = 0.1
"""Share of its thrust that one rotor lacks."""
LOADED, HEAVIER, AHEAD, ROPE = 0.12, 0.25, 0.06, 5.0
"""Payload over mass; share of inertia; centre of gravity and rope over the arm."""
TILT = 0.035
"""rad: of a turned sensor."""
ROTOR = 0.004
"""Inertia of a rotor about its axis over mass and the square of its radius."""
DISC = 3.0
"""Drag in the discs over that of blade elements, which give small vehicles a third of the 0.4 1/s that are measured."""
DRAG = 0.02
"""1/m: what the body's drag decelerates by at 1 m/s."""


def _rotor_inertia(craft: Multirotor, size: float) -> Multirotor:
    """Rotors and bells whose angular momentum the body feels, and which therefore take their time."""
    if not size:
        return craft
    inertia = craft.drive.inertia + size * ROTOR * craft.mass * craft.propeller.radius**2 * 4.0 / craft.count
    return replace(craft, drive=replace(craft.drive, inertia=inertia, lag=max(craft.drive.lag, LAG)))


def _unequal(craft: Multirotor, size: float) -> Multirotor:
    """The second rotor gives less: a cut propeller."""
    if not size:
        return craft
    weak = lift_for(craft.propeller, craft.air_density, 1.0 - WEAK * size)
    lifts = tuple(lift * weak if k == 1 else lift for k, lift in enumerate(craft.lifts))
    return replace(craft, lifts=lifts)


def _felt(craft: Multirotor) -> Multirotor:
    """A vehicle that feels the air that it flies through, as all of them do."""
    shares = {"axial": 1.0, "lift": 1.0, "drag": DISC, "flap": 1.0}
    felt = {name: max(getattr(craft.air, name), share) for name, share in shares.items()}
    return replace(craft, air=replace(craft.air, **felt))


def _drag(craft: Multirotor, size: float) -> Multirotor:
    """A body that the air holds: more from the side, most from below."""
    area = 2.0 * DRAG * size * craft.mass / craft.air_density * np.array([1.0, 1.2, 1.6])
    total = np.asarray(craft.air.drag_area) + area
    return replace(craft, air=replace(craft.air, drag_area=three(total)))


def _wind(craft: Multirotor, size: float) -> Multirotor:
    """From 40 degrees, right of a nose that points north, as fast as the vehicle flies."""
    if not size:
        return craft
    speed = WIND * craft.speed * size
    to = -speed * np.array([np.cos(np.deg2rad(40.0)), np.sin(np.deg2rad(40.0)), 0.0])
    felt = _felt(craft)
    return replace(felt, air=replace(felt.air, wind=three(np.asarray(craft.air.wind) + to)))


def _turbulence(craft: Multirotor, size: float) -> Multirotor:
    """Gusts in each direction."""
    felt = _felt(craft) if size else craft
    return replace(felt, air=replace(felt.air, gusts=craft.air.gusts + GUSTS * craft.speed * size))


def _payload(craft: Multirotor, size: float) -> Multirotor:
    """A box at the centre of gravity."""
    return replace(craft, mass=craft.mass * (1.0 + LOADED * size))


def _cg(craft: Multirotor, size: float) -> Multirotor:
    """Centre of gravity forward of the declared one, and a third of that to the right."""
    shift = AHEAD * size * _arm(craft) * np.array([1.0, 1.0 / 3.0, 0.0])
    load = craft.load and replace(craft.load, hook=three(np.asarray(craft.load.hook) - shift))
    places = tuple(three(np.asarray(place) - shift) for place in craft.places)
    imu, reference = (three(np.asarray(point) - shift) for point in (craft.imu, craft.reference))
    return replace(craft, places=places, imu=imu, reference=reference, load=load)


def _slung_load(craft: Multirotor, size: float) -> Multirotor:
    """A weight on a rope below the declared centre of gravity."""
    arm = _arm(craft)
    return _hung(craft, {"ratio": LOADED * size, "length": ROPE * arm, "damping": 0.05, "hook": 0.1 * arm})


def _hung(craft: Multirotor, values: Mapping[str, float]) -> Multirotor:
    """A weight on a rope by its share of the mass; without a hook in its moments, at a usual one."""
    mass = values["ratio"] * craft.mass
    if not mass:
        return craft
    hook = three(np.asarray(craft.reference) + np.array([0.0, 0.0, values.get("hook", 0.1 * _arm(craft))]))
    load = SlungLoad(mass, values["length"], hook, drag_area=0.01 * mass / craft.air_density, damping=values["damping"])
    return replace(craft, load=load)


def _lever_arm(craft: Multirotor, size: float) -> Multirotor:
    """An IMU that is not where it is declared to be."""
    arm = three(np.array([0.3, 0.15, -0.2]) * _arm(craft))
    return sensor_error("lever_arm", arm)(craft, size)


def _arm(craft: Multirotor) -> float:
    """Radius of the circle of the rotors, m."""
    return float(np.hypot(*np.subtract(craft.places[0], craft.reference)[:2]))


def felt_per_speed(craft: Multirotor) -> tuple[float, float, float]:
    """Deceleration across and along the rotors' axes, 1/s, and pitch by flapping, rad/(s m), by 1 m/s in hover.

    By blade elements with all shares at 1: `propulsion.rotor_drag`, `propulsion.axial_inflow` and
    `propulsion.flapping` in numbers.
    """
    fleet = Fleet.of([craft], [craft])
    hover, blades, spins = fleet.hover, fleet.blades, np.array(craft.spins, dtype=np.float64)[:, None]
    strength, calm = np.array(craft.lifts)[:, None], np.zeros_like(hover.speed)
    ahead = Flow(calm, calm, np.stack([calm + 1.0, calm]))
    loads = blades.loads(hover.speed, hover.induced, ahead, strength, spins)
    drag, pitch = -float(loads.across[0].sum()) / craft.mass, float(loads.hub[1].sum() / craft.inertia_matrix[1, 1])
    thrusts = []
    for climb in (-0.5, 0.5):
        flow, induced = Flow(calm + climb, calm, np.stack([calm, calm])), hover.induced
        for _ in range(200):
            induced = blades.inflow_step(hover.speed, induced, flow, strength, 0.01)
        thrusts.append(float(blades.loads(hover.speed, induced, flow, strength, spins).thrust.sum()))
    return drag, (thrusts[0] - thrusts[1]) / craft.mass, pitch


def _driven(**changes: Callable[[Multirotor, Mapping[str, float]], float]) -> Sized:
    """Numbers of the drive by the parameters."""

    def change(craft: Multirotor, values: Mapping[str, float]) -> Multirotor:
        return replace(craft, drive=replace(craft.drive, **{n: of(craft, values) for n, of in changes.items()}))

    return change


def _inertia_of(craft: Multirotor, values: Mapping[str, float]) -> float:
    """Of a rotor, kg m^2: N is the yaw rate by the sum of spin times speed, or times command."""
    speed = float(Fleet.of([craft], [craft]).hover.speed.mean())
    by_command = 1.0 if craft.telemetry else speed * craft.drive.exponent / craft.drive.command_at(speed)
    return values["N"] * float(craft.inertia_matrix[2, 2]) / by_command


def _dragged(craft: Multirotor, values: Mapping[str, float]) -> Multirotor:
    """Discs that the air holds."""
    share = 0.5 * (values["x"] + values["y"]) / felt_per_speed(craft)[0]
    return replace(craft, air=replace(craft.air, drag=share))


def _tilted(craft: Multirotor, values: Mapping[str, float]) -> Multirotor:
    """Discs that the air tilts against their blades' stiffness."""
    return replace(craft, air=replace(craft.air, flap=values["k"] / felt_per_speed(craft)[2]))


def _climbing(craft: Multirotor, values: Mapping[str, float]) -> Multirotor:
    """Thrust that flow through the discs takes, and flow across brings."""
    return replace(craft, air=replace(craft.air, axial=values["z"] / felt_per_speed(craft)[1], lift=1.0))


def _held_by_air(craft: Multirotor, values: Mapping[str, float]) -> Multirotor:
    """A body with an area of drag."""
    area = 2.0 * craft.mass / craft.air_density * np.array([values[axis] for axis in "xyz"])
    return replace(craft, air=replace(craft.air, drag_area=three(area)))


def _blown(craft: Multirotor, values: Mapping[str, float]) -> Multirotor:
    """Air that moves; the vehicle feels of it what other effects let it feel."""
    return replace(craft, air=replace(craft.air, wind=(values["north"], values["east"], 0.0)))


def _unlike(craft: Multirotor, values: Mapping[str, float]) -> Multirotor:
    """Rotors that each lack a share of their thrust."""
    weak = [lift_for(craft.propeller, craft.air_density, 1.0 - less) for less in values.values()]
    return replace(craft, lifts=tuple(lift * one for lift, one in zip(craft.lifts, weak, strict=True)))


FELT = ("propulsion.rotor_drag", "propulsion.flapping", "propulsion.axial_inflow", "forces.translational_lift")
"""What a vehicle that feels the air has."""

HIDDEN: dict[str, Hidden] = {
    "propulsion.motor_lag": Hidden(
        raised("drive", lag=LAG),
        sized=_driven(lag=lambda craft, values: values["tau"], braking=lambda craft, values: 1.0),
    ),
    "propulsion.voltage": Hidden(
        raised("drive", voltage_power=1.0),
        sized=_driven(voltage_power=lambda craft, values: values["exponent"] * craft.drive.exponent),
    ),
    "propulsion.rotor_inertia": Hidden(
        _rotor_inertia, brings=("propulsion.motor_lag",), sized=_driven(inertia=_inertia_of)
    ),
    "propulsion.rotor_drag": Hidden(
        raised("air", drag=DISC, flap=1.0), brings=("propulsion.flapping",), sized=_dragged
    ),
    "propulsion.flapping": Hidden(raised("air", flap=1.0), flights="speeds", sized=_tilted),
    "propulsion.axial_inflow": Hidden(raised("air", axial=1.0, lift=1.0), sized=_climbing),
    "propulsion.unequal": Hidden(_unequal, sized=_unlike),
    "control.delay": Hidden(raised("drive", delay=DELAY), sized=_driven(delay=lambda craft, values: values["common"])),
    "forces.drag": Hidden(_drag, flights="speeds", sized=_held_by_air),
    "forces.translational_lift": Hidden(raised("air", lift=1.0), flights="speeds"),
    "environment.ground": Hidden(raised("air", ground=1.0), flights="heights"),
    "environment.wind": Hidden(_wind, flights="headings", brings=FELT, sized=_blown),
    "environment.turbulence": Hidden(_turbulence, brings=FELT),
    "mass.payload": Hidden(_payload),
    "mass.cg": Hidden(_cg),
    "mass.inertia": Hidden(more_inertia(HEAVIER)),
    "mass.slung_load": Hidden(_slung_load, sized=_hung),
    "sensors.bias": Hidden(sensor_error("bias", {"p": 0.02, "q": -0.014, "r": 0.01})),
    "sensors.scale": Hidden(sensor_error("scale", dict.fromkeys(GYROS, 0.05))),
    "sensors.misalignment": Hidden(sensor_error("rotation", (TILT / 3, 2 * TILT / 3, 2 * TILT / 3))),
    "sensors.lever_arm": Hidden(_lever_arm),
    "sensors.delay": Hidden(sensor_error("delay", dict.fromkeys(GYROS, 0.03))),
    "sensors.filter": Hidden(sensor_error("lag", dict.fromkeys(GYROS, 0.03))),
}
"""Physics that can be switched on, by id."""


def of_size(craft: Multirotor, effect: str, values: Mapping[str, float]) -> Multirotor:
    """The vehicle with an effect as large as the library's parameters say, by name, SI.

    Where only the typical size is at hand, with that; an effect that no multirotor can hide leaves it as it is.
    """
    hidden = HIDDEN.get(effect)
    if hidden is None:
        return craft
    return hidden.change(craft, 1.0) if hidden.sized is None else hidden.sized(craft, values)
