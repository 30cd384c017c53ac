"""What is said where native code cannot be had and torch does the work."""

from __future__ import annotations

import functools
import logging


class Unsupported(Exception):
    """A model that cannot become native code, or not on this machine; the text says why."""


@functools.cache
def say_once(text: str) -> None:
    """One line on the error stream, the first time in a process; nothing later."""
    logging.getLogger("rotorid_torch").warning(text)
