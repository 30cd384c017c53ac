"""Records of several flights as one padded batch, and their cutting into segments that are simulated side by side."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch.core.storage import mapped_arrays
from rotorid_torch.errors import InputError
from rotorid_torch.identification.arguments import flights_of

TOGETHER = 256
"""Pieces that are cut at once."""


@dataclass(frozen=True)
class Records:
    """Flights of one sample interval, padded to the longest: controls held, outputs NaN beyond a flight's end.

    `states` holds what is known of the state at each sample, to start segments from; NaN where nothing is known.
    """

    dt: float
    lengths: Tensor  # [F] samples
    start: Tensor  # [F] time of the first sample, s
    controls: Tensor  # [F, T, nu]
    outputs: Tensor  # [F, T, ny], NaN = missing
    states: Tensor  # [F, T, nx], NaN = unknown

    @property
    def samples(self) -> int:
        """Samples of the longest flight."""
        return self.controls.shape[1]

    def typical(self) -> Records:
        """A flight of one sample: the first controls, and the mean of the states."""
        mean = torch.stack([states.nan_to_num(0.0).mean(dim=0) for states in self.states]).mean(dim=0)
        first = self.controls[:1, :1].clone(), self.outputs[:1, :1].clone()
        return Records(self.dt, torch.ones_like(self.lengths[:1]), self.start[:1].clone(), *first, mean[None, None])


@dataclass(frozen=True)
class Segments:
    """Pieces of flights, all simulated as one batch of equal length."""

    dt: float
    flight: Tensor  # [S] which flight
    place: Tensor  # [S, T] sample of the flight, held at the last one beyond the piece's end
    start: Tensor  # [S] time of the first sample, s
    outputs: Tensor  # [S, T, ny], NaN = missing or beyond the end

    @property
    def samples(self) -> int:
        """Samples of the longest piece."""
        return self.place.shape[1]

    def __len__(self) -> int:
        return len(self.flight)

    def take(self, record: Tensor) -> Tensor:
        """A record over the flights [F, T, ...] cut into the pieces [S, T, ...]."""
        return record[self.flight[:, None], self.place]

    def first(self, record: Tensor) -> Tensor:
        """A record over the flights [F, T, ...] at the pieces' first samples [S, ...]."""
        return record[self.flight, self.place[:, 0]]

    def write(self, pieces: Tensor, record: Tensor) -> None:
        """Write the pieces [S, T, ...] into a record [F, T, ...] where they belong."""
        inside = self.inside
        flight = self.flight[:, None].expand_as(self.place)
        record[flight[inside], self.place[inside]] = pieces[inside]

    def pick(self, which: Tensor) -> Segments:
        """Some of the pieces."""
        return Segments(self.dt, self.flight[which], self.place[which], self.start[which], self.outputs[which])

    def head(self, samples: int) -> Segments:
        """The first samples of every piece."""
        return Segments(self.dt, self.flight, self.place[:, :samples], self.start, self.outputs[:, :samples])

    @property
    def inside(self) -> Tensor:
        """[S, T] True up to a piece's end."""
        steps = torch.diff(self.place, dim=1, prepend=self.place[:, :1] - 1)
        return steps > 0


def records_from(flights: Sequence[Mapping[str, Any]], states: int | None = None) -> Records:
    """Flights given as dicts of arrays: time (T,), controls (T, nu), outputs (T, ny), and x0 (nx,) or states (T, nx).

    `states` is the number of states where no flight says it.

    Raises
    ------
    InputError
        Where an array is missing, has another shape than the others, or time is not uniform.
    """
    rows = flights_of(flights)
    steps = [float(torch.diff(row["time"]).mean()) for row in rows]
    for i, step in enumerate(steps):
        if abs(step - steps[0]) > 1e-3 * steps[0]:
            raise InputError(
                f"flights[{i}]", "time", f"sample interval {step:.6g} s", f"{steps[0]:.6g} s as in the first flight"
            )
    nx = next((row[key].shape[-1] for row in rows for key in ("states", "x0") if key in row), states)
    if nx is None:
        raise InputError("flights[0]", "x0", "absent in every flight", "the initial state (nx,) of at least one flight")
    for row in rows:
        row["states"] = _known_states(row, nx)
    longest = max(len(row["time"]) for row in rows)
    held = [torch.cat([row["controls"], row["controls"][-1:].expand(longest - len(row["time"]), -1)]) for row in rows]
    return Records(
        dt=sum(steps) / len(steps),
        lengths=torch.tensor([len(row["time"]) for row in rows]),
        start=torch.stack([row["time"][0] for row in rows]),
        controls=torch.stack(held),
        outputs=pad_sequence([row["outputs"] for row in rows], batch_first=True, padding_value=math.nan),
        states=pad_sequence([row["states"] for row in rows], batch_first=True, padding_value=math.nan),
    )


def _known_states(row: Mapping[str, Tensor], nx: int) -> Tensor:
    """[T, nx] from `states`, its first row from `x0` where that is given; NaN where nothing is known."""
    states = row.get("states")
    states = torch.full((len(row["time"]), nx), math.nan, dtype=torch.float64) if states is None else states.clone()
    if "x0" in row:
        states[0] = row["x0"]
    return states


def cut(records: Records, samples: int) -> Segments:
    """Each flight in equal pieces of at most this many samples; they neither overlap nor leave a sample out."""
    flight, first, length = [], [], []
    for f, total in enumerate(records.lengths.tolist()):
        pieces = math.ceil(total / samples)
        edges = [round(i * total / pieces) for i in range(pieces + 1)]
        for a, b in itertools.pairwise(edges):
            flight.append(f)
            first.append(a)
            length.append(b - a)
    offset = torch.arange(max(length))
    place = torch.tensor(first)[:, None] + torch.minimum(offset, torch.tensor(length)[:, None] - 1)
    which = torch.tensor(flight)
    beyond = (offset >= torch.tensor(length)[:, None])[..., None]
    outputs = mapped_arrays.empty(*place.shape, records.outputs.shape[-1])
    for some in torch.arange(len(which)).split(TOGETHER):
        outputs[some] = records.outputs[which[some, None], place[some]].masked_fill(beyond[some], math.nan)
    mapped_arrays.let_go()
    start = records.start[which] + place[:, 0] * records.dt
    return Segments(records.dt, which, place, start, outputs)
