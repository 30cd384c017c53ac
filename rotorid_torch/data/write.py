"""Write a data set: validated first, laid down beside its place, renamed when whole."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.read import Arrays, take_arrays
from rotorid_torch.errors import InputError


def write_dataset(
    folder: str | Path,
    flights: Mapping[str, Mapping[str, Any]],
    *,
    identify: Sequence[str],
    validate: Sequence[str] = (),
    acid: Sequence[str] = (),
    name: str = "",
    kind: str = "helicopter",
    description: str = "",
    vehicle: Any = None,
    controls: Any = None,
    channels: Any = None,
    model: Any = None,
    truth: Mapping[str, Mapping[str, Any]] | None = None,
    kept: Mapping[str, str] | None = None,
) -> Path:
    """Write dataset.toml, flights/NAME.npz and, where given, truth/NAME.npz; returns the folder.

    The arguments are those of `Dataset.from_arrays`, which validates them before anything is written; `truth` holds
    arrays by flight and channel. float32 stays float32, all else is written as float64. An earlier data set at this
    place is replaced whole; of `kept`, texts by name of file, those that say something else stay beside it.

    Raises
    ------
    InputError : where the data are bad, or something that is not a data set is in the way.
    """
    place = Path(folder).absolute()
    refuse_unless_free(place)
    Dataset.from_arrays(
        flights,
        identify=identify,
        validate=validate,
        acid=acid,
        name=name or place.name,
        kind=kind,
        description=description,
        vehicle=vehicle,
        controls=controls,
        channels=channels,
        model=model,
    )
    document = {
        "format": 1,
        "name": name or place.name,
        "kind": kind,
        "description": description,
        "vehicle": _plain(vehicle),
        "controls": {control: _plain(spec) for control, spec in (controls or {}).items()},
        "channels": {channel: _plain(spec) for channel, spec in (channels or {}).items()},
        "flights": {"identify": list(identify), "validate": list(validate), "acid": list(acid)},
        "model": _plain(model),
    }
    place.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=place.parent))
    try:
        beside.chmod(0o755)
        (beside / "dataset.toml").write_text(to_toml(document), encoding="utf-8")
        for file, text in (kept or {}).items():
            if text != to_toml(document):
                (beside / file).write_text(text, encoding="utf-8")
        _write_arrays(beside / "flights", {flight: flights[flight] for flight in (*identify, *validate, *acid)})
        if truth:
            _write_arrays(beside / "truth", truth)
        _move(beside, place)
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise
    return place


def refuse_unless_free(place: Path) -> None:
    """Raise InputError where something that is not a data set is in the way."""
    if place.is_dir() and not place.is_symlink():
        if (place / "dataset.toml").exists() or not any(place.iterdir()):
            return
        raise InputError(place, "", "is in the way and is not a data set", "a new folder, or an earlier data set")
    if place.exists() or place.is_symlink():
        raise InputError(place, "", "is in the way and is not a folder", "a new folder, or an earlier data set")


def _write_arrays(folder: Path, flights: Mapping[str, Mapping[str, Any]]) -> None:
    folder.mkdir()
    for name, given in flights.items():
        arrays: Arrays = take_arrays(given, f"arrays: flight {name}")
        with (folder / f"{name}.npz").open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)


def _move(beside: Path, place: Path) -> None:
    """Rename into place; what lay there goes away after the new one stands."""
    if not place.exists():
        beside.rename(place)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{place.name}.old.", dir=place.parent))
    os.replace(place, old / "was")
    try:
        beside.rename(place)
    except BaseException:
        os.replace(old / "was", place)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _plain(table: Any) -> dict[str, Any]:
    """Give a struct or dict as a dict without what was left at None or empty."""
    plain = msgspec.to_builtins(table) if table is not None else {}
    return {
        key: _without_none(value) for key, value in plain.items() if value is not None and value not in ([], (), "")
    }


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value] if isinstance(value, list | tuple) else value


def to_toml(document: Mapping[str, Any]) -> str:
    """Write nested dicts, lists, text and numbers as TOML: plain keys first, then tables and arrays of tables."""
    return "\n".join(_table(document, ())).strip() + "\n"


def _table(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    nested = {key: value for key, value in table.items() if isinstance(value, Mapping) or _is_tables(value)}
    lines = [f"{_key(key)} = {_value(value)}" for key, value in table.items() if key not in nested]
    for key, value in nested.items():
        inner = (*path, _key(key))
        for item in value if _is_tables(value) else [value]:
            header = f"[[{'.'.join(inner)}]]" if _is_tables(value) else f"[{'.'.join(inner)}]"
            lines += ["", header, *_table(item, inner)]
    return lines


def _is_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and isinstance(value[0], Mapping)


def _key(key: str) -> str:
    return key if key.isascii() and key.replace("_", "").replace("-", "").isalnum() else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(float(value)) if isinstance(value, float) else str(value)
