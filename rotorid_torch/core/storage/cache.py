"""What is kept between runs, such as compiled libraries: sealed files; one that is not right is made anew."""

import os
import re
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rotorid_torch.core.storage.atomic import reason, sweep
from rotorid_torch.core.storage.sealed import Damaged, read_sealed, write_sealed
from rotorid_torch.errors import say_once

MOST = 256 * 2**20
"""Bytes of all files, at most; those that were used last stay."""
DAYS = 90.0
"""Days after which a file that nobody has used goes."""
_NAMES = re.compile(r"[0-9a-f]{24}\.so|(draws|floors)/[0-9a-f]{24}/[0-9]+\.json")
"""Of libraries, of draws, and of those of earlier versions (`floors`)."""


@dataclass(frozen=True)
class Usage:
    """Place, number of files and bytes of all that is kept."""

    folder: str
    files: int
    bytes: int


def cache_folder() -> Path:
    """Where files are kept: ROTORID_CACHE, or the user's cache folder."""
    chosen = os.environ.get("ROTORID_CACHE")
    return (Path(chosen) if chosen else _users_folder() / "rotorid-torch") / "native"


def _users_folder() -> Path:
    chosen = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(chosen) if chosen else Path.home() / ".cache"
    except RuntimeError:  # a user without a home
        return Path(tempfile.gettempdir()) / f"cache-{os.geteuid()}"


def read(name: str) -> bytes | None:
    """Content of a file that `keep` wrote under this name; None where there is none that can be believed.

    One line says where a file is there and is not used.
    """
    file = cache_folder() / name
    try:
        content = read_sealed(file, name)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except Damaged as damage:
        say_once(f"{file.parent}: a kept file {damage}; it is not used and made anew")
        return None
    except OSError as error:
        say_once(f"{file.parent}: a kept file cannot be read ({reason(error)}); it is made anew")
        return None
    with suppress(OSError):
        os.utime(file, follow_symlinks=False)  # when it was used last
    return content


def keep(name: str, content: bytes) -> None:
    """Write a file, whole or not at all. Where that is impossible one line says so: it is only made again later."""
    file = cache_folder() / name
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_sealed(file, name, content)
    except OSError as error:
        say_once(f"{cache_folder()}: nothing can be kept there ({reason(error)}); it is made anew each time")
    _trim()


def discard(name: str) -> None:
    """Remove a file, if it is there."""
    with suppress(OSError):
        (cache_folder() / name).unlink()


def _kept() -> Iterator[tuple[Path, os.stat_result]]:
    """Files of ours with what the system knows of them; of others that lie there nothing is ever removed."""
    folder = cache_folder()
    for file in (*folder.glob("*.so"), *folder.glob("*/*/*.json")):
        with suppress(OSError):
            about = file.lstat()
            if _NAMES.fullmatch(file.relative_to(folder).as_posix()) and not stat.S_ISDIR(about.st_mode):
                yield file, about


def _trim() -> None:
    """Remove what nobody has used for long, and what was used longest ago where there is too much."""
    total, oldest = 0, time.time() - 86400.0 * DAYS
    for file, about in sorted(_kept(), key=lambda one: -one[1].st_mtime):
        total += about.st_size
        if total > MOST or about.st_mtime < oldest:
            with suppress(OSError):
                file.unlink()


def usage() -> Usage:
    """What is kept now."""
    sizes = [about.st_size for _, about in _kept()]
    return Usage(str(cache_folder()), len(sizes), sum(sizes))


def empty() -> Usage:
    """Remove all files; returns what was kept."""
    before = usage()
    for file, _ in list(_kept()):
        file.unlink(missing_ok=True)
    folder = cache_folder()
    drawn = [folder / name for name in ("draws", "floors")]
    for inside in (*(one for place in drawn for one in place.glob("*")), *drawn, folder):
        sweep(inside)
        with suppress(OSError):
            inside.rmdir()
    return before
