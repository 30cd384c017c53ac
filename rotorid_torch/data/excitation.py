"""What the controls did: which moved, how far, and how much of it was not the answer to the aircraft's own motion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
    flights = [dataset.facts[name] for name in dataset.identify]
    motion = [c for c in (*names.RATES, "phi", "theta") if all(f.has(c) for f in flights)]
    others = [c for c in dataset.controls if c != control]
    limits = dataset.control_specs[control].limits
    every = [facts.spreads[control] for facts in dataset.facts.values()]
    found = moves(dataset, [control])[control]
    return Excitation(
        control=control,
        independent=independent_share((dataset.flights[n] for n in dataset.identify), control, [*others, *motion]),
        moved=found.flights,
        travel=found.travel,
        at_limit=max(_share_at(f.bridged([control])[:, 0].numpy(), limits) for f in dataset.flights.values())
        if limits
        else 0.0,
        outside=max(max(limits[0] - s.low, s.high - limits[1], 0.0) for s in every) if limits else 0.0,
    )


@dataclass(frozen=True)
class Moves:
    """Identify flights in which a control moved beyond its noise, and its largest excursion from trim in any."""

    flights: tuple[str, ...]
    travel: float


def moves(dataset: Dataset, controls: Sequence[str]) -> dict[str, Moves]:
    """What these controls did in the identify flights."""
    width = max(1, round(0.1 / dataset.facts[dataset.identify[0]].dt))
    moved: dict[str, list[str]] = {control: [] for control in controls}
    travel = dict.fromkeys(controls, 0.0)
    for flight in (dataset.flights[name] for name in dataset.identify):
        for control, values in zip(controls, flight.bridged(controls).numpy().T, strict=True):
            smooth = running_mean(values, width)
            away = smooth - smooth[flight.lead()].mean()
            least = max(4.0 * dataset.noise(control) / np.sqrt(width), 0.25 * dataset.scales()[control])
            moved[control] += [flight.name] if np.sqrt(np.mean(away**2)) > least else []
            travel[control] = max(travel[control], float(np.abs(away).max()))
    return {control: Moves(tuple(moved[control]), travel[control]) for control in controls}


def _share_at(values: np.ndarray, limits: tuple[float, float]) -> float:
    margin = 0.002 * (limits[1] - limits[0])
    return float(np.mean((values <= limits[0] + margin) | (values >= limits[1] - margin)))


def independent_share(flights: Iterable[Flight], control: str, regressors: Sequence[str]) -> float:
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
