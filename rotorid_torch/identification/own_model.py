"""Anybody's model with what stands between it and the records: pure delays of controls, outputs that are angles."""

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from rotorid_torch.effects.signal_operations import shifted
from rotorid_torch.errors import WrappedAngle

SMALL = 0.5
"""Usual change of an angle from one sample to the next, rad, below which a jump of a turn is one."""
BESIDE = 5
"""Changes on each side of a jump to which it is compared."""
ALIKE = 2.0
"""Times the largest of them: white noise exceeds it twice in a thousand jumps, steps that are no turns do."""


def wrapped(angle: Tensor) -> Tensor:
    """An angle within half a turn of zero, rad; its derivative is one everywhere."""
    return torch.atan2(torch.sin(angle), torch.cos(angle))


def unwrapped(record: Tensor) -> Tensor:
    """A record [..., T] of an angle without jumps of whole turns; NaN = missing."""
    rows = record.clone().reshape(-1, record.shape[-1])
    for row in rows:
        present = ~row.isnan()
        row[present] = torch.from_numpy(np.unwrap(row[present].cpu().numpy())).to(row)
    return rows.reshape(record.shape)


def warn_of_turns(outputs: Tensor, angles: Sequence[int]) -> None:
    """Warn (`WrappedAngle`) of outputs [..., T, ny] that jump by whole turns and are not among the angles."""
    for place in set(range(outputs.shape[-1])) - set(angles):
        rows = outputs[..., place].reshape(-1, outputs.shape[-2])
        jumps = sum(_turns(row[~row.isnan()]) for row in rows)
        if jumps:
            said = f"output {place} jumps by a whole turn ({jumps} times)"
            warnings.warn(f"{said}: angles=[{place}] compares it within half a turn", WrappedAngle, stacklevel=4)


def _turns(record: Tensor) -> int:
    """Jumps of a record (T,) that are whole turns: without them it changes there as it does beside them."""
    changes = record.diff()
    left = (changes - 2.0 * math.pi * torch.round(changes / (2.0 * math.pi))).abs()
    if not len(left) or float(left.median()) >= SMALL:
        return 0
    jumps = ((changes.abs() > math.pi) & (left < SMALL)).nonzero()[:, 0].tolist()
    neighbours = (torch.cat([left[max(k - BESIDE, 0) : k], left[k + 1 : k + 1 + BESIDE]]) for k in jumps)
    return sum(bool(len(near) and left[k] <= ALIKE * near.max()) for k, near in zip(jumps, neighbours, strict=True))


def near(outputs: Tensor, measured: Tensor, angles: Sequence[int]) -> Tensor:
    """Outputs [..., ny] of which the angles are taken within half a turn of the measured ones [..., len(angles)]."""
    columns = list(outputs.unbind(-1))
    for k, i in enumerate(angles):
        columns[i] = measured[..., k] + wrapped(columns[i] - measured[..., k])
    return torch.stack(columns, dim=-1)


class OwnModel(nn.Module):
    """A model behind pure delays of some controls, with some outputs compared as angles.

    Its controls are the model's and behind them the measured angles [..., nu + len(angles)].

    model : with forward(t, x, u), output(x, u) and, if it likes, tape(controls, dt).
    controls : number of the model's controls. angles : places of outputs. delays : start in s by place of the control.
    """

    def __init__(self, model: nn.Module, controls: int, angles: Sequence[int], delays: dict[int, float]) -> None:
        super().__init__()
        self.model, self.count, self.angles, self.late = model, controls, tuple(angles), tuple(delays)
        self.delay = nn.Parameter(torch.tensor(list(delays.values()), dtype=torch.float64))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """Rates [..., nx] of the model."""
        return self.model(t, x, u[..., : self.count])

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        """Outputs [..., ny], angles within half a turn of those measured."""
        outputs = self.model.output(x, u[..., : self.count])  # pyright: ignore[reportCallIssue]
        return near(outputs, u[..., self.count :], self.angles)

    def tape(self, controls: Tensor, dt: float) -> Tensor:
        """The record [..., T, nu + len(angles)] with the controls delayed, and behind the model's own control path."""
        path = controls[..., : self.count]
        if self.late:
            delay = torch.zeros(self.count, dtype=path.dtype).index_put((torch.tensor(self.late),), self.delay)
            path = shifted(path, delay, dt)
        of_model: Any = getattr(self.model, "tape", None)
        path = path if of_model is None else of_model(path, dt)
        return torch.cat([path, controls[..., self.count :]], dim=-1)

    def delays(self) -> dict[str, tuple[int, float, float]]:
        """By name of a delay: its place among them, its lower and its upper bound, s."""
        return {f"delay[{control}]": (k, 0.0, math.inf) for k, control in enumerate(self.late)}
