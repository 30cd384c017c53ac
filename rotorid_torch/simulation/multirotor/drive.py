"""Motors, their control and the battery: from a command to a rotor's speed, and what that draws.

Rows are rotors, columns vehicles in flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.rigid import Array

SLOWEST = 0.05
"""Share of the full speed below which no control lets a rotor fall."""


@dataclass(frozen=True)
class Drives:
    """Drives and batteries of vehicles side by side, [column] each; see `craft.Drive` and `craft.Battery`."""

    full_speed: Array
    idle: Array
    exponent: Array
    power: Array
    lag: Array
    braking: Array
    inertia: Array
    full: Array
    slope: Array
    resistance: Array
    reference: Array
    efficiency: Array
    hover: Array

    @classmethod
    def of(cls, craft: Sequence[Multirotor], hover: Array) -> Drives:
        """`hover` : speed of the rotors in hover, rad/s."""

        def drive(name: str) -> Array:
            return np.array([float(getattr(one.drive, name)) for one in craft])

        def battery(name: str) -> Array:
            return np.array([float(getattr(one.battery, name)) for one in craft])

        return cls(
            *(drive(name) for name in ("full_speed", "idle", "exponent", "voltage_power", "lag", "braking", "inertia")),
            full=battery("full"),
            slope=(battery("full") - battery("empty")) / battery("capacity"),
            resistance=battery("resistance"),
            reference=battery("reference"),
            efficiency=battery("efficiency"),
            hover=hover,
        )

    def asked(self, command: Array, voltage: Array) -> Array:
        """Speed that commands in 0..1 ask for at a voltage, rad/s."""
        share = self.idle + (1.0 - self.idle) * np.clip(command, 0.0, 1.0) ** self.exponent
        return np.maximum(self.full_speed * share * self._sag(voltage), SLOWEST * self.full_speed)

    def command(self, speed: Array) -> Array:
        """Command in 0..1 that asks for a speed, rad/s, at the battery's reference voltage."""
        share = (speed / self.full_speed - self.idle) / (1.0 - self.idle)
        return np.clip(share, 1e-3, 1.0) ** (1.0 / self.exponent)

    def _sag(self, voltage: Array) -> Array | float:
        """Factor of the speed by the voltage."""
        return (voltage / self.reference) ** self.power if self.power.any() else 1.0

    def turned(self, speed: Array, asked: Array, dt: float) -> Array:
        """Speeds a step of dt later, rad/s.

        The motor's torque by current goes with the duty less the counter voltage, and the propeller takes one that goes
        with the square of its speed; both together make the lag at hover. A control that does not brake leaves the
        slowing down to the propeller.

        Source: Bangura and Mahony, Proceedings of ACRA (2012) (brushless motor and aerodynamic load).
        """
        if not self.lag.any():
            return asked
        gap = asked - speed
        motor = np.where(gap > 0.0, 1.0, self.braking) * 0.5
        propeller = 0.25 * (asked + speed) / self.hover
        rate = (motor + propeller) / np.maximum(self.lag, 1e-9)
        return speed + gap * -np.expm1(-rate * dt)

    def voltage(self, used: Array, current: Array) -> Array:
        """Voltage at the terminals, V, [column], after a charge in C and under a current in A."""
        return self.full - self.slope * used - self.resistance * current

    def current(self, torque: Array, speed: Array, voltage: Array | float) -> Array:
        """Current of all motors, A, [column]."""
        return (torque * speed).sum(0) / (self.efficiency * np.maximum(voltage, 0.3 * self.full))
