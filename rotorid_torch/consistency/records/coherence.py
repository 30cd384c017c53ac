"""In which band a response follows the controls linearly: its multiple coherence with all of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from rotorid_torch.consistency.sensor_pairs import minutes
from rotorid_torch.core import names
from rotorid_torch.core.rigid import velocity_rates
from rotorid_torch.core.statistics import stretches, without_line
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

USABLE = 0.6
"""Coherence from which on a response belongs to the controls (Tischler and Remple, ch. 7)."""
RANGE_HZ = (0.05, 40.0)
STEP = 1.4
"""Ratio of a band's edges, within which the responses are taken for constant; wider where there are too few lines."""
ENOUGH = 3.0
"""Independent lines of a band for each control."""
HANN = 1.5
"""Neighbouring lines under a Hann window are so many for one independent one."""


@dataclass(frozen=True)
class Coherence:
    """Multiple coherence (bands,) of a channel with all controls.

    `edges` (bands + 1,) in Hz; `band` is the longest stretch in which it is `USABLE`, None where there is none.
    """

    channel: str
    edges: np.ndarray
    values: np.ndarray
    band: tuple[float, float] | None


def coherences(dataset: Dataset, channels: Sequence[str]) -> tuple[Coherence, ...]:
    """Coherence of channels with all controls over the identify flights, corrected for the number of lines.

    Source: Bendat and Piersol, Random Data, 4th ed., ch. 7 and 9; Tischler and Remple, Aircraft and Rotorcraft System
    Identification, 2nd ed., ch. 7 and 9.
    """
    flights = [dataset.flights[name] for name in dataset.identify]
    recorded = [c for c in channels if all(dataset.facts[name].has(c) for name in dataset.identify)]
    if not recorded:
        return ()
    lines = [_lines(f, dataset.controls, recorded, dataset.vehicle.gravity) for f in flights]
    hertz, values = (np.concatenate(both) for both in zip(*lines, strict=True))
    m = len(dataset.controls)
    edges = _edges(hertz, int(np.ceil(ENOUGH * HANN * m)))
    power = [
        _explained(values[(hertz >= a) & (hertz < b), :m], values[(hertz >= a) & (hertz < b), m:])
        for a, b in pairwise(edges)
    ]
    columns = np.array(power).reshape(-1, len(recorded)).T
    return tuple(Coherence(c, edges, column, _band(column, edges)) for c, column in zip(recorded, columns, strict=True))


def _edges(hertz: np.ndarray, least: int) -> np.ndarray:
    """Edges of bands by `STEP`, each with at least so many of these lines."""
    lines = np.sort(hertz)
    edges, at = [float(lines[0])], 0
    while at + least < len(lines):
        after = int(np.searchsorted(lines, STEP * edges[-1]))
        at = max(at + least, after)
        if at >= len(lines):
            break
        edges.append(float(lines[at]))
    return np.array([*edges[: max(1, len(edges) - 1)], float(lines[-1]) * (1.0 + 1e-9)])


def _responses(flight: Flight, channels: Sequence[str], gravity: float) -> np.ndarray:
    """Channels (T, n); w without an accelerometer as what pushes: its rate without gravity and rotation.

    A tilted aircraft sinks and slides, and no thrust makes it.
    """
    values = flight.bridged(channels).nan_to_num(0.0).numpy()
    moved = (*names.VELOCITIES, *names.RATES, *names.ATTITUDES[:2])
    if "w" in channels and flight.has(*moved) and "az" not in channels:
        velocity, rates, attitude = (flight.bridged(c) for c in (moved[:3], moved[3:6], moved[6:]))
        falling = velocity_rates(velocity, rates, attitude, torch.zeros_like(rates), gravity)[:, 2].numpy()
        column = list(channels).index("w")
        values[:, column] = np.gradient(values[:, column], flight.dt) - falling
    return values


def _lines(
    flight: Flight, controls: Sequence[str], channels: Sequence[str], gravity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) and Fourier lines (n, controls, channels) of a flight's pieces, Hann-windowed, without trend."""
    asked = flight.bridged(controls).nan_to_num(0.0).numpy()
    values = np.concatenate([asked, _responses(flight, channels, gravity)], axis=1)
    transforms, places = [], []
    for first, last in minutes(flight.samples, flight.dt, 0):
        part = without_line(values[first:last])
        hertz = np.fft.rfftfreq(len(part), flight.dt)
        keep = (hertz >= max(RANGE_HZ[0], 1.5 / (len(part) * flight.dt))) & (hertz < min(RANGE_HZ[1], 0.45 / flight.dt))
        transforms.append(np.fft.rfft(part * np.hanning(len(part))[:, None], axis=0)[keep])
        places.append(hertz[keep])
    return np.concatenate(places), np.concatenate(transforms)


def _explained(controls: np.ndarray, responses: np.ndarray) -> np.ndarray:
    """Share (channels,) of the responses' power that complex multiples of the controls explain."""
    free = len(controls) / HANN - controls.shape[1]
    scale = np.maximum(np.linalg.norm(controls, axis=0), np.finfo(float).tiny)
    left = responses - controls @ (np.linalg.lstsq(controls / scale, responses, rcond=1e-8)[0] / scale[:, None])
    power = (np.abs(responses) ** 2).sum(axis=0)
    power = np.where(power > 0.0, power, np.nan)
    return np.clip(1.0 - (np.abs(left) ** 2).sum(axis=0) / power * (free + controls.shape[1]) / free, 0.0, 1.0)


def _band(values: np.ndarray, edges_hz: np.ndarray) -> tuple[float, float] | None:
    """Longest stretch of bands above `USABLE`; a single band below it, amid, is bridged."""
    good = values >= USABLE
    bridged = good.copy()
    bridged[1:-1] |= good[:-2] & good[2:]
    runs = stretches(bridged)
    if not runs:
        return None
    first, last = max(runs, key=lambda run: run[1] - run[0])
    return float(edges_hz[first]), float(edges_hz[last])
