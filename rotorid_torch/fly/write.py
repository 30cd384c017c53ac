"""Writes a flown data set: dataset.toml, flights/, truth/, in a folder that is whole or absent."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.fly.section import Array


def write_dataset(
    out: Path,
    declaration: Mapping[str, Any],
    flights: Mapping[str, Mapping[str, Array]],
    truth: Mapping[str, Mapping[str, Array]],
) -> None:
    """Write a data set beside its place and rename it when complete.

    Raises
    ------
    InputError : something is in the way, or the place cannot be written.
    """
    refuse_existing(out)
    partial = out.with_name(f".{out.name}.partial-{os.getpid()}")
    try:
        for folder, contents in (("flights", flights), ("truth", truth)):
            (partial / folder).mkdir(parents=True)
            for name, channels in contents.items():
                np.savez(partial / folder / f"{name}.npz", **channels)  # pyright: ignore[reportArgumentType]
        (partial / "dataset.toml").write_text(to_toml(declaration), encoding="utf-8")
        partial.rename(out)
    except OSError as error:
        raise InputError(
            out, "", error.strerror or "cannot be written", "a place where files can be written"
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def refuse_existing(out: Path) -> None:
    """Raise InputError if something is in the way, or there is no folder to put the data set in."""
    if out.exists() or out.is_symlink():
        raise InputError(out, "", "is in the way", "the name of a data set that does not exist yet")
    if not out.absolute().parent.is_dir():
        raise InputError(out, "", f"there is no folder {out.absolute().parent}", "a place in a folder that exists")


def to_toml(table: Mapping[str, Any], prefix: str = "") -> str:
    """A mapping of numbers, strings, lists and mappings as toml."""
    plain = [f"{_key(key)} = {_value(value)}" for key, value in table.items() if not isinstance(value, Mapping)]
    text = "\n".join([f"[{prefix}]", *plain] if prefix and (plain or not table) else plain)
    parts = [text] if text else []
    for key, value in table.items():
        if isinstance(value, Mapping):
            parts.append(to_toml(value, f"{prefix}.{_key(key)}" if prefix else _key(key)).rstrip())
    return "\n\n".join(part for part in parts if part) + "\n"


def _key(key: str) -> str:
    """A key, quoted where it must be."""
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else json.dumps(key)


def _value(value: Any) -> str:
    """A toml value."""
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float | np.floating):
        text = repr(float(value))
        return text if any(mark in text for mark in ".en") else text + ".0"
    return str(value) if isinstance(value, int) else json.dumps(str(value))
