"""Channels from what logs hold instead: quaternion, velocity in north-east-down axes, latitude and longitude."""

from dataclasses import replace

import numpy as np

from rotorid_torch.core.names import RATES
from rotorid_torch.importing.signals.fields import Signal
from rotorid_torch.importing.signals.plan import QUATERNION, rate_of

Signals = dict[str, Signal]
ANGLES = ("phi", "theta", "psi")
VELOCITY = ("vn", "ve", "vd")
OVER, STEEP = 2.4, 1.2
"""Roll and pitch angle in rad beyond which Euler angles are not interpolated."""
EQUATOR_M, FLATTENING = 6378137.0, 1.0 / 298.257223563


def unwrapped(values: np.ndarray) -> np.ndarray:
    """Angle (T,) in rad without jumps of a turn, over missing samples too."""
    finite = np.isfinite(values)
    result = values.copy()
    result[finite] = np.unwrap(values[finite])
    return result


def before_resampling(signals: Signals) -> Signals:
    """Euler angles from a quaternion, north and east from latitude and longitude, headings without jumps."""
    derived = dict(signals)
    if all(name in derived for name in QUATERNION):
        q = [derived.pop(name) for name in QUATERNION]
        for name, values in zip(("phi", "theta", "psi"), euler(*(s.values for s in q)), strict=True):
            derived.setdefault(name, replace(q[0], name=name, values=values, source=replace(q[0].source, field="q")))
    if "latitude" in derived and "longitude" in derived:
        latitude, longitude = derived.pop("latitude"), derived.pop("longitude")
        for name, values in zip(("north", "east"), local(latitude.values, longitude.values), strict=True):
            derived.setdefault(name, replace(latitude, name=name, values=values))
    if _turns_over(derived):
        return as_quaternion(derived)
    for name in ("phi", "psi"):
        if name in derived:
            derived[name] = replace(derived[name], values=unwrapped(derived[name].values))
    return derived


_FIRST, _LAST = (0, 1, 2, 3), (3, 0, 1, 2)
_THE_OTHER_WAY, _LEFT_AND_UP = (1.0, -1.0, -1.0, -1.0), (1.0, 1.0, -1.0, -1.0)
ORDERS = {
    "": (_FIRST, (1.0, 1.0, 1.0, 1.0)),
    "vector first, scalar last": (_LAST, (1.0, 1.0, 1.0, 1.0)),
    "from north-east-down to body axes": (_FIRST, _THE_OTHER_WAY),
    "from north-east-down to body axes, scalar last": (_LAST, _THE_OTHER_WAY),
    "in axes to the front, left and up": (_FIRST, _LEFT_AND_UP),
    "in axes to the front, left and up, scalar last": (_LAST, _LEFT_AND_UP),
}
"""How a quaternion may be written: places of scalar and vector, and the signs that make it the usual one."""
TURN_S = 0.1
"""Time over which a quaternion's turn is compared with the body rates."""
AGREES, DISAGREES = 0.3, 0.7
"""Share of the rates' power that the right way may leave, and that the usual one must leave to be given up."""


def by_rates(signals: Signals) -> tuple[Signals, str]:
    """Signals with a quaternion in the usual order, and a sentence where the body rates do not confirm that order.

    The turn between two samples is compared with the rates between them, which no convention changes. Where no rates
    decide, the usual order is taken.
    """
    if not all(name in signals for name in QUATERNION):
        return signals, ""
    columns = " ".join(signals[name].source.field for name in QUATERNION)
    open_order = f"{columns} are taken scalar first, from body to north-east-down axes: no body rates confirm it"
    if not all(name in signals for name in RATES):
        return signals, open_order
    q = np.stack([signals[name].values for name in QUATERNION])
    usual = {order: q[[*places]] * np.array(signs)[:, None] for order, (places, signs) in ORDERS.items()}
    left = {order: _left(signals, each) for order, each in usual.items()}
    best = min(left, key=lambda order: left[order])
    if not (left[best] < AGREES and left[""] > DISAGREES):
        return signals, "" if best == "" and left[best] < DISAGREES else open_order
    moved = {name: replace(signals[name], values=row) for name, row in zip(QUATERNION, usual[best], strict=True)}
    alike = " or ".join(order for order in ORDERS if left[order] < AGREES)
    taken = f": {best} is taken" if alike != best else ""
    return {**signals, **moved}, f"the quaternion is {alike}, by the body rates{taken}"


def _left(signals: Signals, q: np.ndarray) -> float:
    """Share of the body rates' power that the turns of a quaternion (4, T) leave; infinite where nothing turns.

    Source: Stevens and Lewis, Aircraft Control and Simulation (3rd ed.), eq. 1.8-15: q(t)* q(t + dt) is half the turn.
    """
    time = signals[QUATERNION[0]].time
    every = max(1, round(TURN_S * rate_of(time)))
    first, later, span = q[:, :-every], q[:, every:], time[every:] - time[:-every]
    scalar = (first * later).sum(axis=0)
    a, b = first[1:], later[1:]
    vector = first[0] * b - later[0] * a - np.cross(a, b, axis=0)
    turned = 2.0 * np.where(scalar < 0.0, -vector, vector) / span
    means = [_integral(signals[name], time)[every:] - _integral(signals[name], time)[:-every] for name in RATES]
    rates = np.stack(means) / span
    whole = np.isfinite(turned).all(axis=0) & np.isfinite(rates).all(axis=0) & (span < 5.0 * TURN_S)
    away = turned - rates
    power = float((rates[:, whole] ** 2).sum())
    return float((away[:, whole] ** 2).sum()) / power if power > 0.0 else np.inf


def _integral(signal: Signal, time: np.ndarray) -> np.ndarray:
    """Integral of a signal, bridged where it is missing, at these times (T,)."""
    finite = np.isfinite(signal.values)
    at, values = signal.time[finite], signal.values[finite]
    if len(at) < 2:
        return np.full(len(time), np.nan)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(at))])
    return np.interp(time, at, total, left=np.nan, right=np.nan)


def _turns_over(signals: Signals) -> bool:
    """Whether attitudes of one clock come where Euler angles jump: upside down, nose up or nose down."""
    if not all(name in signals for name in ANGLES):
        return False
    phi, theta, psi = (signals[name] for name in ANGLES)
    one = len(phi.time) == len(theta.time) == len(psi.time) and bool((phi.time == psi.time).all())
    with np.errstate(invalid="ignore"):
        far = (np.abs(wrapped(phi.values)) > OVER) | (np.abs(theta.values) > STEEP)
    return one and bool(far.any())


def as_quaternion(signals: Signals) -> Signals:
    """Signals with Euler angles of one clock as a quaternion without jumps, which can be interpolated."""
    derived = dict(signals)
    angles = [derived.pop(name) for name in ANGLES]
    q = quaternion(*(s.values for s in angles))
    for name, values in zip(QUATERNION, q, strict=True):
        derived[name] = replace(angles[0], name=name, values=values)
    return derived


def quaternion(phi: np.ndarray, theta: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """Quaternion (4, T) from body to north-east-down axes, scalar first, its sign without jumps; NaN where missing.

    Source: Stevens and Lewis, Aircraft Control and Simulation (3rd ed.), eq. 1.8-15.
    """
    (sp, st, sy), (cp, ct, cy) = ([f(0.5 * a) for a in (phi, theta, psi)] for f in (np.sin, np.cos))
    q = np.stack(
        [
            cp * ct * cy + sp * st * sy,
            sp * ct * cy - cp * st * sy,
            cp * st * cy + sp * ct * sy,
            cp * ct * sy - sp * st * cy,
        ]
    )
    whole = np.flatnonzero(np.isfinite(q).all(axis=0))
    along = (q[:, whole[1:]] * q[:, whole[:-1]]).sum(axis=0)
    q[:, whole] *= np.cumprod(np.concatenate([[1.0], np.where(along < 0.0, -1.0, 1.0)]))[: len(whole)]
    return q


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angle in rad within half a turn either way."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def angles_on_grid(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays with Euler angles in place of a quaternion: roll within half a turn, heading without jumps."""
    derived = dict(arrays)
    if all(name in derived for name in QUATERNION):
        angles = euler(*(derived.pop(name) for name in QUATERNION))
        derived |= dict(zip(ANGLES, angles, strict=True))
        derived["psi"] = unwrapped(derived["psi"])
    if "phi" in derived:
        derived["phi"] = wrapped(derived["phi"])
    return derived


def euler(q0: np.ndarray, q1: np.ndarray, q2: np.ndarray, q3: np.ndarray) -> tuple[np.ndarray, ...]:
    """Euler angles 3-2-1 (T,) in rad of the rotation from body to north-east-down axes, q0 the scalar part.

    A quaternion of no length is a missing sample.

    Source: Stevens and Lewis, Aircraft Control and Simulation (3rd ed.), eq. 1.8-18.
    """
    norm = q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3
    size = np.where(norm > 0.25, norm, np.nan)
    phi = np.arctan2(2.0 * (q2 * q3 + q0 * q1), q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3) + 0.0 * size
    theta = np.arcsin(np.clip(2.0 * (q0 * q2 - q1 * q3) / size, -1.0, 1.0))
    psi = np.arctan2(2.0 * (q1 * q2 + q0 * q3), q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3) + 0.0 * size
    return phi, theta, psi


def local(latitude: np.ndarray, longitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """North and east (T,) in m of the first known place, from latitude and longitude in rad.

    Source: Groves, Principles of GNSS, Inertial and Multisensor Integrated Navigation (2nd ed.), eq. 2.105 ff.
    """
    finite = np.isfinite(latitude) & np.isfinite(longitude)
    if not finite.any():
        return latitude.copy(), longitude.copy()
    lat0, lon0 = latitude[finite][0], longitude[finite][0]
    square = FLATTENING * (2.0 - FLATTENING)
    bent = 1.0 - square * np.sin(lat0) ** 2
    meridian, prime = EQUATOR_M * (1.0 - square) / bent**1.5, EQUATOR_M / np.sqrt(bent)
    return (latitude - lat0) * meridian, (longitude - lon0) * prime * np.cos(lat0)


def body_velocity(arrays: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], str]:
    """Arrays on the grid with u v w in place of vn ve vd, turned by the attitude; a sentence where that is missing."""
    derived = dict(arrays)
    components = [derived.pop(name) for name in VELOCITY if name in derived]
    if len(components) < 3 or all(name in derived for name in ("u", "v", "w")):
        return derived, ""
    if not all(name in derived for name in ("phi", "theta", "psi")):
        return derived, "velocity north, east and down cannot be turned into body axes without phi, theta and psi"
    turned = to_body(components[0], components[1], components[2], derived["phi"], derived["theta"], derived["psi"])
    return derived | dict(zip(("u", "v", "w"), turned, strict=True)), ""


def to_body(
    north: np.ndarray, east: np.ndarray, down: np.ndarray, phi: np.ndarray, theta: np.ndarray, psi: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """North-east-down components of a vector (T,) in body axes, by Euler angles 3-2-1 in rad.

    Source: Stevens and Lewis, Aircraft Control and Simulation (3rd ed.), eq. 1.7-16.
    """
    ahead = np.cos(psi) * north + np.sin(psi) * east
    side = -np.sin(psi) * north + np.cos(psi) * east
    low = np.sin(theta) * ahead + np.cos(theta) * down
    return (
        np.cos(theta) * ahead - np.sin(theta) * down,
        np.cos(phi) * side + np.sin(phi) * low,
        -np.sin(phi) * side + np.cos(phi) * low,
    )
