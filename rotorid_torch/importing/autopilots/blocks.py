"""A binary log read block by block, so that memory holds the wanted columns and one block, never the file."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

BLOCK = 16 * 2**20
"""Bytes read at a time."""


class Blocks:
    """The bytes of a file from `start` on; `advance` forgets what lies before a place and reads on.

    `data` are the bytes in memory, `base` the place in the file of the first of them, `last` whether the file ends
    with them.
    """

    def __init__(self, stream: BinaryIO, start: int = 0, block: int = BLOCK) -> None:
        self._stream, self._block = stream, block
        self.data, self.base, self.last = b"", start, False
        stream.seek(start)

    def advance(self, used: int) -> None:
        """Drop the first `used` bytes and append a block."""
        more = self._stream.read(self._block)
        self.last = len(more) < self._block
        self.data, self.base = self.data[used:] + more, self.base + used

    def jump(self, place: int) -> None:
        """Go on at this place of the file."""
        self._stream.seek(place)
        self.data, self.base = b"", place
        self.advance(0)


@dataclass
class Gathered:
    """Wanted columns of one kind of message, block by block.

    `layout` gives per column its name, the place in the message and the type; `size` is the message's least length;
    `places` are those of the messages found in the block at hand.
    """

    layout: Sequence[tuple[str, int, np.dtype]]
    size: int
    places: list[int] = field(default_factory=list)
    parts: list[list[np.ndarray]] = field(default_factory=list)

    def take(self, data: bytes) -> None:
        """Take the columns of the messages found in this block."""
        if not self.places:
            return
        raw, at = np.frombuffer(data, np.uint8), np.asarray(self.places, np.int64)
        part = []
        for _, offset, kind in self.layout:
            picked = raw[(at + offset)[:, None] + np.arange(kind.itemsize)]
            part.append(np.ascontiguousarray(picked).view(kind)[:, 0])
        self.parts.append(part)
        self.places.clear()

    def columns(self) -> dict[str, np.ndarray]:
        """All of each column; the blocks' parts are given up on the way."""
        columns = {}
        for index, (name, _, kind) in enumerate(self.layout):
            columns[name] = np.concatenate([part[index] for part in self.parts] or [np.empty(0, kind)])
            for part in self.parts:
                part[index] = np.empty(0, kind)
        return columns
