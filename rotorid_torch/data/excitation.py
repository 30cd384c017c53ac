"""What the controls did: which moved, how far, and how much of it was not the answer to the aircraft's own motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.quiet import running_mean

BAND_HZ = (0.2, 4.0)
"""Band in which a rotorcraft answers its controls; from 2/T where the flights are short."""


@dataclass(frozen=True)
class Excitation:
    """One control over the identify flights.

    `independent` is the share of its variance in the band that neither the aircraft's motion nor the other controls
    explain; `moved` the flights in which it moved beyond its noise; `travel` its largest excursion from trim;
    `at_limit` the largest share of a flight's samples on a declared limit, `outside` the largest distance beyond one.
    """

    control: str
    independent: float
    moved: tuple[str, ...]
    travel: float
    at_limit: float
    outside: float


def excitation(dataset: Dataset, control: str) -> Excitation:
    """Figures of one control, see `Excitation`."""
    flights = [dataset.flights[name] for name in dataset.identify]
    noise, scale = dataset.noise(control), dataset.scales()[control]
    motion = [c for c in (*names.RATES, "phi", "theta") if all(f.has(c) for f in flights)]
    others = [c for c in dataset.controls if c != control]
    width = max(1, round(0.1 / flights[0].dt))
    values = {f.name: running_mean(f.bridged([control])[:, 0].numpy(), width) for f in flights}
    trims = {f.name: values[f.name][f.lead()].mean() for f in flights}
    swing = {name: np.sqrt(np.mean((v - trims[name]) ** 2)) for name, v in values.items()}
    limits = dataset.control_specs[control].limits
    every = [f.bridged([control])[:, 0].numpy() for f in dataset.flights.values()]
    return Excitation(
        control=control,
        independent=independent_share(flights, control, [*others, *motion]),
        moved=tuple(name for name, rms in swing.items() if rms > max(4.0 * noise / np.sqrt(width), 0.25 * scale)),
        travel=float(max(np.abs(v - trims[name]).max() for name, v in values.items())),
        at_limit=max(_share_at(v, limits) for v in every) if limits else 0.0,
        outside=max(float(max(limits[0] - v.min(), v.max() - limits[1], 0.0)) for v in every) if limits else 0.0,
    )


def _share_at(values: np.ndarray, limits: tuple[float, float]) -> float:
    margin = 0.002 * (limits[1] - limits[0])
    return float(np.mean((values <= limits[0] + margin) | (values >= limits[1] - margin)))


def independent_share(flights: Sequence[Flight], control: str, regressors: Sequence[str]) -> float:
    """Share of a control's variance in the band that real multiples of the regressors leave, pooled over flights; 0…1.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, 2nd ed., ch. 9 (correlated inputs).
    """
    target, columns = [], []
    for flight in flights:
        lines = _in_band(flight, [control, *regressors])
        target.append(lines[:, 0])
        columns.append(lines[:, 1:])
    y, x = np.concatenate(target), np.concatenate(columns)
    x = x / np.maximum(np.linalg.norm(x, axis=0), np.finfo(float).tiny)
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0] if x.shape[1] else y
    return float((left @ left) / max(y @ y, np.finfo(float).tiny))


def _in_band(flight: Flight, channels: Sequence[str]) -> np.ndarray:
    """Fourier lines in the band, real above imaginary parts, of Hann-windowed channels without trend; (2 lines, n)."""
    values = flight.bridged(channels).nan_to_num(0.0).numpy()
    ramp = np.stack([np.ones(flight.samples), np.linspace(-1, 1, flight.samples)], axis=1)
    values = values - ramp @ np.linalg.lstsq(ramp, values, rcond=None)[0]
    lines = np.fft.rfft(values * np.hanning(flight.samples)[:, None], axis=0)
    hertz = np.fft.rfftfreq(flight.samples, flight.dt)
    chosen = lines[(hertz >= max(BAND_HZ[0], 2.0 / (flight.samples * flight.dt))) & (hertz <= BAND_HZ[1])]
    return np.concatenate([chosen.real, chosen.imag])
