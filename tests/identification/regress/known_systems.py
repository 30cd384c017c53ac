"""Known linear systems and their exact records, for the tests of regression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from scipy.linalg import expm
from torch import Tensor

from rotorid_torch.identification.regress.ftr import regress


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
        free = np.linalg.solve(vectors, np.real(rest)) * np.exp(values * times[:, None]) @ vectors.T
        return torch.tensor(np.real(forced - free)), torch.tensor(np.real(waves.sum(-1)))

    def follow(self, controls: np.ndarray, dt: float) -> Tensor:
        """Return exact states (T, nx) from rest under controls (T, nu) that are straight lines between samples."""
        states, inputs = self.b.shape
        block = np.zeros((states + 2 * inputs, states + 2 * inputs))
        block[:states, :states], block[:states, states : states + inputs] = self.a, self.b
        block[states : states + inputs, states + inputs :] = np.eye(inputs) / dt
        step = expm(block * dt)[:states]
        record = np.zeros((len(controls), states))
        for k, (now, after) in enumerate(pairwise(controls)):
            record[k + 1] = step @ np.concatenate((record[k], now, after - now))
        return torch.tensor(record)


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


def coverage(
    system: LinearSystem, records: Sequence[Tensor], dt: float, noise: Tensor, runs: int, given: bool, seed: int = 0
) -> Tensor:
    """Share of noisy runs whose 95 % interval holds the truth: (nx, nx + nu), one row per state equation.

    noise : standard deviation of a sample of every channel; given tells the regression about it.
    """
    inside, states = [], len(system.a)
    for start in range(0, runs, 250):
        batch = noisy(records, noise, min(250, runs - start), seed + start)
        fits = [
            regress([r[..., k] for r in batch], batch, dt, noise=noise if given else "estimated") for k in range(states)
        ]
        inside.append(
            torch.stack(
                [(f.coefficients - system.row(k)).abs() < 1.96 * f.standard_errors for k, f in enumerate(fits)], dim=-2
            )
        )
    return torch.cat(inside).to(torch.float64).mean(0)
