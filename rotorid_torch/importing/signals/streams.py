"""What a reader gives: the streams of a log, each a clock and columns, and what the log says of the vehicle."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rotorid_torch.errors import InputError, nearest
from rotorid_torch.importing.signals import units

Choose = Callable[[str, Sequence[str]], Sequence[str]]
"""Called by a reader once per topic with all its fields; gives those to keep, so that the rest costs no memory."""

_INSTANCE = re.compile(r"([^.\[\]]+)\[(\d{1,3})\]\.(.+)", re.DOTALL)
_UNIT_IN_HEADER = re.compile(
    r"\s*([A-Za-z][\w.]*(?: +[\w.]+)*)\s*(?:[\[({<]\s*([^\])}>]*?)\s*[\])}>]|[,/]\s*\(?([^()]+?)\)?)\s*"
)
TOLD = 8
"""Names that a message lists at most."""


@dataclass(frozen=True)
class Stream:
    """One topic of a log (one instance of it): time (T,) in s and columns, each (T,) as stored."""

    time: np.ndarray
    columns: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Source:
    """One field of a log: its topic (empty in a table), the instance of the topic, and the field."""

    topic: str
    instance: int
    field: str

    def __str__(self) -> str:
        """As a map writes it: `topic.field`, `topic[1].field` for a further instance, or a bare column."""
        number = f"[{self.instance}]" if self.instance else ""
        return f"{self.topic}{number}.{self.field}" if self.topic else self.field


@dataclass(frozen=True)
class Log:
    """One file as read.

    Attributes
    ----------
    system : "PX4", "ArduPilot", "blackbox", "SIDPAC", or "" where the file says nothing of its maker.
    about : for people: what recorded this, where it is known.
    streams : by topic and instance; those with samples only.
    fields : all topics with all their fields, also those not kept.
    parameters : the vehicle's settings by name, as they were last.
    warnings : sentences on what could not be read.
    messages : what the log tells people, each with its time in s.
    earlier : the settings as they were first.
    """

    file: Path
    system: str
    about: str
    streams: Mapping[tuple[str, int], Stream]
    fields: Mapping[str, Sequence[str]]
    parameters: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    messages: tuple[tuple[float, str], ...] = ()
    earlier: Mapping[str, float] = field(default_factory=dict)

    def instances(self, topic: str) -> list[int]:
        """Instances of a topic that have samples."""
        return sorted(number for name, number in self.streams if name == topic)

    def source(self, text: str, key: str) -> Source:
        """Field that a map names; `key` is the map's, for the message. Raises InputError where there is none."""
        bare, instance = without_instance(text)
        listed = {joined(topic, name): (topic, name) for topic, fields in self.fields.items() for name in fields}
        for place, (topic, name) in [*listed.items()]:
            listed.setdefault(header_name(place)[0], (topic, name))
        if bare not in listed:
            raise InputError(self.file, key, f"there is no field '{text[:80]}'{self._hint(bare, listed)}", "a field")
        topic, name = listed[bare]
        instances = self.instances(topic)
        if instance not in instances:
            wrong = f"has no samples of {topic or name}" if not instances else f"has {topic} {instances} only"
            raise InputError(self.file, key, wrong, f"'{text[:80]}'")
        return Source(topic, instance, name)

    def stream(self, source: Source) -> Stream:
        """The stream that a field is in."""
        return self.streams[source.topic, source.instance]

    def _hint(self, text: str, words: Iterable[str]) -> str:
        """What may have been meant: a similar name, or what the topic, or the log, holds."""
        topic, _, name = text.partition(".")
        inside = self.fields.get(topic, ())
        if near := nearest(name, inside) or ("" if inside else nearest(text, words)):
            return near
        listed = inside or (list(words) if len(self.fields) == 1 else sorted(self.fields))
        more = f" and {len(listed) - TOLD} more" if len(listed) > TOLD else ""
        return f" (there are {', '.join(listed[:TOLD])}{more})" if listed else ""


def is_numbers(values: np.ndarray) -> bool:
    """Whether a column holds numbers; a damaged format may make it text."""
    return values.dtype.kind in "fiub"


def joined(topic: str, name: str) -> str:
    """Name of a field in a map."""
    return f"{topic}.{name}" if topic else name


def header_name(column: str) -> tuple[str, str]:
    """`p [deg/s]`, `p, deg/s` and `p / (deg/s)` as p and deg/s; without a known unit the column itself and no unit."""
    match = _UNIT_IN_HEADER.fullmatch(column)
    unit = units.in_header(match[1], match[2] or match[3] or "") if match else ""
    return (match[1], unit) if match and (units.find_unit(unit) or units.clock_unit(unit)) else (column.strip(), "")


def without_instance(text: str) -> tuple[str, int]:
    """`topic[1].field` as `topic.field` and 1; 0 where no instance is named."""
    match = _INSTANCE.fullmatch(text)
    return (f"{match[1]}.{match[3]}", int(match[2])) if match else (text, 0)


def choose(texts: Iterable[str]) -> Choose:
    """Reader's choice that keeps what these texts of a map name."""
    wanted = {without_instance(text)[0] for text in texts}

    def remaining(topic: str, fields: Sequence[str]) -> list[str]:
        return [n for n in fields if not wanted.isdisjoint((joined(topic, n), joined(topic, header_name(n)[0])))]

    return remaining


def of_damage(left: int, skipped: int) -> Iterator[str]:
    """Sentences on the bytes of a file that were not read: those left at its end, and those passed over inside."""
    if left:
        yield f"ends in the middle of a message: read up to there ({left} bytes left)"
    if skipped:
        yield f"{skipped} bytes are damaged and were passed over"
