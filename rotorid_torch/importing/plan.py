"""What a log's maker calls the channels: the form of the built-in maps, and choosing among what a log has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rotorid_torch.importing.log import Log, is_numbers, joined
from rotorid_torch.importing.mapping import Entry

FASTER = 1.8
"""A later alternative is taken where it is recorded that much faster."""


@dataclass(frozen=True)
class Plan:
    """Which fields become which channels; the kind of vehicle; sentences on choices; what is known of the vehicle."""

    kind: str
    entries: Mapping[str, Entry]
    notes: tuple[str, ...] = ()
    vehicle: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Group:
    """Channels that come together from one topic: per channel its entry, with a bare field name."""

    topic: str
    entries: Mapping[str, Entry]


def triple(topic: str, channels: str, fields: Sequence[str], unit: str = "", sign: str = "+++") -> Group:
    """Group of some channels of one unit; `sign` has a plus or minus per channel."""
    signs = {"+": 1, "-": -1}
    pairs = zip(channels.split(), fields, sign.ljust(len(fields), "+"), strict=False)
    return Group(topic, {c: Entry(f, unit, 1 if signs[s] == 1 else -1) for c, f, s in pairs})


def first_or_faster(log: Log, alternatives: Sequence[Group], instance: int = 0) -> dict[str, Entry]:
    """Entries of the first group that the log has, or of a later one that is recorded much faster."""
    best: dict[str, Entry] = {}
    rate = 0.0
    for group in alternatives:
        numbers = log.instances(group.topic)
        if not numbers or not all(e.field in log.fields[group.topic] for e in group.entries.values()):
            continue
        number = instance if instance in numbers else numbers[0]
        hertz = rate_of(log.streams[group.topic, number].time)
        if not best or hertz > FASTER * rate:
            best, rate = named(group, number), hertz
    return best


def named(group: Group, instance: int) -> dict[str, Entry]:
    """Entries of a group with the topic before each field."""
    topic = f"{group.topic}[{instance}]" if instance else group.topic
    return {
        channel: Entry(joined(topic, e.field), e.unit, e.sign, e.scale, e.offset)
        for channel, e in group.entries.items()
    }


def rate_of(time: np.ndarray) -> float:
    """Sample rate of a clock in Hz, pauses apart; 0 where it stands."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    return 1.0 / float(steps[steps <= 2.5 * np.median(steps)].mean()) if len(steps) else 0.0


def pulse(name: str, low: float, high: float) -> Entry:
    """Motor command from servo pulses in us between what the vehicle takes for 0 and 1."""
    if not 500.0 <= low < high - 100.0 <= 2900.0:
        low, high = 1000.0, 2000.0
    return Entry(name, "norm", 1, 1.0 / (high - low), -low / (high - low))


def moving(values: np.ndarray) -> bool:
    """Whether a column has two different numbers; text has none."""
    if not is_numbers(values):
        return False
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and float(finite.min()) < float(finite.max())
