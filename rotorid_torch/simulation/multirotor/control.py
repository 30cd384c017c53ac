"""The flight controller: position, velocity, attitude and rates in a cascade, and a mixer over the rotors.

It knows the vehicle as its maker does: the clean one's mass, inertia, thrust curve, places. Integrals of velocity and
rates trim what it does not know.

Source: Mahony, Kumar and Corke, IEEE Robotics and Automation Magazine 19 (2012) (hierarchical control).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.multirotor.drive import Drives
from rotorid_torch.simulation.rigid import Array

TILT = 0.7
"""rad: largest bank or pitch angle that the controller asks for."""
REACTION = 0.015
"""s: time that the fastest loop is late by before any lag or delay of the drives: filters and sampling."""
LEAST, MOST = 0.15, 0.95
"""Thrust of a rotor over its share of the weight, and command, which the mixer does not leave."""
TORQUE = 0.3
"""Largest yaw moment over what the torques of all rotors add up to in hover: lift, roll and pitch come first."""
WINDUP = 0.5, 5.0
"""What integrals reach at most: that of the rate's error, rad; what that of the velocity's asks for, m/s^2."""


@dataclass(frozen=True)
class Targets:
    """What the vehicles shall do at an instant, [.., column].

    `place`, `velocity`, `acceleration` [3]: north east down; `heading`; `tilt` [2], `rate` [3] and `turning` [3]: bank
    and pitch, body rates, and angular acceleration on top of what the place asks for; `lift`: acceleration upwards.
    """

    place: Array
    velocity: Array
    acceleration: Array
    heading: Array
    tilt: Array
    rate: Array
    turning: Array
    lift: Array

    @classmethod
    def unpack(cls, rows: Array) -> Targets:
        """Of the rows [18, column] of `ROWS`."""
        return cls(rows[:3], rows[3:6], rows[6:9], rows[9], rows[10:12], rows[12:15], rows[15:18], rows[18])


ROWS = 19
"""Rows of a packed `Targets`."""


@dataclass(frozen=True)
class Pose:
    """Where the vehicles are, [3, column]: place and velocity (north east down), Euler angles.

    `trig` : cosines and sines of the angles, [2, 3, column].
    """

    place: Array
    velocity: Array
    euler: Array
    trig: Array


@dataclass
class Controller:
    """Controllers of vehicles side by side; holds their integrals."""

    mass: Array
    inertia: Array
    gravity: Array
    allocation: Array
    curve: Array
    torque: Array
    gains: Array
    velocity_error: Array
    rate_error: Array

    @classmethod
    def of(cls, clean: Sequence[Multirotor], flown: Sequence[Multirotor], curve: Array, ratio: Array) -> Controller:
        """For vehicles as their makers know them, gains tuned for the lag and delay of those that fly.

        curve : thrust of each rotor over the square of its speed, N s^2, [rotor, column]. ratio : torque over thrust,
            m, [rotor, column].
        """
        count, columns = curve.shape
        allocation = np.empty((count, 4, columns))
        for column, one in enumerate(clean):
            place, spins = np.asarray(one.places), np.asarray(one.spins)
            effect = np.stack([np.ones(count), -place[:, 1], place[:, 0], spins * ratio[:, column]])
            allocation[:, :, column] = np.linalg.pinv(effect)
        late = np.array([one.drive.lag + one.drive.delay for one in flown]) + REACTION
        rate = np.clip(0.65 / late, 5.0, 25.0)
        gains = np.stack([rate / 24.0, rate / 9.0, rate / 3.2, rate])
        return cls(
            mass=np.array([one.mass for one in clean]),
            inertia=np.stack([one.inertia_matrix for one in clean], axis=-1),
            gravity=np.array([one.gravity for one in clean]),
            allocation=allocation,
            curve=curve,
            torque=TORQUE * ratio.mean(0) * np.array([one.mass * one.gravity for one in clean]),
            gains=gains,
            velocity_error=np.zeros((3, columns)),
            rate_error=np.zeros((3, columns)),
        )

    def commands(self, targets: Targets, at: Pose, gyro: Array, drives: Drives, dt: float) -> Array:
        """Motor commands in 0..1, [rotor, column]; `gyro`: the body rates as the controller reads them, [3, column]."""
        force = self._force(targets, at, dt)
        (cf, ct, cs), (sf, st, ss) = at.trig
        ahead, right = cs * force[0] + ss * force[1], cs * force[1] - ss * force[0]
        size = np.sqrt((force * force).sum(0))
        bank = np.clip(np.arcsin(np.clip(right / size, -1.0, 1.0)) + targets.tilt[0], -TILT, TILT)
        pitch = np.clip(np.arctan2(-ahead, -force[2]) + targets.tilt[1], -TILT, TILT)
        off = np.stack([bank, pitch, targets.heading]) - at.euler
        off[2] -= 2.0 * np.pi * np.round(off[2] / (2.0 * np.pi))
        off *= self.gains[2]
        off[2] *= 0.5
        wanted = np.stack([off[0] - st * off[2], cf * off[1] + sf * ct * off[2], cf * ct * off[2] - sf * off[1]])
        error = wanted + targets.rate - gyro
        self.rate_error = np.clip(self.rate_error + error * dt, -WINDUP[0], WINDUP[0])
        turning = self.gains[3] * (error + 0.15 * self.gains[3] * self.rate_error) + targets.turning
        turning[2] *= 0.4
        moment = (self.inertia * turning[None]).sum(1)
        moment[2] = np.clip(moment[2], -self.torque, self.torque)
        along = -(force[0] * (cf * st * cs + sf * ss) + force[1] * (cf * st * ss - sf * cs) + force[2] * cf * ct)
        wanted_all = np.concatenate([(self.mass * np.maximum(along + targets.lift, 0.2 * self.gravity))[None], moment])
        thrust = self._within_reach((self.allocation * wanted_all[None]).sum(1), drives)
        return np.minimum(drives.command(np.sqrt(thrust / self.curve)), MOST)

    def _within_reach(self, thrust: Array, drives: Drives) -> Array:
        """Thrusts, N, [rotor, column], that the rotors can give: where one cannot, lift gives way and moments stay.

        Source: Faessler, Falanga and Scaramuzza, IEEE Robotics and Automation Letters 2 (2017) (mixer saturation).
        """
        lift, least = self.allocation[:, 0], LEAST * self.mass * self.gravity / len(thrust)
        most = np.maximum(self.curve * drives.asked(np.full_like(thrust, MOST), drives.reference) ** 2, least)
        low, high = ((least - thrust) / lift).max(0), ((most - thrust) / lift).min(0)  # more lift that suits all rotors
        shift = np.where(low <= high, np.minimum(np.maximum(low, 0.0), high), 0.5 * (low + high))
        return np.clip(thrust + lift * shift, least, most)

    def _force(self, targets: Targets, at: Pose, dt: float) -> Array:
        """Specific force that the place asks for, north east down, m/s^2, [3, column]."""
        velocity = targets.velocity + self.gains[0] * np.clip(targets.place - at.place, -3.0, 3.0)
        error = velocity - at.velocity
        integral = 0.35 * self.gains[1] ** 2
        self.velocity_error = np.clip(self.velocity_error + error * dt, -WINDUP[1] / integral, WINDUP[1] / integral)
        force = targets.acceleration + self.gains[1] * error + integral * self.velocity_error
        force[2] -= self.gravity
        force[2] = np.minimum(force[2], -0.3 * self.gravity)
        return force
