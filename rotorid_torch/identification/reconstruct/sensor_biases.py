"""What sensors add that is not motion: constant biases seen through kinematics, and lines of rotor vibration."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch

from rotorid_torch.consistency.records.vibration import SPAN_HZ, lines, spectrum
from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, POSITIONS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.identification.reconstruct.gauss_markov import smear

Array = np.ndarray

WANDER_S = 0.25
"""Time over which a channel is compared with the integral of its rate."""
TOLERATED = 1.5
"""Ratio of seen to expected variance up to which the sensors' noise explains the difference."""
SIGNIFICANT = 5.0
"""Standard errors beyond which a bias is believed."""
LINE_OVER_NOISE = 2.0
"""A line is modelled where its rms exceeds this share of the sensor's noise and 5 % of the channel's variance."""


TURNS = (*RATES, "phi", "theta")
"""Channels by which angles turn."""


def kinematic_biases(dataset: Dataset, flight: Flight) -> dict[str, float]:
    """Constant errors of gyros and accelerometers of a flight that kinematics shows beyond doubt, by channel.

    Gyros against attitude, accelerometers against velocity and attitude, both integrated between gaps; only channels
    whose bias is free. Without attitude (and velocity) a bias cannot be told from a trim and is left in it.
    """
    biases: dict[str, float] = {}
    if flight.has("phi", "theta", *RATES):
        biases |= _rate_biases(dataset, flight)
        if flight.has(*VELOCITIES) and not dataset.dead_reckoned:
            biases |= _force_biases(dataset, flight, biases)
    return biases


def _rate_biases(dataset: Dataset, flight: Flight) -> dict[str, float]:
    angles = [name for name in ("phi", "theta", "psi") if flight.has(name)]
    p, q, r, phi, theta = flight.bridged(("p", "q", "r", "phi", "theta")).numpy().T
    sin, cos, zero, one = np.sin(phi), np.cos(phi), np.zeros_like(p), np.ones_like(p)
    turn = {
        "phi": (one, np.tan(theta) * sin, np.tan(theta) * cos),
        "theta": (zero, cos, -sin),
        "psi": (zero, sin / np.cos(theta), cos / np.cos(theta)),
    }
    stretch = flight.stretches(TURNS).numpy()
    numbers = np.unique(stretch[stretch >= 0])
    if not len(numbers):
        return {}
    left, right, weights = [], [], []
    for i, name in enumerate(angles):
        rates = sum(c * w for c, w in zip(turn[name], (p, q, r), strict=True))
        gap = flight.channels[name].numpy() - integral(np.asarray(rates), flight.dt)
        offset = [(stretch == number) * (one if j == i else zero) for j in range(len(angles)) for number in numbers]
        columns = np.stack([*(-integral(c, flight.dt) for c in turn[name]), *offset], axis=-1)
        measured = ~np.isnan(gap) & (stretch >= 0)
        left.append(columns[measured])
        right.append(gap[measured])
        weights.append(np.full(measured.sum(), 1.0 / dataset.noise(name)))
    w = np.concatenate(weights)
    solution = np.linalg.lstsq(np.concatenate(left) * w[:, None], np.concatenate(right) * w, rcond=1e-8)[0]
    angle_error = max(dataset.noise(name) for name in angles) * _per_slope(stretch, flight.dt)
    biases = {name: float(value) for name, value in zip(RATES, solution, strict=False)}
    return {n: value for n, value in biases.items() if _believed(dataset, flight, n, value, angle_error)}


def _force_biases(dataset: Dataset, flight: Flight, rate_biases: Mapping[str, float]) -> dict[str, float]:
    acceleration = kinematic_acceleration(dataset, flight, rate_biases) - lever_arm(dataset, flight)
    tilt = dataset.vehicle.gravity * max(dataset.noise("phi"), dataset.noise("theta")) * math.sqrt(1 / flight.samples)
    biases: dict[str, float] = {}
    for i, (name, speed) in enumerate(zip(SPECIFIC_FORCES, VELOCITIES, strict=True)):
        if not flight.has(name):
            continue
        force = flight.bridged((name,)).numpy()[:, 0]
        gap = flight.channels[speed].numpy() - integral(force + acceleration[:, i], flight.dt)
        stretch = np.where(np.isnan(gap), -1, flight.stretches((*VELOCITIES, *TURNS, name)).numpy())
        if not (stretch >= 0).any():
            continue
        slope = _slope(flight.time.numpy(), gap, stretch)
        speed_error = dataset.noise(speed) * _per_slope(stretch, flight.dt)
        if _believed(dataset, flight, name, -slope, math.hypot(tilt, speed_error)):
            biases[name] = -slope
    return biases


def _slope(time: Array, values: Array, stretch: Array) -> float:
    """Slope of values (T,) over time by least squares, with a level of its own in each stretch."""
    numbers = np.unique(stretch[stretch >= 0])
    parts = [np.stack([time, values])[:, stretch == number] for number in numbers]
    times, levels = np.concatenate([part - part.mean(axis=1, keepdims=True) for part in parts], axis=1)
    return float(times @ levels / max(times @ times, 1e-300))


def _per_slope(stretch: Array, dt: float) -> float:
    """Standard error, 1/s, of such a slope where values have white noise of one: 1/sqrt(sum of n T^2/12)."""
    samples = np.unique(stretch[stretch >= 0], return_counts=True)[1]
    return 1.0 / math.sqrt(max(float((samples * (dt * (samples - 1)) ** 2).sum()) / 12.0, 1e-300))


def _believed(dataset: Dataset, flight: Flight, name: str, value: float, reference_error: float) -> bool:
    error = math.hypot(dataset.noise(name) / math.sqrt(flight.samples), reference_error)
    return dataset.bias(name) == "free" and abs(value) > SIGNIFICANT * error


def kinematic_acceleration(dataset: Dataset, flight: Flight, bias: Mapping[str, float]) -> Array:
    """d(u, v, w)/dt less specific force, m/s2 (T, 3), from attitude, velocity and rates less their bias."""
    u, v, w, p, q, r, phi, theta = flight.bridged((*VELOCITIES, *RATES, "phi", "theta")).numpy().T
    p, q, r = (rate - bias.get(name, 0.0) for rate, name in zip((p, q, r), RATES, strict=True))
    g = dataset.vehicle.gravity
    along = r * v - q * w - g * np.sin(theta)
    right = p * w - r * u + g * np.cos(theta) * np.sin(phi)
    down = q * u - p * v + g * np.cos(theta) * np.cos(phi)
    return np.stack([along, right, down], axis=-1)


def lever_arm(dataset: Dataset, flight: Flight) -> Array:
    """Specific force (T, 3) that an IMU away from the centre of gravity feels by rotation, from smoothed gyros."""
    imu = dataset.vehicle.imu
    if imu is None or not any(imu) or not flight.has(*RATES):
        return np.zeros((flight.samples, 3))
    omega = smear(flight.bridged(RATES).numpy() + 1e3, flight.dt, 0.03) - 1e3
    arm = np.array(imu)
    return np.cross(np.gradient(omega, flight.dt, axis=0), arm) + np.cross(omega, np.cross(omega, arm))


def integral(rate: Array, dt: float) -> Array:
    """Integral over time by the trapezoidal rule, zero at the first sample."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * dt


def kinematic_disagreement(
    dataset: Dataset, names: Sequence[str], biases: Mapping[str, Mapping[str, float]]
) -> dict[str, float]:
    """Power, unit squared per s, by which attitude, velocity and position wander from their own rates, by channel.

    Clocks that differ, filters and scale errors inside a sensor make measured angles something else than the integral
    of measured rates. What changes within a quarter of a second beyond the sensors' noise is taken as a random walk,
    pooled over the named flights; nothing where the noise explains it.
    """
    excess: dict[str, list[tuple[float, float]]] = {}
    for flight in (dataset.flights[name] for name in names):
        stretch = flight.stretches([n for n in (*TURNS, *VELOCITIES, *SPECIFIC_FORCES) if flight.has(n)]).numpy()
        for name, (value, rate, rate_noise) in _paths(dataset, flight, biases[flight.name]).items():
            lag = max(1, round(WANDER_S / flight.dt))
            gap = value - integral(rate, flight.dt)
            change = gap[lag:] - gap[:-lag]
            change = change[~np.isnan(change) & (stretch[lag:] == stretch[:-lag]) & (stretch[lag:] >= 0)]
            if change.size > lag:
                expected = 2.0 * dataset.noise(name) ** 2 + rate_noise**2 * flight.dt * WANDER_S
                excess.setdefault(name, []).append((float(change.var()), expected))
    power = {name: np.mean(pairs, axis=0) for name, pairs in excess.items()}
    return {
        n: float(measured - expected) / WANDER_S
        for n, (measured, expected) in power.items()
        if measured > TOLERATED * expected
    }


def _paths(dataset: Dataset, flight: Flight, bias: Mapping[str, float]) -> dict[str, tuple[Array, Array, float]]:
    """Channels with the rate that kinematics gives them from other channels, and that rate's noise."""
    paths: dict[str, tuple[Array, Array, float]] = {}
    if not flight.has("phi", "theta", *RATES):
        return paths
    offset = torch.tensor([bias.get(name, 0.0) for name in RATES], dtype=torch.float64)
    rates, attitude = flight.bridged(RATES) - offset, flight.bridged(ATTITUDES if flight.has("psi") else ATTITUDES[:2])
    turning = rigid.euler_rates(rates, attitude).numpy()
    for i, name in enumerate(ATTITUDES[: attitude.shape[-1]]):
        paths[name] = (flight.channels[name].numpy(), turning[:, i], max(dataset.noise(rate) for rate in RATES))
    if not flight.has(*VELOCITIES):
        return paths
    velocity, speed = flight.bridged(VELOCITIES), max(dataset.noise(name) for name in VELOCITIES)
    if "psi" in paths:
        moving = rigid.position_rates(velocity, attitude).numpy()
        for i, name in enumerate(POSITIONS):
            if flight.has(name):
                paths[name] = (flight.channels[name].numpy(), moving[:, i], speed)
    acceleration, lever = kinematic_acceleration(dataset, flight, bias), lever_arm(dataset, flight)
    tilt = dataset.vehicle.gravity * max(dataset.noise("phi"), dataset.noise("theta"))
    for i, (name, force) in enumerate(zip(VELOCITIES, SPECIFIC_FORCES, strict=True)):
        if flight.has(force):
            pushed = flight.bridged((force,)).numpy()[:, 0] - bias.get(force, 0.0) - lever[:, i]
            noise = math.hypot(dataset.noise(force), tilt)
            paths[name] = flight.channels[name].numpy(), pushed + acceleration[:, i], noise
    return paths


def vibration_lines(
    dataset: Dataset, names: Sequence[str], channels: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    """Strongest vibration line (Hz, rms) of each of these channels that has one worth a state, over the named flights.

    Only lines well below the Nyquist frequency; flights of other sample rates than the first are left out.
    """
    flights = [dataset.flights[name] for name in names]
    dt, line_of = flights[0].dt, {}
    for channel in channels:
        records = [f.channels[channel].numpy() for f in flights if f.has(channel) and abs(f.dt / dt - 1.0) < 1e-2]
        if not records:
            continue
        for line in lines(*spectrum(records, dt), largest=1):
            strong = line.rms > LINE_OVER_NOISE * dataset.noise(channel) and line.share > 0.05
            if strong and line.hertz < 0.45 / dt:
                line_of[channel] = (line.hertz, line.rms)
    return line_of


def without_line(record: Array, dt: float, hertz: float) -> Array:
    """The record (T,) with the spectrum around a line lowered to the level beside it; NaN stays NaN."""
    measured = ~np.isnan(record)
    if not measured.any():
        return record
    filled = np.interp(np.arange(len(record)), np.flatnonzero(measured), record[measured])
    ramp = np.linspace(filled[0], filled[-1], len(filled))
    parts = np.fft.rfft(filled - ramp)
    away = np.abs(np.fft.rfftfreq(len(filled), dt) - hertz)
    line, neighbours = away < SPAN_HZ, (away >= SPAN_HZ) & (away < 2.0 * SPAN_HZ)
    if not neighbours.any():
        return record
    level = np.median(np.abs(parts[neighbours]))
    parts[line] *= np.minimum(1.0, level / np.maximum(np.abs(parts[line]), 1e-300))
    return np.where(measured, np.fft.irfft(parts, len(filled)) + ramp, np.nan)
