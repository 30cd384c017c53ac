"""Files of the user: only regular ones are read, and only up to a size, both judged once the file is open.

A pipe, a socket or a device has no end, or blocks for ever; what lies under a name may be exchanged between a look and
the opening, so the open descriptor is asked.
"""

import os
import stat
from pathlib import Path
from typing import BinaryIO

from rotorid_torch.core.storage.atomic import reason
from rotorid_torch.core.storage.paths import nearest_path
from rotorid_torch.errors import InputError

LARGEST = 2**35
"""Bytes of a log that is read piece by piece, at most (32 GiB); a larger one is a damaged or hostile file."""
_KINDS = {
    stat.S_IFDIR: "is a folder",
    stat.S_IFIFO: "is a pipe",
    stat.S_IFSOCK: "is a socket",
    stat.S_IFCHR: "is a device",
    stat.S_IFBLK: "is a device",
}


def open_file(path: str | Path, expected: str, limit: int = LARGEST) -> BinaryIO:
    """Open a regular file of at most `limit` bytes for reading.

    expected : what the file should have been, for the message.

    Raises InputError: there is no such file, it cannot be read, is no regular file or is too large.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)  # a pipe does not block
    except FileNotFoundError:
        raise InputError(path, "", f"there is no such file{nearest_path(path)}", expected) from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise InputError(path, "", f"cannot be read ({reason(error)})", expected) from None
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise InputError(path, "", _KINDS.get(stat.S_IFMT(status.st_mode), "is no regular file"), expected)
        if status.st_size > limit:
            raise InputError(path, "", f"has {status.st_size} bytes", f"{expected}, of at most {limit} bytes")
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_file(path: str | Path, expected: str, limit: int) -> bytes:
    """Read all of a regular file of at most `limit` bytes. Raises InputError, as `open_file` does."""
    with open_file(path, expected, limit) as stream:
        try:
            content = stream.read(limit + 1)  # the file may have grown, and some of the system's tell no size
        except OSError as error:
            raise InputError(path, "", f"cannot be read ({reason(error)})", expected) from None
    if len(content) > limit:
        raise InputError(path, "", f"has over {limit} bytes", f"{expected}, of at most {limit} bytes")
    return content
