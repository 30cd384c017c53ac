"""Moving air: a steady wind, and gusts with Dryden's spectra."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rotorid_torch.simulation.rigid import Array

FOOT = 0.3048  # m
DRIFT = 5.0  # m/s: eddies pass a hovering aircraft with at least this speed
SETTLING = 5.0  # run-up of the shaping filters, in their own time constants


@dataclass(frozen=True)
class Turbulence:
    """`sigma`: standard deviation of each of the three gust components, m/s."""

    sigma: float


def scale_lengths(height: float) -> tuple[float, float, float]:
    """Dryden's scale lengths of u v w near the ground, m.

    Source: MIL-F-8785C, section 3.7.3 (low altitude, 10 to 1000 ft).
    """
    feet = float(np.clip(height / FOOT, 10.0, 1000.0))
    along = feet / (0.177 + 0.000823 * feet) ** 1.2
    return along * FOOT, along * FOOT, feet * FOOT


class Air(NamedTuple):
    """Gusts of u v w: standard deviations, m/s, scale lengths, m, and the speed with which they pass, m/s."""

    intensity: tuple[float, float, float]
    length: tuple[float, float, float]
    speed: float


class Passage(NamedTuple):
    """How a flight passes through the air: height above ground, m, and speed, m/s."""

    height: float
    speed: float


def gusts(turbulence: Turbulence, passage: Passage, dt: float, steps: int, flight: str, seed: int) -> Array:
    """Gust velocity of one flight in body axes at steps 0 to `steps`, m/s, [3, steps + 1]; stationary from the start.

    Every flight has a stream of its own, which neither other flights nor another length change.
    """
    sigma = turbulence.sigma
    air = Air((sigma, sigma, sigma), scale_lengths(passage.height), max(passage.speed, DRIFT))
    return gusts_of(air, dt, steps, flight, [seed])


def gusts_of(air: Air, dt: float, steps: int, flight: str, seeds: Sequence[int]) -> Array:
    """The same of air by its numbers.

    Source: MIL-F-8785C, section 3.7 (Dryden form); shaping filters by spectral factorisation.
    """
    out = np.empty((3, steps + 1))
    for k, (intensity, length) in enumerate(zip(air.intensity, air.length, strict=True)):
        lag = length / air.speed
        run_up = int(SETTLING * lag / dt)
        stream = np.random.default_rng([*seeds, zlib.crc32(f"{flight}/gust/{k}".encode())])
        white = stream.standard_normal(run_up + steps + 1) / np.sqrt(dt)
        out[k] = intensity * _shaped(white, lag, dt, first_order=k == 0)[run_up:]
    return out


def _shaped(white: Array, lag: float, dt: float, *, first_order: bool) -> Array:
    """Unit-variance gust from white noise of unit intensity."""
    if first_order:
        above, below = [np.sqrt(2.0 * lag)], [lag, 1.0]
    else:
        above, below = [np.sqrt(3.0 * lag) * lag, np.sqrt(lag)], [lag * lag, 2.0 * lag, 1.0]
    from scipy.signal import bilinear, lfilter  # slow to import

    return np.asarray(lfilter(*bilinear(above, below, 1.0 / dt), white), dtype=np.float64)
