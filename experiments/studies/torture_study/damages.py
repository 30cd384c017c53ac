"""Ways in which a file of the cache may be damaged."""

from __future__ import annotations

import json
import os
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

Damage = Callable[[Path, np.random.Generator], object]


def _replaced(file: Path, what: bytes) -> None:
    file.write_bytes(what)


def _cut(file: Path, rng: np.random.Generator) -> None:
    whole = file.read_bytes()
    _replaced(file, whole[: int(rng.uniform(0.02, 0.98) * len(whole))])


def _zeros(file: Path, rng: np.random.Generator) -> None:
    whole = bytearray(file.read_bytes())
    begin = int(rng.uniform(0.0, 0.9) * len(whole))
    size = min(4096, len(whole) - begin)
    whole[begin : begin + size] = bytes(size)
    _replaced(file, bytes(whole))


def _constant(value: float, other: float) -> Damage:
    def damage(file: Path, rng: np.random.Generator) -> None:
        whole, sought = file.read_bytes(), struct.pack("<d", value)
        if sought not in whole:
            raise LookupError(f"no {value} in {file.name}")
        _replaced(file, whole.replace(sought, struct.pack("<d", other)))

    return damage


def _flip(file: Path, rng: np.random.Generator) -> None:
    whole = bytearray(file.read_bytes())
    whole[int(rng.integers(len(whole) // 2))] ^= 1
    _replaced(file, bytes(whole))


def _other_library(file: Path, rng: np.random.Generator) -> None:
    others = [f for f in sorted(file.parent.glob("*.so")) if f != file]
    shutil.copy2(others[0], file)


def _system_library(file: Path, rng: np.random.Generator) -> None:
    _replaced(file, Path(next(Path("/lib").rglob("libm.so.6"))).read_bytes())


def _dangling(file: Path, rng: np.random.Generator) -> None:
    file.unlink()
    file.symlink_to("nowhere")


def _folder(file: Path, rng: np.random.Generator) -> None:
    file.unlink()
    file.mkdir()


def _pipe(file: Path, rng: np.random.Generator) -> None:
    file.unlink()
    os.mkfifo(file)


def _of_other(file: Path, rng: np.random.Generator) -> None:
    os.chown(file, 65534, 65534)


LIBRARY_DAMAGES: dict[str, Damage] = {
    "constant 0.125": _constant(0.125, 0.25),
    "constant 0.5": _constant(0.5, 0.501),
    "constant 2": _constant(2.0, 2.1),
    **{f"cut {k}": _cut for k in range(5)},
    **{f"zeros {k}": _zeros for k in range(5)},
    "empty": lambda file, rng: _replaced(file, b""),
    "text": lambda file, rng: _replaced(file, b"not a library\n" * 99),
    "flipped bit": _flip,
    "appended": lambda file, rng: _replaced(file, file.read_bytes() + b"more"),
    "library of another model": _other_library,
    "library of the system": _system_library,
    "dangling link": _dangling,
    "folder": _folder,
    "pipe": _pipe,
    "writable by all": lambda file, rng: file.chmod(0o666),
    "of another user": _of_other,
    "unreadable": lambda file, rng: file.chmod(0),
}


def _edited(change: Callable[[dict], object]) -> Damage:
    def damage(file: Path, rng: np.random.Generator) -> None:
        text = file.read_text()
        kept, end = json.JSONDecoder().raw_decode(text)
        _replaced(file, (json.dumps(change(kept)) + text[end:]).encode())

    return damage


def _ten_times(kept: dict) -> dict:
    return {**kept, "gains": {name: 10.0 * value for name, value in kept["gains"].items()}}


FLOOR_DAMAGES: dict[str, Damage] = {
    "empty": lambda file, rng: _replaced(file, b""),
    "cut": _cut,
    "no entries": lambda file, rng: _replaced(file, b"{}"),
    "edited gains": _edited(_ten_times),
    "a list": lambda file, rng: _replaced(file, b"[1, 2]"),
    "not numbers": _edited(lambda kept: {**kept, "gains": dict.fromkeys(kept["gains"], None)}),
    "an entry gone": _edited(lambda kept: {k: v for k, v in kept.items() if k != "alike"}),
    "of another draw": lambda file, rng: _replaced(file, sorted(file.parent.glob("*.json"))[-1].read_bytes()),
}
