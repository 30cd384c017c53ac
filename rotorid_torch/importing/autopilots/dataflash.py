"""ArduPilot DataFlash and the older PX4 sdlog2, which share their framing, block by block. Own code, as for ULog.

Source: ArduPilot developer guide, "Downloading and Analyzing Data Logs in Mission Planner"; AP_Logger, LogStructure.h.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from rotorid_torch.core.storage.files import open_file
from rotorid_torch.errors import InputError
from rotorid_torch.importing.autopilots.blocks import BLOCK, Blocks, Gathered
from rotorid_torch.importing.signals.streams import Choose, Log, Stream, is_numbers, of_damage

HEAD = b"\xa3\x95"
FORMAT = 0x80
TYPES = {
    **{"b": ("<i1", 1.0), "B": ("<u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0)},
    **{"I": ("<u4", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0), "g": ("<f2", 1.0), "f": ("<f4", 1.0)},
    **{"d": ("<f8", 1.0), "M": ("<u1", 1.0), "n": ("S4", 1.0), "N": ("S16", 1.0), "Z": ("S64", 1.0)},
    **{"c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7)},
    "a": ("S64", 1.0),  # 32 numbers of a batch sampler: one field, never a channel
}
"""Type and factor of every letter of a format."""
NUMBERED = ("I", "Inst", "Instance")
"""Names of the field that numbers the instances of a topic, in ArduPilot's logs that have no units (FMTU) at all."""
CORE, CORES = "C", ("XK", "NK")
"""The same in the topics of the estimators, which begin so."""
CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}
"""Clocks of a topic, with seconds of a count."""
INSTANCES = 32
"""Instances of a topic that are kept."""
MESSAGES = 10_000
"""Messages for people that are kept."""
ALWAYS = {"PARM": ("Name", "Value"), "MSG": ("Message",), "VER": ("Arch",)}
"""What is read of every log: parameters and what it says of itself."""


@dataclass
class _Kind:
    """One kind of message: its name, length with the header, columns, and what is gathered of it.

    `instance` is the column that numbers the topic's instances by its unit, `numbered` by its name alone.
    """

    name: str
    length: int
    columns: dict[str, tuple[int, str]]
    gathered: Gathered | None = None
    factors: list[float] = field(default_factory=list)
    instance: str = ""
    numbered: str = ""
    stamps: array[int] = field(default_factory=lambda: array("q"))


def read_dataflash(file: Path, choose: Choose, block: int = BLOCK) -> Log:
    """Read a DataFlash or sdlog2 log; `choose` says which fields are kept. A cut end is told in the warnings.

    Raises InputError where the file is no such log.
    """
    walk = _Walk(choose)
    with open_file(file, "a log") as stream:
        if stream.read(3) != HEAD + bytes([FORMAT]):
            raise InputError(file, "", "is not a DataFlash log (it begins otherwise)", "a .bin of ArduPilot")
        walk.all(Blocks(stream, 0, block))
    walk.formats.refuse(file)
    return walk.log(file)


@dataclass
class Formats:
    """The definitions of messages in a file; the first one comes again where another log was joined to it."""

    first: object = None
    joined: bool = False
    changed: str = ""

    def take(self, form: object, name: str, known: bool) -> None:
        """A definition of the messages of a name; known : whether its name or number has been another one's."""
        self.joined = self.joined or form == self.first
        self.first = self.first or form
        self.changed = self.changed or (name if self.joined and known else "")

    def refuse(self, file: Path) -> None:
        """Raise InputError where a message is another one, or has other columns, in a second log."""
        if self.changed:
            wrong = "is defined anew: logs whose messages differ are joined"
            raise InputError(file, self.changed, wrong, "one log in a file; several files are imported together")


class _Walk:
    """One pass over the messages."""

    def __init__(self, choose: Choose) -> None:
        self.choose = choose
        self.kinds: dict[int, _Kind] = {FORMAT: _kind("FMT", 89, "BBnNZ", "Type,Length,Name,Format,Columns")}
        self.skipped = self.left = 0
        self.now = -1
        self.has_units = False
        self.bad_formats: list[str] = []
        self.formats = Formats()

    def all(self, blocks: Blocks) -> None:
        """Walk to the file's end."""
        blocks.advance(0)
        while True:
            used = self._block(blocks.data, blocks.last)
            for kind in self.kinds.values():
                if kind.gathered:
                    kind.gathered.take(blocks.data)
            if blocks.last:
                self.left = len(blocks.data) - used
                return
            blocks.advance(used)

    def _block(self, data: bytes, last: bool) -> int:
        """Walk the messages that are whole in memory; bytes used."""
        end, place, kinds = len(data), 0, self.kinds
        while place + 3 <= end:
            kind = kinds.get(data[place + 2]) if data[place] == 0xA3 and data[place + 1] == 0x95 else None
            if kind is None:
                place = self._next(data, place, last)
                continue
            if place + kind.length > end:
                break
            if kind.gathered is not None:
                kind.gathered.places.append(place)
                if self.now >= 0:
                    kind.stamps.append(self.now)
            if kind.name in _RARE:
                self._rare(kind, data[place : place + kind.length])
            place += kind.length
        return place

    def _next(self, data: bytes, place: int, last: bool) -> int:
        head = data.find(HEAD, place + 1)
        after = head if head >= 0 else len(data) if last else len(data) - 1
        if any(data[place:after]) and set(data[place:after]) != {0xFF}:  # erased flash is no loss
            self.skipped += after - place
        return after

    def _rare(self, kind: _Kind, data: bytes) -> None:
        if kind.name == "FMT":
            number, length, name, form, columns = data[3], data[4], data[5:9], data[9:25], data[25:89]
            self._format(number, length, _text(name), _text(form), _text(columns))
        elif kind.name == "TIME" and "StartTime" in kind.columns:
            place, _ = kind.columns["StartTime"]
            self.now = int.from_bytes(data[place : place + 8], "little") & (2**63 - 1)
        elif kind.name == "FMTU" and {"FmtType", "UnitIds"} <= {*kind.columns}:
            place = kind.columns["UnitIds"][0]
            self._units(data[kind.columns["FmtType"][0]], _text(data[place : place + 16]))

    def _format(self, number: int, length: int, name: str, form: str, columns: str) -> None:
        kind, there = _kind(name, length, form, columns), self.kinds.get(number)
        again = there is not None and (there.name, there.columns) == (name, kind.columns)
        taken = there is not None or any(kind.name == name for kind in self.kinds.values())
        self.formats.take((number, name, form, columns), name, taken and not again)
        if taken:
            self.bad_formats += [name] if there is None else []
            return
        if length < 3 or (not kind.columns and columns):
            self.bad_formats.append(name)
        if length >= 3:  # a shorter one would never end
            self.kinds[number] = kind
            self._want(kind)

    def _want(self, kind: _Kind) -> None:
        """Gather of this kind what is wanted, its clock and the number of its instance."""
        wanted = wanted_of(kind.name, list(kind.columns), self.choose)
        if not wanted:
            return
        kind.numbered = numbering(kind.name, {column: letter for column, (_, letter) in kind.columns.items()})
        names = {*wanted, kind.instance, kind.numbered, *CLOCKS} & {*kind.columns}
        layout = [(c, place, np.dtype(TYPES[f][0])) for c, (place, f) in kind.columns.items() if c in names]
        kind.factors = [TYPES[kind.columns[c][1]][1] for c, *_ in layout]
        kind.gathered = Gathered(layout, kind.length)

    def _units(self, number: int, units: str) -> None:
        """The unit `#` marks the field that numbers a topic's instances."""
        kind, at, self.has_units = self.kinds.get(number), units.find("#"), True
        if kind is None or not 0 <= at < len(kind.columns):
            return
        column = list(kind.columns)[at]
        if not (kind.gathered and kind.gathered.places):
            kind.instance = column
            self._want(kind)
        elif column == kind.numbered:  # samples may come before the units
            kind.instance = column

    def log(self, file: Path) -> Log:
        """All that was read."""
        by_name = self.now < 0 and not self.has_units
        topics = (
            Topic(kind.name, _scaled(kind), kind.instance or (kind.numbered if by_name else ""), kind.stamps)
            for kind in self.kinds.values()
            if kind.gathered is not None
        )
        fields = {kind.name: list(kind.columns) for kind in self.kinds.values()}
        log = log_of(file, topics, fields)
        return replace(log, system="PX4" if self.now >= 0 else "ArduPilot", warnings=tuple(self._warnings()))

    def _warnings(self) -> Iterator[str]:
        yield from of_damage(self.left, self.skipped)
        if self.bad_formats:
            yield f"messages of unknown form were passed over ({', '.join(self.bad_formats[:5])})"


def wanted_of(topic: str, columns: Sequence[str], choose: Choose) -> list[str]:
    """Columns of a topic that are gathered; none where nothing of it is wanted."""
    return [column for column in (*choose(topic, columns), *ALWAYS.get(topic, ())) if column in columns]


def numbering(topic: str, letters: Mapping[str, str]) -> str:
    """Column (by its letter a small number) that numbers the instances of a topic by its name; empty without one."""
    likely = (*NUMBERED, CORE) if topic.startswith(CORES) else NUMBERED
    return next((column for column in likely if letters.get(column) == "B"), "")


_NONE = np.empty(0, "S1")
"""A column that is not there."""
_RARE = frozenset(("FMT", "TIME", "FMTU"))


def _kind(name: str, length: int, form: str, columns: str) -> _Kind:
    """Kind of message from its format; without columns where they do not fit its length."""
    placed, place = {}, 3
    for letter, column in zip(form, filter(None, columns.split(",")), strict=False):
        if letter not in TYPES:
            return _Kind(name, length, {})
        placed[column] = (place, letter)
        place += np.dtype(TYPES[letter][0]).itemsize
    return _Kind(name, length, placed if place <= length else {})


def _scaled(kind: _Kind) -> dict[str, np.ndarray]:
    """Columns of a kind as they are meant: some letters of a format stand for hundredths."""
    columns = kind.gathered.columns() if kind.gathered else {}
    with np.errstate(all="ignore"):  # whatever bytes a damaged log holds
        pairs = zip(columns.items(), kind.factors, strict=True)
        return {name: values if factor == 1.0 else values * factor for (name, values), factor in pairs}


@dataclass(frozen=True)
class Topic:
    """One kind of message as read: columns (T,), the column that numbers its instances, stamps in us apart from them.

    `numbered` is empty, and so are the stamps, where there are none.
    """

    name: str
    columns: dict[str, np.ndarray]
    numbered: str
    stamps: Sequence[int] = ()


def log_of(file: Path, topics: Iterable[Topic], fields: Mapping[str, Sequence[str]]) -> Log:
    """Log of ArduPilot's topics: streams by their clocks and instances, settings, what it tells people."""
    streams, texts, messages = {}, [], []
    settings: list[tuple[str, float]] = []
    for topic in topics:
        if topic.name == "PARM":
            settings += _settings(topic.columns)
        elif topic.name in ALWAYS:
            said = topic.columns.get(ALWAYS[topic.name][0], np.empty(0))[:MESSAGES]
            texts += [_text(bytes(text)) for text in said[:100] if isinstance(text, bytes)]
            messages += _timed(topic.columns, said)
        else:
            streams |= _instances(topic)
    about, earlier = "; ".join(texts), dict(reversed(settings))
    return Log(file, "ArduPilot", about, streams, fields, dict(settings), (), tuple(messages), earlier)


def _instances(topic: Topic) -> dict[tuple[str, int], Stream]:
    """Streams of a topic, one per number in a column of it, with time in s; none where nothing says when."""
    columns = topic.columns
    clock = _clock(columns)
    time = np.array(topic.stamps) * 1e-6 if clock is None else clock
    columns = {name: values[len(values) - len(time) :] for name, values in columns.items()}  # before any clock: lost
    if not len(time):
        return {}
    numbers = columns.get(topic.numbered, _NONE)
    if numbers.dtype.kind not in "iu":
        return {(topic.name, 0): Stream(time, columns)}
    streams = {}
    for number in np.unique(numbers)[:INSTANCES]:
        chosen = numbers == number
        picked = {name: values[chosen] for name, values in columns.items()}
        streams[topic.name, int(number)] = Stream(time[chosen], picked)
    return streams


def _clock(columns: dict[str, np.ndarray]) -> np.ndarray | None:
    """Time (T,) in s by a topic's own stamps, which are taken out of its columns; None where it has none."""
    clocks = {name: columns.pop(name) for name in CLOCKS if name in columns}
    return next((clocks[name] * CLOCKS[name] for name in clocks if is_numbers(clocks[name])), None)


def _timed(columns: dict[str, np.ndarray], said: np.ndarray) -> list[tuple[float, str]]:
    """Messages for people with the times at which they were written."""
    time = _clock(columns)
    pairs = zip(time.tolist(), said, strict=False) if time is not None else ()
    return [(float(t), _text(bytes(text))) for t, text in pairs if isinstance(text, bytes)]


def _settings(columns: Mapping[str, np.ndarray]) -> list[tuple[str, float]]:
    """Settings by name, in the order in which they were logged."""
    texts, values = columns.get("Name", np.empty(0)), columns.get("Value", np.empty(0))
    if texts.dtype.kind != "S" or values.dtype.kind != "f":
        return []
    return [(_text(bytes(n)), float(v)) for n, v in zip(texts, values, strict=False) if np.isfinite(v)]


def _text(data: bytes) -> str:
    return data.partition(b"\x00")[0].decode("utf-8", "replace")
