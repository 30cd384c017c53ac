"""What gusts do to free runs: how far they alone lead a model off, and how it does where they are fed in."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.model.gusts import fed
from rotorid_torch.model.model import Model
from rotorid_torch.validate import scores
from rotorid_torch.validate.free_run import Runs, free_run, windows
from rotorid_torch.validate.windows import ScoredChannels


def in_gusts(
    model: Model, dataset: Dataset, gusts: Mapping[str, tuple[Tensor, Tensor]]
) -> Iterator[tuple[str, dict[str, float]]]:
    """Flights with J of their first window: of the difference that gusts make (J_gust), and with gusts fed in (J_fed).

    gusts : time (T,), s, and air velocities (T, 3), m/s, by flight.
    """
    moving, scored = fed(model), ScoredChannels.of(model, dataset)
    calm, rough = Runs.of(model), Runs.of(moving)
    for name, (time, velocities) in gusts.items():
        flight = dataset.flights[name]
        samples = min(scores.horizon_samples(flight.dt), flight.samples)
        piece = windows(model, dataset, [(name, 0)], samples)
        at = flight.time[:samples].numpy()
        air = np.stack([np.interp(at, time.numpy(), v) for v in velocities.numpy().T], axis=-1)
        controls = torch.cat([piece.controls, torch.from_numpy(air)[None]], dim=-1)
        states, outputs = free_run(moving, replace(piece, controls=controls), rough)
        alone = model.recorded(calm(states[:, 0], piece.controls, piece.dt)[1], piece.dt)
        difference = scores.flight_J((outputs - alone)[..., scored.places], scored.scale)
        yield name, {"J_gust": float(difference[0]), "J_fed": float(scored.J(piece, outputs)[0])}
