"""dataset.toml as strict structs: what may be declared. Ranges are in `core.ranges`, checked by `plausible`."""

from typing import Literal

from msgspec import Struct

from rotorid_torch.core import names

Point = tuple[float, float, float]
Row = tuple[float, float, float]
Spin = Literal["ccw", "cw"]


class Rotor(Struct, frozen=True, forbid_unknown_fields=True):
    """Main rotor as declared; SI units; None where not declared."""

    blades: int | None = None
    radius: float | None = None
    chord: float | None = None
    speed: float | None = None
    direction: Spin | None = None
    hinge_offset: float | None = None
    lock_number: float | None = None


Frame = Literal["quad-x", "quad-+", "hexa-x", "hexa-+", "octa-x", "octa-+", "coaxial-x", "custom"]
"""Where a multirotor's motors stand; logs number them in many orders, which flights tell."""


class Motor(Struct, frozen=True, forbid_unknown_fields=True):
    """One motor: position in m from the centre of gravity, thrust = c0 + c1 m + c2 m² in N, torque over thrust in m."""

    position: Point
    spin: Spin
    thrust: Row | None = None
    torque_ratio: float | None = None


class Vehicle(Struct, frozen=True, forbid_unknown_fields=True):
    """What is declared of the vehicle; SI units, body axes, points from the centre of gravity; None if not declared."""

    mass: float | None = None
    inertia: tuple[Row, Row, Row] | None = None
    mass_excludes: tuple[str, ...] = ()
    gravity: float = 9.80665
    air_density: float = 1.225
    hub: Point | None = None
    imu: Point | None = None
    rotor: Rotor | None = None
    motors: tuple[Motor, ...] = ()
    frame: Frame | None = None


class ControlSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One control: unit, limits in that unit, standard deviation of a sample, and which way it moves the vehicle.

    `positive` says the last in words ("nose left" of a pedal): the sign is the data set's own, and derivatives have it.
    """

    unit: Literal["rad", "m", "norm"] = "rad"
    limits: tuple[float, float] | None = None
    noise: float | None = None
    positive: str = ""


class ChannelSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One sensor: standard deviation of a sample and whether it has a constant error per flight."""

    noise: float | None = None
    bias: names.Bias | None = None


class FlightLists(Struct, frozen=True, forbid_unknown_fields=True):
    """Which flights are fitted, which judge, and which are only reported."""

    identify: tuple[str, ...]
    validate: tuple[str, ...] = ()
    acid: tuple[str, ...] = ()

    def all(self) -> tuple[str, ...]:
        """All flights, in order of the lists."""
        return self.identify + self.validate + self.acid


class ModelSettings(Struct, frozen=True):
    """Settings that belong to the vehicle rather than to one run; an unknown key is left out with a warning."""

    reference: str = ""
