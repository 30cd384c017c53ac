"""Builds the aircraft of a vehicle file: checks it, and scales from the UH-60 where it is silent."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from rotorid_torch.data.plausible import check_inertia
from rotorid_torch.errors import InputError
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES, Aircraft
from rotorid_torch.simulation.helicopter.rotor import LOCK_SLOPE
from rotorid_torch.simulation.vehicles.vehicle_file import REFERENCE, ControlTable, read_vehicle


def load_aircraft(path: Path | None = None) -> Aircraft:
    """Aircraft of a vehicle file; without one the UH-60.

    Raises InputError: the file cannot be read, has an unknown key, or declares what no helicopter can be.
    """
    reference = read_vehicle(REFERENCE)
    if path is None:
        return _build(_values(reference), "uh60.toml", reference.name)
    declared = read_vehicle(path)
    _check_numbers(_values(declared), path)
    values = _complete(_values(declared), _values(reference), declared)
    _check(values, path)
    return _build(values, str(path), declared.name)


Values = dict[str, dict[str, Any]]


def _values(file: Any) -> Values:
    """Tables as plain dictionaries, silent keys left out."""
    tables: dict[str, Any] = {name: getattr(file, name) for name in SCALES if name != "rotor"}
    tables["rotor"] = file.vehicle.rotor
    values = {
        name: {key: value for key, value in msgspec.structs.asdict(table).items() if value is not None}
        for name, table in tables.items()
    }
    values["vehicle"].pop("rotor")
    clockwise = file.vehicle.rotor.direction == "cw"
    limits = {name: _limits(name, table, clockwise) for name, table in file.controls.items()}
    values["limits"] = {name: pair for name, pair in limits.items() if pair is not None}
    return values


def _limits(name: str, table: ControlTable, clockwise: bool) -> tuple[float, float] | None:
    """Limits of a blade angle in our signs (nose up, left side down, climb, nose left); None for a stick."""
    if table.unit != "rad" or table.limits is None:
        return None
    low, high = table.limits
    turned = {"lon": "nose down", "lat": "right side down", "ped": "nose right"}
    if clockwise:
        turned |= {"lat": "left side down", "ped": "nose left"}
    return (-high, -low) if table.positive == turned.get(name) else (low, high)


# How a value grows with the size of the aircraft: exponents of radius and of mass.
SCALES: dict[str, dict[str, tuple[float, float]]] = {
    "vehicle": {"mass": (3, 0), "inertia": (2, 1), "hub": (1, 0)},
    "rotor": {"radius": (1, 0), "chord": (-1, 1), "speed": (-1, 0), "hinge_offset": (1, 0)},
    "blade": {
        "mass": (0, 1),
        "first_moment": (1, 1),
        "flap_inertia": (2, 1),
        "flap_spring": (0, 1),
        "lag_spring": (0, 1),
        "lag_damper": (1, 1),
    },
    "tail_rotor": {"position": (1, 0), "radius": (1, 0), "chord": (-1, 1)},
    "fuselage": {
        "position": (1, 0),
        "drag_area": (2, 0),
        "lift_area": (2, 0),
        "pitch_volume": (3, 0),
        "yaw_volume": (3, 0),
    },
    "fin": {"position": (1, 0), "area": (2, 0)},
    "tailplane": {"position": (1, 0), "area": (2, 0)},
    "governor": {"proportional": (1, 1), "integral": (1, 1), "derivative": (2, 1), "inertia": (2, 1)},
    "actuators": {},
}


def _complete(declared: Values, reference: Values, file: Any) -> Values:
    """What the file declares, and for the rest the UH-60 scaled by radius and mass, blades by Lock number and count."""
    base = reference["vehicle"]["mass"], reference["rotor"]["radius"]
    radius = declared["rotor"].get("radius")
    mass = declared["vehicle"].get("mass")
    if radius is None:
        radius = base[1] if mass is None else base[1] * (mass / base[0]) ** (1.0 / 3.0)
    length = radius / base[1]
    weight = (base[0] * length**3 if mass is None else mass) / base[0]
    full: Values = {"limits": dict(reference["limits"]) | declared["limits"]}
    for table, powers in SCALES.items():
        full[table] = dict(reference[table])
        for key, (by_length, by_mass) in powers.items():
            factor = length**by_length * weight**by_mass
            full[table][key] = (np.asarray(reference[table][key], dtype=float) * factor).tolist()
        full[table] |= declared[table]
    if file.vehicle.mass is not None or file.vehicle.inertia is not None:
        full["vehicle"]["mass_excludes"] = list(file.vehicle.mass_excludes)
    _scale_blades(full, declared, reference)
    return full


def _scale_blades(full: Values, declared: Values, reference: Values) -> None:
    """Blade number shares chord and mass out; a declared Lock number sets the blades' inertia and what follows."""
    rotor, blade = full["rotor"], full["blade"]
    share = reference["rotor"]["blades"] / max(rotor["blades"], 1)
    if "chord" not in declared["rotor"]:
        rotor["chord"] *= share
    inertia = blade["flap_inertia"] * share
    if "lock_number" in declared["rotor"]:
        air = full["vehicle"]["air_density"] * LOCK_SLOPE * rotor["chord"] * rotor["radius"] ** 4
        inertia = air / rotor["lock_number"]
    factor = inertia / blade["flap_inertia"]
    for key in ("mass", "first_moment", "flap_inertia", "lag_spring", "lag_damper"):
        if key not in declared["blade"]:
            blade[key] *= factor


def _check_numbers(values: Values, path: Path) -> None:
    """Refuse what is not finite, and what must be positive and is not."""
    for table, entries in values.items():
        for key, value in entries.items():
            place = f"{PLACES.get(table, table)}.{key}"
            numeric = not isinstance(value, str) and key != "mass_excludes"
            if numeric and not np.isfinite(np.asarray(value, dtype=float)).all():
                raise InputError(path, place, "is not finite", "numbers")
            if key in POSITIVE and np.any(np.asarray(value, dtype=float) <= 0.0):
                raise InputError(path, place, f"is {value}", "a positive number")


def _check(values: Values, path: Path) -> None:
    """Refuse what no helicopter can be."""
    _check_numbers(values, path)
    vehicle, rotor, blade = values["vehicle"], values["rotor"], values["blade"]
    if rotor["blades"] < 2:
        raise InputError(path, "vehicle.rotor.blades", f"is {rotor['blades']}", "two blades or more")
    if not 0.0 <= rotor["hinge_offset"] < 0.4 * rotor["radius"]:
        raise InputError(path, "vehicle.rotor.hinge_offset", f"is {rotor['hinge_offset']} m", "0 to 0.4 of the radius")
    if blade["mass"] * blade["flap_inertia"] <= blade["first_moment"] ** 2:
        wrong = "blade mass x flap inertia is not above the first moment's square"
        raise InputError(path, "blade.first_moment", wrong, "a blade that can exist")
    for name, pair in values["limits"].items():
        if not pair[0] < pair[1]:
            raise InputError(path, f"controls.{name}.limits", f"are {list(pair)}", "two numbers, the lower one first")
    check_inertia(np.asarray(vehicle["inertia"], dtype=float), path)


POSITIVE = (
    *("mass", "air_density", "gravity", "radius", "chord", "speed", "lock_number", "flap_inertia", "first_moment"),
    *("lift_slope", "gear", "lag", "proportional", "integral", "area", "tip_loss"),
)
PLACES = {"rotor": "vehicle.rotor", "limits": "controls"}


def _build(values: Values, file: str, name: str) -> Aircraft:
    """Aircraft from complete values; blades taken out of mass, inertia and centre of gravity where they are in."""
    vehicle, rotor, blade = values["vehicle"], values["rotor"], values["blade"]
    clockwise = rotor["direction"] == "cw"
    mirror = np.array([1.0, -1.0 if clockwise else 1.0, 1.0])
    mass, shift, inertia = _without_blades(values, file)

    def place(position: Any) -> list[float]:
        return ((np.asarray(position, dtype=float) - shift) * mirror).tolist()

    def placed(table: Values | dict[str, Any]) -> dict[str, Any]:
        return table | {"position": place(table["position"])}

    def surface(table: dict[str, Any], upright: bool) -> dict[str, Any]:
        lift = {"lift_slope": table["lift_slope"], "stall": table["stall"], "drag": 0.015, "drag_rise": 0.5}
        return placed(table) | {"section": lift, "upright": upright}

    section = {key: blade[key] for key in ("lift_slope", "stall", "drag", "drag_rise")}
    parts = {
        "name": name,
        "mass": mass,
        "inertia": (inertia * np.outer(mirror, mirror)).tolist(),
        "gravity": vehicle["gravity"],
        "air_density": vehicle["air_density"],
        "imu": place(vehicle["imu"]),
        "rotor": blade
        | rotor
        | {"hub": place(vehicle["hub"]), "tilt": blade["shaft_tilt"], "blade_mass": blade["mass"], "section": section},
        "tail": placed(values["tail_rotor"]),
        "fuselage": placed(values["fuselage"]),
        "fin": surface(values["fin"], True),
        "tailplane": surface(values["tailplane"], False),
        "governor": values["governor"] | {"held": True},
        "limits": [values["limits"][control] for control in CONTROL_NAMES],
        "actuator_lag": values["actuators"]["lag"],
        "clockwise": clockwise,
    }
    return msgspec.convert(parts, Aircraft)


def _without_blades(values: Values, file: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass of the body, its centre of gravity from the declared one, its inertia about that; blades sit at the hub."""
    vehicle = values["vehicle"]
    mass, inertia = float(vehicle["mass"]), np.asarray(vehicle["inertia"], dtype=float)
    if "blades" in vehicle["mass_excludes"]:
        return mass, np.zeros(3), inertia
    blades = values["rotor"]["blades"] * values["blade"]["mass"]
    body, hub = mass - blades, np.asarray(vehicle["hub"], dtype=float)
    if body <= 0.5 * mass:
        raise InputError(
            file, "vehicle.mass", f"is {mass} kg with blades of {blades:.0f} kg", "more than twice the blades"
        )
    shift = -blades / body * hub

    def point(m: float, r: np.ndarray) -> np.ndarray:
        return m * (r @ r * np.eye(3) - np.outer(r, r))

    inertia = inertia - point(blades, hub) - point(body, shift)
    check_inertia(inertia, file)
    return body, shift, inertia
