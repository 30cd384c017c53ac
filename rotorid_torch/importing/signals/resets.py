"""Resets of an estimator: steps of attitude, velocity and position that no motion made, undone or cut out.

Source: PX4 Autopilot, msg/VehicleAttitude.msg, VehicleLocalPosition.msg (reset counters and deltas); ArduPilot,
"Onboard Message Log Messages", XKF4 (PI, OFN, OFE), EV (60: EKF altitude reset, 62: EKF yaw reset), ERR.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from rotorid_torch.importing.signals.derive import euler
from rotorid_torch.importing.signals.fields import Signal
from rotorid_torch.importing.signals.plan import QUATERNION
from rotorid_torch.importing.signals.streams import Log, Stream, is_numbers

Signals = dict[str, Signal]

STEP = {
    **dict.fromkeys(("phi", "theta", "psi"), 0.02),
    **dict.fromkeys(("vn", "ve", "vd"), 0.15),
    **dict.fromkeys(("north", "east", "height"), 0.3),
}
"""Smallest step that is one, in the unit of the channel; all channels of an estimator."""
ANGLES = ("phi", "theta", "psi")
UNEXPLAINED = 0.2
"""Share of a step that its logged size may leave."""
AROUND = 8
"""Intervals before and after a step whose median is the motion."""
ABOVE = 8.0
"""A step is so many times as large as what the changes around it usually are away from their median."""
TOLD = 4
"""Resets that are told one by one."""


@dataclass(frozen=True)
class Counter:
    """A counter of resets, the fields that hold the size of the last one, and the channels that have it.

    Four sizes are a quaternion, by which the attitude was turned.
    """

    counter: str
    deltas: tuple[str, ...]
    channels: tuple[str, ...]

    @property
    def fields(self) -> tuple[str, ...]:
        """All fields that are read."""
        return (self.counter, *self.deltas)


_TURN = Counter("quat_reset_counter", tuple(f"delta_q_reset[{i}]" for i in range(4)), ANGLES)
_PLACES = (
    Counter("xy_reset_counter", ("delta_xy[0]", "delta_xy[1]"), ("north", "east")),
    Counter("vxy_reset_counter", ("delta_vxy[0]", "delta_vxy[1]"), ("vn", "ve")),
    Counter("z_reset_counter", ("delta_z",), ("height",)),
    Counter("vz_reset_counter", ("delta_vz",), ("vd",)),
    Counter("heading_reset_counter", ("delta_heading",), ("psi",)),
)
PX4: Mapping[str, tuple[Counter, ...]] = {
    "vehicle_attitude": (_TURN,),
    "estimator_attitude": (_TURN,),
    "vehicle_local_position": _PLACES,
    "estimator_local_position": _PLACES,
}
"""Counters by topic."""
EVENTS = {60: ("height",), 62: ("psi",)}
"""Channels by ArduPilot's EV.Id."""
PRIMARY = 24
"""ERR.Subsys that tells another primary core of the estimator."""
SAYINGS = re.compile(
    r"lane switch|primary changed|(yaw|heading)\b.*(align|reset)|(position|velocity|height) reset|EKF.* reset",
    re.IGNORECASE,
)
"""Messages for people that tell of a reset."""
LATE_S = 0.6
"""Time by which a message for people may be away from the reset."""


@dataclass(frozen=True)
class Reset:
    """A reset that a log tells: time in s and by how much that may be off, channels, sizes where they are logged."""

    time: float
    about: str
    channels: tuple[str, ...]
    sizes: Mapping[str, float] = field(default_factory=dict)
    turn: tuple[float, ...] = ()
    within: float = 0.0


@dataclass(frozen=True)
class Repaired:
    """Signals with the steps undone that could be, times in s at which a flight must be cut, and what to say."""

    signals: Signals
    cuts: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()


def repaired(log: Log, signals: Signals) -> Repaired:
    """Undo resets whose size is logged, cut where it is not; earlier samples are moved to what the later ones say."""
    steady, cuts, notes = dict(signals), list[float](), list[str]()
    for reset in sorted(_resets(log, signals), key=lambda one: one.time):
        steps = _steps(steady, reset)
        if not steps:
            continue
        at = min(time for time, _ in steps.values())
        words = ", ".join(f"{name} by {size:+.3g}" for name, (_, size) in steps.items())
        undone = _undone(steady, reset, at)
        left = {name: abs(size) for name, (_, size) in _steps(undone, reset).items()}
        if any(size > UNEXPLAINED * abs(steps.get(name, (at, 0.0))[1]) for name, size in left.items()):
            cuts.append(at)
            notes.append(
                f"{reset.about} at {at:.2f} s: {words} in one step, its size is not logged: the flight is cut there"
            )
        else:
            steady = undone
            notes.append(f"{reset.about} at {at:.2f} s: {words} in one step, undone: what came before is moved by that")
    more = [f"{len(notes) - TOLD} further resets likewise"] if len(notes) > TOLD else []
    return Repaired(steady, tuple(sorted({*cuts})), (*notes[:TOLD], *more))


def _resets(log: Log, signals: Mapping[str, Signal]) -> Iterator[Reset]:
    sources = {(s.source.topic, s.source.instance) for s in signals.values()}
    for place in sources:
        for counter in PX4.get(place[0], ()):
            yield from _counted(place[0], log.streams[place], counter)
    if log.system == "ArduPilot":
        yield from _of_ardupilot(log, sources)


def _counted(topic: str, stream: Stream, counter: Counter) -> Iterator[Reset]:
    """Resets at which a counter goes on."""
    counts = stream.columns.get(counter.counter)
    if counts is None or not is_numbers(counts):
        return
    logged = [stream.columns.get(name) for name in counter.deltas]
    for at in np.flatnonzero(np.diff(counts.astype(np.int64))) + 1:
        once = (int(counts[at]) - int(counts[at - 1])) % 256 == 1
        sizes = [float(values[at]) for values in logged if values is not None and is_numbers(values)]
        whole = once and len(sizes) == len(counter.deltas) and bool(np.isfinite(sizes).all())
        time, about = float(stream.time[at]), f"{topic} was reset ({counter.counter})"
        if not whole:
            yield Reset(time, about, counter.channels)
        elif counter is _TURN:
            yield Reset(time, about, counter.channels, turn=tuple(sizes))
        elif counter.channels == ("psi",):
            half = 0.5 * sizes[0]
            yield Reset(time, about, counter.channels, turn=(math.cos(half), 0.0, 0.0, math.sin(half)))
        else:
            signed = {c: -size if c == "height" else size for c, size in zip(counter.channels, sizes, strict=True)}
            yield Reset(time, about, counter.channels, signed)


def _of_ardupilot(log: Log, sources: set[tuple[str, int]]) -> Iterator[Reset]:
    for topic in ("XKF4", "NKF4"):
        for instance in log.instances(topic):
            stream = log.streams[topic, instance]
            primary = stream.columns.get("PI")
            if instance == log.instances(topic)[0] and primary is not None and is_numbers(primary):
                for at in np.flatnonzero(np.diff(primary.astype(np.int64))) + 1:
                    switch = f"lane switch of the estimator ({topic}.PI {primary[at - 1]} to {primary[at]})"
                    yield Reset(float(stream.time[at]), switch, ANGLES, within=LATE_S)
            if (topic.replace("4", "1"), instance) in sources:
                yield from _offsets(topic, stream)
    for instance in log.instances("EV"):
        stream = log.streams["EV", instance]
        numbers = stream.columns.get("Id", np.empty(0))
        if is_numbers(numbers):
            for number, channels in EVENTS.items():
                for time in stream.time[numbers == number]:
                    yield Reset(float(time), f"estimator reset (EV {number})", channels, within=LATE_S)
    for instance in log.instances("ERR"):
        stream = log.streams["ERR", instance]
        subsystem, code = (stream.columns.get(name, np.empty(0)) for name in ("Subsys", "ECode"))
        if is_numbers(subsystem) and is_numbers(code) and len(subsystem) == len(code):
            for at in np.flatnonzero(subsystem == PRIMARY):
                switch = f"lane switch of the estimator (ERR {PRIMARY}, to {code[at]:g})"
                yield Reset(float(stream.time[at]), switch, tuple(STEP), within=LATE_S)
    for time, text in log.messages:
        if SAYINGS.search(text):
            yield Reset(time, f"estimator reset ('{text[:50]}')", tuple(STEP), within=LATE_S)


def _offsets(topic: str, stream: Stream) -> Iterator[Reset]:
    """Resets of position, whose sizes OFN and OFE are those of the last one."""
    sizes = [stream.columns.get(name) for name in ("OFN", "OFE")]
    north, east = (v if v is not None and is_numbers(v) else np.empty(0) for v in sizes)
    if not len(north) or len(north) != len(east):
        return
    for at in np.flatnonzero((np.diff(north) != 0) | (np.diff(east) != 0)) + 1:
        size = {"north": float(north[at]), "east": float(east[at])}
        yield Reset(
            float(stream.time[at]), f"position reset ({topic}.OFN, OFE)", ("north", "east"), size, within=LATE_S
        )


def _columns(signals: Mapping[str, Signal]) -> dict[str, Signal]:
    """The signals with Euler angles in place of a quaternion."""
    if not all(name in signals for name in QUATERNION):
        return dict(signals)
    q = [signals[name] for name in QUATERNION]
    angles = euler(*(s.values for s in q))
    return {**signals, **{n: replace(q[0], name=n, values=v) for n, v in zip(ANGLES, angles, strict=True)}}


def _steps(signals: Mapping[str, Signal], reset: Reset) -> dict[str, tuple[float, float]]:
    """Time and size of the step of each channel that has one at a reset."""
    recorded, steps = _columns(signals), dict[str, tuple[float, float]]()
    for name in reset.channels:
        if name not in recorded or name not in STEP:
            continue
        step = step_at(recorded[name].time, recorded[name].values, reset.time, reset.within, name in ANGLES)
        if step is not None and abs(step[1]) > STEP[name]:
            steps[name] = step
    return steps


def step_at(time: np.ndarray, values: np.ndarray, at: float, within: float, angle: bool) -> tuple[float, float] | None:
    """Time in s and size of the largest step (T,) near a time, the motion around it taken out; None where none is.

    The time is that of the first sample after the step.
    """
    finite = np.isfinite(values)
    t, x = time[finite], values[finite]
    first, last = np.searchsorted(t, (at - max(within, 1e-6), at + max(within, 1e-6)))
    first, last = max(int(first) - 1, 1), min(int(last) + 2, len(t) - 1)
    if len(t) < 2 * AROUND or first >= last:
        return None
    low, high = max(first - AROUND - 1, 0), min(last + AROUND + 1, len(t))
    part = np.unwrap(x[low:high]) if angle else x[low:high]
    changes = np.diff(x[low:high])
    changes = (changes + np.pi) % (2.0 * np.pi) - np.pi if angle else np.diff(part)
    away = changes - np.median(changes)
    inside = slice(first - low - 1, last - low)
    best = int(np.argmax(np.abs(away[inside]))) + inside.start
    usual = float(np.median(np.abs(away)))
    if abs(away[best]) <= ABOVE * usual:
        return None
    return float(t[low + best + 1]), float(away[best])


def _undone(signals: Signals, reset: Reset, at: float) -> Signals:
    """Signals whose samples before a reset are moved by its logged size."""
    steady = dict(signals)
    for name, size in reset.sizes.items():
        if name in steady:
            signal = steady[name]
            steady[name] = replace(signal, values=signal.values + size * (signal.time < at))
    if len(reset.turn) == 4 and all(name in steady for name in QUATERNION):
        q = [steady[name] for name in QUATERNION]
        turned = product(np.array(reset.turn), np.stack([s.values for s in q]))
        for signal, values in zip(q, turned, strict=True):
            steady[signal.name] = replace(signal, values=np.where(signal.time < at, values, signal.values))
    return steady


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion product (4, T) of a (4,) and b (4, T), scalar first.

    Source: Stevens and Lewis, Aircraft Control and Simulation (3rd ed.), eq. 1.8-5.
    """
    a0, a1, a2, a3 = a
    b0, b1, b2, b3 = b
    return np.stack(
        [
            a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
            a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
            a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1,
            a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0,
        ]
    )
