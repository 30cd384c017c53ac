"""Vehicle files: what they may say, how they are checked, and what is scaled from the UH-60 where they are silent.

A vehicle file has the tables [vehicle], [vehicle.rotor] and [controls.*] of a data set's dataset.toml, and optionally
[blade], [tail_rotor], [fuselage], [fin], [tailplane], [governor], [actuators] with the keys of vehicles/uh60.toml.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.fly.aircraft import CONTROL_NAMES, Aircraft, Governor
from rotorid_torch.fly.airframe import Fuselage, Surface
from rotorid_torch.fly.rotor import Rotor
from rotorid_torch.fly.section import Section
from rotorid_torch.fly.tail import TailRotor

Triple = tuple[float, float, float]


class _Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A table of a vehicle file; a key that it does not know is an error."""


class RotorTable(_Table):
    """[vehicle.rotor], as in a data set."""

    blades: int | None = None
    radius: float | None = None
    chord: float | None = None
    speed: float | None = None
    direction: Literal["ccw", "cw"] = "ccw"
    hinge_offset: float | None = None
    lock_number: float | None = None


class VehicleTable(_Table):
    """[vehicle], as in a data set."""

    mass: float | None = None
    inertia: tuple[Triple, Triple, Triple] | None = None
    mass_excludes: list[Literal["blades"]] = []
    gravity: float = 9.80665
    air_density: float = 1.225
    hub: Triple | None = None
    imu: Triple = (0.0, 0.0, 0.0)
    rotor: RotorTable = RotorTable()


class ControlTable(_Table):
    """[controls.NAME]: only the limits matter to an aircraft that is flown; the rest is what data sets say."""

    limits: tuple[float, float] | None = None
    unit: Literal["rad"] = "rad"
    noise: float | None = None
    positive: str = ""


class BladeTable(_Table):
    """[blade]; `root_cutout` and `tip_loss` in parts of the radius, `flap_inertia` and `first_moment` about the hinge."""

    mass: float | None = None
    first_moment: float | None = None
    flap_inertia: float | None = None
    flap_spring: float | None = None
    lag_spring: float | None = None
    lag_damper: float | None = None
    twist: float | None = None
    root_cutout: float | None = None
    tip_loss: float | None = None
    lift_slope: float | None = None
    stall: float | None = None
    drag: float | None = None
    drag_rise: float | None = None
    shaft_tilt: float | None = None
    swash_phase: float | None = None


class TailTable(_Table):
    """[tail_rotor]."""

    position: Triple | None = None
    blades: int | None = None
    radius: float | None = None
    chord: float | None = None
    gear: float | None = None
    cant: float | None = None
    twist: float | None = None
    delta3: float | None = None
    lift_slope: float | None = None
    lock_number: float | None = None
    tip_loss: float | None = None
    fin_blockage: float | None = None


class FuselageTable(_Table):
    """[fuselage]."""

    position: Triple | None = None
    drag_area: Triple | None = None
    lift_area: tuple[float, float] | None = None
    pitch_volume: float | None = None
    yaw_volume: float | None = None
    wake_factor: float | None = None


class SurfaceTable(_Table):
    """[fin] and [tailplane]; `incidence` at low and at high speed, changing around `schedule` m/s."""

    position: Triple | None = None
    area: float | None = None
    lift_slope: float | None = None
    stall: float | None = None
    incidence: tuple[float, float] | None = None
    schedule: float | None = None
    wake_factor: float | None = None
    shading: float | None = None


class GovernorTable(_Table):
    """[governor]."""

    proportional: float | None = None
    integral: float | None = None
    derivative: float | None = None
    lag: float | None = None
    inertia: float | None = None


class ActuatorTable(_Table):
    """[actuators]."""

    lag: float | None = None


class VehicleFile(_Table):
    """A whole vehicle file."""

    name: str = "vehicle"
    vehicle: VehicleTable = VehicleTable()
    controls: dict[Literal["lon", "lat", "col", "ped"], ControlTable] = {}
    blade: BladeTable = BladeTable()
    tail_rotor: TailTable = TailTable()
    fuselage: FuselageTable = FuselageTable()
    fin: SurfaceTable = SurfaceTable()
    tailplane: SurfaceTable = SurfaceTable()
    governor: GovernorTable = GovernorTable()
    actuators: ActuatorTable = ActuatorTable()


def load_aircraft(path: Path | None = None) -> Aircraft:
    """Aircraft of a vehicle file; without one the UH-60.

    Raises
    ------
    InputError : the file cannot be read, has an unknown key, or declares what no helicopter can be.
    """
    reference = _read(Path(str(resources.files("rotorid_torch.fly") / "vehicles" / "uh60.toml")))
    if path is None:
        return _build(_values(reference), "uh60.toml", reference)
    declared = _read(path)
    values = _complete(_values(declared), _values(reference), declared)
    _check(values, path)
    return _build(values, str(path), declared)


def _read(path: Path) -> VehicleFile:
    """Parse and check the form of a vehicle file."""
    expected = "a vehicle file in toml with the tables [vehicle] and [vehicle.rotor]"
    try:
        return msgspec.toml.decode(path.read_bytes(), type=VehicleFile)
    except OSError as error:
        raise InputError(path, "", error.strerror or "cannot be read", expected) from error
    except msgspec.ValidationError as error:
        wrong, _, place = str(error).partition(" - at `$.")
        raise InputError(path, place.rstrip("`"), wrong, "the form of dataset.toml's [vehicle]") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(path, "", f"not toml: {error}", expected) from error


Values = dict[str, dict[str, Any]]


def _values(file: VehicleFile) -> Values:
    """Tables as plain dictionaries, silent keys left out."""
    tables: dict[str, Any] = {name: getattr(file, name) for name in SCALES if name != "rotor"}
    tables["rotor"] = file.vehicle.rotor
    found = {
        name: {key: value for key, value in msgspec.structs.asdict(table).items() if value is not None}
        for name, table in tables.items()
    }
    found["vehicle"].pop("rotor")
    found["limits"] = {name: file.controls[name].limits for name in file.controls if file.controls[name].limits}
    return found


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
    "fuselage": {"position": (1, 0), "drag_area": (2, 0), "lift_area": (2, 0), "pitch_volume": (3, 0), "yaw_volume": (3, 0)},
    "fin": {"position": (1, 0), "area": (2, 0)},
    "tailplane": {"position": (1, 0), "area": (2, 0)},
    "governor": {"proportional": (1, 1), "integral": (1, 1), "derivative": (2, 1), "inertia": (2, 1)},
    "actuators": {},
}


def _complete(declared: Values, reference: Values, file: VehicleFile) -> Values:
    """What the file declares, and for the rest the UH-60 scaled by radius and mass, blades by Lock number and count."""
    base = reference["vehicle"]["mass"], reference["rotor"]["radius"]
    radius = declared["rotor"].get("radius")
    mass = declared["vehicle"].get("mass")
    if radius is None:
        radius = base[1] if mass is None else base[1] * (abs(mass) / base[0]) ** (1.0 / 3.0)
    length = radius / base[1]
    weight = (base[0] * length**3 if mass is None else mass) / base[0]
    full: Values = {"limits": dict(reference["limits"]) | declared["limits"]}
    for table, powers in SCALES.items():
        full[table] = dict(reference[table])
        for key, (by_length, by_mass) in powers.items():
            factor = length**by_length * abs(weight) ** by_mass
            full[table][key] = (np.asarray(reference[table][key], dtype=float) * factor).tolist()
        full[table] |= declared[table]
    if file.vehicle.mass is not None or file.vehicle.inertia is not None:
        full["vehicle"]["mass_excludes"] = list(file.vehicle.mass_excludes)
    _scale_blades(full, declared, reference)
    return full


def _scale_blades(full: Values, declared: Values, reference: Values) -> None:
    """Blade number shares chord and mass out; a declared Lock number sets the blades' inertia and what goes with it."""
    rotor, blade = full["rotor"], full["blade"]
    share = reference["rotor"]["blades"] / max(rotor["blades"], 1)
    if "chord" not in declared["rotor"]:
        rotor["chord"] *= share
    inertia = blade["flap_inertia"] * share
    if "lock_number" in declared["rotor"]:
        air = full["vehicle"]["air_density"] * blade["lift_slope"] * rotor["chord"] * rotor["radius"] ** 4
        inertia = air / max(abs(rotor["lock_number"]), 0.1)
    factor = inertia / blade["flap_inertia"]
    for key in ("mass", "first_moment", "flap_inertia", "lag_spring", "lag_damper"):
        if key not in declared["blade"]:
            blade[key] *= factor


def _check(values: Values, path: Path) -> None:
    """Refuse what no helicopter can be."""
    vehicle, rotor, blade = values["vehicle"], values["rotor"], values["blade"]
    for table in ("vehicle", "rotor", "blade", "tail_rotor", "governor", "actuators"):
        for key, value in values[table].items():
            if key in POSITIVE and not (np.isfinite(value) and value > 0.0):
                raise InputError(path, f"{PLACES.get(table, table)}.{key}", f"is {value}", "a positive number")
    for table, entries in values.items():
        for key, value in entries.items():
            if isinstance(value, float | tuple | list) and "excludes" not in key:
                if not np.isfinite(np.asarray(value, dtype=float)).all():
                    raise InputError(path, f"{PLACES.get(table, table)}.{key}", "is not finite", "numbers")
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
    _check_inertia(np.asarray(vehicle["inertia"], dtype=float), path)


POSITIVE = {
    "mass", "air_density", "gravity", "radius", "chord", "speed", "lock_number", "flap_inertia", "first_moment", "lift_slope",
    "gear", "lag", "inertia",
} - {"inertia"}  # fmt: skip
PLACES = {"rotor": "vehicle.rotor", "limits": "controls"}


def _check_inertia(inertia: np.ndarray, path: Path) -> None:
    """A tensor is one of a body if it is symmetric and no principal moment exceeds the sum of the others."""
    expected = "a symmetric tensor whose principal moments are positive and obey the triangle inequality"
    if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=1e-9 * np.abs(inertia).max()):
        raise InputError(path, "vehicle.inertia", "is not symmetric", expected)
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0.0 or moments[2] > moments[0] + moments[1]:
        raise InputError(path, "vehicle.inertia", f"has the principal moments {np.round(moments, 2).tolist()}", expected)


def _build(values: Values, file: str, declared: VehicleFile) -> Aircraft:
    """Aircraft from complete values; blades taken out of mass, inertia and centre of gravity where they are in."""
    vehicle, rotor, blade, tail = values["vehicle"], values["rotor"], values["blade"], values["tail_rotor"]
    mirror = np.array([1.0, -1.0, 1.0]) if rotor["direction"] == "cw" else np.ones(3)
    mass, shift, inertia = _without_blades(values, file)
    inertia = inertia * np.outer(mirror, mirror)

    def place(position: Any) -> Triple:
        x, y, z = (np.asarray(position, dtype=float) - shift) * mirror
        return float(x), float(y), float(z)

    def section(table: dict[str, Any], drag: float, rise: float) -> Section:
        return Section(table["lift_slope"], table["stall"], table.get("drag", drag), table.get("drag_rise", rise))

    def surface(name: str, upright: bool) -> Surface:
        t = values[name]
        lift = section(t, 0.015, 0.5)
        incidence = float(t["incidence"][0]), float(t["incidence"][1])
        return Surface(
            place(t["position"]), t["area"], lift, upright, incidence, t["schedule"], t["wake_factor"], t["shading"]
        )

    body = dict(values["fuselage"])
    body |= {"position": place(body["position"]), "drag_area": tuple(body["drag_area"]), "lift_area": tuple(body["lift_area"])}
    return Aircraft(
        name=declared.name,
        mass=mass,
        inertia=tuple(tuple(float(v) for v in row) for row in inertia),  # pyright: ignore[reportArgumentType]
        gravity=vehicle["gravity"],
        air_density=vehicle["air_density"],
        imu=place(vehicle["imu"]),
        rotor=Rotor(
            **{key: rotor[key] for key in ("blades", "radius", "chord", "speed", "hinge_offset")},
            **{key: blade[key] for key in ("twist", "root_cutout", "tip_loss", "first_moment", "flap_inertia")},
            **{key: blade[key] for key in ("flap_spring", "lag_spring", "lag_damper", "swash_phase")},
            hub=place(vehicle["hub"]),
            tilt=blade["shaft_tilt"],
            elements=8,
            section=section(blade, 0.0, 0.0),
            blade_mass=blade["mass"],
        ),
        tail=TailRotor(**(tail | {"position": place(tail["position"])})),
        fuselage=Fuselage(**body),
        fin=surface("fin", True),
        tailplane=surface("tailplane", False),
        governor=Governor(held=True, **values["governor"]),
        limits=tuple(tuple(values["limits"][name]) for name in CONTROL_NAMES),
        actuator_lag=values["actuators"]["lag"],
        clockwise=rotor["direction"] == "cw",
    )


def _without_blades(values: Values, file: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass of the body, its centre of gravity from the declared one, and its inertia about that; blades sit at the hub."""
    vehicle = values["vehicle"]
    mass, inertia = float(vehicle["mass"]), np.asarray(vehicle["inertia"], dtype=float)
    if "blades" in vehicle["mass_excludes"]:
        return mass, np.zeros(3), inertia
    blades = values["rotor"]["blades"] * values["blade"]["mass"]
    body, hub = mass - blades, np.asarray(vehicle["hub"], dtype=float)
    if body <= 0.5 * mass:
        raise InputError(file, "vehicle.mass", f"is {mass} kg with blades of {blades:.0f} kg", "more than twice the blades")
    shift = -blades / body * hub

    def point(m: float, r: np.ndarray) -> np.ndarray:
        return m * (r @ r * np.eye(3) - np.outer(r, r))

    inertia = inertia - point(blades, hub) - point(body, shift)
    _check_inertia(inertia, Path(file))
    return body, shift, inertia
