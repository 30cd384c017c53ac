"""Channels, controls, axes and units: the one table that everybody reads.

SI units and radians; body axes x forward, y right, z down; Euler angles 3-2-1.
"""

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

Bias = Literal["free", "none"]
Verdict = Literal["accepted", "rejected", "below floor", "suspected", "indistinguishable", "not testable"]
"""What is said of one effect."""
Kind = Literal["nothing undeclared", "undeclared", "group", "unknown", "structure"]
"""What is said of a whole run."""


@dataclass(frozen=True)
class Channel:
    """One measured channel.

    `bias` is the default of its sensor's constant error. Gyros and accelerometers drift, so rates, specific force and
    angular acceleration have a free constant per flight; velocities, attitudes, positions, air data and flapping come
    from solutions that are aligned before flight, and a bias on them could not be told from a trim. What values
    the channel can have is in `core.ranges`; which sign a control has is the data set's (`data.schema.ControlSpec`).
    """

    name: str
    unit: str
    about: str
    kind: str
    bias: Bias = "none"


def _table() -> dict[str, Channel]:
    rows: list[tuple[str, str, str, str]] = [
        ("time", "s", "time", "time"),
        ("lon", "rad", "longitudinal cyclic", "control"),
        ("lat", "rad", "lateral cyclic", "control"),
        ("col", "rad", "main rotor collective", "control"),
        ("ped", "rad", "tail rotor collective", "control"),
        ("u", "m/s", "forward velocity over ground", "velocity"),
        ("v", "m/s", "sideward velocity over ground", "velocity"),
        ("w", "m/s", "downward velocity over ground, body axes", "velocity"),
        ("p", "rad/s", "roll rate", "rate"),
        ("q", "rad/s", "pitch rate", "rate"),
        ("r", "rad/s", "yaw rate", "rate"),
        ("phi", "rad", "roll angle", "attitude"),
        ("theta", "rad", "pitch angle", "attitude"),
        ("psi", "rad", "heading", "attitude"),
        ("north", "m", "position north", "position"),
        ("east", "m", "position east", "position"),
        ("height", "m", "height, positive up", "position"),
        ("ax", "m/s²", "specific force forward at the IMU", "specific force"),
        ("ay", "m/s²", "specific force sideward at the IMU", "specific force"),
        ("az", "m/s²", "specific force downward at the IMU", "specific force"),
        ("pdot", "rad/s²", "roll acceleration", "angular acceleration"),
        ("qdot", "rad/s²", "pitch acceleration", "angular acceleration"),
        ("rdot", "rad/s²", "yaw acceleration", "angular acceleration"),
        ("airspeed", "m/s", "airspeed", "air data"),
        ("alpha", "rad", "angle of attack", "air data"),
        ("beta", "rad", "sideslip", "air data"),
        ("a0", "rad", "coning", "flapping"),
        ("a1", "rad", "longitudinal flapping", "flapping"),
        ("b1", "rad", "lateral flapping", "flapping"),
        ("omega", "rad/s", "main rotor speed", "rotor"),
        ("torque", "N m", "main rotor torque", "rotor"),
        ("voltage", "V", "battery voltage", "rotor"),
    ]
    free = {"rate", "specific force", "angular acceleration"}
    return {
        name: Channel(name, unit, about, kind, "free" if kind in free else "none") for name, unit, about, kind in rows
    }


CHANNELS: dict[str, Channel] = _table()
"""Every channel with a fixed name; `motorN` and `omegaN` are families, see `channel`."""

STICKS = ("lon", "lat", "col", "ped")
"""Controls of a helicopter, in canonical order."""

BODY = ("u", "v", "w", "p", "q", "r", "phi", "theta")
"""Channels that a free run is scored on, where the data set has them."""

VELOCITIES, RATES, ATTITUDES = ("u", "v", "w"), ("p", "q", "r"), ("phi", "theta", "psi")
POSITIONS, SPECIFIC_FORCES = ("north", "east", "height"), ("ax", "ay", "az")
FLAPPING = ("a0", "a1", "b1")
INDUCED_SHARE = "induced.share"
"""Signal of the model: what is left of momentum theory's induced velocity, near the ground for example."""
FORCES, MOMENTS = ("X", "Y", "Z"), ("L", "M", "N")
"""Axes of force (N) and moment (N m) about the centre of gravity, body axes, without gravity."""

_FAMILIES = {
    "motor": Channel("motor", "norm", "motor command, 0…1", "control"),
    "omega": Channel("omega", "rad/s", "rotor speed", "rotor"),
}
_MEMBER = re.compile(r"(motor|omega)([1-9][0-9]?)")


def channel(name: str) -> Channel | None:
    """Channel of this name from the table or from the families `motorN`, `omegaN`; None for somebody's own name."""
    if name in CHANNELS:
        return CHANNELS[name]
    member = _MEMBER.fullmatch(name)
    if member is None:
        return None
    family = _FAMILIES[member[1]]
    return replace(family, name=name, about=f"{family.about} of motor {member[2]}")


MEANT = {
    **dict.fromkeys(("roll", "rollangle", "roll_angle", "bank"), "phi"),
    **dict.fromkeys(("pitch", "pitchangle", "pitch_angle"), "theta"),
    **dict.fromkeys(("yaw", "heading", "hdg", "yawangle", "yaw_angle"), "psi"),
    **{
        f"{kind}{mark}{axis}": name
        for axis, name in zip("xyz", "pqr", strict=True)
        for kind in ("gyro", "gyr", "w", "omega")
        for mark in ("", "_")
    },
    **{f"{kind}[{i}]": name for i, name in enumerate("pqr") for kind in ("gyro", "gyr", "omega")},
    **{f"{kind}{mark}{axis}": f"a{axis}" for axis in "xyz" for kind in ("acc", "accel") for mark in ("", "_")},
    **{f"{kind}[{i}]": f"a{axis}" for i, axis in enumerate("xyz") for kind in ("acc", "accel")},
    **{
        f"{axis}{mark}rate": name
        for axis, name in zip(("roll", "pitch", "yaw"), "pqr", strict=True)
        for mark in ("", "_")
    },
    **dict.fromkeys(("alt", "altitude"), "height"),
    **{"aileron": "lat", "elevator": "lon", "rudder": "ped", "collective": "col"},
    **{"longitudinal": "lon", "lateral": "lat", "pedal": "ped", "pedals": "ped"},
}
"""What other people call channels, in small letters: a hint, for such names tell neither unit nor sign."""
ALIKE = 0.8
"""Twice the letters that two names share, in order, over all their letters: one letter wrong in six, or one too many in
four; `phi_cmd` is no misspelt `phi`."""


def meant(name: str) -> str:
    """Channel that somebody's own name may stand for: in other letters, misspelt, or as others call it; else empty."""
    bare = re.sub(r"\s*[\[({][^\])}]*[^\d\])}][^\])}]*[\])}]$", "", name.strip())  # but for its unit in brackets
    plain = re.sub(r"[\s-]+", "_", bare.lower())
    if plain in MEANT or channel(plain):
        return MEANT.get(plain, plain)
    members = [f"{family}{number}" for family in _FAMILIES for number in range(1, 13)]
    return next(iter(difflib.get_close_matches(plain, [*CHANNELS, *members], 1, ALIKE)), "")


def is_motor(name: str) -> bool:
    """Whether this is a motor command, `motor1` … `motor99`."""
    return name.startswith("motor") and channel(name) is not None


def is_rotor_speed(name: str) -> bool:
    """Whether a name is the speed of one rotor of a multirotor, such as "omega3"."""
    return name.startswith("omega") and is_motor(f"motor{name.removeprefix('omega')}")


def acting(names: Iterable[str]) -> list[str]:
    """The controls among these names; rotor speeds, which then stand for them, where there is none."""
    every = list(names)
    controls = [name for name in every if is_control(name)]
    return controls or [name for name in every if is_rotor_speed(name)]


def is_control(name: str) -> bool:
    """Whether this is a control: `lon lat col ped` or `motorN`."""
    return name in STICKS or is_motor(name)


def thrust_share(name: str) -> str:
    """Signal of the model: what the rotor of a motor command or speed gives of its thrust."""
    return f"thrust.share.{name}"


RECIPROCALS = {f"s/{unit}": f"{unit}/s" for unit in ("rad", "m", "norm")}
"""Units of parameters that are one over what people measure, a control's rate limit, by the unit of that."""


def reciprocal(value: float, error: float | None, unit: str) -> tuple[float, float | None, str]:
    """One over a value, with its standard error (that of x over x^2) and its unit."""
    return 1.0 / value, error and error / value**2, RECIPROCALS.get(unit, f"1/{unit}")


def unit(name: str) -> str:
    """Unit of a channel; an empty string for a name outside the table."""
    listed = channel(name)
    return listed.unit if listed else ""


def about(name: str) -> str:
    """What a channel is, in words; empty for somebody's own name."""
    listed = channel(name)
    return listed.about if listed else ""


def default_bias(name: str) -> Bias:
    """Whether the channel's sensor has a free constant per flight unless the data set says otherwise, see `Channel`."""
    listed = channel(name)
    return listed.bias if listed else "none"


def ordered_controls(names: Iterable[str]) -> tuple[str, ...]:
    """Controls among these names in canonical order: lon lat col ped, then motors by number."""
    chosen = set(names)
    motors = sorted((n for n in chosen if is_motor(n)), key=lambda n: int(n.removeprefix("motor")))
    return (*(n for n in STICKS if n in chosen), *motors)
