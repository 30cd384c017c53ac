"""PX4 ULog, block by block. Own code, because a log may be larger than memory and is not to be trusted.

Source: PX4 Guide, ULog File Format (version 1, with appended data).
"""

import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rotorid_torch.core.storage.files import open_file
from rotorid_torch.errors import InputError
from rotorid_torch.importing.autopilots.blocks import BLOCK, Blocks, Gathered
from rotorid_torch.importing.signals.streams import Choose, Log, Stream, of_damage

MAGIC = b"ULog\x01\x12\x35"
SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
HEADER = 16
LARGEST = 65535
"""Bytes of a message at most: its length has 16 bits. No topic can hold more, whatever its format says."""
DEEPEST = 8
"""Topics inside topics."""
FIELDS, FORMATS = 100_000, 8 * 2**20
"""Most fields of all topics, most bytes of all formats; a file that names more is forged."""
TYPES = {
    "int8_t": np.dtype("<i1"),
    "uint8_t": np.dtype("<u1"),
    "int16_t": np.dtype("<i2"),
    "uint16_t": np.dtype("<u2"),
    "int32_t": np.dtype("<i4"),
    "uint32_t": np.dtype("<u4"),
    "int64_t": np.dtype("<i8"),
    "uint64_t": np.dtype("<u8"),
    "float": np.dtype("<f4"),
    "double": np.dtype("<f8"),
    "bool": np.dtype("<u1"),
    "char": np.dtype("<i1"),
}
SENSED = ("vehicle_angular_velocity", "vehicle_acceleration", "vehicle_attitude", "vehicle_local_position")
"""Topics whose `timestamp_sample` is when the sensor was read; `timestamp` is when the topic was sent."""
TOLD = ("sys_name", "ver_hw", "ver_sw_release_str")
_KINDS, DATA = frozenset(b"FDIMPQARSOLCB"), ord("D")
_HEAD = struct.Struct("<HBH")
_UNWANTED = Gathered((), 0)
_Layout = list[tuple[str, int, np.dtype]]


def read_ulog(file: Path, choose: Choose, block: int = BLOCK) -> Log:
    """Read a ULog; `choose` says which fields are kept. A cut or damaged end is told in the warnings.

    Raises InputError where the file is no ULog, or needs what this reader does not know.
    """
    with open_file(file, "a log") as stream:
        head = stream.read(HEADER)
        if len(head) < HEADER or not head.startswith(MAGIC):
            raise InputError(file, "", "is not a ULog (it begins otherwise)", "a .ulg file of PX4")
        walk = _Walk(file, choose)
        walk.all(Blocks(stream, HEADER, block))
    about = " ".join(walk.info[key] for key in TOLD if key in walk.info)
    fields = {topic: [name for name, *_ in layout] for topic, layout in walk.layouts.items()}
    warnings = tuple(walk.warnings())
    return Log(file, "PX4", about, walk.streams(), fields, walk.parameters, warnings, earlier=walk.earlier)


class _UnknownForm(Exception):
    """A type that no format of the file explains."""


class _Walk:
    """One pass over the messages: formats, subscriptions, parameters, data."""

    def __init__(self, file: Path, choose: Choose) -> None:
        self.file, self.choose = file, choose
        self.formats: dict[str, str] = {}
        self.layouts: dict[str, _Layout] = {}
        self.gathered: dict[tuple[str, int], Gathered] = {}
        self.by_id: dict[int, Gathered] = {}
        self.info: dict[str, str] = {}
        self.parameters: dict[str, float] = {}
        self.earlier: dict[str, float] = {}
        self.appended: list[int] = []
        self.unknown: list[str] = []
        self.format_bytes = self.skipped = self.odd = self.dropouts = self.dropout_ms = self.left = 0

    def all(self, blocks: Blocks) -> None:
        """Walk to the file's end."""
        blocks.advance(0)
        while True:
            used, appended = self._block(blocks)
            for gathered in self.gathered.values():
                gathered.take(blocks.data)
            if appended:
                blocks.jump(self.appended.pop(0))
            elif blocks.last:
                self.left = len(blocks.data) - used
                return
            else:
                blocks.advance(used)

    def _block(self, blocks: Blocks) -> tuple[int, bool]:
        """Walk the messages that are whole in memory; bytes used, and whether data go on in an appended part."""
        data, end, place = blocks.data, len(blocks.data), 0
        limit, stop = self._limit(blocks), len(data) - 5
        slot, head = self.by_id.get, _HEAD.unpack_from
        while place <= stop:
            size, kind, number = head(data, place)
            after = place + 3 + size
            if kind == DATA and after <= end and after <= limit and size >= 2:
                gathered = slot(number)
                if gathered is None or size - 2 < gathered.size:
                    self.odd += 1
                elif gathered.layout:
                    gathered.places.append(place + 5)
            elif after > limit:  # of the first part nothing more was written: data go on in the appended one
                return place, True
            elif kind not in _KINDS or size < 2:
                place = self._next_sync(data, place, blocks.last)
                continue
            elif after > end:
                break
            else:
                self._rare(chr(kind), data[place + 3 : after])
                limit = self._limit(blocks)
            place = after
        return place, False

    def _limit(self, blocks: Blocks) -> float:
        return self.appended[0] - blocks.base if self.appended else float("inf")

    def _next_sync(self, data: bytes, place: int, last: bool) -> int:
        """Place behind the next sync message, where a damaged log can be read on; else what may be forgotten."""
        sync = data.find(SYNC, place)
        after = sync + len(SYNC) if sync >= 0 else len(data) if last else max(place + 1, len(data) - len(SYNC) + 1)
        if any(data[place:after]):  # a card's empty sectors are no loss
            self.skipped += after - place
        return after

    def _rare(self, kind: str, data: bytes) -> None:
        """Take what is not a data message."""
        if kind == "F":
            self._format(data)
        elif kind == "A" and len(data) > 3:
            self._subscribe(data[0], data[1] | data[2] << 8, _text(data[3:]))
        elif kind == "B" and len(data) >= 40:
            self._flags(data)
        elif kind == "O":
            self.dropouts, self.dropout_ms = self.dropouts + 1, self.dropout_ms + (data[0] | data[1] << 8)
        elif kind in "IP":
            self._key_and_value(kind, _text(data[1 : 1 + data[0]]), data[1 + data[0] :])

    def _flags(self, data: bytes) -> None:
        if data[8] & ~1 or any(data[9:16]):
            raise InputError(self.file, "", "needs a newer reader (unknown incompatible flags)", "a ULog of version 1")
        if data[8] & 1:
            self.appended = sorted(place for place in struct.unpack_from("<3Q", data, 16) if 0 < place < 2**62)

    def _key_and_value(self, kind: str, key: str, value: bytes) -> None:
        form, _, name = key.partition(" ")
        if kind == "I" and name in TOLD and form.startswith("char"):
            self.info.setdefault(name, _text(value[:80]))
        elif kind == "P" and form in ("float", "int32_t") and len(value) == 4 and len(self.parameters) < FIELDS:
            number = float(np.frombuffer(value, TYPES[form])[0])
            if math.isfinite(number):
                self.earlier.setdefault(name, number)
                self.parameters[name] = number

    def _format(self, data: bytes) -> None:
        name, _, fields = _text(data).partition(":")
        self.format_bytes += len(data)
        if self.format_bytes > FORMATS:
            raise InputError(self.file, "", f"has formats of over {FORMATS} bytes", "those of a flight log")
        self.formats.setdefault(name, fields)

    def _subscribe(self, instance: int, number: int, topic: str) -> None:
        """Take the columns of messages of this number from now on, where they are wanted."""
        if topic not in self.layouts:
            try:
                layout = list(self._flat(topic))
            except _UnknownForm as unknown:
                self.unknown.append(f"{topic} ({unknown})")
                layout = []
            while layout and layout[-1][0].startswith("_padding"):  # not written at a message's end
                layout.pop()
            self.layouts[topic] = layout
            if sum(map(len, self.layouts.values())) > FIELDS:
                raise InputError(self.file, topic, f"is one field too many: over {FIELDS}", "those of a flight log")
        layout = self.layouts[topic]
        wanted = {*self.choose(topic, [name for name, *_ in layout])}
        if not wanted or "timestamp" not in [name for name, *_ in layout]:
            self.by_id[number] = _UNWANTED
            return
        clocks = ("timestamp", "timestamp_sample") if topic in SENSED else ("timestamp",)
        columns = [column for column in layout if column[0] in wanted or column[0] in clocks]
        size = max(offset + kind.itemsize for _, offset, kind in columns)
        self.by_id[number] = self.gathered.setdefault((topic, instance), Gathered(columns, size))

    def _flat(self, topic: str) -> Iterator[tuple[str, int, np.dtype]]:
        """Fields of a topic with arrays and topics inside it laid out one after the other."""
        place = steps = 0
        pending = [("", "", topic, 0)]
        while pending:
            prefix, name, kind, depth = pending.pop()
            steps += 1
            if kind in TYPES:
                yield f"{prefix}{name}", place, TYPES[kind]
                place += TYPES[kind].itemsize
            elif kind in self.formats and depth < DEEPEST:
                inner = f"{prefix}{name}." if name else ""
                members = [m for part in self.formats[kind].split(";") for m in _members(part)]
                pending += [(inner, member, form, depth + 1) for form, member in reversed(members)]
            else:
                raise _UnknownForm(kind[:40])
            if place > LARGEST or steps + len(pending) > 2 * LARGEST:
                raise InputError(self.file, topic, f"is larger than a message of {LARGEST} bytes", "a true format")

    def streams(self) -> dict[tuple[str, int], Stream]:
        """What was gathered, with time in s."""
        streams = {}
        for key, gathered in self.gathered.items():
            columns = gathered.columns()
            time = columns.pop("timestamp")
            sampled = columns.pop("timestamp_sample", time)
            if len(time):
                streams[key] = Stream(np.where(sampled > 0, sampled, time) * 1e-6, columns)
        return streams

    def warnings(self) -> Iterator[str]:
        """Sentences on what was not read."""
        yield from of_damage(self.left, self.skipped)
        if self.odd:
            yield f"{self.odd} messages do not fit their topic and were passed over"
        if self.unknown:
            yield f"topics of unknown form were passed over: {', '.join(self.unknown[:5])}"
        if self.dropouts:
            yield f"the logger lost data {self.dropouts} times, {self.dropout_ms / 1000:.3g} s in all"


def _members(part: str) -> list[tuple[str, str]]:
    """Types and names of one part of a format, `float[3] xyz` -> three."""
    form, _, name = part.strip().partition(" ")
    kind, bracket, count = form.rstrip("]").partition("[")
    if not name:
        return []
    if not bracket:
        return [(kind, name)]
    number = int(count) if count.isdecimal() and len(count) < 7 else LARGEST + 1
    return [(kind, f"{name}[{index}]") for index in range(min(number, LARGEST + 1))]


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace").rstrip("\x00")
