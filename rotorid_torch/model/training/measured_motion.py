"""An effect's own states along a motion that was measured: a load that swings below a vehicle whose flight is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.native.build import compiled_or_none
from rotorid_torch.core.native.dynamics import Dynamics
from rotorid_torch.effects.base import Effect, Frame, Values
from rotorid_torch.model.training.equilibrium import settled

STEPS = 2
"""Of Newton's method to where the states rest; one, if rates are linear in them."""
LARGEST = 1e3
"""Size at which states and their rates are held: a theta that throws them about explains nothing."""
LOADS = ("force", "moment", "centre")
"""Vectors of a frame that may drive an effect, beside its signals."""


@dataclass(frozen=True, eq=False)
class DrivenEffect:
    """Motion of an effect's own states under the frames before the effect; native code where the effect allows.

    names : signals of the frames. published : states whose rates they hold. loads : vectors that they have.
    parameters : the effect's own.
    """

    effect: Effect
    names: tuple[str, ...]
    published: tuple[str, ...]
    loads: tuple[str, ...]
    parameters: tuple[str, ...]
    compiled: Dynamics | None = None

    @classmethod
    @torch.no_grad()
    def of(cls, effect: Effect, frame: Frame, values: Values) -> DrivenEffect:
        """For frames that hold what this one does."""
        loads = tuple(name for name in LOADS if getattr(frame, name) is not None)
        driven = cls(effect, tuple(frame.signals), tuple(frame.rates), loads, values.names)
        theta, u = values.vector[(0,) * (values.vector.dim() - 1)], driven._inputs(frame)
        x = theta.new_zeros(len(effect.states))

        def dynamics() -> Dynamics:
            point = x, u.reshape(-1, u.shape[-1])[0], theta
            compiled = Dynamics.of(lambda x, u, theta: (driven.rates(theta, x, u), x[:0]), *point)
            compiled.build()
            return compiled

        slow = f"{effect.id} is followed along the flights in torch, many times slower than compiled"
        return replace(driven, compiled=compiled_or_none(dynamics, slow))

    def rates(self, theta: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """Rates [..., n] of the states x [..., n] under inputs u [..., signals, rates and vectors]."""
        n, scalars = len(self.names), len(self.names) + len(self.published)
        signals, rates, vectors = u[..., :n], u[..., n:scalars], u[..., scalars:].unflatten(-1, (-1, 3))
        frame = Frame(
            dict(zip(self.names, signals.unbind(-1), strict=True)),
            rates=dict(zip(self.published, rates.unbind(-1), strict=True)),
        )
        frame = replace(frame, **dict(zip(self.loads, vectors.unbind(-2), strict=True)))
        return self.effect(frame, x, Values(theta, self.parameters))[1]

    @torch.no_grad()
    def states(self, frame: Frame, values: Values, dt: float) -> Tensor:
        """States [..., T, n] from rest, where `frame` holds records [..., T] and `values` parameters [..., 1, P]."""
        u = self._inputs(frame)
        lead = torch.broadcast_shapes(u.shape[:-2], values.vector.shape[:-2])
        inputs = u.expand(*lead, *u.shape[-2:]).reshape(-1, *u.shape[-2:])
        thetas = values.vector.expand(*lead, 1, -1).reshape(len(inputs), -1)
        starts = self._rest(thetas, inputs[:, 0])
        records = [self._record(*each, dt) for each in zip(thetas, starts, inputs, strict=True)]
        return torch.stack(records).reshape(*lead, *records[0].shape)

    def _inputs(self, frame: Frame) -> Tensor:
        """Signals, rates and vectors of a frame side by side [..., n]."""
        vectors = [getattr(frame, name) for name in self.loads]
        scalars = [*frame.signals.values(), *frame.rates.values()]
        parts = [*scalars, *(part for vector in vectors for part in vector.unbind(-1))]
        return torch.stack(torch.broadcast_tensors(*parts), dim=-1)

    def _record(self, theta: Tensor, x0: Tensor, u: Tensor, dt: float) -> Tensor:
        """States [T, n] from x0 [n] under inputs [T, nu]."""
        if self.compiled is not None:
            return self.compiled.simulate(theta, x0[None], u[None], dt, LARGEST)[0][0].nan_to_num(0.0)
        held = lambda t, x, u: self.rates(theta, x, u).nan_to_num(0.0).clamp(-LARGEST, LARGEST)  # noqa: E731
        return simulate(held, x0, u, dt)

    def _rest(self, thetas: Tensor, u: Tensor) -> Tensor:
        """Where the states [B, n] rest under parameters [B, P] and inputs [B, nu]."""
        x = thetas.new_zeros(len(u), len(self.effect.states))
        rates = lambda rows: self.rates(thetas, rows, u.expand(*rows.shape[:-1], -1))  # noqa: E731
        return settled(rates, x, list(range(x.shape[-1])), STEPS)
