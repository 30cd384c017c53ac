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
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from rotorid_torch.core.files import read_file
from rotorid_torch.core.paths import absolute, refuse_foreign, same_file
from rotorid_torch.errors import InputError
from rotorid_torch.printable import printable
from rotorid_torch.run.records import LARGEST

FILES = (
    *("report.json", "report.html", "model.pt", "check.json", "log.txt"),
    *("reconstruct/*.npz", "figures/*.png", "tensorboard/*"),
)
"""Files of a run: a folder that holds others is not replaced."""
ALIKE = (("check",), ("reconstruct",), ("identify", "close-loop"))
"""Commands whose runs replace each other; a run with a model is not replaced by one without."""
FREE_RUN = b"rotorid: free run, format 1"
"""Comment of the archive that `simulate` writes: what lies there and has it may be replaced."""
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


@contextmanager
def run_folder(out: str | Path, command: str) -> Iterator[Path]:
    """Give a folder to write a command's run into; it takes the place `out` when the block ends without an exception.

    Until then an earlier run at `out` stays as it is; on an exception (Ctrl-C too) what was written is removed.

    Raises
    ------
    InputError : at once, where `out` is in the way and no run that `command` replaces, or its parent is missing or
        cannot be written to.
    """
    place = absolute(out)
    refuse_unless_free(place, command)
    partial = _partial_name(place)
    with locked(place.parent):  # making and cleaning exclude each other, so that no folder is seen before its lock
        _clean(place)
        partial.mkdir()
        lock = os.open(partial, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        yield partial
        with locked(place.parent):
            _put_in_place(partial, place, command)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        os.close(lock)


@contextmanager
def free_run_file(out: str | Path, *, overwrite: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """Give a file name beside `out` to write an npz to; it is marked as a free run and renamed when the block ends.

    Parameters
    ----------
    overwrite, inputs : as `refuse_unless_free_run`.

    Raises
    ------
    InputError : as `refuse_unless_free_run`, at once and again before the file is renamed.
    """
    place, inputs = absolute(out), tuple(inputs)
    refuse_unless_free_run(place, overwrite=overwrite, inputs=inputs)
    partial = _partial_name(place).with_suffix(place.suffix)
    try:
        yield partial
        with zipfile.ZipFile(partial, "a") as archive:
            archive.comment = FREE_RUN
        refuse_unless_free_run(place, overwrite=overwrite, inputs=inputs)
        partial.replace(place)
    finally:
        partial.unlink(missing_ok=True)


def refuse_unless_free_run(out: str | Path, *, overwrite: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Raise InputError where no free run can be written to `out`: another file lies there, or the parent is no use.

    Parameters
    ----------
    overwrite : replace other files too.
    inputs : files that are read, which nothing replaces, whatever their names.
    """
    place = absolute(out)
    if place.is_dir():
        raise InputError(out, "", "is a folder", "the name of a file to write")
    same = same_file(place, inputs)
    if same is not None:
        raise InputError(out, "", f"is the file {same}, which is read", "another name")
    if os.path.lexists(place) and not is_free_run(place):
        if place.exists() and not place.is_file():
            raise InputError(out, "", "is in the way and is not a file", "a new name")
        if not overwrite:
            wrong = "is in the way and is not a free run that simulate wrote"
            raise InputError(out, "", wrong, "a new name, or --overwrite to replace the file")
    _refuse_parent(place)


def is_free_run(path: Path) -> bool:
    """Whether `path` is a file that `simulate` wrote: a zip archive that ends with our comment."""
    if path.is_symlink() or not path.is_file():
        return False
    with suppress(OSError), path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 22 - len(FREE_RUN)))  # 22 bytes: end of central directory of a zip
        end = file.read(22 + len(FREE_RUN))
        return end.startswith(b"PK\5\6") and end.endswith(FREE_RUN)
    return False


def refuse_unless_free(out: str | Path, command: str) -> None:
    """Raise InputError where a command's run cannot be written to `out`.

    Something lies there that is not a run of the command's kind, or holds files that are not of a run; or the parent is
    no use.
    """
    place = absolute(out)
    if os.path.lexists(place):
        earlier = command_of(place)
        alike = next(commands for commands in ALIKE if command in commands)
        if earlier is None:
            raise InputError(out, "", "is in the way and is not a run", "a new name, or an earlier RUN to replace")
        if earlier not in alike:
            expected = f"a new name, or an earlier RUN of {' or '.join(alike)} to replace"
            raise InputError(out, "", f"is in the way and is a run of {earlier}", expected)
        refuse_foreign(place, FILES, "a run")
    if printable(str(place), layout=False) != str(place):  # what writes for TensorBoard takes names of UTF-8 only
        raise InputError(out, "", "is not a name that can be printed", "a folder's name without control characters")
    _refuse_parent(place)


def command_of(path: Path) -> str | None:
    """Command that wrote the run in the folder `path`, of whatever format; None where `path` is no run."""
    if path.is_symlink():
        return None
    try:
        head = msgspec.json.decode(read_file(path / "report.json", "a report", LARGEST))
    except (ValueError, RecursionError):
        return None
    if not isinstance(head, dict) or not {"format", "rotorid"} <= head.keys():
        return None
    return str(head.get("command"))


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


def _put_in_place(partial: Path, place: Path, command: str) -> None:
    """Rename; an earlier run is exchanged in one step where the system can, and removed afterwards by the caller."""
    refuse_unless_free(place, command)
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
