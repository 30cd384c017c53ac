"""Write a data set: validated first, laid down beside its place, renamed when whole."""

import json
import os
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from rotorid_torch.core.storage.atomic import atomic_folder, refuse_unless_writable, restore, writing
from rotorid_torch.core.storage.files import read_file
from rotorid_torch.core.storage.paths import absolute, refuse_foreign
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.declare import TOML_LIMIT
from rotorid_torch.data.reading.read import Arrays, take_arrays
from rotorid_torch.data.refusal import plain_number
from rotorid_torch.errors import InputError
from rotorid_torch.printable import printable

BEFORE = "dataset.before"
"""Beginning of the names of files that keep what data sets which were replaced had declared."""
FILES = ("dataset.toml", f"{BEFORE}*.toml", "flights/*.npz", "truth/*.npz", "truth/effects.json")
"""Files of a data set that was written: a folder that holds others is not replaced."""


def write_dataset(
    folder: str | Path,
    flights: Mapping[str, Mapping[str, Any]],
    *,
    truth: Mapping[str, Mapping[str, Any]] | None = None,
    texts: Mapping[str, str] | None = None,
    comment: str = "",
    **declared: Any,
) -> Path:
    """Write dataset.toml, flights/NAME.npz and, where it is handed over, truth/NAME.npz; returns the folder.

    float32 stays float32, all else is written as float64. An earlier data set at this place is replaced whole.

    flights, declared : as for `Dataset.from_arrays`, which validates them before anything is written. Without a name
        the data set has that of the folder.
    truth : arrays by flight and channel.
    texts : more files, by path in the folder; those that say what the data set declares anyway are left out.
    comment : lines that begin with #, for the table [vehicle], after its keys.

    Raises InputError: the data are bad, something that is not a data set is in the way, or the place cannot be written
    to.
    """
    place = absolute(folder)
    refuse_unless_free(place)
    name = declared.pop("name", "") or printable(place.name, layout=False)
    Dataset.from_arrays(flights, name=name, **declared)
    document = _document(name, declared)
    text = _with_comment(to_toml(document), comment)
    listed = [flight for flights_of_list in document["flights"].values() for flight in flights_of_list]
    with writing(place):
        place.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(place, lambda: refuse_unless_free(place)) as partial:
        (partial / "dataset.toml").write_text(text, encoding="utf-8")
        _write_arrays(partial / "flights", {flight: flights[flight] for flight in listed})
        if truth:
            _write_arrays(partial / "truth", truth)
        for file, other in (texts or {}).items():
            if other != text:
                (partial / file).write_text(other, encoding="utf-8")
    return place


def declared_by(dataset: Dataset) -> dict[str, Any]:
    """Lists and tables of a data set as keywords of `write_dataset` and `Dataset.from_arrays`, with its name."""
    lists = {"identify": dataset.identify, "validate": dataset.validate, "acid": dataset.acid}
    about = {"name": dataset.name, "kind": dataset.kind, "description": dataset.description}
    tables = {"vehicle": dataset.vehicle, "controls": dataset.control_specs, "channels": dataset.channel_specs}
    return {**lists, **about, **tables, "model": dataset.settings}


def _with_comment(text: str, comment: str) -> str:
    head, table, after = text.partition("[vehicle]\n")
    keys, _, others = after.partition("\n") if after.startswith("\n") else after.partition("\n\n")
    return f"{head}{table}{keys}{chr(10) if keys else ''}{comment}\n{others}" if comment else text


def _document(name: str, declared: Mapping[str, Any]) -> dict[str, Any]:
    """The declaration in the order of a dataset.toml, without what is left at its default."""
    about = {"kind": declared.get("kind", "helicopter"), "description": declared.get("description", "")}
    sensors = {
        key: {name: _plain(spec) for name, spec in (declared.get(key) or {}).items()}
        for key in ("controls", "channels")
    }
    lists = {key: list(declared.get(key, ())) for key in ("identify", "validate", "acid")}
    tables = {"vehicle": _plain(declared.get("vehicle")), **sensors, "flights": lists}
    return {"format": 1, "name": name, **about, **tables, "model": _plain(declared.get("model"))}


def refuse_unless_free(out: str | Path, written: str = "", inputs: Iterable[Path] = ()) -> None:
    """Raise InputError where no data set can be written to `out`.

    Something that is not a data set is in the way, or a data set that holds other files, or files that are read; or
    the place cannot be written to.

    written : what the description of a data set that may be replaced begins with: flights that were measured cannot be
        made again.
    inputs : files that are read.
    """
    place = absolute(out)
    refuse_unless_writable(place, parents=True)
    restore(place)
    if not os.path.lexists(place):
        return
    if not place.is_dir() or place.is_symlink():
        raise InputError(out, "", "is in the way and is not a folder", "a new folder, or an earlier data set")
    declared = place / "dataset.toml"
    if not declared.is_file():
        if any(place.iterdir()):
            raise InputError(out, "", "is in the way and is not a data set", "a new folder, or an earlier data set")
        return
    if written and not str(_document_of(declared).get("description", "")).startswith(written):
        wrong = f"is in the way and is not a data set whose description begins with '{written}'"
        raise InputError(out, "", wrong, "a new folder, or a data set that the same command wrote")
    refuse_foreign(place, FILES, "a data set")
    same = next((file for file in inputs if os.path.exists(file) and place.resolve() in file.resolve().parents), None)
    if same is not None:
        raise InputError(out, "", f"holds {same}, which is read", "a new folder")


def declarations(out: str | Path) -> dict[str, str]:
    """What a data set at `out` declares, and those before it there, by name of the file that keeps the text."""
    place = absolute(out)
    if not (place / "dataset.toml").is_file():
        return {}
    text = _text(place / "dataset.toml")
    texts = {f.name: _text(f) for f in sorted(place.glob(f"{BEFORE}*.toml"))}
    return texts if text in texts.values() else {**texts, f"{BEFORE}{len(texts) + 1}.toml": text}


def _text(file: Path) -> str:
    return read_file(file, "a data set's declaration", TOML_LIMIT).decode("utf-8", "replace")


def declared_vehicle(file: Path, written: str) -> dict[str, Any]:
    """Table [vehicle] of a dataset.toml whose description begins with `written`; empty where there is none."""
    document = _document_of(file)
    vehicle = document.get("vehicle") if str(document.get("description", "")).startswith(written) else None
    return vehicle if isinstance(vehicle, dict) else {}


def _document_of(file: Path) -> dict[str, Any]:
    """A dataset.toml; empty where the file cannot be read."""
    try:
        return tomllib.loads(_text(file)) if file.is_file() else {}
    except (ValueError, RecursionError):
        return {}


def _write_arrays(folder: Path, flights: Mapping[str, Mapping[str, Any]]) -> None:
    folder.mkdir()
    for name, columns in flights.items():
        arrays: Arrays = take_arrays(columns, f"arrays: flight {name}")
        with (folder / f"{name}.npz").open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)


def _plain(table: Any) -> dict[str, Any]:
    """Give a struct or dict as a dict without what was left at None or empty."""
    plain = msgspec.to_builtins(table, enc_hook=plain_number) if table is not None else {}
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
