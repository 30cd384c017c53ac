"""What a multirotor is: frame, rotors, drives, battery, what the air does to it, sensors. One vehicle, plain numbers.

Body axes x forward, y right, z down, from the centre of gravity; rotors' axes are -z but for small angles. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from rotorid_torch.simulation.helicopter.sensor_errors import SensorErrors
from rotorid_torch.simulation.helicopter.slung_load import SlungLoad
from rotorid_torch.simulation.rigid import Array

Three = tuple[float, float, float]
STILL: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Propeller:
    """Blades of all rotors alike. `pitch` at the root and its `twist` from root to tip in rad; sections are linear.

    `lift_slope` 1/rad, `drag` coefficient of the section; `lock` number and `stiffness` of flapping: the square of the
    flapping frequency in revolutions, less one (0: a hinge at the centre).
    """

    radius: float
    chord: float
    blades: int
    pitch: float
    twist: float
    lift_slope: float = 5.5
    drag: float = 0.025
    lock: float = 3.0
    stiffness: float = 1.0

    @property
    def disc(self) -> float:
        """Disc area, m^2."""
        return np.pi * self.radius**2


@dataclass(frozen=True)
class Drive:
    """Electronic speed control and motor of a rotor.

    The speed that a command m in 0..1 asks for is `full_speed` (idle + (1 - idle) m^exponent), rad/s, times a power
    `voltage_power` of the voltage over the battery's reference (0: the control makes up for the voltage).

    `lag` : s, with which the speed comes at hover; 0: at once. `braking` : of what speeds a rotor up, the share that
    slows it down. `inertia` : of rotor and bell about its axis, kg m^2, as the body feels it.
    `delay` : s, from the recorded command to the control.
    """

    full_speed: float
    idle: float
    exponent: float
    voltage_power: float = 0.0
    lag: float = 0.0
    braking: float = 0.6
    inertia: float = 0.0
    delay: float = 0.0

    def command_at(self, speed: float) -> float:
        """Command that asks for a speed, rad/s, at the battery's reference voltage."""
        share = (speed / self.full_speed - self.idle) / (1.0 - self.idle)
        return max(share, 1e-3) ** (1.0 / self.exponent)


@dataclass(frozen=True)
class Battery:
    """Open-circuit voltage falls in a line from `full` to `empty`, V; `resistance`, ohm; `capacity`, C.

    `reference` : loaded voltage that the thrust curve is declared for, V. `efficiency` : shaft power over electric.
    """

    full: float
    empty: float
    resistance: float
    capacity: float
    reference: float
    efficiency: float = 0.6


@dataclass(frozen=True)
class Air:
    """What the air does beyond carrying the hovering vehicle; a clean vehicle feels none of it.

    Shares of the velocity through the air that a rotor feels, 1 in nature: `axial` along its axis, `lift` in its disc
    as far as thrust and inflow go, `drag` as far as forces in the disc go, `flap` as far as moments on the hub go.
    `drag_area` of the body by axis, m^2. `ground` : strength of the images of the rotors below the ground, 1 by theory.
    `wind` : velocity of the air, north east down, m/s; `gusts` : standard deviation of its turbulence, m/s.
    """

    axial: float = 0.0
    lift: float = 0.0
    drag: float = 0.0
    flap: float = 0.0
    drag_area: Three = STILL
    ground: float = 0.0
    wind: Three = STILL
    gusts: float = 0.0


@dataclass(frozen=True)
class Multirotor:
    """A multirotor.

    `places` of the rotors, m; `spins`, 1 for counter-clockwise seen from above, else -1; `lifts`, the share of its lift
    that each rotor gives; `cants`, rad, by which each rotor's axis leans about its arm, so that its thrust turns the
    vehicle to the right (none: all are -z). `wake`, how much of the induced velocity of the rotor above a lower one of
    a pair blows through it; `imu` and `reference` (the declared centre of gravity) in m from the true one. `unsteady` :
    standard deviation of each rotor's thrust as a share of it, by its wake. `noise`, `resolution` by channel, SI. From
    flight to flight, standard deviations: `tilt` of the attitude's axes against the body's, rad; `offsets` of gyros,
    rad/s, and accelerometers, m/s^2. `gyro` : noise of a sample of the gyros that the controller reads, rad/s.
    """

    name: str
    mass: float
    inertia: tuple[Three, Three, Three]
    places: tuple[Three, ...]
    spins: tuple[int, ...]
    lifts: tuple[float, ...]
    propeller: Propeller
    drive: Drive
    battery: Battery
    speed: float
    height: float
    rate: int = 100
    air: Air = Air()
    load: SlungLoad | None = None
    imu: Three = STILL
    reference: Three = STILL
    wake: float = 0.3
    unsteady: float = 0.004
    gravity: float = 9.80665
    air_density: float = 1.225
    telemetry: bool = False
    noise: Mapping[str, float] = field(default_factory=dict)
    resolution: Mapping[str, float] = field(default_factory=dict)
    cants: tuple[float, ...] = ()
    tilt: float = 0.0
    offsets: tuple[float, float] = (0.0, 0.0)
    gyro: float = 0.002
    sensors: SensorErrors = field(default_factory=SensorErrors)

    @property
    def inertia_matrix(self) -> Array:
        """Tensor, kg m^2."""
        return np.asarray(self.inertia, dtype=np.float64)

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.places)

    def with_like_rotors(self) -> Multirotor:
        """The vehicle as its maker means it: every rotor lifts what its kind does."""
        return replace(self, lifts=(1.0,) * self.count)

    @property
    def lean(self) -> Array:
        """[2, n] : forces along x and y that each rotor gives over its thrust, across its arm."""
        across = np.asarray(self.places)[:, :2].T
        tangent = np.stack([-across[1], across[0]]) / np.maximum(np.hypot(*across), 1e-12)
        return tangent * np.asarray(self.cants or (0.0,) * self.count)

    @property
    def above(self) -> Array:
        """[n, n] : 1 where the second rotor of the pair hangs above the first on the same axis."""
        place = np.asarray(self.places)
        across = np.linalg.norm(place[:, None, :2] - place[None, :, :2], axis=-1)
        below = place[:, None, 2] - place[None, :, 2] > 1e-6
        return ((across < 0.5 * self.propeller.radius) & below).astype(np.float64)
