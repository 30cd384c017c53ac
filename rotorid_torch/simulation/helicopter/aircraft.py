"""The helicopter: what it consists of, and the rows of its state; `motion` moves it.

Inside, every main rotor turns counter-clockwise; `flight_test` mirrors an aircraft whose rotor turns the other way.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rotorid_torch.simulation.helicopter.airframe import Fuselage, Surface
from rotorid_torch.simulation.helicopter.atmosphere import Turbulence
from rotorid_torch.simulation.helicopter.control_path import ControlPath
from rotorid_torch.simulation.helicopter.inflow import PLAIN, Wake
from rotorid_torch.simulation.helicopter.rotor import Rotor
from rotorid_torch.simulation.helicopter.sensor_errors import SensorErrors
from rotorid_torch.simulation.helicopter.slung_load import SlungLoad
from rotorid_torch.simulation.helicopter.tail import TailRotor
from rotorid_torch.simulation.rigid import Array, skew

BODY, RATES, EULER, PLACE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
CONTROLS, INFLOW, TAIL_INFLOW = slice(12, 16), slice(16, 19), 19
AZIMUTH, SPEED, TORQUE, SPEED_ERROR, BLADES = 20, 21, 22, 23, 24
"""Rows of the state: u v w | p q r | phi theta psi | north east height | lon lat col ped at the blades | lambda0
lambda_c lambda_s | tail inflow | rotor azimuth, speed | engine torque, integrated speed error | flap, flap rate, lag,
lag rate of each blade; then, where the aircraft has them: curvature of the wake (aft, right), the cable's direction
(north, east) and its rates, the pieces of the control path. lon lat col ped are "at the blades" unless there is such a
path: then they are what is recorded, before it."""

CONTROL_NAMES = ("lon", "lat", "col", "ped")


@dataclass(frozen=True)
class Governor:
    """Rotor-speed governor and engine; `held`: the speed is constant, whatever torque that takes.

    Gains on the speed error, N m per rad/s (per rad, per rad/s^2); `lag` of the engine, s; `inertia` of the
    drive as the rotor sees it, kg m^2.

    Source: Hilbert, NASA TM-85890, table 3 (UH-60 engine and governor).
    """

    held: bool
    proportional: float
    integral: float
    derivative: float
    lag: float
    inertia: float


Three = tuple[float, float, float]


@dataclass(frozen=True)
class Aircraft:
    """Everything that flies, frozen: an effect is a changed copy.

    `mass` and `inertia` are those of the body without blades, about its own centre of gravity; `limits` (4 pairs, rad)
    and `actuator_lag` (s) belong to lon, lat, col, ped. `clockwise`: the rotor turns clockwise seen from above.

    What only an altered aircraft has: `path` between recorded controls and blades, `load` on a cable, `wind` (m/s
    towards north, east, down), `turbulence`, `reference` (the declared centre of gravity from the true one, m),
    `quadratic_damping` (N m per (rad/s)^2 about x, y, z), `swirl` (sideways wash at fin and tail rotor, as a part of
    the downwash there), and errors of the `sensors`.
    """

    name: str
    mass: float
    inertia: tuple[tuple[float, float, float], ...]
    gravity: float
    air_density: float
    imu: tuple[float, float, float]
    rotor: Rotor
    tail: TailRotor
    fuselage: Fuselage
    fin: Surface
    tailplane: Surface
    governor: Governor
    limits: tuple[tuple[float, float], ...]
    actuator_lag: float
    clockwise: bool
    wake: Wake = PLAIN
    path: ControlPath | None = None
    load: SlungLoad | None = None
    wind: Three | None = None
    turbulence: Turbulence | None = None
    reference: Three = (0.0, 0.0, 0.0)
    quadratic_damping: Three | None = None
    swirl: float = 0.0
    sensors: SensorErrors = field(default_factory=SensorErrors)

    @cached_property
    def blade_rows(self) -> slice:
        """Rows of flap, flap rate, lag, lag rate of the blades."""
        return slice(BLADES, BLADES + 4 * self.rotor.blades)

    @cached_property
    def curvature_rows(self) -> slice:
        """Rows of the wake's curvature; none for a straight wake."""
        start = self.blade_rows.stop
        return slice(start, start + (2 if self.wake.distortion else 0))

    @cached_property
    def swing_rows(self) -> slice:
        """Rows of the slung load; none without one."""
        start = self.curvature_rows.stop
        return slice(start, start + (4 if self.load else 0))

    @cached_property
    def settled_rows(self) -> int:
        """Number of rows that trim settles or is given; those of the control path come after them, zero in trim."""
        return self.swing_rows.stop

    @cached_property
    def states(self) -> int:
        """Number of rows of the state."""
        return self.settled_rows + (self.path.states if self.path else 0)

    @property
    def knows_directions(self) -> bool:
        """Whether trim is another one on another heading, or has rows that turn with it."""
        return self.wind is not None or self.load is not None

    @cached_property
    def own_matrix(self) -> Array:
        """7 x 7: mass and inertia of the body, and of the drive (fast shafts, seen from the rotor)."""
        out = np.zeros((7, 7))
        out[:3, :3] = self.mass * np.eye(3)
        out[3:6, 3:6] = self.inertia
        out[6, 6] = self.governor.inertia
        return out

    @cached_property
    def inertia_matrix(self) -> Array:
        """3 x 3 kg m^2."""
        return np.asarray(self.inertia, dtype=np.float64)

    @cached_property
    def levers(self) -> Array:
        """[3 x 5, 3]: matrices r x for hub, tail rotor, fuselage, fin, tailplane."""
        parts = (self.tail, self.fuselage, self.fin, self.tailplane)
        return skew(np.array([self.rotor.hub, *(part.position for part in parts)])).reshape(15, 3)

    @cached_property
    def loads_to_moment(self) -> Array:
        """[3, 3 x 4]: moment by the forces at tail rotor, fuselage, fin, tailplane."""
        return np.concatenate(list(self.levers.reshape(5, 3, 3)[1:]), axis=1)

    @cached_property
    def washed_places(self) -> Array:
        """[3, 3, 1]: fuselage, fin, tailplane from the hub, (aft, right, up)."""
        points = np.array([self.fuselage.position, self.fin.position, self.tailplane.position])
        return (self.rotor.to_shaft @ (points - np.asarray(self.rotor.hub)).T)[:, :, None]

    @cached_property
    def tail_place(self) -> Array:
        """[3, 1, 1]: tail rotor from the hub, (aft, right, up)."""
        from_hub = np.asarray(self.tail.position) - np.asarray(self.rotor.hub)
        return (self.rotor.to_shaft @ from_hub)[:, None, None]

    @cached_property
    def limit_rows(self) -> tuple[Array, Array]:
        """Lower and upper limits of the controls, (4, 1)."""
        pairs = np.asarray(self.limits)
        return pairs[:, :1], pairs[:, 1:]
