"""dataset.toml, or the same as dicts, to a validated declaration."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from msgspec import Struct

from rotorid_torch.core.storage.files import read_file
from rotorid_torch.data import plausible
from rotorid_torch.data.refusal import convert
from rotorid_torch.data.schema import ChannelSpec, ControlSpec, FlightLists, ModelSettings, Vehicle
from rotorid_torch.errors import InputError, nearest

TOML_LIMIT = 1_000_000
"""Largest dataset.toml in bytes; a larger one is not a declaration."""


class _Header(Struct, frozen=True, forbid_unknown_fields=True):
    format: Literal[1]
    kind: Literal["helicopter", "multirotor"]
    flights: FlightLists
    name: str = ""
    description: str = ""
    vehicle: Vehicle = Vehicle()
    controls: dict[str, Any] = {}
    channels: dict[str, Any] = {}
    model: dict[str, Any] = {}


class Declaration(Struct, frozen=True):
    """The whole of dataset.toml, validated."""

    name: str
    kind: str
    description: str
    vehicle: Vehicle
    controls: dict[str, ControlSpec]
    channels: dict[str, ChannelSpec]
    flights: FlightLists
    model: ModelSettings
    warnings: tuple[str, ...]

    def units(self) -> dict[str, str]:
        """Units of the declared controls."""
        return {name: spec.unit for name, spec in self.controls.items()}


def read_declaration(path: Path) -> tuple[Declaration, bytes]:
    """Read and validate a dataset.toml; also its bytes. Raises InputError with the key that is at fault."""
    content = read_file(path, "a data set: a folder with dataset.toml and flights/NAME.npz", TOML_LIMIT)
    try:
        document = tomllib.loads(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(path, "", f"is not text (byte {error.start})", "TOML in UTF-8") from None
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        _refuse_question_marks(path, content.decode("utf-8"))
        raise InputError(path, "", f"is not TOML: {error}", "a dataset.toml with format = 1") from None
    return declare(document, path), content


def _refuse_question_marks(path: Path, text: str) -> None:
    """Raise InputError where a key that import leaves to be filled in still has its question mark."""
    for number, line in enumerate(text.splitlines(), 1):
        key, equals, value = line.partition("#")[0].partition("=")
        if equals and "?" in value and not {'"', "'"} & {*value}:
            wrong = f"is {value.strip()} in line {number}"
            raise InputError(path, key.strip(), wrong, "numbers for the question marks, or # before the line")


def declare(document: Mapping[str, Any], file: str | Path) -> Declaration:
    """Validate a document of dataset.toml's form (nested dicts); `file` is named in errors. Raises InputError."""
    header = convert(dict(document), _Header, file, "")
    model = convert(header.model, ModelSettings, file, "model")
    controls = {key: convert(value, ControlSpec, file, f"controls.{key}") for key, value in header.controls.items()}
    channels = {key: convert(value, ChannelSpec, file, f"channels.{key}") for key, value in header.channels.items()}
    plausible.check_finite(document, file)
    plausible.check_vehicle(header.vehicle, file)
    plausible.check_controls(controls, file)
    plausible.check_channels(channels, file)
    plausible.check_lists(header.flights, file)
    return Declaration(
        name=header.name,
        kind=header.kind,
        description=header.description,
        vehicle=header.vehicle,
        controls=controls,
        channels=channels,
        flights=header.flights,
        model=model,
        warnings=tuple(_unused(header)),
    )


def _unused(header: _Header) -> Iterator[str]:
    for key in header.model:
        if key not in ModelSettings.__struct_fields__:
            yield f"[model] {key} is not known{nearest(key, ModelSettings.__struct_fields__)} and not used"
    for part in header.vehicle.mass_excludes:
        if part != "blades":
            yield f"mass_excludes '{part}' is not known (blades is) and not used"
