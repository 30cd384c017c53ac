"""Manoeuvres of a multirotor's flight test: what the controller is asked for over time, and the lists of flights.

All of them are flown under position control, as multirotors are: the inputs ride on what the controller does. Sizes go
with the vehicle's own speed and height.
"""

import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.simulation.multirotor.control import ROWS, Targets
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.rigid import Array

QUIET = 1.5
"""s of hover before the first input."""
ROUND = 0.1
"""s over which steps are rounded."""
LISTS = {
    "identify": ("thrust_p", "roll_p", "pitch_p", "yaw_p", "sweep_p", "translate_p", "eight_p"),
    "validate": ("mixed_n", "eight_n"),
    "acid": ("random_a",),
}
FLIGHTS = tuple(name for names in LISTS.values() for name in names)
GROUPS = {
    "all": FLIGHTS,
    "heights": ("low_p", "low_q", "low_n"),
    "headings": (
        *("hover_p", "hover_p-120deg", "hover_p-240deg", "eight_p-90deg", "translate_p-180deg", "eight_n-270deg"),
    ),
    "speeds": ("fast_p", "fast_q", "fast_n"),
}
"""Names that stand for several flights; the last three are flown where an effect needs them to show."""
GENTLE = 2.5
"""m/s^2: acceleration of a course along an axis, about which a slow vehicle stays below by its speed."""
LAST = {"p": "identify", "q": "identify", "n": "validate", "a": "acid"}
"""List of a manoeuvre by the last letter of its name."""


@dataclass(frozen=True)
class Course:
    """What a manoeuvre is flown by: time from its first input, s, [T], a stream of chance, and the vehicle's sizes.

    `speed` in m/s, `height` in m, `span` of the rotors' circle in m, `gravity` in m/s^2.
    """

    time: Array
    chance: np.random.Generator
    speed: float
    height: float
    span: float
    gravity: float

    def steps(self, edges: Sequence[float], levels: Sequence[float], every: float) -> Array:
        """Levels between edges, again every so many s with the other sign; zero before the first input.

        Corners are rounded over `ROUND` seconds, as autopilots round what they ask for.
        """
        phase = np.mod(self.time, every)
        values = np.concatenate([[0.0], levels, [0.0]])[np.searchsorted(edges, phase, side="right")]
        sharp = np.where(self.time >= 0.0, values * (1.0 - 2.0 * (np.floor(self.time / every) % 2)), 0.0)
        width = max(round(ROUND / float(self.time[1] - self.time[0])), 1)
        window = np.hanning(width + 2)[1:-1]
        return np.convolve(sharp, window / window.sum(), mode="full")[: len(sharp)]

    def moved(self, rate: Array) -> Array:
        """Integral of a rate over time, zero before the first input."""
        gone = np.where(self.time >= 0.0, rate, 0.0)
        return np.concatenate([[0.0], np.cumsum(0.5 * (gone[1:] + gone[:-1]) * np.diff(self.time))])


Manoeuvre = Callable[[Course, Targets], None]
"""Writes what the controller is asked for into targets that are zero."""


def _fly_along(targets: Targets, course: Course, velocity: Array) -> None:
    """Place, velocity and acceleration of a course that begins at rest; velocity [3, T], north east down, m/s."""
    ramp = np.clip(course.time / 2.0, 0.0, 1.0)
    velocity = velocity * (ramp * ramp * (3.0 - 2.0 * ramp))
    targets.velocity[:] = velocity
    targets.place[:] += np.stack([course.moved(row) for row in velocity])
    targets.acceleration[:] = np.gradient(velocity, course.time, axis=1)


def _thrust(course: Course, targets: Targets) -> None:
    """Steps of lift up and down, and smaller quick ones."""
    targets.lift[:] = 0.25 * course.gravity * course.steps((0.0, 0.5, 1.0), (1.0, -1.0), 3.0)
    targets.lift[:] += 0.12 * course.gravity * course.steps((2.0, 2.15, 2.3), (1.0, -1.0), 3.0)


def _tilts(course: Course, targets: Targets, axis: int) -> None:
    """Doublets of bank or pitch, of two sizes."""
    targets.tilt[axis] = 0.28 * course.steps((0.0, 0.5, 1.0), (1.0, -1.0), 4.0)
    targets.tilt[axis] += 0.12 * course.steps((2.4, 2.6, 2.8), (-1.0, 1.0), 4.0)


def _yaw(course: Course, targets: Targets) -> None:
    """Doublets of the yaw rate, and steps of the heading."""
    targets.rate[2] = 0.6 * course.steps((0.0, 0.5, 1.0), (1.0, -1.0), 3.5)
    targets.heading[:] = 0.3 * course.steps((2.0, 3.5), (1.0,), 3.5)


def _sweep(course: Course, targets: Targets) -> None:
    """Sweeps from 0.4 to 6 Hz of lift, roll, pitch and yaw, one after the other."""
    part = max(float(course.time[-1]), 1.0) / 4.0
    since = np.mod(course.time, part)
    growth = np.log(6.0 / 0.4)
    wave = np.sin(2.0 * np.pi * 0.4 * part / growth * np.expm1(growth * since / part))
    turned = zip(targets.rate, (0.5, 0.5, 0.25), strict=True)
    for k, (row, size) in enumerate(((targets.lift, 0.15 * course.gravity), *turned)):
        row[:] = np.where((course.time >= 0.0) & (course.time // part == k), size * wave, 0.0)


def _translate(course: Course, targets: Targets) -> None:
    """Out and back along each axis in turn."""
    smooth = np.sin(np.pi * np.clip(np.mod(course.time, 3.0) / 2.4, 0.0, 1.0)) ** 2
    turn = np.where(course.time >= 0.0, course.time // 3.0, -1)
    sizes = ((0, 1), (0, -1), (1, 1), (1, -1), (2, -0.5), (2, 0.5))
    velocity = np.zeros((3, len(course.time)))
    for k, (axis, size) in enumerate(sizes):
        velocity[axis] += np.where(turn % len(sizes) == k, size * min(course.speed, GENTLE) * smooth, 0.0)
    _fly_along(targets, course, velocity)


def _eight(course: Course, targets: Targets, sense: float, faster: float) -> None:
    """Figures of eight that rise and fall."""
    speed = faster * course.speed
    turn = min(1.3, 3.0 * np.sqrt(faster) / speed)
    phase = turn * course.time
    climb = -0.25 * course.speed * np.cos(0.7 * phase + 1.0)
    velocity = np.stack([speed * np.cos(phase), sense * speed * np.cos(2.0 * phase), climb]) / np.sqrt(2.0)
    _fly_along(targets, course, velocity)
    targets.heading[:] = sense * 0.4 * np.sin(0.5 * np.maximum(course.time, 0.0))


def _mixed(course: Course, targets: Targets) -> None:
    """Doublets of all axes in turn, with the other signs."""
    (bank, pitch), yaw = targets.tilt, targets.rate[2]
    moved = (targets.lift, -0.2 * course.gravity), (bank, -0.25), (pitch, -0.25), (yaw, -0.5)
    for k, (row, size) in enumerate(moved):
        start = 1.6 * k
        row[:] = size * course.steps((start, start + 0.45, start + 0.9), (1.0, -1.0), 6.4)


def _random(course: Course, targets: Targets) -> None:
    """A walk of many sines in all directions."""
    velocity = np.zeros((3, len(course.time)))
    for axis, size in enumerate((0.5, 0.5, 0.25)):
        for frequency in (0.11, 0.23, 0.37, 0.61):
            phase, turn = course.chance.uniform(0.0, 2.0 * np.pi), 2.0 * np.pi * frequency
            velocity[axis] += size * min(course.speed / 1.6, GENTLE / turn) * np.sin(turn * course.time + phase)
    _fly_along(targets, course, velocity)
    targets.rate[2] = 0.4 * np.sin(0.9 * np.maximum(course.time, 0.0))
    targets.lift[:] = 0.1 * course.gravity * course.steps((1.0, 1.3, 1.6), (1.0, -1.0), 5.0)


def _low(course: Course, targets: Targets) -> None:
    """Hover at heights near the ground, with steps of lift: from two spans down to a fifth of one."""
    levels = course.span * np.array([1.2, 0.5, 0.3, 0.8, 0.2, 2.0, 0.4, 0.25])
    levels = course.chance.permutation(levels)
    at = np.clip(course.time, 0.0, None) / 3.0
    k = at.astype(int)
    ramp = np.clip((at - k) * 3.0, 0.0, 1.0)
    before, after = levels[(k - 1) % len(levels)], levels[k % len(levels)]
    height = before + (after - before) * ramp * ramp * (3.0 - 2.0 * ramp)
    targets.place[2] = course.height - np.where(course.time >= 0.0, height, levels[-1])
    targets.velocity[2] = np.gradient(targets.place[2], course.time)
    targets.acceleration[2] = np.gradient(targets.velocity[2], course.time)


MANOEUVRES: dict[str, Manoeuvre] = {
    "thrust": _thrust,
    "roll": partial(_tilts, axis=0),
    "pitch": partial(_tilts, axis=1),
    "yaw": _yaw,
    "sweep": _sweep,
    "translate": _translate,
    "eight_p": partial(_eight, sense=1.0, faster=1.0),
    "eight_n": partial(_eight, sense=-1.0, faster=1.0),
    "mixed": _mixed,
    "random": _random,
    "low": _low,
    "hover": lambda course, targets: None,
    "fast_p": partial(_eight, sense=1.0, faster=2.2),
    "fast_q": partial(_eight, sense=-1.0, faster=1.7),
    "fast_n": partial(_eight, sense=-1.0, faster=2.2),
}
NAMES = tuple(dict.fromkeys(name.split("-")[0] for names in GROUPS.values() for name in names))
FORM = re.compile(rf"({'|'.join(NAMES)})(?:-([0-9]{{1,3}})deg)?")


def chosen(flights: Sequence[str]) -> tuple[str, ...]:
    """Names of the flights to fly, of names and of `GROUPS`, in the order of the groups.

    Raises InputError: a name that does not exist, or none at all.
    """
    if not flights:
        raise InputError("usage", "flights", "the list is empty", "some of " + ", ".join(FLIGHTS))
    expanded = dict.fromkeys(one for name in flights for one in GROUPS.get(name, (name,)))
    for name in expanded:
        if FORM.fullmatch(name) is None:
            expected = f"some of {', '.join(NAMES)}, with a heading as in eight_p-90deg, or of {', '.join(GROUPS)}"
            raise InputError("usage", "flights", f"there is no flight '{name}'", expected)
    usual = tuple(name for names in GROUPS.values() for name in names if name in expanded)
    return tuple(dict.fromkeys((*usual, *expanded)))


def lists(flights: Sequence[str]) -> dict[str, list[str]]:
    """The flights by list, which their manoeuvres decide."""
    places = {name: LAST[name.split("-")[0][-1]] for name in flights}
    return {key: [name for name in flights if places[name] == key] for key in LISTS}


def heading(name: str, usual: float) -> float:
    """Heading that a flight begins with, rad."""
    form = FORM.fullmatch(name)
    return usual if form is None or form[2] is None else np.deg2rad(float(form[2]))


def targets_of(name: str, craft: Multirotor, time: Array, usual: float) -> Array:
    """What the controller is asked for in a flight, packed, [ROWS, T]; see `control.Targets`.

    time : s, [T], from the beginning of the record; before it the vehicle hovers. usual : heading of the data set, rad.
    """
    manoeuvre = name.split("-")[0]
    span = 2.0 * max(float(np.hypot(*place[:2])) for place in craft.places)
    chance = np.random.default_rng(zlib.crc32(manoeuvre.encode()))
    course = Course(time - QUIET, chance, craft.speed, craft.height, span, craft.gravity)
    kind = manoeuvre if manoeuvre in MANOEUVRES else manoeuvre.split("_")[0]
    targets = Targets.unpack(np.zeros((ROWS, len(time))))
    MANOEUVRES[kind](course, targets)
    turn = heading(name, usual)
    cosine, sine = np.cos(turn), np.sin(turn)
    rows = np.empty((ROWS, len(time)))
    for first, vectors in ((0, targets.place), (3, targets.velocity), (6, targets.acceleration)):
        north, east, down = vectors
        rows[first : first + 3] = cosine * north - sine * east, sine * north + cosine * east, down
    rows[2] -= craft.height
    rows[9] = targets.heading + turn
    rows[10:12], rows[12:15], rows[15:18], rows[18] = targets.tilt, targets.rate, targets.turning, targets.lift
    return rows
