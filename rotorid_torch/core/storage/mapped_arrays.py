"""Arrays of many flights whose numbers lie in a temporary file: memory holds only the part that is worked on.

The array is an ordinary tensor; the kernel reads and writes its pages. `let_go` takes those that are in memory out of
the process, so that a sweep over the flights holds a few of them at a time.
"""

import ctypes
import math
import mmap
import os
import sys
import tempfile
import weakref

import torch
from torch import Tensor

from rotorid_torch.core.storage.atomic import writing_temporary

LARGE = 16 * 2**20
"""Bytes from which an array lies in a file; with less it is plain memory."""

_mapped: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()


def empty(*shape: int) -> Tensor:
    """An uninitialised float64 tensor of this shape; where another device is the default, in that device's memory.

    Raises Unwritable: the temporary folder has no room for it.
    """
    size = 8 * math.prod(shape)
    if size == 0 or size < LARGE or sys.platform != "linux" or torch.get_default_device().type != "cpu":
        return torch.empty(shape, dtype=torch.float64)
    with writing_temporary(), tempfile.TemporaryFile(prefix="rotorid-") as file:
        os.posix_fallocate(file.fileno(), 0, size)  # now: a page that finds no room later would end the process
        pages = mmap.mmap(file.fileno(), size)
    _mapped.add(pages)
    return torch.frombuffer(pages, dtype=torch.float64).view(shape)


def copied(tensor: Tensor) -> Tensor:
    """A copy of a float64 tensor."""
    return empty(*tensor.shape).copy_(tensor)


def let_go() -> None:
    """Take the pages of all such arrays out of the process, and memory that was freed.

    The arrays' numbers stay, and come back as they are read. Where there is no such array, nothing is done.
    """
    for pages in list(_mapped):
        pages.madvise(mmap.MADV_DONTNEED)
    if _mapped:
        give_back()


def give_back() -> None:
    """Hand memory that was freed back to the system, of which C's library keeps hundreds of megabytes in pieces."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
        if trim is not None:
            trim(0)
