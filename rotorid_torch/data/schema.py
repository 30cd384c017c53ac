"""dataset.toml as strict structs: what may be declared, and in which range."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from rotorid_torch.core import names

Metres = Annotated[float, Meta(ge=-1000, le=1000, description="m")]
Point = tuple[Metres, Metres, Metres]
Row = tuple[float, float, float]
Spin = Literal["ccw", "cw"]


class Rotor(Struct, frozen=True, forbid_unknown_fields=True):
    """Main rotor as declared; SI units; None where not declared."""

    blades: Annotated[int, Meta(ge=1, le=20)] | None = None
    radius: Annotated[float, Meta(gt=0, le=50, description="m")] | None = None
    chord: Annotated[float, Meta(gt=0, le=10, description="m")] | None = None
    speed: Annotated[float, Meta(gt=0, le=10_000, description="rad/s")] | None = None
    direction: Spin | None = None
    hinge_offset: Annotated[float, Meta(ge=0, le=50, description="m")] | None = None
    lock_number: Annotated[float, Meta(gt=0, le=100)] | None = None


class Motor(Struct, frozen=True, forbid_unknown_fields=True):
    """One motor: position in m from the centre of gravity, thrust = c0 + c1 m + c2 m² in N, torque over thrust in m."""

    position: Point
    spin: Spin
    thrust: Row | None = None
    torque_ratio: Annotated[float, Meta(ge=0, le=10, description="m")] | None = None


class Vehicle(Struct, frozen=True, forbid_unknown_fields=True):
    """What is declared of the vehicle; SI units, body axes, points from the centre of gravity; None if not declared."""

    mass: Annotated[float, Meta(gt=0, le=1e6, description="kg")] | None = None
    inertia: tuple[Row, Row, Row] | None = None
    mass_excludes: tuple[str, ...] = ()
    gravity: Annotated[float, Meta(gt=0, le=100, description="m/s²")] = 9.80665
    air_density: Annotated[float, Meta(ge=0, le=100, description="kg/m³")] = 1.225
    hub: Point | None = None
    imu: Point | None = None
    rotor: Rotor | None = None
    motors: tuple[Motor, ...] = ()


class ControlSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One control: unit, limits in that unit, standard deviation of a sample, and a word for people."""

    unit: Literal["rad", "m", "norm"] = "rad"
    limits: tuple[float, float] | None = None
    noise: Annotated[float, Meta(ge=0)] | None = None
    positive: str = ""


class ChannelSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One sensor: standard deviation of a sample and whether it has a constant error per flight."""

    noise: Annotated[float, Meta(ge=0)] | None = None
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
