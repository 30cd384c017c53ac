"""Equations linear in their regressors: trim value plus derivatives, each a named parameter; flapping is one block."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from rotorid_torch.core.names import FLAPPING
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values


class LinearBlock(nn.Module):
    """rows = trim + D z, with z the perturbations of `columns` from the reference; D has entries only where declared.

    rows : names of the equations.
    columns : names of all regressors, in the order of z.
    pattern : for each row the regressors that it has.
    declared : the parameters, by names "row.column" and "row.trim".
    """

    index: Tensor
    trims: Tensor

    def __init__(
        self,
        rows: Sequence[str],
        columns: Sequence[str],
        pattern: Mapping[str, Sequence[str]],
        declared: Sequence[Parameter],
    ) -> None:
        super().__init__()
        self.rows, self.columns = tuple(rows), tuple(columns)
        self.declared = tuple(declared)
        places = {p.name: i for i, p in enumerate(self.declared)}
        absent = len(self.declared)  # a zero is appended there
        index = [[places[f"{r}.{c}"] if c in pattern[r] else absent for c in self.columns] for r in self.rows]
        self.register_buffer("index", torch.tensor(index, dtype=torch.int64))
        self.register_buffer("trims", torch.tensor([places[f"{r}.trim"] for r in self.rows], dtype=torch.int64))

    def matrix(self, p: Values) -> Tensor:
        """D [..., rows, columns]."""
        return torch.cat([p.vector, torch.zeros_like(p.vector[..., :1])], dim=-1)[..., self.index]

    def forward(self, z: Tensor, p: Values) -> Tensor:
        """Values of the rows [..., rows] at perturbations z [..., columns]."""
        matrix, trim = self.matrix(p), p.vector[..., self.trims]
        if matrix.dim() == 2:
            return trim + z @ matrix.mT
        return trim + (matrix @ z.unsqueeze(-1)).squeeze(-1)


class LinearEffect(Effect):
    """An effect that is a block of equations, linear about the reference [columns]."""

    reference: Tensor

    def __init__(self, block: LinearBlock, reference: Tensor, states: tuple[State, ...] = ()) -> None:
        super().__init__(block.declared, states)
        self.block = block
        self.register_buffer("reference", reference)

    def values(self, frame: Frame, p: Values) -> Tensor:
        """Values of the rows [..., rows]."""
        return self.block(frame.stack(self.block.columns) - self.reference, p)


class Flapping(LinearEffect):
    """First-order coupled flapping: d(a0, a1, b1)/dt = trim + D (a0, a1, b1, u v w, p q r, controls).

    beta(psi) = a0 - a1 cos(psi) - b1 sin(psi), psi = 0 aft; rad. Rows in rad/s.

    Source: Chen, NASA TM-81169 (1980), tip-path-plane dynamics reduced to first order; Padfield, Helicopter Flight
    Dynamics, sec. 3.2.
    """

    id, stage, role = "rotor", Stage.ROTOR, Role.NOMINAL

    def __init__(self, block: LinearBlock, reference: Tensor) -> None:
        super().__init__(block, reference, tuple(State(n, "rad") for n in FLAPPING))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Publishes the flapping states; returns their rates."""
        frame = frame.with_signals(**dict(zip(FLAPPING, x.unbind(-1), strict=True)))
        return frame, self.values(frame, p)


class AlgebraicFlapping(LinearEffect):
    """Flapping that follows its drivers without lag: (a0, a1, b1) = trim + D (u v w, p q r, controls), rad.

    For rotors whose data show no lag of flapping behind its drivers: there a state would be an artefact.

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2 (quasi-steady flapping).
    """

    id, stage, role = "rotor", Stage.ROTOR, Role.NOMINAL

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Publishes the flapping that the drivers demand."""
        return frame.with_signals(**dict(zip(FLAPPING, self.values(frame, p).unbind(-1), strict=True))), x
