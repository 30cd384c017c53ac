"""Kinematics of a rigid body in numpy, the simulator's own: vectors are [3, ...], component first."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dot(a: Array, b: Array) -> Array:
    """Scalar product over the first axis of length three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Array, b: Array) -> Array:
    """Vector product over the first axis of length three; b has the full shape, a may broadcast."""
    out = np.empty_like(b)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


def skew(vectors: Array) -> Array:
    """Matrices of the vector product from the left, [..., 3, 3] of [..., 3]: skew(r) @ v = r x v."""
    return np.cross(vectors[..., None, :], np.eye(3)).swapaxes(-1, -2)


def to_earth(euler: Array) -> Array:
    """Matrices from body axes to (north, east, down), [3, 3, flight], of phi theta psi [3, flight]."""
    (cp, ct, cs), (sp, st, ss) = np.cos(euler), np.sin(euler)
    return np.array(
        [
            [ct * cs, sp * st * cs - cp * ss, cp * st * cs + sp * ss],
            [ct * ss, sp * st * ss + cp * cs, cp * st * ss - sp * cs],
            [-st, sp * ct, cp * ct],
        ]
    )


def turned(matrix: Array, vector: Array) -> Array:
    """Matrices [3, 3, flight] times vectors [3, flight]."""
    return (matrix * vector[None]).sum(1)


def body_rates(x: Array, specific_force: Array, angular: Array, gravity: float) -> Array:
    """Rates of velocity, body rates, Euler angles and position (north, east, height), [12, ...], of these rows x.

    specific_force : [3, ...] m/s^2, body axes. angular : [3, ...] rad/s^2.

    Source: Etkin and Reid, Dynamics of Flight, 3rd ed., section 4.7.
    """
    velocity, omega = x[:3], x[3:6]
    (u, v, w), (p, q, r), (phi, theta, psi) = velocity, omega, x[6:9]
    cp, sp, ct, st, cs, ss = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
    out = np.empty((12, *x.shape[1:]))
    out[:3] = specific_force - cross(omega, velocity)
    out[0] -= gravity * st
    out[1] += gravity * ct * sp
    out[2] += gravity * ct * cp
    out[3:6] = angular
    turning = q * sp + r * cp
    out[6], out[7], out[8] = p + turning * st / ct, q * cp - r * sp, turning / ct
    level, side = u * ct + (v * sp + w * cp) * st, v * cp - w * sp
    out[9], out[10], out[11] = level * cs - side * ss, level * ss + side * cs, u * st - (v * sp + w * cp) * ct
    return out


def at_place(specific_force: Array, rates: Array, angular: Array, place: Array) -> Array:
    """Specific force [T, 3] at a place of the body [3], from that at the centre of gravity, body rates and their rates.

    Source: Etkin and Reid, Dynamics of Flight, 3rd ed., section 4.5 (acceleration of a point of a turning body).
    """
    return specific_force + np.cross(angular, place) + np.cross(rates, np.cross(rates, place))


def three(values: Any) -> tuple[float, float, float]:
    """Three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z
