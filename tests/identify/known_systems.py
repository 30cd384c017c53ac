"""Known linear systems and their exact records, for the tests of regression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class LinearSystem:
    """dx/dt = A x + B u."""

    a: np.ndarray
    b: np.ndarray

    def row(self, state: int) -> Tensor:
        """Coefficients of one state equation, states first."""
        return torch.tensor(np.concatenate((self.a[state], self.b[state])))

    def fly(self, times: np.ndarray, seed: int, lines: int = 6) -> tuple[Tensor, Tensor]:
        """Return exact states (T, nx) from rest and controls (T, nu), sums of sines between 0.1 and 1.8 Hz."""
        rng = np.random.default_rng(seed)
        omega = 2.0 * np.pi * rng.uniform(0.1, 1.8, (self.b.shape[1], lines))
        phase = rng.uniform(0.0, 2.0 * np.pi, omega.shape)
        amplitude = 0.02 * rng.uniform(0.4, 1.0, omega.shape)
        waves = np.exp(1j * (omega * times[:, None, None] + phase)) * amplitude
        forced = np.zeros((len(times), len(self.a)), dtype=complex)
        rest = np.zeros(len(self.a), dtype=complex)
        for i, k in np.ndindex(*omega.shape):  # each sine has its own particular solution
            shape = np.linalg.solve(1j * omega[i, k] * np.eye(len(self.a)) - self.a, self.b[:, i])
            forced += waves[:, i, k, None] * shape
            rest += waves[0, i, k] * shape
        values, vectors = np.linalg.eig(self.a)
        free = np.linalg.solve(vectors, rest.real) * np.exp(values * times[:, None]) @ vectors.T
        return torch.tensor(forced.real - free.real), torch.tensor(waves.sum(-1).real)


ROLL_PITCH_YAW = LinearSystem(
    a=np.array([[-2.0, -0.4, 0.3], [0.5, -1.2, -0.2], [-0.1, 0.6, -0.5]]),
    b=np.array([[6.0, 0.5], [-0.8, 3.0], [1.0, -2.0]]),
)
NOISE = torch.tensor([0.002, 0.002, 0.002, 0.0005, 0.0005], dtype=torch.float64)
"""Per sample: rates in rad/s, controls in rad."""


def flights(system: LinearSystem, durations: Sequence[float], dt: float, seed: int = 0) -> list[Tensor]:
    """Records (T, nx + nu) of flights, states first."""
    records = []
    for number, duration in enumerate(durations):
        times = np.arange(round(duration / dt) + 1) * dt
        records.append(torch.cat(system.fly(times, seed + number), dim=-1))
    return records


def noisy(records: Sequence[Tensor], noise: Tensor, runs: int, seed: int) -> list[Tensor]:
    """Add white noise, independent for every run: (runs, T, n)."""
    generator = torch.Generator().manual_seed(seed)
    return [r + noise * torch.randn(runs, *r.shape, generator=generator, dtype=torch.float64) for r in records]
