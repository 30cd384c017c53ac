"""Flights of a linear helicopter in turbulence, whose gusts are known."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core.names import STICKS
from rotorid_torch.data import Dataset
from rotorid_torch.model.gusts import DRIFT, fed
from tests.known_models import flown, linear_vehicle, manoeuvres

DT = 0.04
INTENSITY, LENGTH = 1.0, 60.0


def gust(samples: int, rng: np.random.Generator) -> np.ndarray:
    """Gusts [T, 3] of first order, stationary from the start."""
    decay = np.exp(-DT * DRIFT / LENGTH)
    g = np.zeros((samples, 3))
    g[0] = INTENSITY * rng.standard_normal(3)
    for k in range(1, samples):
        g[k] = decay * g[k - 1] + INTENSITY * np.sqrt(1.0 - decay**2) * rng.standard_normal(3)
    return g


def turbulent(seed: int = 1) -> tuple[Dataset, Tensor]:
    """Flights of a linear helicopter in turbulence, and its gusts [F, T, 3]."""
    rng = np.random.default_rng(seed)
    sticks = manoeuvres(20.0, DT) | {f"{n}_again": 0.7 * c for n, c in manoeuvres(20.0, DT).items()}
    gusts = np.stack([gust(len(c), rng) for c in sticks.values()])
    gusts -= gusts.mean(axis=(0, 1))  # what flights have in common is no gust
    moved = {n: np.concatenate([c, g], axis=1) for (n, c), g in zip(sticks.items(), gusts, strict=True)}
    sticks_declared = {c: {"unit": "rad", "noise": 1e-7} for c in STICKS}  # nothing says what the gusts' channels are
    data = flown(fed(linear_vehicle()), moved, DT, noise=0.01, seed=seed, controls=sticks_declared)
    return data, torch.tensor(gusts)
