"""Effects of the control path: what lies between the recorded control and the swashplate."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.effects.base import Effect, Role, Stage, Values
from rotorid_torch.effects.registry import register

LONGEST = 0.25


@register
class ControlDelay(Effect):
    """Pure delay of all recorded controls, common to them.

    The record is shifted by a fractional number of samples with cubic (Catmull-Rom) interpolation: exact at zero,
    smooth in the delay between samples and continuous with its first derivative across them; before its beginning the
    record is held.

    Source: Catmull and Rom (1974); Tischler and Remple, Aircraft and Rotorcraft System Identification, sec. 11.2
    (equivalent time delay).
    """

    id, stage, role = "control.delay", Stage.CONTROL, Role.UNDECLARED

    def __init__(self) -> None:
        super().__init__((Parameter("common", 0.0, "s", (0.0, LONGEST), doc="delay of every control"),))

    def tape(self, record: Tensor, names: tuple[str, ...], dt: float, p: Values) -> Tensor:
        """Record [..., T, nu] shifted by p["common"] s; the delay may carry leading dimensions of the record."""
        shift = (p["common"] / dt)[..., None, None]
        samples = record.shape[-2]
        place = torch.arange(samples, dtype=record.dtype, device=record.device)[:, None] - shift
        whole = torch.floor(place.detach())
        part = place - whole
        first = whole.to(torch.int64)

        def at(offset: int) -> Tensor:
            index = (first + offset).clamp(0, samples - 1)
            shape = np.broadcast_shapes(index.shape[:-2], record.shape[:-2])
            return record.expand(*shape, -1, -1).gather(-2, index.expand(*shape, samples, record.shape[-1]))

        before, here, after, beyond = (at(k) for k in (-1, 0, 1, 2))
        slope, curve = 0.5 * (after - before), before - 2.5 * here + 2.0 * after - 0.5 * beyond
        twist = 1.5 * (here - after) + 0.5 * (beyond - before)
        return here + part * (slope + part * (curve + part * twist))
