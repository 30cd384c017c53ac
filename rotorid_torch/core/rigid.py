"""Rigid-body equations: body axes x forward, y right, z down; Euler angles 3-2-1; everything broadcasts over `...`.

Source: Morelli and Klein, Aircraft System Identification (2nd ed.), ch. 3; Stevens and Lewis, Aircraft Control and
Simulation (3rd ed.), eq. 1.8-2 ff.
"""

import numpy as np
import torch
from torch import Tensor


def vec(*parts: Tensor) -> Tensor:
    """Stack parts along a new last dimension after broadcasting them against each other."""
    return torch.stack(torch.broadcast_tensors(*parts), dim=-1)


def join(*parts: Tensor) -> Tensor:
    """Concatenate parts [..., n] along the last dimension after broadcasting their leading ones against each other."""
    # numpy's, for torch's own loads a computer algebra system when it is first called, a second
    shape = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
    return torch.cat([part.expand(*shape, -1) for part in parts], dim=-1)


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Cross product of a [..., 3] and b [..., 3], leading dimensions broadcast."""
    ax, ay, az = a.unbind(-1)
    bx, by, bz = b.unbind(-1)
    return vec(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def gravity_in_body(attitude: Tensor, gravity: float | Tensor) -> Tensor:
    """Gravity in body axes, m/s2 [..., 3], from attitude [..., 2 or 3] (phi, theta, (psi)), rad."""
    phi, theta = attitude[..., 0], attitude[..., 1]
    cos_theta = torch.cos(theta)
    return vec(-gravity * torch.sin(theta), gravity * cos_theta * torch.sin(phi), gravity * cos_theta * torch.cos(phi))


def velocity_rates(velocity: Tensor, rates: Tensor, attitude: Tensor, specific_force: Tensor, gravity: float) -> Tensor:
    """d(u, v, w)/dt, m/s2 [..., 3].

    velocity : [..., 3] m/s, body; rates : [..., 3] rad/s; attitude : [..., >= 2] phi, theta (rad).
    specific_force : [..., 3] m/s2, external force without gravity over mass, at the centre of gravity.
    """
    return specific_force + gravity_in_body(attitude, gravity) - cross(rates, velocity)


def gyroscopic(rates: Tensor, inertia: Tensor) -> Tensor:
    """Angular acceleration -I^-1 (omega x I omega), rad/s2 [..., 3], of a body with inertia [3, 3] kg m2."""
    return -(cross(rates, rates @ inertia.mT) @ torch.linalg.inv(inertia).mT)


def euler_rates(rates: Tensor, attitude: Tensor) -> Tensor:
    """d(phi, theta, psi)/dt, rad/s [..., 3], from body rates [..., 3] and attitude [..., >= 2]."""
    p, q, r = rates.unbind(-1)
    phi, theta = attitude[..., 0], attitude[..., 1]
    sin_phi, cos_phi = torch.sin(phi), torch.cos(phi)
    about_z = q * sin_phi + r * cos_phi
    return vec(p + torch.tan(theta) * about_z, q * cos_phi - r * sin_phi, about_z / torch.cos(theta))


def position_rates(velocity: Tensor, attitude: Tensor) -> Tensor:
    """d(north, east, height)/dt, m/s [..., 3]; height is positive up; attitude [..., 3] phi, theta, psi."""
    u, v, w = velocity.unbind(-1)
    phi, theta, psi = attitude.unbind(-1)
    sin_phi, cos_phi = torch.sin(phi), torch.cos(phi)
    level = u * torch.cos(theta) + (v * sin_phi + w * cos_phi) * torch.sin(theta)
    side = v * cos_phi - w * sin_phi
    climb = u * torch.sin(theta) - (v * sin_phi + w * cos_phi) * torch.cos(theta)
    return vec(level * torch.cos(psi) - side * torch.sin(psi), level * torch.sin(psi) + side * torch.cos(psi), climb)


def velocity_in_body(level: Tensor, attitude: Tensor) -> Tensor:
    """U v w, m/s [..., 3], of a velocity north, east and up [..., 3]; attitude [..., 3] phi, theta, psi."""
    axes = torch.eye(3, dtype=level.dtype)
    columns = [(position_rates(axis.expand_as(level), attitude) * level).sum(dim=-1) for axis in axes]
    return torch.stack(columns, dim=-1)


def specific_force_at(point: Tensor, specific_force: Tensor, rates: Tensor, angular_acceleration: Tensor) -> Tensor:
    """Specific force, m/s2 [..., 3], at a point [3] m from the centre of gravity (an IMU)."""
    return specific_force + cross(angular_acceleration, point) + cross(rates, cross(rates, point))
