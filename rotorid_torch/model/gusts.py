"""A model in moving air: gusts as states that are followed, or as a history that is fed in."""

import math
from dataclasses import replace

import msgspec
from torch import Tensor

from rotorid_torch.core.names import FLAPPING, FORCES, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model

DRIFT = 5.0
"""m/s: eddies pass a hovering vehicle with at least this speed."""
LENGTHS = (20.0, 533.0)
"""m: gusts of a shorter scale pass within tenths of a second, and what the model lacks would be taken for them; none is
longer than 1750 ft (MIL-F-8785C, sec. 3.7.2, medium and high altitude)."""
QUICK = 20.0
"""1/s: rate of what the air does beside gusts of these lengths, and of what the model lacks there."""
GUSTS = tuple(f"gust_{n}" for n in VELOCITIES)
QUICK_FORCES = tuple(f"quick_force_{n}" for n in SPECIFIC_FORCES)


def passing_speed(model: Model) -> float:
    """Speed with which eddies pass the vehicle at its reference, m/s."""
    return max(math.hypot(*(model.reference.get(n, 0.0) for n in VELOCITIES)), DRIFT)


def lacks(model: Model) -> str:
    """Why gusts have nothing to act through in a model; empty where they have."""
    if model.effect("rotors") is not None:
        return "a multirotor's model follows rates and accelerations, in which gusts are a disturbance already"
    forces = model.effect("forces")
    has_forces = forces is not None and any(p.name == f"{r}.trim" for p in forces.declared for r in FORCES)
    moving = model.layout.has(*VELOCITIES) and has_forces
    return "" if moving else "no velocities are measured that gusts could act through"


class Gusts(Effect):
    """Gusts with Dryden's form, first order per axis: dg/dt = -(V/L) g + noise, subtracted from the velocities.

    Source: MIL-F-8785C, sec. 3.7 (Dryden form).
    """

    id, stage, role = "gusts", Stage.ENVIRONMENT, Role.NOMINAL

    def __init__(self, speed: float) -> None:
        bounds = speed / LENGTHS[1], speed / LENGTHS[0]
        super().__init__(
            tuple(Parameter(f"rate_{n}", speed / 100.0, "1/s", bounds, doc="speed over length") for n in VELOCITIES),
            tuple(State(n, "m/s") for n in GUSTS),
        )

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Velocities through the air; the rates of the gusts."""
        air = frame.stack(VELOCITIES) - x
        return frame.with_air(*air.unbind(-1)), -p.stack(*(f"rate_{n}" for n in VELOCITIES)) * x


class QuickForces(Effect):
    """Specific forces that last a twentieth of a second: what a model lacks, which would be taken for short gusts."""

    id, stage, role = "quick", Stage.MASS, Role.NOMINAL

    def __init__(self) -> None:
        super().__init__((), tuple(State(n, "m/s2") for n in QUICK_FORCES))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """The forces, and their rates."""
        return frame.add(force=x), -QUICK * x


class FedGusts(Effect):
    """Gusts of a known history, which comes in behind the controls."""

    id, stage, role = "gusts", Stage.ENVIRONMENT, Role.NOMINAL

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Velocities through the air."""
        air = frame.stack(VELOCITIES) - frame.stack(GUSTS)
        return frame.with_air(*air.unbind(-1)), x


def in_gusts(model: Model) -> Model:
    """The model with gusts as states, its parameters where they are."""
    return _with(model, model.body.controls, Gusts(passing_speed(model)), QuickForces())


def fed(model: Model) -> Model:
    """The model with gusts as three more inputs behind its controls, its parameters where they are."""
    return _with(model, (*model.body.controls, *GUSTS), FedGusts())


def with_gust_inputs(spec: ModelSpec) -> ModelSpec:
    """The spec of a model in which gusts are fed."""
    reference = {**spec.reference, **dict.fromkeys(GUSTS, 0.0)}
    return msgspec.structs.replace(spec, inputs=(*spec.inputs, *GUSTS), reference=reference)


def without_gust_inputs(spec: ModelSpec) -> ModelSpec:
    """The spec of the same model in still air."""
    reference = {n: v for n, v in spec.reference.items() if n not in GUSTS}
    return msgspec.structs.replace(spec, inputs=tuple(n for n in spec.inputs if n not in GUSTS), reference=reference)


def noisy_states(model: Model) -> tuple[str, ...]:
    """States of a model in gusts whose rates have noise: of the air, and for what it lacks of rates and flapping."""
    return *GUSTS, *QUICK_FORCES, *RATES, *(n for n in FLAPPING if model.layout.has(n))


def _with(model: Model, controls: tuple[str, ...], *effects: Effect) -> Model:
    reference = {**model.reference, **dict.fromkeys((*GUSTS, *QUICK_FORCES), 0.0)}
    model_in_gusts = Model(replace(model.body, controls=controls), [*model.chain, *effects], reference)
    model_in_gusts.start_from(model.named_values)
    return model_in_gusts
