"""Memory that a process has let go of, for its next arrays."""

import ctypes
import sys

LARGEST, SPARE = -3, -1
"""glibc's numbers: the size from which an array is mapped by itself, and the free memory that is not given back."""
HELD = 1 << 28, 1 << 25
"""Bytes for both, the second where a glibc takes no more: arrays of tens of megabytes come and go, and the system would
clear every page of each anew."""


def hold_freed_memory() -> None:
    """Freed memory stays with the process and serves again; where the allocator is another than glibc's, as it likes.

    Source: mallopt(3), M_MMAP_THRESHOLD and M_TRIM_THRESHOLD.
    """
    if sys.platform != "linux":
        return
    library = ctypes.CDLL(None)
    for size in HELD if hasattr(library, "mallopt") else ():
        if library.mallopt(LARGEST, size):
            library.mallopt(SPARE, size)
            return
