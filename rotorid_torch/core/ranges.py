"""What an aircraft and its sensors can be: the one table of ranges, from a drone of a gram to a helicopter of 100 t.

`import`, `check` and `identify` read it, and docs/data-set.md prints it. The Mil V-12 (105 t, two rotors
of 35 m) is the largest rotorcraft that has flown; its numbers bound the large end.

Source: Leishman, Principles of Helicopter Aerodynamics, 2nd ed., appendix (rotorcraft data); ISO 2533 (atmosphere); WGS
84 (gravity); data sheets of inertial sensors (ICM-456xx: 4000 deg/s and 32 g; ADXL375: 200 g).
"""

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Range:
    """Least and largest value in a unit, what bounds it, and whether zero is allowed besides."""

    low: float
    high: float
    unit: str
    bound: str
    or_zero: bool = False

    def holds(self, value: float) -> bool:
        """Whether a value lies inside; NaN does not."""
        return self.low <= value <= self.high or (self.or_zero and value == 0.0)

    def __str__(self) -> str:
        zero = "0 or " if self.or_zero else ""
        return f"{zero}{self.low:g} to {self.high:g} {self.unit}".rstrip()


@dataclass(frozen=True)
class ChannelRange:
    """Range of some channels' samples in one unit, and of their noise's standard deviation where it is declared."""

    names: tuple[str, ...]
    samples: Range
    noise: Range | None


LEAST_NOISE = 1e-9
"""Least standard deviation in any unit: below it lie the digits of a sample, not a sensor."""
NOISE = "a twentieth of the range; of a heading that of an angle drawn from a whole turn, pi / 3^½"


def _channel(names: str, unit: str, low: float, high: float, noise: float | None, bound: str) -> ChannelRange:
    spread = None if noise is None else Range(LEAST_NOISE, noise, unit, NOISE, or_zero=True)
    return ChannelRange(tuple(names.split()), Range(low, high, unit, bound), spread)


STICKS = "lon lat col ped"
CHANNELS: tuple[ChannelRange, ...] = (
    _channel("time", "s", -1e10, 1e10, None, "seconds since 1970 are 2e9"),
    _channel(STICKS, "rad", -1.58, 1.58, 0.1, "a blade across the flow"),
    _channel(STICKS, "m", -1.0, 1.0, 0.05, "a pilot's arm"),
    _channel(STICKS, "norm", -10.0, 10.0, 0.5, "full travel is 1; a controller may ask for more"),
    _channel("motorN", "norm", -1.5, 1.5, 0.075, "0 to 1, -1 where motors reverse, and half as much again"),
    _channel("u v w", "m/s", -340.0, 340.0, 15.0, "speed of sound"),
    _channel("p q r", "rad/s", -100.0, 100.0, 5.0, "gyroscopes of 4000 deg/s, and 40 %"),
    _channel("phi", "rad", -3.15, 3.15, 0.15, "half a turn"),
    _channel("theta", "rad", -1.58, 1.58, 0.075, "a quarter of a turn"),
    _channel("psi", "rad", -1e4, 1e4, 1.8, "1600 turns, unwrapped"),
    _channel("north east", "m", -1e8, 1e8, 100.0, "grid coordinates with the number of their zone before them"),
    _channel("height", "m", -5000.0, 20_000.0, 100.0, "deepest mine; above the record of 12 442 m"),
    _channel("ax ay az", "m/s²", -2000.0, 2000.0, 100.0, "accelerometers of 200 g"),
    _channel("pdot qdot rdot", "rad/s²", -1e5, 1e5, 5000.0, "a gyroscope's range within a millisecond"),
    _channel("airspeed", "m/s", -20.0, 340.0, 15.0, "zero error of a pitot tube; speed of sound"),
    _channel("alpha beta", "rad", -3.15, 3.15, 0.15, "half a turn"),
    _channel("a0 a1 b1", "rad", -1.58, 1.58, 0.075, "a quarter of a turn"),
    _channel("omega omegaN", "rad/s", -1e4, 1e4, 500.0, "motors of 95 000 rpm, either way"),
    _channel("torque", "N m", -1e7, 1e7, 5e5, "eight times a Mil Mi-26's"),
    _channel("voltage", "V", -1.0, 2000.0, 20.0, "zero error; electric drives of 800 V"),
    _channel("vn ve vd", "m/s", -340.0, 340.0, None, "speed of sound"),
    _channel("q0 q1 q2 q3", "norm", -1.5, 1.5, None, "a quaternion of length 1"),
    _channel("latitude longitude", "rad", -6.3, 6.3, None, "a turn"),
)
OTHER = _channel("other", "", -1e100, 1e100, 1e99, "its square is still a number")
"""Channels of somebody's own names, in a unit that only they know."""

POINT = "the largest fuselage and rotor spacing are below 70 m"
DECLARED: dict[str, Range] = {
    "vehicle.mass": Range(1e-3, 2e5, "kg", "a drone of a gram; twice a Mil V-12"),
    "vehicle.inertia": Range(1e-9, 1e9, "kg m²", "a gram within 1 mm; 200 t within 70 m"),
    "vehicle.gravity": Range(9.7, 9.9, "m/s²", "9.764 to 9.834 on the ground, 0.06 less in 20 km"),
    "vehicle.air_density": Range(0.08, 1.8, "kg/m³", "20 km high; the coldest air at sea level"),
    "vehicle.hub": Range(-50.0, 50.0, "m", POINT),
    "vehicle.imu": Range(-50.0, 50.0, "m", POINT),
    "vehicle.rotor.blades": Range(1, 16, "", "8 on a Mil Mi-26, twice"),
    "vehicle.rotor.radius": Range(0.01, 25.0, "m", "17.5 m of a Mil V-12, 19.8 m of a Hughes XH-17"),
    "vehicle.rotor.chord": Range(5e-4, 3.0, "m", "1.5 m of a Hughes XH-17, twice"),
    "vehicle.rotor.speed": Range(1.0, 1e4, "rad/s", "9 of a Hughes XH-17; motors of 95 000 rpm"),
    "vehicle.rotor.hinge_offset": Range(0.0, 25.0, "m", "less than the radius"),
    "vehicle.rotor.lock_number": Range(0.1, 100.0, "", "5 to 15 of helicopters"),
    "vehicle.motors.position": Range(-50.0, 50.0, "m", POINT),
    "vehicle.motors.thrust": Range(-1e6, 1e6, "N", "weight of 100 t on one rotor, at a command of 1"),
    "vehicle.motors.torque_ratio": Range(1e-5, 5.0, "m", "a tenth of the radius; 0 of a coaxial pair", or_zero=True),
}
"""Every number of [vehicle], by its key without indices; of an inertia these are the principal moments."""

DERIVED: dict[str, Range] = {
    "radius of gyration": Range(1e-3, 50.0, "m", "(principal moment / mass)^½"),
    "radius of gyration over size": Range(
        0.02, 3.0, "", "the same over the rotor's radius or a motor's arm; 0.1 to 0.5 usually"
    ),
    "tip speed": Range(5.0, 340.0, "m/s", "rotor speed times radius; below the speed of sound"),
    "thrust over weight": Range(0.3, 100.0, "", "all motors at a command of 1, or at their largest recorded speed"),
}
"""What follows from several declared numbers."""


def of_channel(name: str, unit: str = "") -> ChannelRange:
    """Ranges of a channel; `unit` is that of a stick, rad by default. `OTHER` for a name that is not in the table."""
    family = re.sub(r"^(motor|omega)[1-9][0-9]?$", r"\1N", name)
    rows = [row for row in CHANNELS if family in row.names]
    return next((row for row in rows if row.samples.unit == unit), rows[0] if rows else OTHER)
