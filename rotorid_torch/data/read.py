"""Flight files as they lie on disk: npz and csv to plain float64 arrays, refusing what is not data."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from rotorid_torch.errors import InputError

Arrays = dict[str, np.ndarray]

SAMPLES = 20_000_000
"""Longest flight; a longer one is a damaged or hostile file."""
CHANNELS = 1000
"""Most channels of a flight."""
BYTES = 4 * 2**30
"""Most bytes of a flight, unpacked."""


def find_flight(folder: Path, name: str) -> Path:
    """File of a flight: flights/NAME.npz, else flights/NAME.csv. Raises InputError where neither lies there."""
    for suffix in (".npz", ".csv"):
        path = folder / "flights" / f"{name}{suffix}"
        if path.is_file():
            return path
    path = folder / "flights" / f"{name}.npz"
    raise InputError(path, "", "there is no such file", f"the flight '{name}' of dataset.toml, as .npz or .csv")


def parse_flight(path: Path, content: bytes) -> Arrays:
    """Arrays of a flight file by name, each as stored; `content` are the file's bytes. Raises InputError."""
    if not content:
        raise InputError(
            path, "", "is empty", "one array per channel" if path.suffix == ".npz" else "a header row and numbers"
        )
    return _parse_csv(path, content) if path.suffix == ".csv" else _parse_npz(path, content)


def _parse_npz(path: Path, content: bytes) -> Arrays:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            _check_size(path, members)
            return {m.filename.removesuffix(".npy"): _member(path, archive, m) for m in members}
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError) as error:
        raise InputError(path, "", f"is not a whole npz file ({error})", "an npz as numpy.savez writes it") from None


def _check_size(path: Path, members: list[zipfile.ZipInfo]) -> None:
    total = sum(member.file_size for member in members)
    if len(members) > CHANNELS or total > BYTES:
        told = f"holds {len(members)} arrays of {total / 2**20:.0f} MiB in all"
        raise InputError(path, "", told, f"at most {CHANNELS} channels and {BYTES / 2**20:.0f} MiB")
    seen = set()
    for member in members:
        if member.filename in seen:
            raise InputError(path, member.filename.removesuffix(".npy"), "is there twice", "each channel once")
        seen.add(member.filename)


def _member(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    name = member.filename.removesuffix(".npy")
    with archive.open(member) as stream:
        shape, dtype = _header(path, name, stream)
        _check_array(path, name, shape, dtype)
        expected = int(np.prod(shape)) * dtype.itemsize
        data = stream.read(expected + 1)
    if len(data) != expected:
        raise InputError(path, name, f"has {len(data)} bytes of data", f"{expected} for {shape[0]} samples of {dtype}")
    return np.frombuffer(data, dtype=dtype)


def _header(path: Path, name: str, stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    try:
        version = npy.read_magic(stream)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read(stream)
    except (ValueError, EOFError, SyntaxError, TypeError) as error:
        raise InputError(
            path, name, f"is not an array ({str(error).splitlines()[0]})", "an array of float32 or float64"
        ) from None
    return shape, dtype


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
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, "", f"is not text (byte {error.start})", "csv in UTF-8 with a header row") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise InputError(path, "", "is empty", "a header row and numbers")
    header = [field.strip().strip('"') for field in lines[0][1].split(",")]
    _check_header(path, header)
    table = np.array([_row(path, header, number, line) for number, line in lines[1:]]).reshape(-1, len(header))
    return {name: table[:, column] for column, name in enumerate(header)}


def _check_header(path: Path, header: list[str]) -> None:
    for column, name in enumerate(header, 1):
        if not name:
            raise InputError(path, f"column {column}", "has no name", "a header row with a name per column")
        if header.count(name) > 1:
            raise InputError(path, name, "is there twice", "each channel once")
    if len(header) > CHANNELS:
        raise InputError(path, "", f"has {len(header)} columns", f"at most {CHANNELS}")


def _row(path: Path, header: list[str], number: int, line: str) -> list[float]:
    fields = line.split(",")
    if len(fields) != len(header):
        raise InputError(path, f"line {number}", f"has {len(fields)} fields", f"{len(header)} as in the header row")
    row = []
    for name, field in zip(header, fields, strict=True):
        try:
            row.append(float(field) if field.strip() else float("nan"))
        except ValueError:
            raise InputError(
                path, name, f"is '{field.strip()[:40]}' in line {number}", "a number, or nothing for a missing sample"
            ) from None
    return row


def take_arrays(given: Mapping[str, Any], place: str) -> Arrays:
    """Take arrays handed over in Python (NumPy, tensors, lists), under the rules of files. Raises InputError."""
    arrays: Arrays = {}
    for name, value in given.items():
        raw = value.detach().cpu().numpy() if hasattr(value, "detach") else value
        try:
            array = np.asarray(raw)
        except ValueError:
            raise InputError(place, str(name), "is not an array of numbers", "one value per sample") from None
        if array.dtype.kind in "iu":
            array = array.astype(np.float64)
        _check_array(place, str(name), array.shape, array.dtype)
        arrays[str(name)] = array
    return arrays
