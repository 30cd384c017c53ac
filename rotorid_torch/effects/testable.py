"""What a data set must have for an effect to be tested, and in plain words what it lacks."""

from collections.abc import Callable

from rotorid_torch.core import names
from rotorid_torch.effects.spec import ModelSpec

Need = Callable[[ModelSpec], str | None]
"""What a spec lacks of what an effect needs; None where it has it."""


def need(met: Callable[[ModelSpec], bool], lacking: str) -> Need:
    """A need from the condition under which it is met, and what is said where it is not."""
    return lambda spec: None if met(spec) else lacking


def without_motors(why: str) -> Need:
    """The controls are no motor commands, of which an effect makes no sense for this reason."""
    return need(lambda spec: not any(map(names.is_motor, spec.controls)), why)


def channel(name: str) -> Need:
    """A channel is measured."""
    return need(lambda spec: name in spec.reference, f"the channel {name} is missing")


def _nothing_aside(spec: ModelSpec) -> str | None:
    aside = " and ".join(spec.mass_excludes)
    return f"the {aside} fly along outside the declared mass and inertia" if aside else None


class Needs:
    """Needs that several effects share: each says what a spec lacks, None where it has it."""

    VELOCITIES = need(
        lambda spec: set(names.VELOCITIES) <= set(spec.states), "the velocities u v w and the attitude are not measured"
    )
    RATES = need(lambda spec: set(names.RATES) <= set(spec.states), "the rates p q r are not measured")
    FORCES = need(lambda spec: "Z" in spec.patterns, "neither velocities nor specific forces are measured")
    ROTOR = need(
        lambda spec: spec.rotor is not None, "the main rotor's blades, radius, chord and speed are not declared"
    )
    MASS = need(lambda spec: spec.mass is not None, "the mass is not declared")
    INERTIA = need(
        lambda spec: spec.mass is not None and spec.inertia is not None, "the mass and the inertia are not declared"
    )
    NOTHING_ASIDE: Need = _nothing_aside
    """Nothing flies along whose mass and inertia are not declared."""
    MOTORS = need(lambda spec: any(map(names.is_motor, spec.controls)), "the vehicle has no motor commands")
    NOT_MULTIROTOR = without_motors("the vehicle is a multirotor")
