"""How long a flight is quiet: before any control moves beyond its noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rotorid_torch.data.flight import Flight

LEAST_S = 0.5
SMOOTH_S = 0.1


def quiet_samples(flight: Flight, noise: Mapping[str, float], spread: Mapping[str, float]) -> int:
    """Samples before any control moves; at least 0.5 s.

    A control moves where it leaves its mean over the first 0.5 s by 5 standard deviations of its noise and by 5 % of
    its usual excursion, both smoothed over 0.1 s; the second leaves room for a controller that answers sensor noise.
    """
    width = max(1, round(SMOOTH_S / flight.dt))
    least = max(1, min(flight.samples, round(LEAST_S / flight.dt)))
    end = flight.samples
    for control, sigma in noise.items():
        values = flight.bridged([control])[:, 0].numpy()
        smooth = running_mean(values, width)
        bound = max(5.0 * sigma / np.sqrt(width), 0.05 * spread[control])
        moved = np.abs(smooth - values[:least].mean()) > bound
        if moved.any():
            end = min(end, int(moved.argmax()) - width // 2)
    return max(least, end)


def running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Centred mean over `width` samples, over what there is at the ends."""
    ones = np.ones(width)
    return (
        np.convolve(values, ones, "same")[: len(values)]
        / np.convolve(np.ones_like(values), ones, "same")[: len(values)]
    )
