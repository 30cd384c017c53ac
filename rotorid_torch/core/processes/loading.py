"""The imports of a process that begins."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rotorid_torch.core.processes.memory import hold_freed_memory

BETWEEN = 10_000
"""Objects made before Python looks for cycles that nobody uses; it would look at all of a run's every few seconds."""


@contextmanager
def loading() -> Iterator[None]:
    """A block of imports, whose million objects stay: Python does not look among them for what nobody uses any more."""
    if "torch" in sys.modules:  # a command in somebody's process
        yield
        return
    hold_freed_memory()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.set_threshold(BETWEEN)
        gc.enable()
