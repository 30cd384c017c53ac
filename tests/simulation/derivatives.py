"""Derivatives of a linear model of the flight-test aircraft, in the form of the books."""

from __future__ import annotations

import numpy as np

from rotorid_torch.simulation.flight.linear import LinearAircraft
from rotorid_torch.simulation.flight.trim import Trim
from rotorid_torch.simulation.rigid import Array


def derivatives(linear: LinearAircraft, trim: Trim) -> Array:
    """Table of derivatives: rows X Y Z (m/s^2) L M N (rad/s^2) per u v w p q r (SI) and lon lat col ped (rad), 6 x 10.

    The terms of the turning axes are taken out of the rates, gravity is left aside; the rest belongs to the forces.
    """
    u, v, w = trim.state[:3]
    out = np.hstack([linear.a[:6, :6], linear.b[:6]])
    turning = np.array([[0.0, -w, v], [w, 0.0, -u], [-v, u, 0.0]])
    out[:3, 3:6] -= turning
    return out
