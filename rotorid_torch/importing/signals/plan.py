"""What a log's maker calls the channels: the form of the built-in maps, and choosing among what a log has."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rotorid_torch.importing.signals.mapping import Entry
from rotorid_torch.importing.signals.streams import Log, is_numbers, joined

QUATERNION = ("q0", "q1", "q2", "q3")
"""From body to north-east-down axes, scalar first; becomes phi, theta, psi."""
FASTER = 1.8
"""A later alternative is taken where it is recorded that much faster."""


@dataclass(frozen=True)
class Plan:
    """Which fields become which channels; the kind of vehicle; sentences on choices; what is known of the vehicle.

    `reasons` say per channel why its source was taken, where the log has another one. `frame` is that of a multirotor
    by its settings, `lines` of TOML for the vehicle's table, by key.
    """

    kind: str
    entries: Mapping[str, Entry]
    notes: tuple[str, ...] = ()
    vehicle: Mapping[str, object] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    frame: str = ""
    lines: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Group:
    """Channels that come together from one topic: per channel its entry, with a bare field name.

    A spare one, such as a single sensor before filters and calibration, is taken only where there is no other.
    """

    topic: str
    entries: Mapping[str, Entry]
    spare: bool = False


def triple(
    topic: str, channels: str, fields: Sequence[str], unit: str = "", sign: str = "+++", spare: bool = False
) -> Group:
    """Group of some channels of one unit; `sign` has a plus or minus per channel."""
    signs = {"+": 1, "-": -1}
    pairs = zip(channels.split(), fields, sign.ljust(len(fields), "+"), strict=False)
    return Group(topic, {c: Entry(f, unit, 1 if signs[s] == 1 else -1) for c, f, s in pairs}, spare)


@dataclass(frozen=True)
class Chosen:
    """Entries of one group, how often it is recorded (Hz), and why it was taken; empty where there was no choice.

    Where there are no entries, `missing` says which channels have no data, and in which topics they were looked for.
    """

    entries: Mapping[str, Entry] = field(default_factory=dict)
    hertz: float = 0.0
    reason: str = ""
    missing: str = ""

    def reasons(self) -> dict[str, str]:
        """The reason by channel; channels of which there is none are left out."""
        return dict.fromkeys(self.entries, self.reason) if self.reason else {}


Instances = Callable[[str, Sequence[int]], tuple[int, str]]
"""Which instance of a topic is taken, of those there are, and why."""


def lowest(topic: str, numbers: Sequence[int]) -> tuple[int, str]:
    """The lowest instance."""
    others = ", ".join(str(number) for number in sorted(numbers)[1:])
    return min(numbers), f"instance {min(numbers)}, the lowest; {others} left" if others else ""


def first_or_faster(log: Log, alternatives: Sequence[Group], instance: Instances = lowest) -> Chosen:
    """Entries of the first group that the log has, or of a later one that is recorded much faster.

    A group without content (all zero or not a number) is none; one that never changes gives way to one that does.
    """
    best, moves, chosen_why, left = Chosen(), False, "", list[str]()
    for group in alternatives:
        numbers = log.instances(group.topic)
        if not numbers or not all(e.field in log.fields[group.topic] for e in group.entries.values()):
            continue
        if group.spare and best.entries:
            continue
        number, why = instance(group.topic, numbers)
        filled = [n for n in numbers if _filled(log, group, n)]
        if filled and number not in filled:
            number, why = filled[0], f"instance {filled[0]}; {_written(group, number)} left: all zero or not a number"
        stream = log.streams[group.topic, number]
        columns = [stream.columns[e.field] for e in group.entries.values() if e.field in stream.columns]
        name = _written(group, number)
        if not filled:
            left.append(f"{name} left: all zero or not a number")
            continue
        hertz, changing = rate_of(stream.time), any(map(moving, columns))
        if not best.entries or (changing and not moves):
            left += [f"{best.reason} left: never changes"] if best.entries else []
            best, moves, chosen_why = Chosen(named(group, number), hertz, name), changing, why
        elif changing and hertz > FASTER * best.hertz:
            left.append(f"{best.reason} left: {best.hertz:.3g} Hz against {hertz:.3g} Hz")
            best, chosen_why = Chosen(named(group, number), hertz, name), why
    if not best.entries:
        words = (c if c not in QUATERNION else "phi theta psi" for group in alternatives for c in group.entries)
        channels = " ".join(dict.fromkeys(" ".join(words).split()))
        topics = ", ".join(dict.fromkeys(group.topic for group in alternatives))
        return Chosen(missing=f"{channels} ({'; '.join(left) or f'no {topics}'})")
    return Chosen(best.entries, best.hertz, "; ".join([*([chosen_why] if chosen_why else []), *left]))


def _filled(log: Log, group: Group, number: int) -> bool:
    """Whether an instance of a group's topic has any content."""
    columns = log.streams[group.topic, number].columns
    return any(has_content(columns[e.field]) for e in group.entries.values() if e.field in columns)


def _written(group: Group, number: int) -> str:
    """A group for people: its topic, and its first field where one topic holds several."""
    instance = f"[{number}]" if number else ""
    return f"{group.topic}{instance}.{next(iter(group.entries.values())).field}"


def has_content(values: np.ndarray) -> bool:
    """Whether a column has a finite number that is not zero."""
    return is_numbers(values) and bool((np.isfinite(values) & (values != 0)).any())


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


def moving(values: np.ndarray) -> bool:
    """Whether a column has two different numbers; text has none."""
    if not is_numbers(values):
        return False
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and float(finite.min()) < float(finite.max())


def merged(
    kind: str, chosen: Sequence[Chosen], notes: Sequence[str], vehicle: Mapping[str, object] | None = None
) -> Plan:
    """Plan of all choices, later ones first where two have a channel; reasons of what was left are notes too."""
    entries = {name: entry for one in chosen for name, entry in one.entries.items()}
    reasons = {name: reason for one in chosen for name, reason in one.reasons().items()}
    sentences = [f"{', '.join(one.entries)}: {one.reason}" for one in chosen if one.reason and one.entries]
    absent = [one.missing for one in chosen if one.missing]
    missing = ", ".join(m for m in absent if entries.keys().isdisjoint(m.partition(" (")[0].split()))
    none = [f"no data: {missing}"] if missing else []
    return Plan(kind, entries, (*notes, *sentences, *none), vehicle or {}, reasons)


def imu_line(settings: Mapping[str, float], keys: Sequence[str]) -> dict[str, str]:
    """Place of the inertial sensor by three settings in m, as a line of TOML; none where they are not set."""
    place = [round(settings.get(key, 0.0), 4) for key in keys]
    return {"imu": f"imu = {place}   # m, by {keys[0]}, ..."} if any(place) else {}
