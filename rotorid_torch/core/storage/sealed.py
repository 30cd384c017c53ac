"""Files that are checked before anything in them is believed.

A sealed file ends with a digest of its name and content, belongs to the user who runs, and cannot be written by others:
what was cut short, changed, or laid there by somebody else is not used. It is read once, and what was checked is what
is handed out: a file that changes afterwards has no part in it.
"""

import hashlib
import os
import stat
from pathlib import Path

from rotorid_torch.core.storage.atomic import make_private_file, partial

LARGEST = 2**30
"""Bytes of a file, at most."""
_MARK, _DIGITS = b"\nrotorid sha256 ", 64


class Damaged(Exception):
    """A file that is not as it was written; the text says in which way."""


def write_sealed(file: Path, name: str, content: bytes) -> None:
    """Write a file, whole or not at all. Raises OSError."""
    with partial(file, make_private_file) as path:
        with path.open("wb") as stream:
            stream.write(content)
            stream.write(_ending(name, content))
        if file.is_dir() and not file.is_symlink():
            file.rmdir()
        path.replace(file)


def read_sealed(file: Path, name: str) -> bytes:
    """Content of a file that was written under this name. Raises Damaged, and OSError where there is none."""
    if file.is_symlink():
        raise Damaged("is a link")
    handle = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOFOLLOW)  # a pipe does not make it wait
    with open(handle, "rb") as stream:
        about = os.fstat(handle)
        if not stat.S_ISREG(about.st_mode):
            raise Damaged("is no file")
        if about.st_uid != os.geteuid() or about.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise Damaged("belongs to another user or can be written by others")
        if about.st_size > LARGEST:
            raise Damaged("is too large")
        whole = stream.read(LARGEST)
    end = len(whole) - len(_MARK) - _DIGITS
    content = whole[: max(end, 0)]
    if whole[max(end, 0) :] != _ending(name, content):
        raise Damaged("is cut short or changed")
    return content


def _ending(name: str, content: bytes) -> bytes:
    digest = hashlib.sha256(f"{name}\0".encode())
    digest.update(content)
    return _MARK + digest.hexdigest().encode()
