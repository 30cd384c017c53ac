"""The form of a vehicle file: the tables and keys of uh60.toml, each of them optional.

[vehicle], [vehicle.rotor] and [controls.*] are those of a data set's dataset.toml, which passes too: what it says of
its flights is read over. SI units, radians; positions from the centre of gravity that the mass belongs to, body axes.
The Lock number is for a lift slope of `rotor.LOCK_SLOPE`; `flap_inertia` and `first_moment` are about the hinge.
"""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import msgspec

from rotorid_torch.core.storage.files import read_file
from rotorid_torch.data.declare import TOML_LIMIT
from rotorid_torch.errors import InputError

REFERENCE = Path(str(resources.files("rotorid_torch.simulation.vehicles") / "uh60.toml"))
Default = tuple[Any, Any]
"""Type of a key, and its value where the file is silent."""


class ControlTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """[controls.NAME]: limits of blade angles count; those of sticks, and noise, are only read over."""

    limits: tuple[float, float] | None = None
    unit: Literal["rad", "m", "norm"] = "rad"
    noise: float | None = None
    positive: str = ""


KEYS: Mapping[str, Default] = {
    "name": (str, "vehicle"),
    "mass_excludes": (list[Literal["blades"]], []),
    "gravity": (float, 9.80665),
    "air_density": (float, 1.225),
    "imu": (tuple[float, float, float], (0.0, 0.0, 0.0)),
    "direction": (Literal["ccw", "cw"], "ccw"),
    "controls": (dict[Literal["lon", "lat", "col", "ped"], ControlTable], {}),
}
"""Keys that are no numbers, or have a value where a file is silent; all others have none."""
OF_A_DATA_SET: Mapping[str, Default] = {
    "format": (Literal[1], 1),
    "kind": (Literal["helicopter"], "helicopter"),
    "description": (str, ""),
    "channels": (dict[str, dict[str, float | str]], {}),
    "flights": (dict[str, list[str]], {}),
    "model": (dict[str, Any], {}),
}


@cache
def _form() -> type[msgspec.Struct]:
    return _table("VehicleFile", tomllib.loads(REFERENCE.read_text(encoding="utf-8")), OF_A_DATA_SET)


def _table(name: str, reference: Mapping[str, Any], more: Mapping[str, Default]) -> type[msgspec.Struct]:
    """A table with the keys of the reference's, all of them optional."""
    fields = [(key, *kind) for key, kind in more.items()]
    for key, value in reference.items():
        if key in KEYS:
            fields.append((key, *KEYS[key]))
        elif isinstance(value, dict):
            table = _table(key, value, {})
            fields.append((key, table, table()))
        else:
            fields.append((key, _kind(value) | None, None))
    return msgspec.defstruct(name, fields, frozen=True, forbid_unknown_fields=True)


def _kind(value: Any) -> Any:
    """Type of a number, or of nested lists of as many."""
    return tuple[*map(_kind, value)] if isinstance(value, list) else type(value)


def read_vehicle(path: Path) -> Any:
    """Parse a vehicle file and check its form: a struct with its tables as attributes.

    Raises InputError: it cannot be read, is not toml, or has a key or a type that does not belong there.
    """
    expected = "a vehicle file in toml with the tables [vehicle] and [vehicle.rotor]"
    content = read_file(path, expected, TOML_LIMIT)
    try:
        return msgspec.toml.decode(content, type=_form())
    except msgspec.ValidationError as error:
        wrong, _, place = str(error).partition(" - at `$.")
        raise InputError(path, place.rstrip("`"), wrong, "the form of dataset.toml's [vehicle]") from error
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise InputError(path, "", f"not toml: {error}", expected) from error
