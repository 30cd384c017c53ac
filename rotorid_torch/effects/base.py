"""What a piece of physics is: an Effect with named parameters and states that acts at one stage of the model's chain.

The chain runs CONTROL -> ENVIRONMENT -> ROTOR -> FORCES -> MASS -> SENSORS. Inside the time loop every effect takes a
`Frame` and returns a new one; control-path effects run once over the control record before the loop (`tape`), effects
of the sensors act on the outputs: `forward` at a sample, `tape` over the record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.momentum import Flow
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.effects.testable import Need
from rotorid_torch.effects.weights import Weight, lent, taken


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


class Showing(Enum):
    """Where an effect shows in ordinary flights: small manoeuvres about one reference.

    `trajectories`: in the motion, beyond what free derivatives, trims and initial states can imitate; `absorbed`: those
    imitate it; `other flights`: they do too, unless the flights differ in heading, height or speed; `kinematics`: in
    the sensors against each other; `innovations`: in the spectrum of what no control explains.
    """

    TRAJECTORIES = "trajectories"
    ABSORBED = "absorbed"
    OTHER_FLIGHTS = "other flights"
    KINEMATICS = "kinematics"
    INNOVATIONS = "innovations"


@dataclass(frozen=True)
class Frame:
    """What the stages hand on: all tensors [..., n], about the body, SI.

    `signals` holds every channel-like quantity by name (u v w p q r phi theta, flapping, controls), each [...].
    `force` is the external specific force without gravity, m/s2; `moment` the angular acceleration that the external
    moment about the centre of gravity gives (inertia^-1 M), rad/s2. `rates` holds the rates of the effects' own states
    published so far, by the states' names; a later effect may replace one. `centre` is where the centre of gravity
    really is, m from where it is declared; None: there. `hubs` are forces at a multirotor's rotors [..., motors, 3], in
    body axes and in units of their thrust, beside thrust itself; the rotors make force and moment of them. `leaning`
    are further ones in proportion to the rotor's thrust, at the thrust of the reference. `flow` is what flows through
    the rotors, where that changes their thrust.
    """

    signals: Mapping[str, Tensor]
    force: Tensor | None = None
    moment: Tensor | None = None
    rates: Mapping[str, Tensor] = field(default_factory=dict)
    centre: Tensor | None = None
    hubs: Tensor | None = None
    leaning: Tensor | None = None
    flow: Flow | None = None

    def stack(self, names: tuple[str, ...]) -> Tensor:
        """These signals as [..., len(names)]."""
        return torch.stack(torch.broadcast_tensors(*(self.signals[n] for n in names)), dim=-1)

    def with_signals(self, **signals: Tensor) -> Frame:
        """The same frame with signals added or replaced."""
        return replace(self, signals={**self.signals, **signals})

    def with_rates(self, **rates: Tensor) -> Frame:
        """The same frame with rates of the effects' own states added or replaced."""
        return replace(self, rates={**self.rates, **rates})

    def rate(self, name: str) -> Tensor:
        """Rate of an earlier effect's state [...]; zero where none has been published."""
        return self.rates[name] if name in self.rates else torch.zeros_like(self.signals[name])

    def with_air(self, *velocity: Tensor) -> Frame:
        """The same frame with u, v, w through the air, m/s; those over ground stay to be asked for."""
        ground = {f"ground.{n}": self.signals.get(f"ground.{n}", self.signals[n]) for n in VELOCITIES}
        return self.with_signals(**ground, **dict(zip(VELOCITIES, velocity, strict=True)))

    def over_ground(self) -> Tensor:
        """Velocity over ground in body axes [..., 3], m/s."""
        return vec(*(self.signals.get(f"ground.{n}", self.signals[n]) for n in VELOCITIES))

    def each(self, change: Callable[[Tensor, int], Tensor]) -> Frame:
        """The same frame with every tensor changed; `change` is told how many dimensions follow the leading ones."""
        vectors = [None if v is None else change(v, 1) for v in (self.force, self.moment, self.centre)]
        hubs, leaning = (None if v is None else change(v, 2) for v in (self.hubs, self.leaning))
        signals, rates = ({n: change(v, 0) for n, v in part.items()} for part in (self.signals, self.rates))
        force, moment, centre = vectors
        whole = replace(self, signals=signals, rates=rates, force=force, moment=moment, centre=centre)
        flow = None if self.flow is None else Flow(*(change(v, 1) for v in self.flow))
        return replace(whole, hubs=hubs, leaning=leaning, flow=flow)

    def add(self, force: Tensor | None = None, moment: Tensor | None = None) -> Frame:
        """The same frame with specific force [..., 3] and angular acceleration [..., 3] added."""
        return replace(self, force=_sum(self.force, force), moment=_sum(self.moment, moment))

    def add_at_hubs(self, force: Tensor) -> Frame:
        """The same frame with forces at the rotors [..., motors, 3] added."""
        return replace(self, hubs=_sum(self.hubs, force))

    def add_leaning(self, force: Tensor) -> Frame:
        """The same frame with forces at the rotors [..., motors, 3] added that grow with thrust."""
        return replace(self, leaning=_sum(self.leaning, force))


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
        return self.vector[..., self._place(name)]

    def stack(self, *names: str) -> Tensor:
        """These parameters as [..., len(names)]."""
        return self.vector[..., [self._place(n) for n in names]]

    def first(self, count: int) -> tuple[Values, Tensor]:
        """The first of these parameters, and the numbers of the others."""
        return Values(self.vector[..., :count], self.names[:count]), self.vector[..., count:]

    def _place(self, name: str) -> int:
        if name not in self.names:
            raise ValueError(f"{name!r} is read and not declared; declared are {', '.join(self.names)}")
        return self.names.index(name)


class Effect(nn.Module):
    """One piece of physics.

    A subclass sets `id`, `stage`, `role`, declares parameters and states, and writes `forward` or `tape`. Parameter
    names are local ("drag.x"); the model prefixes them with the id. `predicts` names channels beyond the body's that
    the effect publishes as signals: outputs where the flights have them. `ordinary` is structure that every rotor has,
    in every comparison from the start.
    Modules of torch that are attributes are trained with the rest: their weights are parameters behind those declared,
    with `weight_sd` for prior_sd, one number or one for each beginning of a name ("net.0").
    `order` : among effects of its stage, the lower first, equals as they join.
    `proportional` : whether twice the size does about twice as much. `separated_by` are the flights that tell it from
    derivatives which absorb it. `delays` : the parameter by which controls act later, s. `rotors_absorb` : what of a
    multirotor's model takes up all of it. `acts_through` : the effect that makes forces of what this one changes, where
    the nominal model makes none, as that of a multirotor, whose rotors feel no air.
    `averages` : channels of whose record `tape` takes centred means, and over how many seconds; a model that runs
    sample by sample takes them as they come.
    `needs` : what the data must have, each a function of the spec that says what it lacks, or None (see `testable`).
    """

    id: str = ""
    stage: Stage = Stage.FORCES
    order: int = 0
    role: Role = Role.UNDECLARED
    showing: Showing = Showing.TRAJECTORIES
    predicts: tuple[str, ...] = ()
    ordinary: bool = False
    proportional: bool = True
    delays: str = ""
    separated_by: str = "larger or longer inputs on every control"
    weight_sd: float | Mapping[str, float] = 1.0
    rotors_absorb: str = ""
    acts_through: str = ""
    averages: ClassVar[Mapping[str, float]] = {}
    needs: tuple[Need, ...] = ()

    def __init__(self, declared: tuple[Parameter, ...] = (), states: tuple[State, ...] = ()) -> None:
        super().__init__()
        self._declared = declared
        self._weights: list[Weight] = []
        self.states = states

    @property
    def declared(self) -> tuple[Parameter, ...]:
        """Parameters: those declared, then the weights of the modules that the effect holds.

        Raises
        ------
        InputError : a module's weights would not be trained.
        """
        if next(self.parameters(), None) is not None:
            weights, parameters = taken(self, self.id or type(self).__name__, self.weight_sd)
            self._weights, self._declared = [*self._weights, *weights], (*self._declared, *parameters)
        return self._declared

    @declared.setter
    def declared(self, parameters: tuple[Parameter, ...]) -> None:
        self._declared = parameters

    @property
    def network_weights(self) -> Sequence[Weight]:
        """Tensors of weights, in the order in which their numbers end `declared`."""
        return self._weights if self.declared else ()

    @contextmanager
    def lent(self, p: Values) -> Iterator[Values]:
        """Within the block the modules have their weights out of one vector of parameters; the others are returned."""
        if not self.network_weights:
            yield p
            return
        declared, weights = p.first(len(self._declared) - sum(w.count for w in self._weights))
        with lent(self._weights, weights):
            yield declared

    def __call__(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """`forward`, the modules with their weights; of several vectors of parameters one after the other."""
        if not (self._weights or self._modules or self._parameters):
            return super().__call__(frame, x, p)
        if p.vector.dim() > 1 and self.network_weights:
            return _one_by_one(self, frame, x, p)
        with self.lent(p) as declared:
            return super().__call__(frame, x, declared)

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> Effect:
        """The effect for a vehicle; override where the vehicle's declaration or reference is needed."""
        return cls()

    @classmethod
    def untestable(cls, spec: ModelSpec) -> str | None:
        """Why this data set cannot test the effect, in plain words; None where it can. By default: the first need."""
        return next((lacking for need in cls.needs if (lacking := need(spec)) is not None), None)

    @classmethod
    def within(cls, spec: ModelSpec) -> str:
        """Id of the part of the nominal model that is this physics already; empty where none is."""
        return ""

    @classmethod
    def absorbed_by(cls, spec: ModelSpec) -> str:
        """Id of the part of the nominal model that takes up all of the effect; empty where none does."""
        return cls.rotors_absorb if spec.motors else ""

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Frame after this effect, and the rates [..., n] of its own states x [..., n]; without states, x itself.

        Effects of the sensors are called after all others, on a frame whose signals hold every output.
        """
        return frame, x

    def read(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """The controls [..., T, n] as they were, from what sensors that err recorded of them; before any `tape`."""
        return record

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """The record [..., T, n] as it reaches the next stage: of controls, or, where sensors act, of outputs."""
        return record


def _one_by_one(effect: Effect, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
    """An effect at parameters [K, ..., P], K times: modules of torch know one set of weights."""
    vector = p.vector
    if len(vector) == 1:
        return effect(frame, x, replace(p, vector=vector[0]))
    lead = np.broadcast_shapes(vector.shape[:-1], x.shape[:-1], *(s.shape for s in frame.signals.values()))
    place = len(lead) - (vector.dim() - 1)
    inside = (*lead[:place], *lead[place + 1 :])

    def chosen(k: int) -> Callable[[Tensor, int], Tensor]:
        return lambda v, n: v.expand(*lead, *v.shape[v.dim() - n :]).select(place, k)

    def whole(v: Tensor, n: int) -> Tensor:
        return v.expand((*inside, *v.shape[v.dim() - n :]))

    results = [effect(frame.each(chosen(k)), chosen(k)(x, 1), replace(p, vector=vector[k])) for k in range(len(vector))]
    parts = [iter(_tensors(frame.each(whole))) for frame, _ in results]
    rates = torch.stack([whole(r, 1) for _, r in results], dim=place)
    return results[0][0].each(lambda v, n: torch.stack([next(part) for part in parts], dim=place)), rates


def _tensors(frame: Frame) -> list[Tensor]:
    """All tensors of a frame in the order of `Frame.each`."""
    tensors: list[Tensor] = []

    def noted(v: Tensor, n: int) -> Tensor:
        tensors.append(v)
        return v

    frame.each(noted)
    return tensors
