"""The folder of a run: written beside its place and renamed when complete, so that it is whole or absent.

While it is written the folder is called `.NAME.RANDOM.partial` and is locked; a lock ends with its process, however
that dies, so that the next run to the same place knows the leftovers of dead ones and removes them.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from rotorid_torch.errors import InputError

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


@contextmanager
def run_folder(out: str | Path) -> Iterator[Path]:
    """Give a folder to write a run into; it takes the place `out` when the block ends without an exception.

    Until then an earlier run at `out` stays as it is; on an exception (Ctrl-C too) what was written is removed.

    Raises
    ------
    InputError : at once, where `out` is in the way and not a run, or its parent is missing or cannot be written to.
    """
    place = Path(out).absolute()
    refuse_unless_free(place)
    partial = _partial_name(place)
    with locked(place.parent):  # making and cleaning exclude each other, so that no folder is seen before its lock
        _clean(place)
        partial.mkdir()
        lock = os.open(partial, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        yield partial
        with locked(place.parent):
            _put_in_place(partial, place)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        os.close(lock)


@contextmanager
def whole_file(out: str | Path) -> Iterator[Path]:
    """Give a file name beside `out` to write to; it is renamed to `out` when the block ends without an exception.

    Raises
    ------
    InputError : at once, where `out` is a folder, or its parent is missing or cannot be written to.
    """
    refuse_unless_file(out)
    place = Path(out).absolute()
    partial = _partial_name(place).with_suffix(place.suffix)
    try:
        yield partial
        partial.replace(place)
    finally:
        partial.unlink(missing_ok=True)


def refuse_unless_file(out: str | Path) -> None:
    """Raise InputError where no file can be written to `out`: a folder lies there, or the parent is no use."""
    place = Path(out).absolute()
    if place.is_dir():
        raise InputError(out, "", "is a folder", "the name of a file to write")
    _refuse_parent(place)


def refuse_unless_free(out: str | Path) -> None:
    """Raise InputError where a run cannot be written to `out`: something else lies there, or the parent is no use."""
    place = Path(out).absolute()
    if (place.exists() or place.is_symlink()) and not is_run(place):
        raise InputError(out, "", "is in the way and is not a run", "a new name, or an earlier RUN to replace")
    _refuse_parent(place)


def is_run(path: Path) -> bool:
    """Whether `path` is a folder with a report.json of ours, of whatever format."""
    try:
        head = msgspec.json.decode((path / "report.json").read_bytes())
    except (OSError, msgspec.DecodeError):
        return False
    return not path.is_symlink() and isinstance(head, dict) and {"format", "rotorid"} <= head.keys()


def _refuse_parent(place: Path) -> None:
    parent = place.parent
    if not parent.is_dir():
        raise InputError(place, "", f"its folder {parent} does not exist", "an existing folder to write in")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(place, "", f"its folder {parent} cannot be written to", "a folder with write permission")


def _partial_name(place: Path) -> Path:
    return place.with_name(f".{place.name}.{secrets.token_hex(4)}.partial")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes of ours out of the same folder until the block ends."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _clean(place: Path) -> None:
    for leftover in place.parent.iterdir():
        if not (leftover.name.startswith(f".{place.name}.") and leftover.name.endswith(".partial")):
            continue
        with suppress(OSError):
            handle = os.open(leftover, os.O_RDONLY)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(leftover, ignore_errors=True)
            finally:
                os.close(handle)


def _put_in_place(partial: Path, place: Path) -> None:
    """Rename; an earlier run is exchanged in one step where the system can, and removed afterwards by the caller."""
    refuse_unless_free(place)
    if not place.exists():
        partial.rename(place)
    elif not _exchange(partial, place):
        earlier = _partial_name(place)
        place.rename(earlier)
        partial.rename(place)
        shutil.rmtree(earlier, ignore_errors=True)


def _exchange(one: Path, other: Path) -> bool:
    """Swap two folders atomically (Linux renameat2); False where that does not exist."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    return renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0
