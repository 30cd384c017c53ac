"""ArduPilot's logs as text (.log of Mission Planner): the messages of a DataFlash log, one a line, in their units.

Source: ArduPilot developer guide, "Downloading and Analyzing Data Logs in Mission Planner".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from rotorid_torch.core.storage.files import open_file
from rotorid_torch.errors import InputError
from rotorid_torch.importing.autopilots.dataflash import (
    CLOCKS,
    HEAD,
    Formats,
    Topic,
    log_of,
    numbering,
    read_dataflash,
    wanted_of,
)
from rotorid_torch.importing.signals.streams import Choose, Log

LONGEST = 2**16
"""Bytes of a line that is read; what is longer is damaged."""
TEXTS, WHOLE = "nNZ", "bBhHiIqQ"
"""Letters of a format that stand for text, and for whole numbers."""
KINDS, BEGINNING = 512, 50
"""Kinds of messages that are kept, and lines before the first message that may say what flew."""
BYTES = 64
"""Bytes of a text that are kept."""


def read_text_or_dataflash(file: Path, choose: Choose) -> Log:
    """Read an ArduPilot log by what it holds: both forms are named `.log`. Raises InputError where it is neither."""
    with open_file(file, "a log") as stream:
        if stream.read(len(HEAD)) != HEAD:
            stream.seek(0)
            return _Walk(choose).all(file, stream)
    return read_dataflash(file, choose)


@dataclass
class _Kind:
    """One kind of message: its columns with their letters, and the texts of those that are wanted, by their place."""

    name: str
    letters: dict[str, str]
    instance: str = ""
    gathered: dict[int, list[str]] = field(default_factory=dict)


class _Walk:
    """One pass over the lines."""

    def __init__(self, choose: Choose) -> None:
        self.choose = choose
        self.kinds: dict[str, _Kind] = {}
        self.numbers: dict[str, str] = {}
        self.before: list[str] = []
        self.odd = 0
        self.formats = Formats()
        self.has_units = False

    def all(self, file: Path, stream: BinaryIO) -> Log:
        """Walk to the file's end."""
        for line in _lines(stream):
            name, *values = [part.strip() for part in line.split(",")]
            if name == "FMT":
                self._format(values)
            elif name == "FMTU":
                self._units(values)
            elif (kind := self.kinds.get(name)) is not None:
                self._take(kind, values)
            elif not self.kinds and len(self.before) < BEGINNING:
                self.before.append(line.strip())
            elif not self.kinds:
                break
        if not self.kinds:
            raise InputError(
                file, "", "is no log of ArduPilot (no line begins with FMT)", "its .bin, or the .log of it"
            )
        self.formats.refuse(file)
        return self._log(file)

    def _format(self, values: list[str]) -> None:
        """FMT, number, length, name, letters, columns."""
        if len(values) < 5 or len(self.kinds) >= KINDS:
            return
        number, _, name, letters, *columns = values
        kind, there = _Kind(name, dict(zip(columns, letters, strict=False))), self.kinds.get(name)
        other = there is not None and [*there.letters.items()] != [*kind.letters.items()]
        self.formats.take(values, name, other or self.numbers.get(number, name) != name)
        if there is not None:
            return
        wanted = wanted_of(name, list(kind.letters), self.choose)
        if wanted:
            names = {*wanted, *CLOCKS, numbering(name, kind.letters)}
            kind.gathered = {place: [] for place, column in enumerate(kind.letters) if column in names}
        self.kinds[name], self.numbers[number] = kind, name

    def _units(self, values: list[str]) -> None:
        """FMTU, time, number, units, multipliers; the unit `#` marks the column that numbers a topic's instances."""
        self.has_units = True
        kind = self.kinds.get(self.numbers.get(values[1], "")) if len(values) > 2 else None
        at = values[2].find("#") if kind else -1
        if kind and kind.gathered and 0 <= at < len(kind.letters):
            if not any(kind.gathered.values()):
                kind.gathered.setdefault(at, [])
            kind.instance = list(kind.letters)[at] if at in kind.gathered else ""

    def _take(self, kind: _Kind, values: list[str]) -> None:
        """One message; a text at its end may hold commas."""
        count = len(kind.letters)
        if len(values) > count and list(kind.letters.values())[-1:] in (["Z"], ["N"]):
            values = [*values[: count - 1], ", ".join(values[count - 1 :])]
        if len(values) != count:
            self.odd += 1
            return
        for place, texts in kind.gathered.items():
            texts.append(values[place])

    def _log(self, file: Path) -> Log:
        topics = (self._topic(kind) for kind in self.kinds.values() if kind.gathered)
        log = log_of(file, topics, {name: list(kind.letters) for name, kind in self.kinds.items()})
        lines = f"{self.odd} lines do not fit their topic and were passed over"
        about = "; ".join([*filter(None, (log.about,)), *filter(None, self.before[:3])])
        return replace(log, about=about, warnings=(lines,) if self.odd else ())

    def _topic(self, kind: _Kind) -> Topic:
        listed = list(kind.letters.items())
        columns = {listed[place][0]: _column(texts, listed[place][1]) for place, texts in kind.gathered.items()}
        by_name = "" if self.has_units else numbering(kind.name, kind.letters)
        return Topic(kind.name, columns, kind.instance or by_name)


def _lines(stream: BinaryIO) -> Iterator[str]:
    """Lines as text; what is longer than a message is left out."""
    while data := stream.readline(LONGEST):
        if len(data) < LONGEST:
            yield data.decode("utf-8", "replace")
            continue
        while data and not data.endswith(b"\n"):
            data = stream.readline(LONGEST)


def _column(texts: list[str], letter: str) -> np.ndarray:
    """Column (T,) as a binary log has it: text in bytes, numbers as they are, one that cannot be read as NaN."""
    if letter in TEXTS:
        return np.array([text.encode()[:BYTES] for text in texts], f"S{BYTES}")
    values = np.array([_number(text) for text in texts], np.float64)
    whole = letter in WHOLE and bool((np.abs(values) < 2.0**53).all()) and bool((values % 1.0 == 0.0).all())
    return values.astype(np.int64) if whole else values


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan
