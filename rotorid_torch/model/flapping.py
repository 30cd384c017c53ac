"""Main-rotor flapping in multi-blade coordinates: coning, longitudinal and lateral, first order or algebraic."""

from __future__ import annotations

from torch import Tensor

from rotorid_torch.core.names import FLAPPING
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Frame, Role, Stage, Values
from rotorid_torch.model.linear_equations import LinearBlock, LinearEffect


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
