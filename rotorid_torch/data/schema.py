"""dataset.toml as strict structs: what may be declared, in which range, and one line for what may not."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct

from rotorid_torch.core import names
from rotorid_torch.errors import InputError

Metres = Annotated[float, Meta(ge=-1000, le=1000, description="m")]
Point = tuple[Metres, Metres, Metres]
Row = tuple[float, float, float]
Spin = Literal["ccw", "cw"]

TOML_LIMIT = 1_000_000
"""Largest dataset.toml in bytes; a larger one is not a declaration."""


class Rotor(Struct, frozen=True, forbid_unknown_fields=True):
    """Main rotor as declared; SI units; None where not declared."""

    blades: Annotated[int, Meta(ge=1, le=20)] | None = None
    radius: Annotated[float, Meta(gt=0, le=50, description="m")] | None = None
    chord: Annotated[float, Meta(gt=0, le=10, description="m")] | None = None
    speed: Annotated[float, Meta(gt=0, le=10_000, description="rad/s")] | None = None
    direction: Spin | None = None
    hinge_offset: Annotated[float, Meta(ge=0, le=50, description="m")] | None = None
    lock_number: Annotated[float, Meta(gt=0, le=100)] | None = None


class Motor(Struct, frozen=True, forbid_unknown_fields=True):
    """One motor of a multirotor: position in m from the centre of gravity, thrust = c0 + c1 m + c2 m² in N, torque over thrust in m."""

    position: Point
    spin: Spin
    thrust: Row | None = None
    torque_ratio: Annotated[float, Meta(ge=0, le=10, description="m")] | None = None


class Vehicle(Struct, frozen=True, forbid_unknown_fields=True):
    """What is declared of the vehicle; SI units, body axes, points in m from the centre of gravity; None where not declared."""

    mass: Annotated[float, Meta(gt=0, le=1e6, description="kg")] | None = None
    inertia: tuple[Row, Row, Row] | None = None
    mass_excludes: tuple[str, ...] = ()
    gravity: Annotated[float, Meta(gt=0, le=100, description="m/s²")] = 9.80665
    air_density: Annotated[float, Meta(ge=0, le=100, description="kg/m³")] = 1.225
    hub: Point | None = None
    imu: Point | None = None
    rotor: Rotor | None = None
    motors: tuple[Motor, ...] = ()


class ControlSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One control: unit, limits in that unit, standard deviation of a sample, and a word for people."""

    unit: Literal["rad", "m", "norm"] = "rad"
    limits: tuple[float, float] | None = None
    noise: Annotated[float, Meta(ge=0)] | None = None
    positive: str = ""


class ChannelSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One sensor: standard deviation of a sample and whether it has a constant error per flight."""

    noise: Annotated[float, Meta(ge=0)] | None = None
    bias: names.Bias | None = None


class FlightLists(Struct, frozen=True, forbid_unknown_fields=True):
    """Which flights are fitted, which judge, and which are only reported."""

    identify: tuple[str, ...]
    validate: tuple[str, ...] = ()
    acid: tuple[str, ...] = ()

    def all(self) -> tuple[str, ...]:
        """All flights, in order of the lists."""
        return self.identify + self.validate + self.acid


class ModelSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings that belong to the vehicle rather than to one run."""

    reference: str = ""


class _Header(Struct, frozen=True, forbid_unknown_fields=True):
    format: Literal[1]
    kind: Literal["helicopter", "multirotor"]
    flights: FlightLists
    name: str = ""
    description: str = ""
    vehicle: Vehicle = Vehicle()
    controls: dict[str, Any] = {}
    channels: dict[str, Any] = {}
    model: ModelSettings = ModelSettings()


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


def read_declaration(path: Path) -> tuple[Declaration, bytes]:
    """Read and validate a dataset.toml; also its bytes. Raises InputError with the key that is at fault."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError(
            path, "", "there is no such file", "a data set: a folder with dataset.toml and flights/NAME.npz"
        ) from None
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})", "a readable dataset.toml") from None
    if len(content) > TOML_LIMIT:
        raise InputError(path, "", f"has {len(content)} bytes", f"a dataset.toml below {TOML_LIMIT} bytes")
    try:
        document = tomllib.loads(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(path, "", f"is not text (byte {error.start})", "TOML in UTF-8") from None
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise InputError(path, "", f"is not TOML: {error}", "a dataset.toml with format = 1") from None
    return declare(document, path), content


def declare(document: Mapping[str, Any], file: str | Path) -> Declaration:
    """Validate a document of dataset.toml's form (nested dicts); `file` is named in errors. Raises InputError."""
    raw = {key: value for key, value in document.items()}
    header = _convert(raw, _Header, file, "")
    controls = {key: _convert(value, ControlSpec, file, f"controls.{key}") for key, value in header.controls.items()}
    channels = {key: _convert(value, ChannelSpec, file, f"channels.{key}") for key, value in header.channels.items()}
    _check_finite(document, file)
    _check_vehicle(header, file)
    _check_controls(controls, file)
    _check_channels(channels, file)
    _check_lists(header.flights, file)
    return Declaration(
        header.name, header.kind, header.description, header.vehicle, controls, channels, header.flights, header.model
    )


T = TypeVar("T")


def _convert(value: Any, kind: type[T], file: str | Path, prefix: str) -> T:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise _told(str(error), value, kind, file, prefix) from None


def _told(message: str, document: Any, kind: Any, file: str | Path, prefix: str) -> InputError:
    """msgspec's message as file, key path, what is there, and what is allowed."""
    text, _, place = message.partition(" - at `$")
    path = place.rstrip("`").lstrip(".")
    key = ".".join(part for part in (prefix, path) if part)
    steps = [int(s) if s.isdigit() else s for s in re.findall(r"[^.\[\]]+", path)]
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", text):
        fields = _fields_at(kind, steps)
        full = f"{key}.{unknown[1]}" if key else unknown[1]
        return InputError(file, full, f"unknown key{names.nearest(unknown[1], fields)}", f"one of {', '.join(fields)}")
    if missing := re.fullmatch(r"Object missing required field `(.*)`", text):
        allowed = _allowed(_type_at(kind, [*steps, missing[1]]))
        return InputError(file, f"{key}.{missing[1]}" if key else missing[1], "is missing", allowed or "this key")
    found = _value_at(document, steps)
    allowed = _allowed(_type_at(kind, steps))
    expected = re.sub(r"^Expected ", "", text.split(", got")[0]).replace("`", "").replace(" | null", "")
    return InputError(file, key, f"is {_short(found)}", allowed or expected)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _value_at(document: Any, steps: list[Any]) -> Any:
    for step in steps:
        try:
            document = document[step]
        except (KeyError, IndexError, TypeError):
            return None
    return document


def _type_at(kind: Any, steps: list[Any]) -> Any:
    """msgspec's description of the type that the steps lead to, or None."""
    info: Any = msgspec.inspect.type_info(kind)
    for step in steps:
        info = _child(_bare(info), step)
    return info


def _bare(info: Any) -> Any:
    while isinstance(info, msgspec.inspect.UnionType | msgspec.inspect.Metadata):
        if isinstance(info, msgspec.inspect.Metadata):
            info = info.type
        else:
            info = next(t for t in info.types if not isinstance(t, msgspec.inspect.NoneType))
    return info


def _child(info: Any, step: Any) -> Any:
    if isinstance(info, msgspec.inspect.StructType):
        return next((f.type for f in info.fields if f.encode_name == step), None)
    if isinstance(info, msgspec.inspect.TupleType) and isinstance(step, int) and step < len(info.item_types):
        return info.item_types[step]
    return getattr(info, "item_type", None)


def _fields_at(kind: Any, steps: list[Any]) -> list[str]:
    info = _bare(_type_at(kind, steps))
    return [f.encode_name for f in getattr(info, "fields", ())]


_WORDS = {
    "StrType": "text",
    "DictType": "a table",
    "StructType": "a table",
    "VarTupleType": "a list",
    "BoolType": "true or false",
}


def _allowed(info: Any) -> str:
    """What a type allows, in words for people: choices, a range with its unit, a list of so many numbers."""
    described = info
    while isinstance(described, msgspec.inspect.UnionType):
        described = next(t for t in described.types if not isinstance(t, msgspec.inspect.NoneType))
    unit = ""
    if isinstance(described, msgspec.inspect.Metadata):
        unit = (described.extra_json_schema or {}).get("description", "")
    bare = _bare(info)
    if isinstance(bare, msgspec.inspect.LiteralType):
        return " or ".join(repr(v) for v in bare.values)
    if isinstance(bare, msgspec.inspect.TupleType):
        nested = isinstance(_bare(bare.item_types[0]), msgspec.inspect.TupleType)
        return f"a list of {len(bare.item_types)} {'rows of 3 numbers' if nested else 'numbers'}"
    if isinstance(bare, msgspec.inspect.FloatType | msgspec.inspect.IntType):
        return _range_words(bare, unit)
    return _WORDS.get(type(bare).__name__, "")


def _range_words(info: Any, unit: str) -> str:
    noun = "a whole number" if isinstance(info, msgspec.inspect.IntType) else "a number"
    low = f"above {info.gt:g}" if info.gt is not None else f"from {info.ge:g}" if info.ge is not None else ""
    high = f"to {info.le:g}" if info.le is not None else ""
    return " ".join(word for word in (noun, low, high, unit) if word)


def _numbers(value: Any, key: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _numbers(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _numbers(item, f"{key}[{index}]")
    elif isinstance(value, float):
        yield key, value


def _check_finite(document: Mapping[str, Any], file: str | Path) -> None:
    for key, number in _numbers(document, ""):
        if not math.isfinite(number):
            raise InputError(file, key, f"is {number}", "a finite number")


def _check_vehicle(header: _Header, file: str | Path) -> None:
    vehicle = header.vehicle
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

    Source: any text on rigid bodies, e.g. Goldstein, Classical Mechanics, ch. 5: I1 + I2 - I3 = 2 ∫ z² dm ≥ 0. A slack of 0.1 % allows for
    rounded digits.
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


def _check_controls(controls: Mapping[str, ControlSpec], file: str | Path) -> None:
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


def _check_channels(channels: Mapping[str, ChannelSpec], file: str | Path) -> None:
    for name in channels:
        if names.is_control(name):
            raise InputError(file, f"channels.{name}", "is a control", f"its noise in [controls.{name}]")
        if name == "time":
            raise InputError(file, "channels.time", "time has no sensor", "no [channels.time]")


def _check_lists(lists: FlightLists, file: str | Path) -> None:
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
            f"flight {_short(name)} is not a plain name",
            "NAME of a file flights/NAME.npz inside the data set",
        )
