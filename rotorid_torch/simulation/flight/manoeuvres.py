"""The flight test's manoeuvres: 3-2-1-1 inputs, doublets of both signs, a collective sweep, and their lists."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorid_torch.errors import InputError, nearest
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES
from rotorid_torch.simulation.rigid import Array

QUIET = 1.0  # s before the input starts
UNIT, HALF = 0.8, 1.2  # s: unit of the 3-2-1-1, half of a doublet
SWEEP_TIME, SWEEP_BAND = 6.0, (0.05, 2.0)  # s, Hz
AMPLITUDE = 0.1  # of full deflection

LISTS = {
    "identify": tuple(f"f321_{name}" for name in CONTROL_NAMES) + tuple(f"dbl_{name}_p" for name in CONTROL_NAMES),
    "validate": tuple(f"dbl_{name}_n" for name in CONTROL_NAMES),
    "acid": ("sweep_col",),
}
FLIGHTS = tuple(name for names in LISTS.values() for name in names)

GROUPS = {
    "headings": (
        *("f321_lon-90deg", "dbl_lat_p-90deg", "f321_lat-180deg"),
        *("dbl_lon_p-180deg", "f321_lon-270deg", "dbl_lat_p-270deg"),
        *("dbl_lon_n-90deg", "dbl_lat_n-180deg", "dbl_lon_n-270deg"),
    ),
    "heights": (
        *("f321_col-5m", "dbl_col_p-5m", "dbl_lon_p-5m", "f321_col-9m", "dbl_col_p-9m", "dbl_lat_p-9m"),
        *("dbl_lon_n-5m", "dbl_col_n-9m", "dbl_col_n-15m"),
    ),
}
"""Further flights that vary heading (rad clockwise from north, in degrees) or height above ground (m)."""


def groups(speed: float) -> dict[str, tuple[str, ...]]:
    """Names that stand for several flights; those of "speeds" are at two speeds beside the data set's own, m/s."""
    first = round(speed) + 10 if speed < 25.0 else round(speed) - 10
    second = round(speed) + (20 if speed < 25.0 else 10)
    near = (f"dbl_{motion}-{first}mps" for motion in ("lon_p", "lat_p", "col_p", "lon_n"))
    far = (f"dbl_{motion}-{second}mps" for motion in ("lon_p", "lat_p", "col_p", "col_n"))
    return {"all": FLIGHTS, **GROUPS, "speeds": (*near, *far)}


@dataclass(frozen=True)
class Condition:
    """Where a flight begins: heading (rad), height (m), speed (m/s)."""

    heading: float
    height: float
    speed: float


UNITS = {"deg": ("heading", np.pi / 180.0), "m": ("height", 1.0), "mps": ("speed", 1.0)}


def conditioned(name: str, usual: Condition) -> tuple[str, Condition]:
    """The manoeuvre of a flight, and its condition: `dbl_lon_p-90deg-5m` changes what it names, all else is usual."""
    changes = {UNITS[unit][0]: UNITS[unit][1] * int(value) for value, unit in CHANGE.findall(name)}
    return name.split("-")[0], replace(usual, **changes)


CHANGE = re.compile(r"-([0-9]{1,3})(deg|mps|m)(?=-|$)")
FORM = re.compile(rf"(?:{'|'.join(FLIGHTS)})(?:{CHANGE.pattern})*")


def chosen(flights: Sequence[str] | None, speed: float = 0.0) -> tuple[str, ...]:
    """Names of the flights to fly: those of the lists in their order, then the others in theirs.

    `flights` may name `groups`, and `speed` (m/s) is the data set's own.

    Raises InputError: a name that does not exist, or none at all.
    """
    if flights is None:
        return FLIGHTS
    available = groups(speed)
    expanded = [one for name in flights for one in available.get(name, (name,))]
    for name in expanded:
        if not _exists(name):
            expected = f"some of {', '.join(FLIGHTS)}, with a condition as in dbl_lon_p-90deg, dbl_col_p-5m or "
            expected += f"dbl_lon_p-20mps, or of {', '.join(available)}"
            hint = nearest(name, (*FLIGHTS, *available))
            raise InputError("usage", "flights", f"there is no flight '{name}'{hint}", expected)
    if not flights:
        raise InputError("usage", "flights", "the list is empty", "some of " + ", ".join(FLIGHTS))
    usual = tuple(name for name in FLIGHTS if name in expanded)
    return usual + tuple(dict.fromkeys(name for name in expanded if name not in FLIGHTS))


def _exists(name: str) -> bool:
    """Whether a name has the form of a flight: a manoeuvre, each kind of condition once at most, no height of zero."""
    changes = CHANGE.findall(name)
    units = [unit for _, unit in changes]
    ground = any(unit == "m" and not int(value) for value, unit in changes)
    return FORM.fullmatch(name) is not None and len(set(units)) == len(units) and not ground


def lists(flights: Sequence[str]) -> dict[str, list[str]]:
    """The flights by list, which their manoeuvres decide."""
    places = {name: key for key, names in LISTS.items() for name in names}
    return {key: [name for name in flights if places[name.split("-")[0]] == key] for key in LISTS}


def stick(name: str, time: Array) -> tuple[int, Array]:
    """Which control a flight moves (its place in lon lat col ped), and how, in units of the amplitude.

    Steps happen at samples of 154 Hz or at their own times; the value at a step's time is the one after it.

    Source: Hamel and Kaletka, Progress in Aerospace Sciences 33 (1997) (3-2-1-1); Tischler and Remple, Aircraft and
    Rotorcraft System Identification, chapter 5 (doublets, sweeps with an exponential rise of frequency).
    """
    name = name.split("-")[0]
    kind, control = name.split("_")[:2]
    place = CONTROL_NAMES.index(control)
    since = time - QUIET
    if kind == "f321":
        return place, _steps(since, (3 * UNIT, 5 * UNIT, 6 * UNIT, 7 * UNIT), (1.0, -1.0, 1.0, -1.0))
    if kind == "dbl":
        sign = 1.0 if name.endswith("p") else -1.0
        return place, _steps(since, (HALF, 2 * HALF), (sign, -sign))
    low, high = SWEEP_BAND
    growth = np.log(high / low)
    phase = 2.0 * np.pi * low * SWEEP_TIME / growth * np.expm1(growth * since / SWEEP_TIME)
    return place, np.where((since >= 0.0) & (since < SWEEP_TIME), np.sin(phase), 0.0)


def _steps(since: Array, ends: tuple[float, ...], levels: tuple[float, ...]) -> Array:
    """Levels that hold until their ends, zero before and after."""
    edges = np.round(np.array([0.0, *ends]) * SAMPLE_RATE) / SAMPLE_RATE
    return np.concatenate([[0.0], levels, [0.0]])[np.searchsorted(edges, since, side="right")]


SAMPLE_RATE = 154.0  # Hz


def pilot(flights: Sequence[str], time: Array, limits: Sequence[tuple[float, float]]) -> Array:
    """Stick inputs of all flights, rad, [4, T, flight]."""
    out = np.zeros((4, len(time), len(flights)))
    for k, name in enumerate(flights):
        place, shape = stick(name, time)
        low, high = limits[place]
        out[place, :, k] = AMPLITUDE * (high - low) * shape
    return out
