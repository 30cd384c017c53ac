"""Main-rotor flapping in multi-blade coordinates: coning, longitudinal and lateral, first order or algebraic."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from rotorid_torch.core.names import FLAPPING
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.model.linear_equations import LinearBlock


class Flapping(Effect):
    """First-order coupled flapping: d(a0, a1, b1)/dt = trim + D (a0, a1, b1, u v w, p q r, controls).

    beta(psi) = a0 - a1 cos(psi) - b1 sin(psi), psi = 0 aft; rad. Rows in rad/s.

    Source: Chen, NASA TM-81169 (1980), tip-path-plane dynamics reduced to first order; Padfield, Helicopter Flight
    Dynamics, sec. 3.2.
    """

    id, stage, role = "rotor", Stage.ROTOR, Role.NOMINAL
    reference: Tensor

    def __init__(self, block: LinearBlock, reference: Tensor) -> None:
        super().__init__(block.declared, tuple(State(n, "rad") for n in FLAPPING))
        self.block = block
        self.register_buffer("reference", reference)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Publishes the flapping states; returns their rates."""
        frame = frame.with_signals(**dict(zip(FLAPPING, x.unbind(-1), strict=True)))
        return frame, self.block(frame.stack(self.block.columns) - self.reference, p)


class AlgebraicFlapping(Effect):
    """Flapping that follows its drivers without lag: (a0, a1, b1) = trim + D (u v w, p q r, controls), rad.

    For rotors whose data show no lag of flapping behind its drivers: there a state would be an artefact.

    Source: Padfield, Helicopter Flight Dynamics, sec. 3.2 (quasi-steady flapping).
    """

    id, stage, role = "rotor", Stage.ROTOR, Role.NOMINAL
    reference: Tensor

    def __init__(self, block: LinearBlock, reference: Tensor) -> None:
        super().__init__(block.declared)
        self.block = block
        self.register_buffer("reference", reference)

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Publishes the flapping that the drivers demand."""
        flapping = self.block(frame.stack(self.block.columns) - self.reference, p)
        return frame.with_signals(**dict(zip(FLAPPING, flapping.unbind(-1), strict=True))), x


def reference_vector(columns: Sequence[str], reference: dict[str, float]) -> Tensor:
    """Reference values of these signals [n]; what the reference does not know is taken as zero."""
    return torch.tensor([reference.get(c, 0.0) for c in columns], dtype=torch.float64)
