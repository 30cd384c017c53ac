"""What no named effect explains: in which equation, with what it goes, since when, in which band. Never a name.

Forces and moments that step 1 found, less those of the model on the measured motion. What linear terms could still take
up is projected out of both sides; what is left is compared with products of the motion and controls, with what grows
faster than its channel or levels off, and with everything linear that begins at some time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import torch
from torch import Tensor

from rotorid_torch.core.names import FORCES, MOMENTS
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.identification.reconstruct import Reconstruction
from rotorid_torch.identification.step2 import measured
from rotorid_torch.identification.step3 import averaged
from rotorid_torch.model.model import Model

RATE = 20.0
"""Hz: records are averaged down to this; the body moves below a fifth of it."""
ONSET_S = 0.5
"""Steps in which the beginning of something new is looked for, s."""
EDGE_S = 2.0
"""Something that begins within this of a flight's ends is not told from a manoeuvre, s."""
SMOOTH_S = 0.25
"""Moments are averaged over this: rates differentiated are noise above."""


@dataclass(frozen=True)
class Trace:
    """The best description of what an equation leaves over: what it goes with and how, since when.

    size : its rms. share : of the square of all that linear terms leave over. weight : what counts against the floor,
    the size times its correlation with the rest: what is large must also stand out, for no model of other people's
    aircraft is perfect.
    """

    goes_with: str
    shape: str
    since_s: float | None
    size: float
    share: float

    @property
    def weight(self) -> float:
        """Its rms times its correlation with what is left over."""
        return self.size * self.share**0.5


@dataclass(frozen=True, eq=False)
class LeftOver:
    """Equations' residuals [N, rows] of all flights in one column, and what may go with them [N, k].

    linear : what linear terms and a constant of each flight take up. flight : the flight of each sample [N].
    """

    rows: tuple[str, ...]
    residual: Tensor
    names: tuple[str, ...]
    signals: Tensor
    time: Tensor
    linear: Tensor
    flight: Tensor

    @property
    def usual(self) -> Tensor:
        """Rms of each signal [k]."""
        return self.signals.square().mean(dim=0).sqrt().clamp_min(1e-300)

    def beyond(self, values: Tensor) -> Tensor:
        """Columns [N, m] less what linear terms take up."""
        basis = torch.linalg.qr(self.linear).Q
        return values - basis @ (basis.mT @ values)


def left_over(model: Model, dataset: Dataset, reconstruction: Reconstruction, flights: Sequence[str]) -> LeftOver:
    """Residuals of a model's forces and moments on flights, and the signals they may go with."""
    residuals, columns, times, constants = [], [], [], []
    rows = tuple(FORCES + MOMENTS)
    names: tuple[str, ...] = ()
    for k, name in enumerate(flights):
        seen = measured(model, dataset, reconstruction, name)
        dt = dataset.facts[name].dt
        every = max(1, round(1.0 / (dt * RATE)))
        forces = _modelled(model, seen.signals)
        names = tuple(n for n in (*model.body.states, *model.body.controls) if n in seen.signals)
        signals = torch.stack([seen.signals[n] - model.reference.get(n, 0.0) for n in names], dim=-1)
        time = dt * torch.arange(len(signals), dtype=torch.float64)
        residual = averaged(seen.specific - forces, every)
        residuals.append(_smooth(residual.nan_to_num(0.0), max(1, round(SMOOTH_S * RATE))))
        columns.append(averaged(signals, every))
        times.append(averaged(time[:, None], every)[:, 0])
        own = torch.zeros(len(columns[-1]), len(flights), dtype=torch.float64)
        own[:, k] = 1.0
        constants.append(own)
    signals = torch.cat(columns)
    own = torch.cat(constants)
    linear = torch.cat([signals, own], dim=1)
    return LeftOver(rows, torch.cat(residuals), names, signals, torch.cat(times), linear, own.argmax(dim=1))


def _modelled(model: Model, signals: Mapping[str, Tensor]) -> Tensor:
    """Specific forces and angular accelerations by the external moment [T, 6] on measured signals."""
    x = torch.stack([signals.get(n, torch.zeros_like(signals["p"])) for n in model.layout.names], dim=-1)
    u = torch.stack([signals[n] for n in model.body.controls], dim=-1)
    with torch.no_grad():
        frame, _ = model.frame(model.theta, x, u)
    none = torch.zeros(len(x), 3, dtype=torch.float64)
    force = none if frame.force is None else frame.force
    return torch.cat([force, none if frame.moment is None else frame.moment], dim=-1)


def _smooth(records: Tensor, width: int) -> Tensor:
    """Running mean over a few samples [T, n]."""
    kernel = torch.ones(1, 1, width, dtype=torch.float64) / width
    padded = torch.nn.functional.pad(records.mT[:, None], (width // 2, width - 1 - width // 2), mode="replicate")
    return torch.nn.functional.conv1d(padded, kernel)[:, 0].mT


def scan(left: LeftOver) -> dict[str, Trace]:
    """The best trace of each equation."""
    names, columns = zip(*_shapes(left, left.usual), *_onsets(left), strict=True)
    tried = left.beyond(torch.stack(columns, dim=-1))
    residual = left.beyond(left.residual) / len(left.residual) ** 0.5
    sizes = ((tried / tried.norm(dim=0).clamp_min(1e-300)).mT @ residual).abs()
    shares = (sizes / residual.norm(dim=0).clamp_min(1e-300)).square()
    best = sizes.argmax(dim=0).tolist()
    return {
        row: Trace(*names[i], size=float(sizes[i, k]), share=float(shares[i, k]))
        for k, (row, i) in enumerate(zip(left.rows, best, strict=True))
    }


def column(trace: Trace, left: LeftOver, usual: Tensor) -> Tensor:
    """What a trace goes with on other flights [N]; zero where they end before it begins. usual : size of signals."""
    columns = dict([*_shapes(left, usual), *_onsets(left)])
    return columns.get((trace.goes_with, trace.shape, trace.since_s), torch.zeros_like(left.time))


Named = tuple[tuple[str, str, float | None], Tensor]
"""What something goes with, how, since when; and its column [N]."""


def _shapes(left: LeftOver, usual: Tensor) -> Iterator[Named]:
    """What the motion and the controls, of usual sizes [k], make beyond linear terms."""
    for i, j in combinations_with_replacement(range(len(left.names)), 2):
        a, b = left.signals[:, i], left.signals[:, j]
        if i == j:
            yield (left.names[i], "by its square", None), a * a
            yield (left.names[i], "growing faster than it", None), a * a.abs()
            yield (left.names[i], "levelling off", None), torch.tanh(a / usual[i])
        else:
            yield (f"{left.names[i]} {left.names[j]}", "by their product", None), a * b


def _onsets(left: LeftOver) -> Iterator[Named]:
    """What begins at some time and goes on linearly."""
    end = float(left.time.max())
    for onset in torch.arange(EDGE_S, end - EDGE_S, ONSET_S, dtype=torch.float64).tolist():
        after = (left.time >= onset).to(torch.float64)
        for i, name in enumerate(left.names):
            yield (name, "", onset), left.signals[:, i] * after
        yield ("time", "", onset), after
