"""Degrees where radians belong: told by attitude against the integral of the rate."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from rotorid_torch.core.statistics import without_line
from rotorid_torch.data.flight import Flight
from rotorid_torch.errors import InputError

Record = tuple[np.ndarray, np.ndarray]
"""Time (T,) in s and values (T,)."""
PAIRS = (("phi", "p"), ("theta", "q"), ("psi", "r"))


def refuse_degrees_of_attitude(flight: Flight, file: str | Path) -> None:
    """Raise InputError where an attitude moves about 57 times as much as its rate says, or a 57th of it."""
    for angle, rate in PAIRS:
        if not flight.has(angle, rate):
            continue
        ratio, correlation = attitude_over_rate(flight, angle, rate)
        if correlation < 0.9:
            continue
        if 35.0 < ratio < 90.0:
            raise InputError(
                file, angle, f"moves {ratio:.0f} times as much as the integral of {rate} (degrees?)", "radians"
            )
        if 35.0 < 1.0 / max(ratio, 1e-9) < 90.0:
            raise InputError(file, rate, f"is {1.0 / ratio:.0f} times the rate of {angle} (degrees?)", "rad/s")


ROUNDED = 1e-3
"""rad: what an angle of a turn may be too large, written with few digits."""
TURNS = 200.0
"""Largest unwrapped roll angle in rad: 30 turns."""


def unwrapped_roll(time: np.ndarray, phi: np.ndarray, rate_time: np.ndarray, rate: np.ndarray) -> bool:
    """Whether a roll angle (T,) beyond half a turn is one in rad that goes on turning, as its rate (n,) says."""
    finite, measured = np.isfinite(phi), np.isfinite(rate) & np.isfinite(rate_time)
    if finite.sum() < 16 or measured.sum() < 16 or not np.pi < np.abs(phi[finite]).max() <= TURNS:
        return False
    t, angle = time[finite], phi[finite]
    fine = rate_time[measured]
    steps = 0.5 * (rate[measured][1:] + rate[measured][:-1]) * np.diff(fine)
    integral = np.interp(t, fine, np.concatenate([[0.0], np.cumsum(steps)]))
    left = without_line(np.stack([angle, integral], axis=1), t)
    power, turned = (left**2).sum(axis=0), float((left[:, 0] * left[:, 1]).sum())
    if power.min() <= 0.0:
        return False
    return 0.5 < turned / power[1] < 2.0 and turned > 0.9 * math.sqrt(power[0] * power[1])


def beyond_half_a_turn(angles: Mapping[str, Record], rate: Record | None) -> list[str]:
    """Those of the angles phi and theta that are right but for whole turns; `rate` is that of roll."""
    listed = [name for name in ("phi", "theta") if name in angles and counted_from_zero(angles[name][1])]
    if "phi" in angles and "phi" not in listed and rate is not None and unwrapped_roll(*angles["phi"], *rate):
        listed.append("phi")
    return listed


def counted_from_zero(angle: np.ndarray) -> bool:
    """Whether an angle (T,) in rad runs from zero to a turn: it jumps there, by more than it can turn in a sample."""
    finite = angle[np.isfinite(angle)]
    if len(finite) < 2 or finite.min() < 0.0 or finite.max() > 2.0 * np.pi + ROUNDED:
        return False
    return bool(np.abs(np.diff(finite)).max() > np.pi)


def attitude_over_rate(flight: Flight, angle: str, rate: str) -> tuple[float, float]:
    """Slope of an Euler angle on the integral of its body rate, both without trend, and their correlation."""
    values = flight.bridged([angle, rate]).numpy()
    integral = np.cumsum(values[:, 1]) * flight.dt
    left = without_line(np.stack([values[:, 0], integral], axis=1))
    power, turned = (left**2).sum(axis=0), (left[:, 0] * left[:, 1]).sum()
    if power.min() <= 0.0:
        return 0.0, 0.0
    return float(turned / power[1]), float(turned / math.sqrt(power[0] * power[1]))
