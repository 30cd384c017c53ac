"""A process that begins: its imports, and the memory that it holds on to."""

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

LARGEST, SPARE = -3, -1
"""glibc's numbers: the size from which an array is mapped by itself, and the free memory that is not given back."""
HELD = 1 << 28, 1 << 25
"""Bytes for both, the second where a glibc takes no more: arrays of tens of megabytes come and go, and the system would
clear every page of each anew."""
BETWEEN = 10_000
"""Objects made before Python looks for cycles that nobody uses; it would look at all of a run's every few seconds."""


@contextmanager
def loading() -> Iterator[None]:
    """A block of imports, whose million objects stay: Python does not look among them for what nobody uses any more."""
    if "torch" in sys.modules:  # a command in somebody's process
        yield
        return
    _hold_freed_memory()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.set_threshold(BETWEEN)
        gc.enable()


def _hold_freed_memory() -> None:
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
