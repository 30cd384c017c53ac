"""Judging a model: free runs of every flight and of all its 8-s windows, as records and as overlays to draw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.model.model import Model
from rotorid_torch.run.figures import Overlay
from rotorid_torch.run.records import LISTS, ChannelRecord, FlightRecord, ScoresRecord, WindowsRecord
from rotorid_torch.validate import scores
from rotorid_torch.validate.free_run import free_run, windows


@dataclass(frozen=True)
class Judgement:
    """What the free runs of a model say: records per flight, scores of the lists, and the runs from START = 0."""

    flights: dict[str, FlightRecord]
    scores: ScoresRecord
    overlays: tuple[Overlay, ...]


@dataclass(frozen=True)
class Runs:
    """Free runs of one flight: measured and simulated [W, T, ny], the first window beginning at START = 0."""

    flight: str
    dt: float
    measured: Tensor
    simulated: Tensor


def judge(model: Model, dataset: Dataset) -> Judgement:
    """Fly the model free on all flights of the data set and score it."""
    flights: dict[str, FlightRecord] = {}
    overlays = []
    runs = {run.flight: run for run in _free_runs(model, dataset)}
    for name in dataset.flights:
        flights[name] = flight_record(runs[name], model.body.outputs, dataset)
        overlays.append(_overlay(runs[name], model.body.outputs, dataset))
    return Judgement(flights, list_scores(flights), tuple(overlays))


def list_scores(flights: dict[str, FlightRecord]) -> ScoresRecord:
    """Score of each list from its flights' J; None for a list without flights."""

    def score(name: str) -> float | None:
        J = [math.nan if f.J is None else f.J for f in flights.values() if f.list == name]
        return scores.list_score(torch.tensor(J, dtype=torch.float64)).item() if J else None

    return ScoresRecord(**{name: score(name) for name in LISTS})


def flight_record(run: Runs, outputs: Sequence[str], dataset: Dataset) -> FlightRecord:
    """Scores of one flight; J counts the data set's scored channels, the channels' own numbers all outputs it has."""
    places = [i for i, name in enumerate(outputs) if name in dataset.scored()]
    scale = _column([dataset.scales()[outputs[i]] for i in places])
    noise = _column([dataset.noise(outputs[i]) for i in places])
    measured, error = run.measured[..., places], (run.simulated - run.measured)[..., places]
    J = scores.flight_J(error, scale)
    return FlightRecord(
        list=dataset.listed(run.flight),
        J=J[0].item(),
        J_noise=scores.noise_J(measured[0], noise, scale).item(),
        J_trim=scores.trim_J(measured[0], scale, run.dt).item(),
        windows=WindowsRecord(**scores.window_statistics(J)._asdict()),
        channels=_channels(run, outputs, dataset),
    )


def _channels(run: Runs, outputs: Sequence[str], dataset: Dataset) -> dict[str, ChannelRecord]:
    measured, simulated = run.measured[0], run.simulated[0]
    error = simulated - measured
    rmse, r2, theil = scores.rmse(error), scores.r2(error, measured), scores.theil(simulated, measured, run.dt)
    return {
        name: ChannelRecord(
            rmse=rmse[i].item(),
            r2=r2[i].item(),
            theil=theil.coefficient[i].item(),
            theil_parts=tuple(theil.parts[i].tolist()),
        )
        for i, name in enumerate(outputs)
        if dataset.flights[run.flight].has(name)
    }


def _free_runs(model: Model, dataset: Dataset) -> list[Runs]:
    """All windows of all flights of one sample interval as one batch."""
    runs = []
    for dt in sorted({flight.dt for flight in dataset.flights.values()}):
        names = [name for name, flight in dataset.flights.items() if flight.dt == dt]
        starts = {name: scores.window_starts(dataset.flights[name].samples, dt) for name in names}
        places = [(name, start) for name in names for start in starts[name]]
        pieces = windows(model, dataset, places, scores.horizon_samples(dt))
        _, simulated = free_run(model, pieces)
        counts = [len(starts[name]) for name in names]
        split = zip(names, pieces.measured.split(counts), simulated.split(counts), strict=True)
        runs += [Runs(name, dt, measured, outputs) for name, measured, outputs in split]
    return runs


def _overlay(run: Runs, outputs: Sequence[str], dataset: Dataset) -> Overlay:
    flight = dataset.flights[run.flight]
    samples = min(flight.samples, run.measured.shape[1])
    has = [(i, name) for i, name in enumerate(outputs) if flight.has(name)]
    return Overlay(
        run.flight,
        dataset.listed(run.flight),
        flight.time[:samples],
        {name: run.measured[0, :samples, i] for i, name in has},
        {name: run.simulated[0, :samples, i] for i, name in has},
    )


def _column(values: Sequence[float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)
