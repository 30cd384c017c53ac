"""Effects as users write them: one of forces, one with a state of its own, one in the control path."""

from __future__ import annotations

import torch
from torch import Tensor

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.core.state import State
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values


class OwnDrag(Effect):
    """Drag quadratic in each body velocity, m/s2.

    Source: Hoerner, Fluid-Dynamic Drag.
    """

    id, stage, role = "own.drag", Stage.FORCES, Role.UNDECLARED

    def __init__(self) -> None:
        super().__init__(tuple(Parameter(axis, 0.0, "1/m", (0.0, 1.0), doc=f"drag along {axis}") for axis in "xyz"))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        speed = frame.stack(("u", "v", "w"))
        return frame.add(force=-p.stack("x", "y", "z") * speed * speed.abs()), x


class OwnLag(Effect):
    """Roll acceleration that follows the lateral stick late, through a state of its own.

    Source: any book on first-order lags.
    """

    id, stage, role = "own.lag", Stage.FORCES, Role.UNDECLARED

    def __init__(self) -> None:
        declared = (
            Parameter("L", 0.0, "1/s2", (-100.0, 100.0), doc="roll acceleration by the late stick"),
            Parameter("tau", 0.2, "s", (0.05, 2.0), doc="time constant"),
        )
        super().__init__(declared, (State("late", "rad", "late stick"),))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        late = x[..., 0]
        zero = torch.zeros_like(p["L"] * late)
        moment = vec(p["L"] * late, zero, zero)
        return frame.add(moment=moment), ((frame.signals["lat"] - late) / p["tau"]).unsqueeze(-1)


class OwnGain(Effect):
    """Control gearing other than declared: every control times 1 + k.

    Source: the rigging sheet.
    """

    id, stage, role = "own.gain", Stage.CONTROL, Role.UNDECLARED

    def __init__(self) -> None:
        super().__init__((Parameter("k", 0.0, "1", (-0.5, 0.5), doc="relative error of the gearing"),))

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        return record * (1.0 + p["k"][..., None, None])


OWN = (OwnDrag, OwnLag, OwnGain)
