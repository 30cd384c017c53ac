"""Why a data set cannot test an effect: what its spec lacks, in plain words."""

from collections.abc import Callable

from rotorid_torch.core.names import RATES, VELOCITIES, is_motor
from rotorid_torch.effects.spec import ModelSpec

Need = Callable[[ModelSpec], str | None]
"""Why a spec lacks what an effect needs; None where it does not."""


def first(*reasons: str | None) -> str | None:
    """The first reason there is."""
    return next((r for r in reasons if r is not None), None)


def no_velocities(spec: ModelSpec) -> str | None:
    """The velocities are not states of the model."""
    return None if set(VELOCITIES) <= set(spec.states) else "the velocities u v w and the attitude are not measured"


def no_rates(spec: ModelSpec) -> str | None:
    """The rates are not states of the model."""
    return None if set(RATES) <= set(spec.states) else "the rates p q r are not measured"


def no_forces(spec: ModelSpec) -> str | None:
    """The model has no force equations."""
    return None if "Z" in spec.patterns else "neither velocities nor specific forces are measured"


def no_rotor(spec: ModelSpec) -> str | None:
    """The main rotor is not declared."""
    return None if spec.rotor is not None else "the main rotor's blades, radius, chord and speed are not declared"


def no_mass(spec: ModelSpec) -> str | None:
    """The mass is not declared."""
    return None if spec.mass is not None else "the mass is not declared"


def no_inertia(spec: ModelSpec) -> str | None:
    """Mass or inertia is not declared."""
    declared = spec.mass is not None and spec.inertia is not None
    return None if declared else "the mass and the inertia are not declared"


def excluded(spec: ModelSpec) -> str | None:
    """Something flies along whose mass and inertia are not declared."""
    if not spec.mass_excludes:
        return None
    return f"the {' and '.join(spec.mass_excludes)} fly along outside the declared mass and inertia"


def no_motors(spec: ModelSpec) -> str | None:
    """The vehicle is no multirotor."""
    return None if any(map(is_motor, spec.controls)) else "the vehicle has no motor commands"


def multirotor(spec: ModelSpec) -> str | None:
    """The vehicle has no rotor with a swashplate."""
    return "the vehicle is a multirotor" if any(map(is_motor, spec.controls)) else None


def not_for_motors(why: str) -> Need:
    """The controls are motor commands, of which an effect makes no sense for a reason."""
    return lambda spec: why if any(map(is_motor, spec.controls)) else None


def no_channel(name: str) -> Need:
    """A channel is missing from the flights."""
    return lambda spec: None if name in spec.reference else f"the channel {name} is missing"
