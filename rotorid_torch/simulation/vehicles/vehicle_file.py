"""The form of a vehicle file.

It has the tables [vehicle], [vehicle.rotor] and [controls.*] of a data set's dataset.toml, and optionally [blade],
[tail_rotor], [fuselage], [fin], [tailplane], [governor], [actuators] with the keys of vehicles/uh60.toml. SI units,
radians; positions from the centre of gravity that the mass belongs to, body axes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import msgspec

from rotorid_torch.core.storage.files import read_file
from rotorid_torch.data.declare import TOML_LIMIT
from rotorid_torch.errors import InputError

Triple = tuple[float, float, float]


class RotorTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[vehicle.rotor], as in a data set; the Lock number for a lift slope of `rotor.LOCK_SLOPE`."""

    blades: int | None = None
    radius: float | None = None
    chord: float | None = None
    speed: float | None = None
    direction: Literal["ccw", "cw"] = "ccw"
    hinge_offset: float | None = None
    lock_number: float | None = None


class VehicleTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[vehicle], as in a data set."""

    mass: float | None = None
    inertia: tuple[Triple, Triple, Triple] | None = None
    mass_excludes: list[Literal["blades"]] = []
    gravity: float = 9.80665
    air_density: float = 1.225
    hub: Triple | None = None
    imu: Triple = (0.0, 0.0, 0.0)
    rotor: RotorTable = RotorTable()


class ControlTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[controls.NAME]: limits of blade angles count; those of sticks, and the rest, are only read over."""

    limits: tuple[float, float] | None = None
    unit: Literal["rad", "m", "norm"] = "rad"
    noise: float | None = None
    positive: str = ""


class BladeTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[blade]; `root_cutout`, `tip_loss` in parts of the radius, `flap_inertia`, `first_moment` about the hinge."""

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


class TailTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
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


class FuselageTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[fuselage]."""

    position: Triple | None = None
    drag_area: Triple | None = None
    lift_area: tuple[float, float] | None = None
    pitch_volume: float | None = None
    yaw_volume: float | None = None
    wake_factor: float | None = None


class SurfaceTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[fin] and [tailplane]; `incidence` at low and at high speed, changing around `schedule` m/s."""

    position: Triple | None = None
    area: float | None = None
    lift_slope: float | None = None
    stall: float | None = None
    incidence: tuple[float, float] | None = None
    schedule: float | None = None
    wake_factor: float | None = None
    shading: float | None = None


class GovernorTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[governor]."""

    proportional: float | None = None
    integral: float | None = None
    derivative: float | None = None
    lag: float | None = None
    inertia: float | None = None


class ActuatorTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[actuators]."""

    lag: float | None = None


class VehicleFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A whole vehicle file; a data set's dataset.toml passes too, what it says of its flights is not used."""

    name: str = "vehicle"
    format: Literal[1] = 1
    kind: Literal["helicopter"] = "helicopter"
    description: str = ""
    channels: dict[str, dict[str, float | str]] = {}
    flights: dict[str, list[str]] = {}
    model: dict[str, Any] = {}
    vehicle: VehicleTable = VehicleTable()
    controls: dict[Literal["lon", "lat", "col", "ped"], ControlTable] = {}
    blade: BladeTable = BladeTable()
    tail_rotor: TailTable = TailTable()
    fuselage: FuselageTable = FuselageTable()
    fin: SurfaceTable = SurfaceTable()
    tailplane: SurfaceTable = SurfaceTable()
    governor: GovernorTable = GovernorTable()
    actuators: ActuatorTable = ActuatorTable()


def read_vehicle(path: Path) -> VehicleFile:
    """Parse a vehicle file and check its form.

    Raises InputError: it cannot be read, is not toml, or has a key or a type that does not belong there.
    """
    expected = "a vehicle file in toml with the tables [vehicle] and [vehicle.rotor]"
    content = read_file(path, expected, TOML_LIMIT)
    try:
        return msgspec.toml.decode(content, type=VehicleFile)
    except msgspec.ValidationError as error:
        wrong, _, place = str(error).partition(" - at `$.")
        raise InputError(path, place.rstrip("`"), wrong, "the form of dataset.toml's [vehicle]") from error
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise InputError(path, "", f"not toml: {error}", expected) from error
