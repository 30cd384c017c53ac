"""Exact kinematics of a rigid body, rate by rate, and the errors by which sensors depart from them.

Only inertial motion over ground enters: wind and gusts act on the aircraft, but on none of these equations.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from rotorid_torch.core.names import ATTITUDES, POSITIONS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.effects.families.sensors import DAMPED, DAMPING, PERIOD, SMOOTHED

Array = np.ndarray

UNITS: dict[str, tuple[str, ...]] = {
    "velocities": VELOCITIES,
    "attitude": ATTITUDES,
    "rates": RATES,
    "accelerations": SPECIFIC_FORCES,
}
"""Channels that share a clock and a filter; flapping has no kinematics."""

GRAVITY_RANGE = 0.0053
"""Gravity at the poles over that at the equator, less 1: what a declaration may leave open."""

TRIADS = (RATES, SPECIFIC_FORCES, tuple(f"{rate}dot" for rate in RATES))
"""Vectors that an IMU reads."""
OF_GYROS = "misalignment_of_gyros"
"""A turn of the gyros alone, which the accelerometers do not share."""
_TURN = ("p", "q", "r", "phi", "theta")
_MOVE = ("u", "v", "w", *_TURN)
EQUATIONS: dict[str, tuple[str, ...]] = {
    "phi": _TURN,
    "theta": _TURN,
    "psi": (*_TURN, "psi"),
    "u": (*_MOVE, "ax"),
    "v": (*_MOVE, "ay"),
    "w": (*_MOVE, "az"),
    "north": ("u", "v", "w", "phi", "theta", "psi", "north"),
    "east": ("u", "v", "w", "phi", "theta", "psi", "east"),
    "height": ("u", "v", "w", "phi", "theta", "height"),
    "p": ("p", "pdot"),
    "q": ("q", "qdot"),
    "r": ("r", "rdot"),
}
"""Channel whose rate is compared, and the channels that this takes."""


def of_part_of_a_vector(channels: Collection[str]) -> set[str]:
    """Channels of the IMU that read a vector of which another axis is not there: they cannot be turned."""
    return {name for triad in TRIADS for name in triad if name in channels and not set(triad) <= set(channels)}


def usable(channels: Collection[str]) -> tuple[str, ...]:
    """Equations for which every channel is there."""
    return tuple(name for name, needs in EQUATIONS.items() if set(needs) <= set(channels))


def sides(
    x: Mapping[str, Array], equations: Collection[str], gravity: float, arm: Sequence[Array | float]
) -> tuple[list[Array], list[Array]]:
    """Both sides of d(left)/dt = right of each equation, (...) each, for channels (...) without error.

    The velocity that is differentiated is that of the IMU, at `arm` (3) m from the centre of gravity: its rate needs
    no angular acceleration. Channels and arm may have leading dimensions of their own, which broadcast.

    Source: Morelli and Klein, Aircraft System Identification, 2nd ed., eq. 3.20, 3.24, 3.35, 10.11.
    """
    left, right = dict(x), {rate: x[f"{rate}dot"] for rate in RATES if f"{rate}dot" in x}
    wanted = set(equations)
    if wanted - set(RATES):
        tilt = _Tilt(np.sin(x["phi"]), np.cos(x["phi"]), np.sin(x["theta"]), np.cos(x["theta"]))
        if wanted & set(ATTITUDES):
            right |= _turning(x, tilt)
        if wanted & set(VELOCITIES):
            moved, pushed = _moving(x, tilt, wanted, gravity, arm)
            left |= moved
            right |= pushed
        if wanted & set(POSITIONS):
            right |= _travelling(x, tilt)
    order = [name for name in EQUATIONS if name in wanted]
    return [left[name] for name in order], [right[name] for name in order]


class _Tilt(NamedTuple):
    sin_phi: Array
    cos_phi: Array
    sin_theta: Array
    cos_theta: Array


def _turning(x: Mapping[str, Array], tilt: _Tilt) -> dict[str, Array]:
    """Rates of the Euler angles."""
    about_z = x["q"] * tilt.sin_phi + x["r"] * tilt.cos_phi
    return {
        "phi": x["p"] + tilt.sin_theta / tilt.cos_theta * about_z,
        "theta": x["q"] * tilt.cos_phi - x["r"] * tilt.sin_phi,
        "psi": about_z / tilt.cos_theta,
    }


def _moving(
    x: Mapping[str, Array], tilt: _Tilt, wanted: Collection[str], gravity: float, arm: Sequence[Array | float]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Velocity of the IMU over ground, and its rate."""
    p, q, r = x["p"], x["q"], x["r"]
    u = x["u"] + q * arm[2] - r * arm[1]
    v = x["v"] + r * arm[0] - p * arm[2]
    w = x["w"] + p * arm[1] - q * arm[0]
    fall = (-tilt.sin_theta, tilt.cos_theta * tilt.sin_phi, tilt.cos_theta * tilt.cos_phi)
    turned = (r * v - q * w, p * w - r * u, q * u - p * v)
    felt = [i for i, name in enumerate(VELOCITIES) if name in wanted]
    pushed = {VELOCITIES[i]: x[SPECIFIC_FORCES[i]] + gravity * fall[i] + turned[i] for i in felt}
    return {"u": u, "v": v, "w": w}, pushed


def _travelling(x: Mapping[str, Array], tilt: _Tilt) -> dict[str, Array]:
    """Rates of the position; height is positive up."""
    across = x["v"] * tilt.sin_phi + x["w"] * tilt.cos_phi
    rates = {"height": x["u"] * tilt.sin_theta - across * tilt.cos_theta}
    if "psi" in x:
        level = x["u"] * tilt.cos_theta + across * tilt.sin_theta
        side = x["v"] * tilt.cos_phi - x["w"] * tilt.sin_phi
        sin_psi, cos_psi = np.sin(x["psi"]), np.cos(x["psi"])
        rates |= {"north": level * cos_psi - side * sin_psi, "east": level * sin_psi + side * cos_psi}
    return rates


def without_static_errors(readings: Mapping[str, Array], errors: Mapping[str, Array | float]) -> dict[str, Array]:
    """Channels (...) less bias, scale and the IMU's misalignment; errors by name ("scale.q", "misalignment.x", ...).

    What a sensor reads is (1 + scale) times the truth plus the bias; an IMU turned by a small rotation vector e reads
    R(e)' times the truth, to first order truth - e x truth. Errors are numbers, or arrays that broadcast with channels.
    What reads a vector of which an axis is not recorded cannot be turned back, and is missing then.
    """
    x = dict(readings)
    for name, value in errors.items():
        kind, _, channel = name.partition(".")
        if kind == "bias" and channel in x:
            x[channel] = x[channel] - value
    for name, value in errors.items():
        kind, _, channel = name.partition(".")
        if kind == "scale" and channel in x:
            x[channel] = x[channel] / (1.0 + value)
    for kind, triads in (("misalignment", TRIADS), (OF_GYROS, TRIADS[::2])):
        turn = [errors.get(f"{kind}.{axis}", 0.0) for axis in "xyz"]
        for triad in triads if any(np.any(part) for part in turn) else ():
            present = [name for name in triad if name in x]
            if present:
                missing = np.full_like(x[present[0]], np.nan)
                turned = rotated([x.get(name, missing) for name in triad], turn)
                x |= {name: turned[triad.index(name)] for name in present}
    return x


def rotated(values: Sequence[Array], vector: Sequence[Array | float]) -> list[Array]:
    """Components (3) of a vector turned by a rotation vector (3), rad; v + a e x v + b e x (e x v).

    Source: Rodrigues' formula; Stevens and Lewis, Aircraft Control and Simulation, 3rd ed., eq. 1.2-12.
    """
    angle = np.sqrt(sum(np.square(part) for part in vector))
    a, b = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    across = _cross(vector, values)
    twice = _cross(vector, across)
    return [v + a * once + b * two for v, once, two in zip(values, across, twice, strict=True)]


def _cross(a: Sequence[Array | float], b: Sequence[Array]) -> list[Array]:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def undoing(errors: Mapping[str, Array | float], unit: str) -> tuple[Array | float, Array | float]:
    """Coefficients a, s, and b, s², by which a unit's filters are undone: x = y + a dy/dt + b d²y/dt².

    A filter of first order (tau) has a = tau; one of second order a = 2 zeta T, b = T² with T one over its natural
    frequency; a symmetric window b = -variance/2, to second order in frequency. One behind the other they multiply.
    """
    tau, period = errors.get(f"filter.{unit}", 0.0), errors.get(f"filter.{unit}{PERIOD}", 0.0)
    damped = 2.0 * errors.get(f"filter.{unit}{DAMPED}", DAMPING[2]) * period
    smoothed = 0.5 * errors.get(f"filter.{unit}{SMOOTHED}", 0.0)
    return tau + damped, period * period + damped * tau - smoothed


def null(name: str) -> float:
    """Value of an error where there is none: the damping of a filter without period is that of most."""
    return DAMPING[2] if name.endswith(DAMPED) else 0.0


_UNIT = {channel: unit for unit, members in UNITS.items() for channel in members}


def unit_of(channel: str) -> str:
    """Unit (velocities, attitude, ...) that a channel belongs to; an empty string for none."""
    return _UNIT.get(channel, "")
