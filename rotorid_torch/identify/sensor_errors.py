"""What sensors add that is not motion: constant biases seen through kinematics, and lines of rotor vibration."""

from __future__ import annotations

import math

import numpy as np

from rotorid_torch.core.names import RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.vibration import SPAN_HZ, lines, spectrum

Array = np.ndarray

SIGNIFICANT = 5.0
"""Standard errors beyond which a bias is believed."""
LINE_OVER_NOISE = 2.0
"""A line is modelled where its rms exceeds this share of the sensor's noise and 5 % of the channel's variance."""


def kinematic_biases(dataset: Dataset, flight: Flight) -> dict[str, float]:
    """Constant errors of gyros and accelerometers of a flight that kinematics shows beyond doubt, by channel.

    Gyros against attitude, accelerometers against velocity and attitude, both integrated; only channels whose bias is
    free. Without attitude (and velocity) a bias cannot be told from a trim and is left in it.
    """
    found: dict[str, float] = {}
    if flight.has("phi", "theta", *RATES):
        found |= _rate_biases(dataset, flight)
        if flight.has(*VELOCITIES):
            found |= _force_biases(dataset, flight)
    return found


def _rate_biases(dataset: Dataset, flight: Flight) -> dict[str, float]:
    angles = [name for name in ("phi", "theta", "psi") if flight.has(name)]
    p, q, r, phi, theta = flight.bridged(("p", "q", "r", "phi", "theta")).numpy().T
    sin, cos, zero, one = np.sin(phi), np.cos(phi), np.zeros_like(p), np.ones_like(p)
    turn = {
        "phi": (one, np.tan(theta) * sin, np.tan(theta) * cos),
        "theta": (zero, cos, -sin),
        "psi": (zero, sin / np.cos(theta), cos / np.cos(theta)),
    }
    left, right, weights = [], [], []
    for i, name in enumerate(angles):
        rates = sum(c * w for c, w in zip(turn[name], (p, q, r), strict=True))
        gap = flight.channels[name].numpy() - integral(np.asarray(rates), flight.dt)
        offset = [one if j == i else zero for j in range(len(angles))]
        columns = np.stack([*(-integral(c, flight.dt) for c in turn[name]), *offset], axis=-1)
        known = ~np.isnan(gap)
        left.append(columns[known])
        right.append(gap[known])
        weights.append(np.full(known.sum(), 1.0 / dataset.noise(name)))
    w = np.concatenate(weights)
    solution = np.linalg.lstsq(np.concatenate(left) * w[:, None], np.concatenate(right) * w, rcond=1e-8)[0]
    span = flight.dt * (flight.samples - 1)
    angle_error = max(dataset.noise(name) for name in angles) / span * math.sqrt(12.0 / flight.samples)
    return {
        name: float(value)
        for name, value in zip(RATES, solution, strict=False)
        if _believed(dataset, flight, name, float(value), angle_error)
    }


def _force_biases(dataset: Dataset, flight: Flight) -> dict[str, float]:
    known = kinematic_acceleration(dataset, flight)
    span = flight.dt * (flight.samples - 1)
    tilt = dataset.vehicle.gravity * max(dataset.noise("phi"), dataset.noise("theta")) * math.sqrt(1 / flight.samples)
    found: dict[str, float] = {}
    for i, (name, speed) in enumerate(zip(SPECIFIC_FORCES, VELOCITIES, strict=True)):
        if not flight.has(name):
            continue
        force = flight.bridged((name,)).numpy()[:, 0]
        gap = flight.channels[speed].numpy() - integral(force + known[:, i], flight.dt)
        there = ~np.isnan(gap)
        slope = float(np.polyfit(flight.time.numpy()[there], gap[there], 1)[0])
        speed_error = dataset.noise(speed) / span * math.sqrt(12.0 / flight.samples)
        if _believed(dataset, flight, name, -slope, math.hypot(tilt, speed_error)):
            found[name] = -slope
    return found


def _believed(dataset: Dataset, flight: Flight, name: str, value: float, reference_error: float) -> bool:
    error = math.hypot(dataset.noise(name) / math.sqrt(flight.samples), reference_error)
    return dataset.bias(name) == "free" and abs(value) > SIGNIFICANT * error


def kinematic_acceleration(dataset: Dataset, flight: Flight) -> Array:
    """d(u, v, w)/dt less specific force, m/s2 (T, 3), from measured attitude, rates and velocity."""
    u, v, w, p, q, r, phi, theta = flight.bridged((*VELOCITIES, *RATES, "phi", "theta")).numpy().T
    g = dataset.vehicle.gravity
    return np.stack(
        [
            r * v - q * w - g * np.sin(theta),
            p * w - r * u + g * np.cos(theta) * np.sin(phi),
            q * u - p * v + g * np.cos(theta) * np.cos(phi),
        ],
        axis=-1,
    )


def integral(rate: Array, dt: float) -> Array:
    """Integral over time by the trapezoidal rule, zero at the first sample."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * dt


def vibration_lines(dataset: Dataset, channels: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Strongest vibration line (Hz, rms) of each of these channels that has one worth a state, over identify flights.

    Only lines well below the Nyquist frequency; flights of other sample rates than the first are left out.
    """
    flights = [dataset.flights[name] for name in dataset.identify]
    dt, found = flights[0].dt, {}
    for channel in channels:
        records = [f.channels[channel].numpy() for f in flights if f.has(channel) and abs(f.dt / dt - 1.0) < 1e-2]
        if not records:
            continue
        for line in lines(*spectrum(records, dt), largest=1):
            strong = line.rms > LINE_OVER_NOISE * dataset.noise(channel) and line.share > 0.05
            if strong and line.hertz < 0.45 / dt:
                found[channel] = (line.hertz, line.rms)
    return found


def without_line(record: Array, dt: float, hertz: float) -> Array:
    """The record (T,) with the spectrum around a line lowered to the level beside it; NaN stays NaN."""
    known = ~np.isnan(record)
    if not known.any():
        return record
    filled = np.interp(np.arange(len(record)), np.flatnonzero(known), record[known])
    ramp = np.linspace(filled[0], filled[-1], len(filled))
    parts = np.fft.rfft(filled - ramp)
    away = np.abs(np.fft.rfftfreq(len(filled), dt) - hertz)
    line, beside = away < SPAN_HZ, (away >= SPAN_HZ) & (away < 2.0 * SPAN_HZ)
    if not beside.any():
        return record
    level = np.median(np.abs(parts[beside]))
    parts[line] *= np.minimum(1.0, level / np.maximum(np.abs(parts[line]), 1e-300))
    return np.where(known, np.fft.irfft(parts, len(filled)) + ramp, np.nan)
