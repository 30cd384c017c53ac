"""A small bounded network on forces and moments: what no named effect explains."""

from __future__ import annotations

import torch
from torch import Tensor

from rotorid_torch.core.names import FORCES, MOMENTS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.effects.base import Effect, Frame, Role, Showing, Stage, Values
from rotorid_torch.effects.registry import register
from rotorid_torch.effects.spec import ModelSpec

INPUT_SD, OUTPUT_SD = 0.5, 0.3
"""Prior standard deviations of the weights; what physics explains stays with physics."""
NEAR_ZERO = 0.1
"""Share of a usual hidden weight about which its prior lies: an input that is not asked for has no part."""
TRUST = "neural.trust"
"""Among a spec's sizes: share of the prior's standard deviations that is allowed, where residuals are coloured."""


@register
class NeuralForces(Effect):
    """Small network on forces and moments, bounded: what no named effect explains.

    (X Y Z L M N) += bound tanh(W2 tanh(W1 z + b1)), z signals from the reference in units of their size; six hidden
    units. Zero at the start (W2 = 0), bounded by half the rms of each row, shrunk by the prior of its weights; the
    first weights are drawn by a fixed seed.

    Source: Rackauckas et al., arXiv:2001.04385 (universal differential equations).
    """

    id, stage, role, showing = "neural.forces", Stage.FORCES, Role.LEARNT, Showing.TRAJECTORIES
    hidden, share = 6, 0.5
    """Hidden units; share of a row's rms that no output of the network exceeds."""
    reference: Tensor
    size: Tensor
    bound: Tensor

    def __init__(self, inputs: tuple[str, ...], rows: tuple[str, ...], spec: ModelSpec) -> None:
        chance = torch.Generator().manual_seed(0)
        drawn = torch.randn(self.hidden, len(inputs) + 1, generator=chance, dtype=torch.float64)
        drawn, trust = drawn.clamp(-2.0, 2.0) / len(inputs) ** 0.5, spec.sizes.get(TRUST, 1.0)
        units, bounds, doc = range(self.hidden), (-10.0, 10.0), "weight of the hidden layer"
        hidden = [(f"h{k}.{n}", float(drawn[k, i])) for k in units for i, n in enumerate((*inputs, "one"))]
        sd = trust * INPUT_SD, trust * OUTPUT_SD
        first = [Parameter(n, NEAR_ZERO * d, "1", bounds, sd[0], doc=doc, typical=d) for n, d in hidden]
        names, doc = [f"{row}.h{k}" for row in rows for k in units], "output's weight"
        super().__init__((*first, *(Parameter(n, 0.0, "1", bounds, sd[1], doc=doc, typical=0.2) for n in names)))
        self.inputs, self.rows = inputs, rows
        column = lambda numbers: torch.tensor(numbers, dtype=torch.float64)  # noqa: E731
        self.register_buffer("reference", column([spec.reference.get(n, 0.0) for n in inputs]))
        self.register_buffer("size", column([max(spec.sizes.get(n, 1.0), 1e-9) for n in inputs]))
        self.register_buffer("bound", column([self.share * spec.sizes.get(f"row.{r}", 1.0) for r in rows]))

    @classmethod
    def from_spec(cls, spec: ModelSpec) -> NeuralForces:
        """Of velocities, rates and controls where they are; into the rows that the model has.

        Of a multirotor forces by velocities and by what drives the rotors alone. Commands answer the rates, so that a
        network of these would learn the controller.
        """
        inputs = tuple(n for n in (*VELOCITIES, *(() if spec.motors else RATES)) if n in spec.states)
        rows = tuple(r for r in (*FORCES, *(() if spec.motors else MOMENTS)) if r in spec.patterns)
        return cls((*inputs, *(spec.driven if spec.motors else spec.controls)), rows, spec)

    @classmethod
    def untestable(cls, spec: ModelSpec) -> str | None:
        """A model without equations of force and moment about a reference has no rows to add to.

        The network of a multirotor learns specific force at measured velocities.
        """
        if spec.motors and not {*VELOCITIES, *SPECIFIC_FORCES} <= {*spec.states, *spec.outputs}:
            return "a network tells the forces of the air by u v w from ax ay az, which are not all measured"
        if any(r in spec.patterns for r in (*FORCES, *MOMENTS)):
            return None
        return "the model has no equations of force and moment about a reference that a network could add to"

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Adds the network's forces and moments."""
        n, m = len(self.inputs) + 1, len(self.rows)
        first = p.vector[..., : self.hidden * n].unflatten(-1, (self.hidden, n))
        second = p.vector[..., self.hidden * n :].unflatten(-1, (m, self.hidden))
        z = (frame.stack(self.inputs) - self.reference) / self.size
        hidden = torch.tanh((first[..., :-1] * z.unsqueeze(-2)).sum(-1) + first[..., -1])
        out = self.bound * torch.tanh((second * hidden.unsqueeze(-2)).sum(-1))
        forces = sum(r in FORCES for r in self.rows)
        return frame.add(out[..., :forces] if forces else None, out[..., forces:] if forces < m else None), x
