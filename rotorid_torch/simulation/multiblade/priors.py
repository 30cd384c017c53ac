"""What is drawn: every number of a helicopter, its usual value scaled from the UH-60, and its spread.

What a data set declares is drawn within what such declarations are usually wrong by: mass 1 % (weighing, fuel burnt),
inertia 3 % (swung or summed up from drawings), places 2 cm (where the centre of gravity is), rotor geometry less. What
it does not declare is drawn as widely as helicopters of one size differ: the radius goes with the cube root of the
mass, the moments of inertia with the mass times the square of the radius.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from rotorid_torch.data.schema import Rotor, Vehicle
from rotorid_torch.simulation.helicopter.aircraft import Aircraft
from rotorid_torch.simulation.helicopter.rotor import LOCK_SLOPE
from rotorid_torch.simulation.multiblade.craft import Craft
from rotorid_torch.simulation.rigid import Array
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft

MASS_ERROR, INERTIA_ERROR, PLACE_ERROR, GEOMETRY_ERROR, LOCK_ERROR = 0.01, 0.03, 0.02, 0.003, 0.02
RADIUS_SPREAD, INERTIA_SPREAD = 0.12, 0.3
"""Undeclared: of R/m^(1/3) over UH-60, UH-1H, OH-6A, Bo 105 and AH-1 (0.38 to 0.51 m/kg^(1/3)); of I/(m R^2)."""


@dataclass(frozen=True)
class Number:
    """A drawn number: usual value, standard deviation, and whether that is a share of it (log-normal)."""

    value: float
    spread: float
    share: bool = True

    def at(self, normal: Array) -> Array:
        """Values for standard normal deviates."""
        return self.value * np.exp(self.spread * normal) if self.share else self.value + self.spread * normal


@cache
def reference() -> Aircraft:
    """The UH-60 that is scaled."""
    return load_aircraft()


def numbers(vehicle: Vehicle, speed: float) -> dict[str, Number]:
    """All drawn numbers of helicopters such as this one.

    vehicle : a rotor that turns counter-clockwise (mirrored before, if need be).
    speed : of the trimmed flight, m/s.
    """
    base = reference()
    mass, radius = _size(vehicle, base)
    length, weight = radius.value / base.rotor.radius, mass.value / base.mass
    return {
        "mass": mass,
        "radius": radius,
        "density": Number(vehicle.air_density, 0.002),
        **_inertia(vehicle, base, weight * length**2),
        **_places(vehicle, base, length),
        **_rotor(vehicle, base, length, weight),
        **_tail(base, length, weight),
        **_airframe(base, length, speed),
        **_drive(base, length, weight),
    }


def _size(vehicle: Vehicle, base: Aircraft) -> tuple[Number, Number]:
    """Mass and radius of the main rotor; the UH-60's where neither is declared."""
    mass, radius = vehicle.mass, None if vehicle.rotor is None else vehicle.rotor.radius
    usual_mass = base.mass if radius is None else base.mass * (radius / base.rotor.radius) ** 3
    usual_radius = base.rotor.radius if mass is None else base.rotor.radius * (mass / base.mass) ** (1.0 / 3.0)
    return (
        Number(usual_mass, 3.0 * RADIUS_SPREAD) if mass is None else Number(mass, MASS_ERROR),
        Number(usual_radius, RADIUS_SPREAD) if radius is None else Number(radius, GEOMETRY_ERROR),
    )


def _inertia(vehicle: Vehicle, base: Aircraft, scale: float) -> dict[str, Number]:
    """Moments by their shares, products by shares of the moments around them; the UH-60's to scale if undeclared."""
    tensor = scale * base.inertia_matrix if vehicle.inertia is None else np.asarray(vehicle.inertia, dtype=np.float64)
    error = INERTIA_SPREAD if vehicle.inertia is None else INERTIA_ERROR
    out = {f"inertia{k}{k}": Number(float(tensor[k, k]), error) for k in range(3)}
    for a, b in ((0, 1), (0, 2), (1, 2)):
        declared = tensor[a, b] != 0.0 or (a, b) == (0, 2)
        spread = error * float(np.sqrt(tensor[a, a] * tensor[b, b])) if declared else 0.0
        out[f"inertia{a}{b}"] = Number(float(tensor[a, b]), spread, False)
    return out


def _places(vehicle: Vehicle, base: Aircraft, length: float) -> dict[str, Number]:
    """Hub and IMU."""
    out: dict[str, Number] = {}
    hub = vehicle.hub or tuple(length * part for part in base.rotor.hub)
    imu = vehicle.imu or (0.0, 0.0, 0.0)
    for k, wide in enumerate((0.02, 0.002, 0.03)):
        spread = PLACE_ERROR if vehicle.hub is not None else max(wide * length * base.rotor.radius, PLACE_ERROR)
        out[f"hub{k}"] = Number(float(hub[k]), spread, False)
        out[f"imu{k}"] = Number(float(imu[k]), PLACE_ERROR if vehicle.imu is not None else 0.1, False)
    return out


def _rotor(vehicle: Vehicle, base: Aircraft, length: float, weight: float) -> dict[str, Number]:
    """Main rotor and its inflow."""
    rotor, usual_rotor = vehicle.rotor or Rotor(), base.rotor
    blades, reach = rotor.blades or usual_rotor.blades, usual_rotor.radius - usual_rotor.hinge_offset
    chord = usual_rotor.chord * usual_rotor.blades / blades * weight / length
    lock = LOCK_SLOPE * base.air_density * usual_rotor.chord * usual_rotor.radius**4 / usual_rotor.flap_inertia

    def declared_or(declared: float | None, error: float, usual: float, wide: float) -> Number:
        return Number(usual, wide) if declared is None else Number(declared, error)

    return {
        "chord": declared_or(rotor.chord, GEOMETRY_ERROR, chord, 0.1),
        "speed": declared_or(rotor.speed, 0.001, usual_rotor.speed / length, 0.03),
        "hinge_offset": declared_or(rotor.hinge_offset or None, 0.02, usual_rotor.hinge_offset * length, 0.3),
        "lock": declared_or(rotor.lock_number, LOCK_ERROR, lock, 0.2),
        "slenderness": Number(usual_rotor.flap_inertia / (usual_rotor.first_moment * reach), 0.03),
        "solidness": Number(usual_rotor.flap_inertia / (usual_rotor.blade_mass * reach**2), 0.06),
        "flap_stiffness": Number(0.0, 0.002 if rotor.hinge_offset else 0.02, False),
        "lag_stiffness": Number(usual_rotor.lag_spring / (usual_rotor.flap_inertia * usual_rotor.speed**2), 0.5),
        "lag_damping": Number(usual_rotor.lag_damper / (usual_rotor.flap_inertia * usual_rotor.speed), 0.5),
        "tilt": Number(usual_rotor.tilt, 0.02, False),
        "swash_phase": Number(-0.07, 0.1, False),
        "delta3": Number(0.0, 0.05, False),
        "twist": Number(usual_rotor.twist, 0.05, False),
        "root_cutout": Number(usual_rotor.root_cutout, 0.1),
        "tip_loss": Number(0.975, 0.008),
        "lift_slope": Number(0.97 * usual_rotor.section.lift_slope, 0.05),
        "drag": Number(usual_rotor.section.drag, 0.2),
        "drag_rise": Number(usual_rotor.section.drag_rise, 0.3),
        "inflow_gain0": Number(1.0, 0.07),
        "inflow_gain1": Number(1.0, 0.2),
        "inflow_speed0": Number(1.0, 0.2),
        "inflow_speed1": Number(1.0, 0.2),
    }


def _tail(base: Aircraft, length: float, weight: float) -> dict[str, Number]:
    """Tail rotor."""
    tail = base.tail
    return {
        "tail_position0": Number(tail.position[0] * length, 0.05),
        "tail_position1": Number(0.0, 0.03 * length, False),
        "tail_position2": Number(tail.position[2] * length, 0.4 * length, False),
        "tail_radius": Number(tail.radius * length, 0.07),
        "tail_solidity": Number(tail.solidity * weight / length**2, 0.12),
        "tail_gear": Number(tail.gear, 0.05),
        "tail_cant": Number(0.2, 0.15, False),
        "tail_twist": Number(tail.twist, 0.08, False),
        "tail_delta3": Number(float(np.tan(tail.delta3)), 0.15, False),
        "tail_lift_slope": Number(tail.lift_slope, 0.05),
        "tail_lock": Number(tail.lock_number, 0.2),
        "tail_tip_loss": Number(tail.tip_loss, 0.02),
        "tail_blockage": Number(tail.fin_blockage, 0.06),
    }


def _airframe(base: Aircraft, length: float, speed: float) -> dict[str, Number]:
    """Fuselage, fin, tailplane: areas with the square of the length, volumes with its cube."""
    body, fin, plane = base.fuselage, base.fin, base.tailplane
    area, volume = length**2, length**3
    blend = 0.5 * (1.0 + np.tanh((speed - plane.schedule) / plane.schedule_width))
    travel = plane.incidence[1] - plane.incidence[0]
    incidence = plane.incidence[0] + blend * travel
    schedule = 2.0 * blend * (1.0 - blend) * travel / plane.schedule_width
    out = {
        "fuselage_position0": Number(body.position[0] * length, 0.2 * length, False),
        "fuselage_position1": Number(0.0, 0.0, False),
        "fuselage_position2": Number(body.position[2] * length, 0.2 * length, False),
        "fuselage_drag0": Number(body.drag_area[0] * area, 0.3),
        "fuselage_drag1": Number(body.drag_area[1] * area, 0.4),
        "fuselage_drag2": Number(body.drag_area[2] * area, 0.4),
        "fuselage_lift0": Number(body.lift_area[0] * area, 0.4),
        "fuselage_lift1": Number(body.lift_area[1] * area, 0.4),
        "fuselage_pitch": Number(body.pitch_volume * volume, 0.4),
        "fuselage_yaw": Number(body.yaw_volume * volume, 0.4),
        "fuselage_wake": Number(body.wake_factor, 0.25),
        "fin_area": Number(fin.area * fin.shading * area, 0.3),
        "fin_lift_slope": Number(fin.section.lift_slope, 0.1),
        "plane_area": Number(plane.area * plane.shading * area, 0.3),
        "plane_lift_slope": Number(plane.section.lift_slope, 0.1),
        "plane_incidence": Number(float(incidence), 0.08 + 0.15 * float(1.0 - blend), False),
        "plane_schedule": Number(float(schedule), 0.5 * abs(float(schedule)) + 0.001, False),
        "plane_speed": Number(speed, 0.0, False),
        "plane_wake": Number(plane.wake_factor, 0.3),
    }
    for name, place in (("fin", fin.position), ("plane", plane.position)):
        out[f"{name}_position0"] = Number(place[0] * length, 0.06)
        out[f"{name}_position1"] = Number(0.0, 0.0, False)
        out[f"{name}_position2"] = Number(place[2] * length, 0.25 * length, False)
    return out


def _drive(base: Aircraft, length: float, weight: float) -> dict[str, Number]:
    """Governor and engine."""
    governor = base.governor
    return {
        "governor_proportional": Number(governor.proportional * length * weight, 0.4),
        "governor_integral": Number(governor.integral * length * weight, 0.4),
        "governor_derivative": Number(governor.derivative * length**2 * weight, 0.4),
        "governor_lag": Number(governor.lag, 0.4),
        "drive_inertia": Number(governor.inertia * length**2 * weight, 0.4),
    }


Kinds = NDArray[np.bool_]
"""Which rotor each aircraft of a batch has, [aircraft, 3]: quasi-steady flapping (no lag then), blades that do not lag,
inflow without gradients."""
KINDS: Kinds = np.array([(False, False, False), (False, True, False), (True, True, False), (True, True, True)])
"""Flap and lag; flap alone; quasi-steady flapping, in a dynamic inflow and in a uniform one."""


def build(values: Mapping[str, Array], kind: Kinds, vehicle: Vehicle, held: bool, relaxation: float) -> Craft:
    """Batch of helicopters of drawn values, each [aircraft]."""
    one = {name: value[:, None] for name, value in values.items()}

    def three(name: str) -> Array:
        return np.stack([one[f"{name}{k}"] for k in range(3)])

    tensor = np.stack([np.stack([one[f"inertia{min(a, b)}{max(a, b)}"] for b in range(3)]) for a in range(3)])
    reach = one["radius"] - one["hinge_offset"]
    inertia = LOCK_SLOPE * one["density"] * one["chord"] * one["radius"] ** 4 / one["lock"]
    stiffness = inertia * one["speed"] ** 2
    uniform = np.where(kind[:, 2:], 0.0, 1.0)
    full: dict[str, Array] = {
        "inertia": tensor,
        "hub": three("hub"),
        "imu": three("imu"),
        "flap_inertia": inertia,
        "first_moment": inertia / (one["slenderness"] * reach),
        "blade_mass": inertia / (one["solidness"] * reach**2),
        "flap_spring": one["flap_stiffness"] * stiffness,
        "lag_spring": one["lag_stiffness"] * stiffness,
        "lag_damper": one["lag_damping"] * inertia * one["speed"],
        "inflow_gain": np.stack([one["inflow_gain0"], one["inflow_gain1"]]),
        "inflow_speed": np.stack([one["inflow_speed0"], one["inflow_speed1"] * uniform]),
        **{name: three(name) for name in ("tail_position", "fuselage_position", "fin_position", "plane_position")},
        "fuselage_drag": three("fuselage_drag"),
        "fuselage_lift": np.stack([one["fuselage_lift0"], one["fuselage_lift1"]]),
    }
    full |= {name: value for name, value in one.items() if name in Craft.__dataclass_fields__}
    rotor = vehicle.rotor
    return Craft(
        blades=(rotor.blades if rotor is not None and rotor.blades else reference().rotor.blades),
        with_blades="blades" not in vehicle.mass_excludes,
        held=held,
        relaxation=relaxation,
        gravity=vehicle.gravity,
        steady_flap=kind[:, 0],
        stiff_lag=kind[:, 1],
        **full,
    )
