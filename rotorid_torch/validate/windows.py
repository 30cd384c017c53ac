"""Free runs of flights over 8 s from every whole second on, as the score J defines them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.model.model import Model
from rotorid_torch.validate import scores
from rotorid_torch.validate.free_run import Runs, Windows, free_run, windows

TOGETHER = 100_000
"""Samples of windows that are run at once; what is known of them takes a hundred megabytes."""


def all_windows(
    model: Model, dataset: Dataset, names: Sequence[str], run: Runs
) -> Iterator[tuple[str, Windows, Tensor]]:
    """All windows of these flights with their outputs, some flights at once; by sample interval."""
    by_step = defaultdict(list)
    for name in names:
        by_step[dataset.facts[name].dt].append(name)
    groups = [(dt, group) for dt, names in by_step.items() for group in _groups(dataset, names, dt)]
    for dt, names in groups:
        samples = min(scores.horizon_samples(dt), max(dataset.facts[name].samples for name in names))
        starts = {name: scores.window_starts(dataset.facts[name].samples, dt) for name in names}
        places = [(name, k) for name in names for k in starts[name]]
        pieces = windows(model, dataset, places, samples)
        _, outputs = free_run(model, pieces, run)
        first = 0
        for name in names:
            first_starts = range(first, first + len(starts[name]))
            yield name, pieces.pick(first_starts), outputs[list(first_starts)]
            first = first_starts.stop
        del pieces, outputs  # before the next group's


@dataclass(frozen=True)
class ScoredChannels:
    """Channels that count: their places among a model's outputs, scales and noise [n]."""

    places: list[int]
    scale: Tensor
    noise: Tensor

    @classmethod
    def of(cls, model: Model, dataset: Dataset) -> ScoredChannels:
        """Those that the data set scores and the model gives."""
        names = [c for c in dataset.scored() if c in model.body.outputs]
        scale, noise = ([of(c) for c in names] for of in (dataset.scales().__getitem__, dataset.noise))
        places = [model.body.outputs.index(c) for c in names]
        return cls(places, *(torch.tensor(v, dtype=torch.float64) for v in (scale, noise)))

    def J(self, pieces: Windows, outputs: Tensor) -> Tensor:
        """J of each window [W]."""
        return scores.flight_J((outputs - pieces.measured)[..., self.places], self.scale)


def _groups(dataset: Dataset, names: Sequence[str], dt: float) -> Iterator[list[str]]:
    """Flights whose windows are run at once."""
    group, total = [], 0
    for name in names:
        numbers = len(scores.window_starts(dataset.facts[name].samples, dt)) * scores.horizon_samples(dt)
        if group and total + numbers > TOGETHER:
            yield group
            group, total = [], 0
        group, total = [*group, name], total + numbers
    yield group
