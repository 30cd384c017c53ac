"""Numbers that say how well a reconstruction follows what is true: shares within its own error, slow error.

Shapes: time is dimension -2 and components are dimension -1, [..., T, n]. For simulated flights; experiments and tests.
"""

from __future__ import annotations

import torch
from torch import Tensor

SLOW_HZ = 2.0
"""Flight mechanics lies below, blade motion above."""


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
