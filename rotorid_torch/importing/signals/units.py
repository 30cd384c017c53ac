"""Units that logs use, and what they are in SI."""

import math
import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Unit:
    """Value in SI = factor * value + offset; `measures` is the SI unit as the table of channels writes it."""

    measures: str
    factor: float = 1.0
    offset: float = 0.0


_FOOT, _KNOT, _G = 0.3048, 1852.0 / 3600.0, 9.80665
UNITS: dict[str, Unit] = {
    "rad": Unit("rad"),
    "deg": Unit("rad", math.pi / 180.0),
    "cdeg": Unit("rad", math.pi / 18000.0),
    "rad/s": Unit("rad/s"),
    "deg/s": Unit("rad/s", math.pi / 180.0),
    "mrad/s": Unit("rad/s", 1e-3),
    "rpm": Unit("rad/s", math.pi / 30.0),
    "Hz": Unit("rad/s", 2.0 * math.pi),
    "rad/s²": Unit("rad/s²"),
    "deg/s²": Unit("rad/s²", math.pi / 180.0),
    "m": Unit("m"),
    "mm": Unit("m", 1e-3),
    "cm": Unit("m", 1e-2),
    "km": Unit("m", 1e3),
    "ft": Unit("m", _FOOT),
    "in": Unit("m", _FOOT / 12.0),
    "m/s": Unit("m/s"),
    "cm/s": Unit("m/s", 1e-2),
    "mm/s": Unit("m/s", 1e-3),
    "km/h": Unit("m/s", 1.0 / 3.6),
    "kn": Unit("m/s", _KNOT),
    "kt": Unit("m/s", _KNOT),
    "mph": Unit("m/s", 5280.0 * _FOOT / 3600.0),
    "ft/s": Unit("m/s", _FOOT),
    "ft/min": Unit("m/s", _FOOT / 60.0),
    "m/s²": Unit("m/s²"),
    "g": Unit("m/s²", _G),
    "mg": Unit("m/s²", 1e-3 * _G),
    "cm/s²": Unit("m/s²", 1e-2),
    "ft/s²": Unit("m/s²", _FOOT),
    "N m": Unit("N m"),
    "ft lb": Unit("N m", _FOOT * 4.4482216152605),
    "V": Unit("V"),
    "mV": Unit("V", 1e-3),
    "norm": Unit("norm"),
    "%": Unit("norm", 0.01),
    "us": Unit("norm", 1e-3, -1.0),  # a servo pulse of 1000 to 2000 us is 0 to 1
    "s": Unit("s"),
    "ms": Unit("s", 1e-3),
    "ns": Unit("s", 1e-9),
}
"""`us` of a control is a servo pulse; of a clock it is a microsecond, see `clock_unit`."""


SPELLINGS = (
    *((" per ", "/"), ("°", "deg"), ("**2", "²"), ("^2", "²"), ("/s2", "/s²"), ("/s/s", "/s²")),
    ("second squared", "s²"),
)
"""What people write, and the same as the table has it."""
WORDS = {
    **dict.fromkeys(("degrees", "degree", "degs"), "deg"),
    **dict.fromkeys(("radians", "radian", "rads"), "rad"),
    **dict.fromkeys(("meters", "meter", "metres", "metre"), "m"),
    **dict.fromkeys(("feet", "foot"), "ft"),
    **dict.fromkeys(("seconds", "second", "secs", "sec"), "s"),
    **dict.fromkeys(("minutes", "minute"), "min"),
    **dict.fromkeys(("hours", "hour", "hr"), "h"),
    **dict.fromkeys(("knots", "knot", "kts"), "kt"),
    **{"volts": "V", "volt": "V", "percent": "%", "pct": "%", "gs": "g"},
}
"""Words of a unit, in small letters, and the same as the table has them."""
WHOLE = {
    **{"g's": "g", "-": "norm", "kmh": "km/h", "kph": "km/h"},
    **{"dps": "deg/s", "degps": "deg/s", "deg_s": "deg/s", "radps": "rad/s", "rad_s": "rad/s"},
    **{"mps": "m/s", "m_s": "m/s", "fps": "ft/s", "ft_s": "ft/s", "mps2": "m/s²", "m_s2": "m/s²", "fps2": "ft/s²"},
    **{"degps2": "deg/s²", "deg_s2": "deg/s²", "radps2": "rad/s²", "rad_s2": "rad/s²"},
}
"""Units that are spelt as one word, in small letters."""


_INVERSE = re.compile(r"[ .·*]\s*s(?:ec)?\^?\{?-([12])\}?$")
_WORD = re.compile(r"[A-Za-z]{2,}")
_RAISED = str.maketrans("⁻¹²", "-12")


def find_unit(name: str) -> Unit | None:
    """Unit of this name, also written with ^2, a plain 2 or as m.s-1, or in capitals; None where the table has none."""
    name = name.strip().translate(MICRO)
    name = name.translate(_RAISED) if "⁻" in name else name
    name = _INVERSE.sub(lambda power: "/s" + power[1].replace("1", ""), name)
    name = WHOLE.get(name.lower(), name)
    for typed, meant in SPELLINGS:
        name = name.replace(typed, meant)
    name = _WORD.sub(lambda word: WORDS.get(word[0].lower(), word[0]), name)
    return UNITS.get(name) or (find_unit(name.lower()) if name != name.lower() else None)


CLOCKS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "usecs", "micros", "microsec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecond", "nanoseconds"), 1e-9),
    **{"minute": 60.0, "minutes": 60.0, "hour": 3600.0, "hours": 3600.0, "day": 86400.0, "days": 86400.0},
}
"""Seconds of one unit of a clock; `min` stands for a least value as often."""
MICRO = str.maketrans(dict.fromkeys("\N{MICRO SIGN}\N{GREEK SMALL LETTER MU}", "u"))
"""The two letters that are printed alike."""
_OF_DAY = re.compile(r"hh?:mm:ss([.,][sfx0]+)?|utc|gmt")
"""What headers say of times of day, whose texts are read in seconds."""


def clock_unit(name: str) -> float | None:
    """Seconds of one unit of a clock; None where it is none."""
    name = name.strip().lower().translate(MICRO)
    return 1.0 if _OF_DAY.fullmatch(name) else CLOCKS.get(name)


def in_header(name: str, unit: str) -> str:
    """A unit as its column's name makes it plain: `min` of a time are minutes, elsewhere a least value."""
    return "minutes" if unit.lower() == "min" and name.strip().lower() in ("t", "time") else unit


def names_of(measures: str) -> list[str]:
    """Names of all units that measure the same."""
    return [name for name, unit in UNITS.items() if unit.measures == measures]
