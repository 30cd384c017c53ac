"""Lift and drag of a wing section at any angle of attack, with stall: blade elements and tail surfaces use it."""

from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.rigid import Array


@dataclass(frozen=True)
class Section:
    """A section or a low-aspect wing: linear lift up to stall, flat plate beyond, blended smoothly.

    lift_slope : 1/rad.
    stall : angle of attack at which half of the linear lift has gone, rad.
    drag : profile drag coefficient at zero lift.
    drag_rise : drag per squared angle of attack below stall, 1/rad^2 (induced drag too, for a wing).

    Source: Hoerner, Fluid-Dynamic Drag (flat plate: normal force 2 sin(alpha), lift 1.1 sin(2 alpha));
    Leishman, Principles of Helicopter Aerodynamics, section 7.10 (representations of static stall).
    """

    lift_slope: float
    stall: float
    drag: float
    drag_rise: float

    blend = 0.015  # rad: width of the passage from attached to separated flow
    plate_lift, plate_drag = 1.1, 1.9

    def coefficients(self, angle: Array) -> tuple[Array, Array]:
        """Lift and drag coefficients at an angle of attack, rad, any shape; |angle| below 2 pi - stall."""
        attached = 0.5 - 0.5 * np.tanh((np.abs(angle) - self.stall) * (0.5 / self.blend))
        sine = np.sin(angle)
        square = sine * sine
        plate = (2.0 * self.plate_lift) * (sine * np.cos(angle))
        lift = plate + attached * (self.lift_slope * angle - plate)
        drag = self.drag + square * (self.plate_drag + attached * (self.drag_rise - self.plate_drag))
        return lift, drag
