"""Arrays of an npz by what their headers say, so that a reader judges sizes before it unpacks anything."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.lib import format as npy

from rotorid_torch.errors import InputError

WHOLE = "an npz as numpy.savez writes it"


@dataclass(frozen=True)
class ArrayHeader:
    """What an array of an npz says of itself: shape, order, type of its numbers, and the bytes that it takes."""

    member: zipfile.ZipInfo
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]

    @property
    def bytes(self) -> int:
        """Size of the array in memory."""
        return math.prod(self.shape) * self.dtype.itemsize


@contextmanager
def opened(file: Path, stream: BinaryIO | IO[bytes], most: int) -> Iterator[Npz]:
    """Headers and arrays of an npz of at most so many arrays.

    Raises InputError where the file is no npz, has too many arrays, one of them twice, or a pickled one; whatever
    fails in a damaged archive while the block works is told as that.
    """
    try:
        with zipfile.ZipFile(stream) as archive:
            members = archive.infolist()
            if len(members) > most:
                raise InputError(file, "", f"holds {len(members)} arrays", f"at most {most}")
            yield Npz(file, archive, members)
    except InputError:
        raise
    except Exception as error:  # a damaged archive fails in many ways, none of which is ours
        raise InputError(file, "", f"is not a whole npz file ({error})", WHOLE) from None


class Npz:
    """An open npz; `headers` by the arrays' names."""

    def __init__(self, file: Path, archive: zipfile.ZipFile, members: list[zipfile.ZipInfo]) -> None:
        self._file, self._archive = file, archive
        self.headers: dict[str, ArrayHeader] = {}
        for member in members:
            name = member.filename.removesuffix(".npy")
            if name in self.headers:
                raise InputError(file, name, "is there twice", "each channel once")
            with archive.open(member) as stream:
                self.headers[name] = _header(file, name, member, stream)

    def array(self, name: str) -> np.ndarray:
        """The array of this name; InputError where its bytes are not those that its header tells."""
        header = self.headers[name]
        with self._archive.open(header.member) as stream:
            _header(self._file, name, header.member, stream)
            data = stream.read(header.bytes + 1)
        if len(data) != header.bytes:
            text = f"{header.bytes} for an array of shape {header.shape} of {header.dtype}"
            raise InputError(self._file, name, f"has {len(data)} bytes of data", text)
        if not header.bytes:
            return np.empty(header.shape, header.dtype)
        return np.frombuffer(data, header.dtype).reshape(header.shape, order="F" if header.fortran else "C")


def _header(file: Path, name: str, member: zipfile.ZipInfo, stream: IO[bytes]) -> ArrayHeader:
    try:
        read = npy.read_array_header_1_0 if npy.read_magic(stream) == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    except Exception as error:  # a damaged header fails anywhere in the parser of Python's literals
        text = (str(error).splitlines() or ["an empty one"])[0]
        raise InputError(file, name, f"is not an array ({text[:120]})", "an array of numbers") from None
    if dtype.hasobject:
        raise InputError(file, name, "is a pickled object", "float32 or float64; nothing is unpickled")
    if any(length < 0 for length in shape):
        raise InputError(file, name, f"has the shape {shape}", "an array of numbers")
    return ArrayHeader(member, shape, fortran, dtype)


def refuse_beyond(file: Path, bytes_of: Mapping[str, int], budget: int) -> None:
    """Raise InputError where arrays, by their sizes in bytes, take more than the budget."""
    total = sum(bytes_of.values())
    if total > budget:
        largest = max(bytes_of, key=lambda name: bytes_of[name])
        text = f"unpacks to over {budget / 2**20:.0f} MiB in all"
        raise InputError(file, largest, text, "the arrays of a flight")
