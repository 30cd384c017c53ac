"""Flight files as they lie on disk: npz and csv to plain float64 arrays, refusing what is not data."""

import io
import os
from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from rotorid_torch.arguments import Argument, described, filled, numbers_of
from rotorid_torch.core.storage.files import read_file
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.reading import npz
from rotorid_torch.errors import InputError, nearest

Arrays = dict[str, np.ndarray]

FOLDERS = ("flights", "truth")
"""Of a data set: what was measured, and what a simulator knows."""
SAMPLES = 20_000_000
"""Longest flight; a longer one is a damaged or hostile file."""
CHANNELS = 1000
"""Most channels of a flight."""
BYTES = 2**29
"""Most bytes of a flight, unpacked: 67 million numbers, an hour of 37 channels at 500 Hz."""
CSV_BYTES = 2**27
"""Most bytes of a flight as text."""


def find_flight(folder: Path, name: str) -> Path:
    """File of a flight: flights/NAME.npz, else flights/NAME.csv. Raises InputError where neither lies there."""
    npz_file, csv_file = (folder / "flights" / f"{name}{suffix}" for suffix in (".npz", ".csv"))
    expected = f"the flight '{name}' of dataset.toml, as .npz or .csv"
    for path in (npz_file, csv_file):
        try:
            os.lstat(path)
            return path
        except FileNotFoundError:
            continue
        except OSError as error:
            raise InputError(path, "", f"cannot be read ({error.strerror})", expected) from None
    hint = nearest(name, (path.stem for path in npz_file.parent.glob("*")))
    raise InputError(npz_file, "", f"there is no such file{hint}", expected)


def read_flight(path: Path) -> bytes:
    """Bytes of a flight's file. Raises InputError where it is no regular file, or too large for one flight."""
    return read_file(path, "a flight", CSV_BYTES if path.suffix == ".csv" else BYTES)


def parse_flight(path: Path, content: bytes) -> Arrays:
    """Arrays of a flight file by name, each as stored; `content` are the file's bytes. Raises InputError."""
    if not content:
        raise InputError(
            path, "", "is empty", "one array per channel" if path.suffix == ".npz" else "a header row and numbers"
        )
    return _parse_csv(path, content) if path.suffix == ".csv" else _parse_npz(path, content)


def _parse_npz(path: Path, content: bytes) -> Arrays:
    with npz.opened(path, io.BytesIO(content), CHANNELS) as archive:
        for name, header in archive.headers.items():
            _check_array(path, name, header.shape, header.dtype)
        npz.refuse_beyond(path, {name: header.bytes for name, header in archive.headers.items()}, BYTES)
        return {name: archive.array(name) for name in archive.headers}


def _check_array(path: str | Path, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    if dtype.hasobject:
        raise InputError(path, name, "is a pickled object", "float32 or float64; nothing is unpickled")
    if dtype.kind != "f" or dtype.itemsize not in (4, 8):
        kind = {"U": "text", "S": "text", "c": "complex", "b": "true/false"}.get(dtype.kind, str(dtype))
        raise InputError(path, name, f"is {kind}", "float32 or float64")
    if len(shape) != 1:
        raise InputError(
            path, name, f"has {len(shape)} dimensions, shape {shape}", "one dimension, one value per sample"
        )
    if not 0 <= shape[0] <= SAMPLES:
        raise InputError(path, name, f"has {shape[0]} samples", f"at most {SAMPLES}")


def _parse_csv(path: Path, content: bytes) -> Arrays:
    try:
        text = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig")
        lines = ((number, line) for number, line in enumerate(text, 1) if line.strip())
        _, first = next(lines, (0, ""))
        if not first:
            raise InputError(path, "", "is empty", "a header row and numbers")
        if first.count(",") >= CHANNELS:
            raise InputError(path, "", f"has {first.count(',') + 1} columns", f"at most {CHANNELS}")
        header = [field.strip().strip('"') for field in first.split(",")]
        _check_header(path, header)
        numbers = array("d")
        for number, line in lines:
            numbers.extend(_row(path, header, number, line))
    except UnicodeDecodeError as error:
        raise InputError(path, "", f"is not text ({error.reason})", "csv in UTF-8 with a header row") from None
    table = np.array(numbers).reshape(-1, len(header))
    return {name: table[:, column] for column, name in enumerate(header)}


def _check_header(path: Path, header: list[str]) -> None:
    if len(header) == 1:
        expected = "commas between columns named as channels; rotorid import reads tables of other forms"
        raise InputError(path, "line 1", f"is '{header[0][:40]}', one column", expected)
    for column, name in enumerate(header, 1):
        if not name:
            raise InputError(path, f"column {column}", "has no name", "a header row with a name per column")
        if header.count(name) > 1:
            raise InputError(path, name, "is there twice", "each channel once")


def _row(path: Path, header: list[str], number: int, line: str) -> list[float]:
    if line.count(",") != len(header) - 1:
        wrong = f"has {line.count(',') + 1} fields"
        raise InputError(path, f"line {number}", wrong, f"{len(header)} as in the header row")
    row = []
    for name, field in zip(header, line.split(","), strict=True):
        try:
            row.append(number_of(field) if field.strip() else float("nan"))
        except ValueError:
            raise InputError(
                path, name, f"is '{field.strip()[:40]}' in line {number}", "a number, or nothing for a missing sample"
            ) from None
    return row


def number_of(field: str) -> float:
    """The number that a table's field holds. Raises ValueError for what only Python takes for one (1_000)."""
    if "_" in field:
        raise ValueError(field)
    return float(field)


def take_arrays(table: Mapping[str, Any], place: str) -> Arrays:
    """Take arrays handed over in Python (NumPy, tensors, lists, pandas), under the rules of files.

    Raises InputError.
    """
    table = table.channels if isinstance(table, Flight) else table
    if not hasattr(table, "keys"):
        raise InputError(place, "", f"is {described(table)}", "a dict of channels: time, controls, p, q, r, ...")
    arrays: Arrays = {}
    for name, value in dict(table).items():
        raw = filled(Argument(place, str(name)), value).detach().cpu() if isinstance(value, Tensor) else value
        try:
            array = numbers_of(raw)
        except (ValueError, OverflowError):
            raise InputError(place, str(name), "is not an array of numbers", "one value per sample") from None
        if array.dtype.kind in "iu":
            array = array.astype(np.float64)
        _check_array(place, str(name), array.shape, array.dtype)
        arrays[str(name)] = array
    return arrays
