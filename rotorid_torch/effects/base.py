"""What a piece of physics is: an Effect with named parameters and states that acts at one stage of the model's chain.

The chain runs CONTROL -> ENVIRONMENT -> ROTOR -> FORCES -> MASS -> SENSORS. Inside the time loop every effect takes a
`Frame` and returns a new one; control-path effects run once over the control record before the loop (`tape`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum, IntEnum

import torch
from torch import Tensor, nn

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.state import State
from rotorid_torch.effects.spec import ModelSpec


class Stage(IntEnum):
    """Where an effect acts; the order of the chain."""

    CONTROL = 0
    ENVIRONMENT = 1
    ROTOR = 2
    FORCES = 3
    MASS = 4
    SENSORS = 5


class Role(Enum):
    """Why an effect is there.

    `nominal`: the model that every vehicle starts from; `structure`: what any vehicle of the kind has and the nominal
    model leaves out; `undeclared`: what makes this vehicle differ from its declaration; `learnt`: a network.
    """

    NOMINAL = "nominal"
    STRUCTURE = "structure"
    UNDECLARED = "undeclared"
    LEARNT = "learnt"


@dataclass(frozen=True)
class Frame:
    """What the stages hand on: all tensors [..., n], about the body, SI.

    `signals` holds every channel-like quantity by name (u v w p q r phi theta, flapping, controls), each [...].
    `force` is the external specific force without gravity, m/s2; `moment` the angular acceleration that the external
    moment about the centre of gravity gives (inertia^-1 M), rad/s2.
    """

    signals: Mapping[str, Tensor]
    force: Tensor | None = None
    moment: Tensor | None = None

    def stack(self, names: tuple[str, ...]) -> Tensor:
        """These signals as [..., len(names)]."""
        return torch.stack(torch.broadcast_tensors(*(self.signals[n] for n in names)), dim=-1)

    def with_signals(self, **signals: Tensor) -> Frame:
        """The same frame with signals added or replaced."""
        return replace(self, signals={**self.signals, **signals})

    def add(self, force: Tensor | None = None, moment: Tensor | None = None) -> Frame:
        """The same frame with specific force [..., 3] and angular acceleration [..., 3] added."""
        return replace(self, force=_sum(self.force, force), moment=_sum(self.moment, moment))


def _sum(a: Tensor | None, b: Tensor | None) -> Tensor | None:
    if a is None or b is None:
        return b if a is None else a
    return a + b


@dataclass(frozen=True)
class Values:
    """An effect's own slice of theta [..., n], read by the names it declared."""

    vector: Tensor
    names: tuple[str, ...]

    def __getitem__(self, name: str) -> Tensor:
        return self.vector[..., self.names.index(name)]

    def stack(self, *names: str) -> Tensor:
        """These parameters as [..., len(names)]."""
        return self.vector[..., [self.names.index(n) for n in names]]


class Effect(nn.Module):
    """One piece of physics.

    A subclass sets `id`, `stage`, `role`, declares parameters and states, and writes `forward` or `tape`. Parameter
    names are local ("drag.x"); the model prefixes them with the id.
    """

    id: str = ""
    stage: Stage = Stage.FORCES
    role: Role = Role.UNDECLARED

    def __init__(self, declared: tuple[Parameter, ...] = (), states: tuple[State, ...] = ()) -> None:
        super().__init__()
        self.declared = declared
        self.states = states

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Effect:
        """The effect for a vehicle; override where the vehicle's declaration or reference is needed."""
        return cls()

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Frame after this effect, and the rates [..., n] of its own states x [..., n]; without states, x itself."""
        return frame, x

    def tape(self, controls: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """The control record [..., T, nu] as it reaches the next stage; control-path effects only."""
        return controls
