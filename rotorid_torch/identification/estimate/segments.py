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

FINEST = 12
"""Steps of the shortest sample interval, at most, where intervals of flights differ."""
SAME_STEP = 1e-3
"""Of a step, by which those of flights may differ."""
TOGETHER = 256
"""Pieces that are cut at once."""


@dataclass(frozen=True)
class Records:
    """Flights of one step, padded to the longest: controls held, outputs NaN beyond a flight's end.

    `states` holds what is known of the state at each step, to start segments from; NaN where nothing is known.
    `every`: steps from one measured sample of a flight to the next, one where it is None.
    `hold`: controls stay as they are from a step to the next; else they are linear in between.
    """

    dt: float
    lengths: Tensor  # [F] samples
    start: Tensor  # [F] time of the first sample, s
    controls: Tensor  # [F, T, nu]
    outputs: Tensor  # [F, T, ny], NaN = missing
    states: Tensor  # [F, T, nx], NaN = unknown
    every: Tensor | None = None  # [F]
    hold: bool = False

    def spacing(self) -> Tensor:
        """Steps from one measured sample to the next [F]."""
        return torch.ones_like(self.lengths) if self.every is None else self.every

    def refined(self, times: int) -> Records:
        """The same flights in steps so many times shorter: nothing is measured in between."""
        if times == 1:
            return self
        parts = (_between(self.controls, times, self.hold), _apart(self.outputs, times), _apart(self.states, times))
        lengths, every = (self.lengths - 1) * times + 1, self.spacing() * times
        return Records(self.dt / times, lengths, self.start, *parts, every, self.hold)

    def pick(self, which: Tensor) -> Records:
        """Some of the flights."""
        lengths, start, every = self.lengths[which], self.start[which], self.spacing()[which]
        controls, outputs, states = self.controls[which], self.outputs[which], self.states[which]
        return Records(self.dt, lengths, start, controls, outputs, states, every, self.hold)

    def times(self) -> list[Tensor]:
        """Times (T,) of the measured samples of each flight, s."""
        ends = zip(self.start, self.lengths.tolist(), self.spacing().tolist(), strict=True)
        return [start + self.dt * torch.arange(0, length, every, dtype=torch.float64) for start, length, every in ends]

    def measured(self, record: Tensor) -> list[Tensor]:
        """A record over the steps [F, T, ...] at the measured samples of each flight."""
        ends = zip(record, self.lengths.tolist(), self.spacing().tolist(), strict=True)
        return [one[:length:every] for one, length, every in ends]

    @property
    def samples(self) -> int:
        """Samples of the longest flight."""
        return self.controls.shape[1]

    def typical(self) -> Records:
        """A flight of one sample: the first controls, and the mean of the states."""
        mean = torch.stack([states.nan_to_num(0.0).mean(dim=0) for states in self.states]).mean(dim=0)
        first = self.controls[:1, :1].clone(), self.outputs[:1, :1].clone()
        one = torch.ones_like(self.lengths[:1]), self.start[:1].clone()
        return Records(self.dt, *one, *first, mean[None, None], hold=self.hold)


def _between(record: Tensor, times: int, hold: bool) -> Tensor:
    """A record [F, T, n] at `times` as many steps, linear or held in between."""
    share = torch.zeros(times, 1) if hold else (torch.arange(times) / times).unsqueeze(-1)
    inside = record[:, :-1, None] + share.to(record) * (record[:, 1:, None] - record[:, :-1, None])
    return torch.cat([inside.flatten(1, 2), record[:, -1:]], dim=1)


def _apart(record: Tensor, times: int) -> Tensor:
    """A record [F, T, n] at `times` as many steps, NaN in between."""
    wide = record.new_full((len(record), (record.shape[1] - 1) * times + 1, record.shape[2]), math.nan)
    wide[:, ::times] = record
    return wide


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
        inside, flight = self.inside, self.flight[:, None].expand_as(self.place)
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
        return torch.diff(self.place, dim=1, prepend=self.place[:, :1] - 1) > 0


def records_from(flights: Sequence[Mapping[str, Any]], hold: bool = False) -> Records:
    """Flights given as dicts of arrays: time (T,), controls (T, nu), outputs (T, ny), and x0 (nx,) or states (T, nx).

    hold : controls are held from a sample to the next.

    Flights of several sample intervals share a step of which each is a multiple.

    Raises InputError where an array is missing, has another shape than the others, time is not uniform, or there is no
    such step.
    """
    rows = flights_of(flights)
    dt, every = _common_step([float(row["time"][-1] - row["time"][0]) / (len(row["time"]) - 1) for row in rows])
    nx = next((row[key].shape[-1] for row in rows for key in ("states", "x0") if key in row), None)
    if nx is None:
        raise InputError("flights[0]", "x0", "absent in every flight", "the initial state (nx,) of at least one flight")
    for row in rows:
        row["states"] = _known_states(row, nx)
    for row, times in zip(rows, every, strict=True):
        if times > 1:
            row["controls"] = _between(row["controls"][None], times, hold)[0]
            row["outputs"], row["states"] = (_apart(row[key][None], times)[0] for key in ("outputs", "states"))
    controls = [row["controls"] for row in rows]
    lengths = [len(record) for record in controls]
    held = [torch.cat([u, u[-1:].expand(max(lengths) - len(u), -1)]) for u in controls]
    return Records(
        dt=dt,
        lengths=torch.tensor(lengths),
        start=torch.stack([row["time"][0] for row in rows]),
        controls=torch.stack(held),
        outputs=pad_sequence([row["outputs"] for row in rows], batch_first=True, padding_value=math.nan),
        states=pad_sequence([row["states"] for row in rows], batch_first=True, padding_value=math.nan),
        every=torch.tensor(every) if max(every) > 1 else None,
        hold=hold,
    )


def _common_step(intervals: Sequence[float]) -> tuple[float, list[int]]:
    """The longest step, s, of which every sample interval is a multiple, and the multiples.

    Raises InputError: the step would have to be shorter than a `FINEST`th of the shortest interval.
    """
    shortest = min(intervals)
    for parts in range(1, FINEST + 1):
        every = [round(interval * parts / shortest) for interval in intervals]
        steps = [interval / n for interval, n in zip(intervals, every, strict=True)]
        if max(steps) - min(steps) <= SAME_STEP * shortest / parts:
            return sum(steps) / len(steps), every
    i = next(k for k, interval in enumerate(intervals) if abs(interval - intervals[0]) > SAME_STEP * intervals[0])
    wrong = f"sample interval {intervals[i]:.6g} s beside {intervals[0]:.6g} s of the first flight"
    expected = f"intervals that are multiples of a step, at least a {FINEST}th of the shortest one: resample"
    raise InputError(f"flights[{i}]", "time", wrong, expected)


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
    for f, (total, every) in enumerate(zip(records.lengths.tolist(), records.spacing().tolist(), strict=True)):
        pieces, measured = math.ceil(total / samples), (total - 1) // every + 1
        edges = [min(round(i * measured / pieces) * every, total) for i in range(pieces + 1)]
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
