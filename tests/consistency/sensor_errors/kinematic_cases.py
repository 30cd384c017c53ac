"""Exact kinematics for tests: body rates and specific forces as sums of sines, integrated finely; sensors that err."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter, lsim

from rotorid_torch.data.dataset import Dataset

GRAVITY = 9.81
UNITS = {
    "velocities": ("u", "v", "w"),
    "attitude": ("phi", "theta", "psi"),
    "rates": ("p", "q", "r"),
    "accelerations": ("ax", "ay", "az"),
}
NOISE = {
    **dict.fromkeys(("u", "v", "w", "ax", "ay", "az"), 0.05),
    **dict.fromkeys(("p", "q", "r", "phi", "theta", "psi"), 0.002),
    "height": 0.2,
}
FINE = 8


def _sines(rng: np.random.Generator, size: float, fastest: float):
    """A sum of six sines of about this rms and its derivative, as functions of time."""
    hertz = np.exp(rng.uniform(np.log(0.08), np.log(fastest), 6))
    phase, amplitude = rng.uniform(0, 2 * np.pi, 6), size * rng.uniform(0.5, 1.5, 6) / np.sqrt(3.0)
    # angles and speeds are integrals: slow sines stay as small in them as fast ones
    amplitude *= np.minimum(1.0, hertz / 0.3)
    omega = 2 * np.pi * hertz
    return (
        lambda t: np.sin(np.multiply.outer(t, omega) + phase) @ amplitude,
        lambda t: np.cos(np.multiply.outer(t, omega) + phase) @ (amplitude * omega),
    )


def _rates(x: np.ndarray, omega: np.ndarray, force: np.ndarray) -> np.ndarray:
    u, v, w, phi, theta, psi = x[:6]
    p, q, r = omega
    across = q * np.sin(phi) + r * np.cos(phi)
    fall = GRAVITY * np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    level = u * np.cos(theta) + (v * np.sin(phi) + w * np.cos(phi)) * np.sin(theta)
    side = v * np.cos(phi) - w * np.sin(phi)
    climb = u * np.sin(theta) - (v * np.sin(phi) + w * np.cos(phi)) * np.cos(theta)
    moved = force + fall - np.cross(omega, x[:3], axis=0)
    turned = [p + np.tan(theta) * across, q * np.cos(phi) - r * np.sin(phi), across / np.cos(theta)]
    path = [level * np.cos(psi) - side * np.sin(psi), level * np.sin(psi) + side * np.cos(psi), climb]
    return np.array([*moved, *turned, *path])


def motion(seed: int, flights: int, seconds: float = 15.0, dt: float = 1 / 100, speed: float = 0.0) -> list[dict]:
    """True channels of several flights on a grid FINE times denser, 0.5 s longer at both ends."""
    rng = np.random.default_rng(seed)
    rates = [[_sines(rng, size, 1.5) for size in (0.12, 0.06, 0.08)] for _ in range(flights)]
    forces = [[_sines(rng, size, 1.0) for size in (0.3, 0.3, 0.8)] for _ in range(flights)]
    step = dt / 2
    count = round((seconds + 1.0) / step) + 1
    half = 0.5 * step * np.arange(2 * count) - 0.5
    down = np.array([0.0, 0.0, -GRAVITY])[:, None, None]
    omega = np.array([[f(half) for f, _ in flight] for flight in rates]).transpose(1, 0, 2)
    force = np.array([[f(half) for f, _ in flight] for flight in forces]).transpose(1, 0, 2) + down
    x = np.repeat(np.array([speed, 0.0, 0.0, 0.0, 0.02, 0.3, 0.0, 0.0, 30.0])[:, None], flights, axis=1)
    states = np.empty((count, 9, flights))
    for i in range(count):
        states[i] = x
        a, m, b = 2 * i, 2 * i + 1, min(2 * i + 2, 2 * count - 1)
        k1 = _rates(x, omega[..., a], force[..., a])
        k2 = _rates(x + 0.5 * step * k1, omega[..., m], force[..., m])
        k3 = _rates(x + 0.5 * step * k2, omega[..., m], force[..., m])
        k4 = _rates(x + step * k3, omega[..., b], force[..., b])
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    coarse = half[::2]
    time = np.arange(round((seconds + 1.0) * FINE / dt) + 1) * dt / FINE - 0.5
    names = ("u", "v", "w", "phi", "theta", "psi", "north", "east", "height")
    return [
        {
            "time": time,
            **dict(zip(names, CubicSpline(coarse, states[:, :, k])(time).T, strict=True)),
            **{name: f(time) for name, (f, _) in zip("pqr", rates[k], strict=True)},
            **{f"{name}dot": d(time) for name, (_, d) in zip("pqr", rates[k], strict=True)},
            "force": np.array([f(time) for f, _ in forces[k]]).T + down[:, 0, 0],
        }
        for k in range(flights)
    ]


def read(truth: Mapping, errors: Mapping[str, float], seed: int, dt: float = 1 / 100, noise: float = 1.0) -> dict:
    """What sensors with these errors ("delay.attitude", "scale.q", "lever_arm.x", ...) read, with white noise."""
    time, step = truth["time"], truth["time"][1] - truth["time"][0]
    arm = np.array([errors.get(f"lever_arm.{a}", 0.0) for a in "xyz"])
    omega = np.stack([truth[c] for c in "pqr"], axis=-1)
    turning = np.stack([truth[f"{c}dot"] for c in "pqr"], axis=-1)
    felt = truth["force"] + np.cross(turning, arm) + np.cross(omega, np.cross(omega, arm))
    e = np.array([errors.get(f"misalignment.{a}", 0.0) for a in "xyz"])
    angle = np.linalg.norm(e)
    skew = np.array([[0, -e[2], e[1]], [e[2], 0, -e[0]], [-e[1], e[0], 0]])
    turned = (
        np.eye(3)
        if angle == 0
        else (np.eye(3) + np.sin(angle) / angle * skew + (1 - np.cos(angle)) / angle**2 * skew @ skew)
    )
    exact = {c: truth[c] for c in ("u", "v", "w", "phi", "theta", "psi", "height")}
    # R(e)' times the vector
    exact |= dict(zip("pqr", (omega @ turned).T, strict=True))
    exact |= dict(zip(("ax", "ay", "az"), (felt @ turned).T, strict=True))
    grid = np.arange(0.0, time[-1] - 0.5 + 1e-9, dt)
    rng = np.random.default_rng(seed)
    out = {"time": grid}
    for channel, values in exact.items():
        unit = next((u for u, members in UNITS.items() if channel in members), "")
        values = (1 + errors.get(f"scale.{channel}", 0.0)) * values + errors.get(f"bias.{channel}", 0.0)
        lag, delay = errors.get(f"filter.{unit}", 0.0), errors.get(f"delay.{unit}", 0.0)
        if lag:
            keep = np.exp(-step / lag)
            # exact for an input that is a straight line between samples
            b1 = lag / step * (1 - keep) - keep
            b0 = 1 - lag / step * (1 - keep)
            values = lfilter([b0, b1], [1.0, -keep], values, zi=[values[0] * (1 - b0)])[0]
        if period := errors.get(f"filter.{unit}_period", 0.0):
            system = ([1.0], [period**2, 2.0 * errors.get(f"filter.{unit}_damping", 0.7) * period, 1.0])
            values = values[0] + lsim(system, values - values[0], time - time[0])[1]
        out[channel] = CubicSpline(time, values)(grid - delay)
        out[channel] = out[channel] + noise * NOISE[channel] * rng.standard_normal(len(grid))
        if window := errors.get(f"filter.{unit}_smoothing", 0.0):  # after the flight: noise and all
            out[channel] = gaussian_filter1d(out[channel], window**0.5 / dt)
    return out


MOTIONS: dict = {}


def data(
    errors: Mapping[str, float],
    seed: int,
    flights: int = 6,
    seconds: float = 15.0,
    dt: float = 1 / 100,
    noise: float = 1.0,
    channels: Mapping | None = None,
    speed: float = 0.0,
    keep=None,
    motions: int = 0,
) -> Dataset:
    """A data set of such flights; the same motion for the same `motions`, other noise for another seed."""
    made = {}
    key = (motions, flights, seconds, dt, speed)
    if key not in MOTIONS:
        MOTIONS[key] = motion(motions, flights, seconds, dt, speed)
    for k in range(flights):
        made[f"f{k}"] = read(MOTIONS[key][k], errors, 7919 * seed + k, dt, noise)
        if keep is not None:
            made[f"f{k}"] = {c: made[f"f{k}"][c] for c in ("time", *keep)}
        made[f"f{k}"]["lat"] = 0.1 * np.sin(made[f"f{k}"]["time"])
    specs = {c: {"noise": s * max(noise, 1e-6)} for c, s in NOISE.items() if keep is None or c in keep}
    for channel, spec in (channels or {}).items():
        specs[channel] = {**specs.get(channel, {}), **spec}
    return Dataset.from_arrays(
        made,
        identify=list(made),
        vehicle={"gravity": GRAVITY, "imu": [0.0, 0.0, 0.0]},
        controls={"lat": {"unit": "rad"}},
        channels=specs,
    )
