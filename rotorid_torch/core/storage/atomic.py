"""Files and folders that are whole or absent: written beside their place, renamed when complete.

Until then such a one is called `.NAME.rotorid-XXXXXXXX.partial` and is locked. A lock ends with its process, however
that dies: whoever writes next into the same folder can tell leftovers of the dead from what is alive, and removes them.
"""

import ctypes
import errno
import fcntl
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rotorid_torch.errors import InputError

_HIDDEN = re.compile(r"\.(?P<name>.+)\.rotorid-[0-9a-f]{8}\.(?P<state>partial|earlier)", re.DOTALL)
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
ROOM = "a place with room and with permission to write"
OUTPUT = "standard output"
"""The place that commands print to."""
TEMPORARY = "room for temporary files; TMPDIR names another folder"
_OF_DISKS = (None, *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM))
"""Errors that a write may end with, which names no file; None where numpy tells how many bytes it could write."""


class Unwritable(InputError):
    """A place that cannot be written to."""


@contextmanager
def atomic_folder(place: Path, refuse: Callable[[], None]) -> Iterator[Path]:
    """Give a folder to write into; it takes the place when the block ends without an exception.

    What lies at the place stays as it is until then, and is exchanged in one step. On an exception (Ctrl-C too) what
    was written is removed.

    place : absolute path. refuse : raises where something lies there that is not to be replaced; asked at both ends.

    Raises Unwritable: the place cannot be written to.
    """
    refuse()
    with suppress(OSError):
        sweep(Path(tempfile.gettempdir()))
    with writing(place), partial(place, Path.mkdir) as path:
        yield path
        refuse()
        _replace(path, place)


@contextmanager
def atomic_file(place: Path, refuse: Callable[[], None] = lambda: None) -> Iterator[Path]:
    """The same for a file, which is empty first.

    Raises Unwritable: the place cannot be written to.
    """
    refuse()
    with writing(place), partial(place, lambda path: path.touch(exist_ok=False)) as path:
        yield path
        refuse()
        path.replace(place)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Give a folder in the temporary folder that only this user can read; removed when the block ends.

    Raises Unwritable: the temporary folder cannot be written to.
    """
    with writing_temporary(), partial(Path(tempfile.gettempdir(), "scratch"), lambda p: p.mkdir(mode=0o700)) as path:
        yield path


@contextmanager
def partial(place: Path, make: Callable[[Path], None]) -> Iterator[Path]:
    """Give something new beside a place, locked; it is removed when the block ends, whatever it is by then."""
    sweep(place.parent)
    path, lock = _begun(place, make)
    try:
        yield path
    finally:
        try:
            remove(path)
        finally:
            os.close(lock)


def _begun(place: Path, make: Callable[[Path], None]) -> tuple[Path, int]:
    while True:
        path = _beside(place, "partial")
        make(path)
        with suppress(FileNotFoundError):  # swept by another process before it was locked
            lock = _lock(path)
            if path.exists():
                return path, lock
            os.close(lock)


def make_private_file(path: Path) -> None:
    """Make a file that others can neither read nor write."""
    path.touch(mode=0o600, exist_ok=False)


def sweep(folder: Path) -> None:
    """Remove what dead processes of this user left half-written in a folder; put back what they were to replace."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in list(entries):
            hidden = _HIDDEN.fullmatch(entry.name)
            with suppress(OSError):
                if hidden is None or entry.stat(follow_symlinks=False).st_uid != os.geteuid():
                    continue
                if hidden["state"] == "earlier":
                    _put_back(Path(entry.path), folder / hidden["name"])
                else:
                    lock = _lock(Path(entry.path), wait=False)
                    _remove(Path(entry.path))
                    os.close(lock)


def restore(place: Path) -> None:
    """Put back what a process was to replace and hid, where it died before the new one took the place."""
    if not os.path.lexists(place):
        with suppress(OSError):
            for path in place.absolute().parent.iterdir():
                hidden = _HIDDEN.fullmatch(path.name)
                if hidden and hidden["state"] == "earlier" and hidden["name"] == place.name:
                    _put_back(path, place)


def _put_back(earlier: Path, place: Path) -> None:
    with suppress(FileNotFoundError):
        if not os.path.lexists(place):
            earlier.rename(place)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there; an interrupt in the midst of that takes effect afterwards."""
    try:
        _remove(path)
    except KeyboardInterrupt:
        _remove(path)
        raise


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def _beside(place: Path, state: str) -> Path:
    return place.with_name(f".{place.name}.rotorid-{secrets.token_hex(4)}.{state}")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes of ours out of the same folder until the block ends."""
    lock = _lock(folder)
    try:
        yield
    finally:
        os.close(lock)


def _lock(path: Path, wait: bool = True) -> int:
    """Open file whose lock is held. OSError without `wait` where another process holds it, or nobody can."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        if not wait:
            os.close(handle)
            raise
        # a file system without locks: nobody can take this for a leftover, for nobody gets the lock
    return handle


def _replace(path: Path, place: Path) -> None:
    """Rename; what lies at the place is exchanged in one step where the system can, and removed by the caller."""
    hidden: list[Path] = []
    try:
        while True:
            if os.path.lexists(place):
                if _exchange(path, place):
                    break
                hidden.append(_beside(place, "earlier"))  # a process that dies now leaves it to be put back
                place.rename(hidden[-1])
            try:
                path.rename(place)
                break
            except OSError as error:  # another process was faster, or has put back what was here
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
    except BaseException:
        for earlier in hidden:
            _put_back(earlier, place)
        raise
    for earlier in hidden:
        with suppress(FileNotFoundError):
            _remove(earlier.rename(_beside(place, "partial")))


def _exchange(one: Path, other: Path) -> bool:
    """Swap two names atomically (Linux renameat2); False where the system or its file system cannot."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    return renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0


def refuse_unless_writable(place: Path, parents: bool = False) -> None:
    """Raise Unwritable where nothing can be written at a place; tried with an empty folder beside it.

    place : absolute path. parents : folders above the place that are missing will be made.
    """
    parent = place.parent
    while parents and not os.path.lexists(parent):
        parent = parent.parent
    if not os.path.isdir(parent):
        raise Unwritable(place, "", f"its folder {parent} {_missing(parent)}", "an existing folder to write in")
    if os.path.ismount(place):
        raise Unwritable(place, "", "is a mount point and cannot be replaced", "a new name inside it")
    try:
        with partial(parent / place.name, Path.mkdir):
            pass
    except OSError as error:
        raise Unwritable(place, "", f"its folder {parent} cannot be written to ({reason(error)})", ROOM) from error


def _missing(folder: Path) -> str:
    try:
        os.stat(folder)
    except PermissionError as error:
        return f"cannot be reached ({reason(error)})"
    except OSError:
        return "does not exist"
    return "is not a folder"


@contextmanager
def writing(place: str | Path, expected: str = ROOM) -> Iterator[None]:
    """Turn what the system says against writing to a place into an Unwritable that names the place."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        if not (error.errno in _OF_DISKS if error.filename is None else _of_place(error.filename, place)):
            raise
        raise Unwritable(place, "", f"cannot be written to ({reason(error)})", expected) from error


@contextmanager
def writing_temporary() -> Iterator[None]:
    """The same for the temporary folder."""
    try:
        place = tempfile.gettempdir()
    except OSError as error:  # none of those that Python tries can be written to
        named = os.environ.get("TMPDIR", "/tmp")
        raise Unwritable(named, "", "cannot be written to", TEMPORARY) from error
    with writing(place, TEMPORARY):
        yield


def _of_place(file: object, place: str | Path) -> bool:
    """Whether a file that the system names is the place, lies in it, or is what shall take it."""
    path, root = Path(os.fsdecode(file)) if isinstance(file, str | bytes) else Path(str(file)), Path(place)
    return path == root or root in path.parents or any(_HIDDEN.fullmatch(part) for part in path.parts)


def reason(error: OSError | ValueError) -> str:
    """What the system says, without number and name."""
    return getattr(error, "strerror", None) or " ".join(str(error).split())[:120]
