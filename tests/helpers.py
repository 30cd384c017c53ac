"""What several tests need: shared flight data, and a small data set to break."""

import os
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


def shared(*parts: str) -> Path:
    """Path inside the shared reference data (beside the repository, or ROTORID_SHARED); skips where it is missing."""
    place = Path(os.environ.get("ROTORID_SHARED", ROOT.parent / "shared")).joinpath(*parts)
    if not place.exists():
        pytest.skip(f"shared data are not here: {'/'.join(parts)} (set ROTORID_SHARED)")
    return place


def shared_sets() -> list[str]:
    """Names of the shared data sets; empty where they are missing."""
    place = Path(os.environ.get("ROTORID_SHARED", ROOT.parent / "shared")) / "flightdata"
    return sorted(toml.parent.name for toml in place.glob("*/dataset.toml"))


def small_flight(samples: int = 400, dt: float = 0.02, seed: int = 0) -> dict[str, np.ndarray]:
    """A kinematically consistent flight: a roll doublet from 1 s on, small noise; float64 channels."""
    rng = np.random.default_rng(seed)
    time = dt * np.arange(samples)
    stick = 0.02 * ((time > 1.0) & (time <= 2.0)) - 0.02 * ((time > 2.0) & (time <= 3.0))
    p = np.convolve(stick, np.exp(-time / 0.3) * dt / 0.3)[:samples] * 10.0
    phi = np.concatenate([[0.0], np.cumsum((p[1:] + p[:-1]) / 2 * dt)])
    v = np.concatenate([[0.0], np.cumsum(9.80665 * np.sin(phi[:-1]) * dt)])
    quiet = {name: np.zeros(samples) for name in ("u", "w", "q", "r", "theta", "psi", "ax", "ay")}
    clean = {"lat": stick, "lon": stick[::-1] * 0.0, "v": v, "p": p, "phi": phi, "az": -9.80665 * np.cos(phi), **quiet}
    clean["w"] = clean["w"] + 0.0
    noisy = {name: values + 1e-3 * rng.standard_normal(samples) for name, values in clean.items()}
    return {"time": time, **noisy}


def small_arrays() -> dict[str, dict[str, np.ndarray]]:
    """Three small flights by name."""
    return {name: small_flight(seed=seed) for seed, name in enumerate(("one", "two", "three"))}


def small_toml() -> str:
    """Text of a dataset.toml for `small_arrays`."""
    return """format = 1
name = "small"
kind = "helicopter"
[vehicle]
mass = 1000.0
inertia = [[500.0, 0.0, -50.0], [0.0, 2000.0, 0.0], [-50.0, 0.0, 1800.0]]
imu = [0.1, 0.0, 0.2]
[vehicle.rotor]
blades = 4
radius = 5.0
chord = 0.3
speed = 40.0
direction = "ccw"
[controls.lat]
unit = "rad"
limits = [-0.1, 0.1]
noise = 0.001
[controls.lon]
[channels.p]
noise = 0.001
bias = "none"
[flights]
identify = ["one"]
validate = ["two"]
acid = ["three"]
[model]
reference = "hover"
"""


def small_folder(folder: Path) -> Path:
    """Lay the small data set down in a folder."""
    (folder / "flights").mkdir(parents=True)
    (folder / "dataset.toml").write_text(small_toml(), encoding="utf-8")
    for name, arrays in small_arrays().items():
        np.savez(folder / "flights" / f"{name}.npz", **arrays)
    return folder
