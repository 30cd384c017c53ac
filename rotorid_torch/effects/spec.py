"""What a model is built from, as plain data: declared by the data set, seen in its flights, chosen as structure."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from rotorid_torch.core.names import is_motor
from rotorid_torch.core.ranges import of_channel
from rotorid_torch.data import plausible
from rotorid_torch.data.refusal import convert
from rotorid_torch.data.schema import Vehicle
from rotorid_torch.errors import InputError

USUAL_ARM, USUAL_MASS = 0.1, 0.3
"""m and kg of a multirotor whose arms are not declared: 0.045 m at 27 g, 0.15 m at 1 kg."""
USUAL_GYRATION = 0.7
"""Usual radius of gyration about a level axis, over the rms distance of the rotors from it: 1 if all mass sat there.

0.76 of a Crazyflie 2.0 (Foerster, ETH, 2015: 27 g, 1.66e-5 kg m2, arms of 46 mm).
"""
FlappingKind = Literal["none", "algebraic", "first order"]


class RotorSpec(msgspec.Struct, frozen=True, kw_only=True):
    """Main rotor as declared, SI; `direction` is "ccw" or "cw", seen from above."""

    blades: int
    radius: float
    chord: float
    speed: float
    direction: str = "ccw"
    hinge_offset: float | None = None
    lock_number: float | None = None

    @property
    def spin(self) -> float:
        """+1 for a rotor that turns counter-clockwise seen from above, -1 for the other."""
        return 1.0 if self.direction == "ccw" else -1.0


class MotorSpec(msgspec.Struct, frozen=True, kw_only=True):
    """One motor of a multirotor as declared: place from the centre of gravity, m, and what its rotor does.

    spin : +1 for counter-clockwise seen from above. thrust : c0, c1, c2, N by the rotor's input. torque_ratio : torque
        over thrust, m.
    """

    position: tuple[float, float, float]
    spin: float
    thrust: tuple[float, float, float] | None = None
    torque_ratio: float | None = None


class ModelSpec(msgspec.Struct, frozen=True, kw_only=True):
    """Plain data from which `nominal.build` makes the model; what model.pt holds beside theta.

    states, controls, outputs : names of body states, controls and outputs, in order.
    reference : value of every signal at the reference point.
    sizes : rms excursion of every signal and of every row's response over the identify flights; scales the priors.
    patterns : regressors of each row (X Y Z L M N, a0 a1 b1).
    flapping_doubtful : the lag is so short that first order and algebraic must both be tried.
    inflow, cyclic_inflow : whether the induced velocity, and its first harmonics, are states.
    effects : ids of effects beyond the nominal model.
    mass_excludes : what flies along but is not in mass and inertia.
    inputs : measured quantities beyond the controls that drive the model: rotor speeds, battery voltage.
    motors : a multirotor's, one per motor command.
    found_places : of motors whose places are not declared, R2 of the moments that say where they stand; None where
        they are declared. The arms are not known then, nor are the inertia's moments in control power.
    spins : of a multirotor's rotors, +1 for counter-clockwise seen from above.
    each_control : ids of effects of the control path whose parameter every control has for itself.
    free, values : by full parameter name, whether it is estimated, and where it starts, other than the effect declares.
    screening_sizes : by full parameter name, where tracing starts with effects that declare no typical size.
    ranges : smallest and largest value of every signal in the identify flights.
    """

    states: tuple[str, ...]
    controls: tuple[str, ...]
    outputs: tuple[str, ...]
    reference: dict[str, float]
    sizes: dict[str, float]
    ranges: dict[str, tuple[float, float]]
    patterns: dict[str, tuple[str, ...]]
    control_units: dict[str, str]
    flapping: FlappingKind = "none"
    flapping_doubtful: bool = False
    inflow: bool = False
    cyclic_inflow: bool = False
    gravity: float = 9.80665
    air_density: float = 1.225
    mass: float | None = None
    inertia: tuple[tuple[float, ...], ...] | None = None
    hub: tuple[float, float, float] | None = None
    imu: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mass_excludes: tuple[str, ...] = ()
    rotor: RotorSpec | None = None
    inputs: tuple[str, ...] = ()
    motors: tuple[MotorSpec, ...] = ()
    found_places: dict[str, float] | None = None
    spins: tuple[float, ...] = ()
    effects: tuple[str, ...] = ()
    each_control: tuple[str, ...] = ()
    free: dict[str, bool] = {}
    values: dict[str, float] = {}
    screening_sizes: dict[str, float] = {}

    @property
    def lift(self) -> float:
        """Specific force upwards at the reference, m/s2."""
        return self.gravity * math.cos(self.reference.get("phi", 0.0)) * math.cos(self.reference.get("theta", 0.0))

    @property
    def driven(self) -> tuple[str, ...]:
        """What a multirotor's rotors are driven by: their measured speeds, or the commands where these are missing."""
        speeds = tuple(name for name in self.inputs if name.startswith("omega"))
        return speeds or self.commands

    @property
    def commands(self) -> tuple[str, ...]:
        """Motor commands among the controls."""
        return tuple(name for name in self.controls if is_motor(name))

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Controls of a multirotor beside its motors: elevons, flaps, tilting servos."""
        return tuple(name for name in self.controls if not is_motor(name)) if self.commands else ()

    def with_effects(self, *effects: str, each_control: bool = False) -> ModelSpec:
        """With more effects, of one size for all controls or of one for each."""
        each = (*self.each_control, *effects) if each_control else self.each_control
        return msgspec.structs.replace(self, effects=(*self.effects, *effects), each_control=each)

    def without(self, effects: Collection[str]) -> ModelSpec:
        """With these effects less, where it has them."""
        remaining, each = (tuple(e for e in listed if e not in effects) for listed in (self.effects, self.each_control))
        return msgspec.structs.replace(self, effects=remaining, each_control=each)

    def plain(self) -> dict[str, Any]:
        """As builtins, for model.pt."""
        return msgspec.to_builtins(self)

    @staticmethod
    def from_plain(plain: Any) -> ModelSpec:
        """From builtins; msgspec.ValidationError where they are not a spec."""
        return msgspec.convert(plain, ModelSpec)


def arm(spec: ModelSpec) -> float:
    """Distance of a multirotor's rotors from its centre, m."""
    declares = spec.found_places is None
    declared = sum(math.hypot(*m.position[:2]) for m in spec.motors) / len(spec.motors) if declares else 0.0
    return declared or usual_arm(spec.mass, spec.inertia)


def usual_arm(mass: float | None, inertia: Sequence[Sequence[float]] | None) -> float:
    """Arm, m, of multirotors of this mass, kg, and inertia, kg m2.

    Of rotors on a circle the rms distance from a level axis is arm/sqrt(2): arm = sqrt((Ixx + Iyy)/m)/0.7. Without
    inertia it is that of bodies of one density, 0.1 m (m/0.3 kg)^(1/3); without mass of a body of middle size.
    """
    if mass is None:
        return USUAL_ARM
    if inertia is None:
        return USUAL_ARM * (mass / USUAL_MASS) ** (1.0 / 3.0)
    return math.sqrt((inertia[0][0] + inertia[1][1]) / mass) / USUAL_GYRATION


def read_spec(plain: Any, file: str | Path) -> ModelSpec:
    """Spec of a file, as plain data: of the right form, and of a vehicle that can be.

    Raises InputError with the key that is at fault.
    """
    spec = convert(plain, ModelSpec, file, "spec")
    plausible.check_finite({"spec": spec.plain()}, file)
    try:
        plausible.check_vehicle(convert(_vehicle(spec), Vehicle, file, "spec"), file)
    except InputError as error:
        raise InputError(file, error.key.replace("vehicle.", "spec.", 1), error.wrong, error.expected) from None
    for key in ("states", "controls", "outputs", "inputs", "effects"):
        listed = getattr(spec, key)
        if twice := next((name for name in listed if listed.count(name) > 1), None):
            raise InputError(file, f"spec.{key}", f"names {twice} twice", "each name once")
    for name, size in spec.sizes.items():
        if size < 0.0:
            raise InputError(file, f"spec.sizes.{name}", f"is {size:g}", "a root mean square, from 0")
    for name, (low, high) in spec.ranges.items():
        if low > high:
            raise InputError(file, f"spec.ranges.{name}", f"is {low:g} to {high:g}", "lower below upper")
    for name in (*spec.states, *spec.controls, *spec.inputs):
        if name not in spec.reference:
            raise InputError(file, f"spec.reference.{name}", "is missing", "the value of every signal")
    for name, value in spec.reference.items():
        allowed = of_channel(name, spec.control_units.get(name, "")).samples
        if not allowed.holds(value):
            raise InputError(file, f"spec.reference.{name}", f"is {value:g}", str(allowed))
    return spec


def _vehicle(spec: ModelSpec) -> dict[str, Any]:
    """The vehicle that a spec describes, as a data set declares it."""
    plain = spec.plain()
    motors = [
        {**motor, "spin": {1.0: "ccw", -1.0: "cw"}.get(motor["spin"], motor["spin"])} for motor in plain["motors"]
    ]
    fields = {name: value for name, value in plain.items() if name in Vehicle.__struct_fields__}
    return {**fields, "motors": motors if spec.found_places is None else []}
