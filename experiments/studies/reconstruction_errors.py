"""Numbers that say how well a reconstruction follows what is true: shares within its own error, slow error.

Shapes: time is dimension -2 and components are dimension -1, [..., T, n]. For simulated flights.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

SLOW_HZ = 2.0
"""Flight mechanics lies below, blade motion above."""
WINDOWS_S = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Lengths over which a spectrum is taken as constant."""


def share_within(error: Tensor, sd: Tensor, sigmas: float) -> Tensor:
    """Share of samples whose error is within so many of its standard deviations: [..., T, n] -> [..., n]."""
    return (error.abs() < sigmas * sd).double().mean(dim=-2)


def slow_error(error: Tensor, signal: Tensor, dt: float, hertz: float = SLOW_HZ) -> Tensor:
    """Root mean square of the error below a frequency over that of the signal's deviation from its mean: [..., n].

    `error` [..., T, n] and `signal` [..., S, n] without gaps; `dt` in s. The signal may be longer: several flights.
    """
    deviation = signal - signal.mean(dim=-2, keepdim=True)
    slow = below(error, dt, hertz)
    return (slow.square().mean(dim=-2) / deviation.square().mean(dim=-2)).sqrt()


def below(signal: Tensor, dt: float, hertz: float) -> Tensor:
    """What a signal [..., T, n] holds below a frequency; mirrored at its end, so that its ends do not leak."""
    mirrored = torch.cat([signal, signal.flip(-2)], dim=-2)
    samples = mirrored.shape[-2]
    spectrum = torch.fft.rfft(mirrored, dim=-2)
    slow = torch.fft.rfftfreq(samples, dt, dtype=signal.dtype, device=signal.device) <= hertz
    return torch.fft.irfft(spectrum * slow[:, None], n=samples, dim=-2)[..., : signal.shape[-2], :]


def least_slow_error(signal: Tensor, noise: Callable[[Tensor], Tensor], dt: float, hertz: float = SLOW_HZ) -> Tensor:
    """`slow_error` that a linear smoother of each component makes on average, knowing its true spectrum: [..., n].

    Window by window each coefficient of a local cosine transform is shrunk by S / (S + N) with its own true square S;
    the best of several window lengths. No smoother knows as much, so this flatters; only what is known beforehand about
    how components hang together, or follow from controls, can do better.

    signal : [..., T, n] the truth. noise : variance [m, n] of the measurements' error at frequencies [m] in Hz, as the
        variance per sample of white noise with that density; infinite where nothing is measured. dt : s.

    Source: Malvar, IEEE Trans. ASSP 38 (1990), the transform; Donoho and Johnstone, Biometrika 81 (1994), ideal use.
    """
    deviation = signal - signal.mean(dim=-2, keepdim=True)
    errors = []
    for window in WINDOWS_S:
        length = min(round(window / dt), signal.shape[-2])
        square = _local_cosines(deviation, length).square()
        frequency = (torch.arange(length, dtype=signal.dtype) + 0.5) / (2.0 * length * dt)
        left = (square / (1.0 + square / noise(frequency)))[..., frequency <= hertz, :]
        errors.append(left.sum(dim=(-3, -2)) / signal.shape[-2])
    return (torch.stack(errors).amin(dim=0) / deviation.square().mean(dim=-2)).sqrt()


def _local_cosines(signal: Tensor, length: int) -> Tensor:
    """Orthonormal lapped cosine transform, [..., T, n] -> [..., windows, length, n]; mirrored at the ends."""
    windows = math.ceil(signal.shape[-2] / length)
    beyond = windows * length - signal.shape[-2]
    before, after = signal[..., :length, :].flip(-2), torch.cat([signal.flip(-2), signal], dim=-2)
    padded = torch.cat([before, signal, after[..., : length + beyond, :]], dim=-2).unfold(-2, 2 * length, length)
    place = torch.arange(2 * length, dtype=signal.dtype)
    order = torch.arange(length, dtype=signal.dtype)
    bell = (math.pi * (place + 0.5) / (2 * length)).sin() * math.sqrt(2.0 / length)
    table = (math.pi / length * (place[:, None] + 0.5 + length / 2) * (order + 0.5)).cos() * bell[:, None]
    return (padded @ table).mT
