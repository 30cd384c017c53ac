"""The flight test's manoeuvres: 3-2-1-1 inputs, doublets of both signs, a collective sweep, and their lists."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.fly.aircraft import CONTROL_NAMES
from rotorid_torch.fly.section import Array

QUIET = 1.0  # s before the input starts
UNIT, HALF = 0.8, 1.2  # s: unit of the 3-2-1-1, half of a doublet
SWEEP_TIME, SWEEP_BAND = 6.0, (0.05, 2.0)  # s, Hz
AMPLITUDE = 0.1  # of full deflection

LISTS = {
    "identify": tuple(f"f321_{name}" for name in CONTROL_NAMES) + tuple(f"dbl_{name}_p" for name in CONTROL_NAMES),
    "validate": tuple(f"dbl_{name}_n" for name in CONTROL_NAMES),
    "acid": ("sweep_col",),
}
FLIGHTS = tuple(name for names in LISTS.values() for name in names)


def chosen(flights: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the flights to fly, in the order of the lists.

    Raises
    ------
    InputError : a name that does not exist, or none at all.
    """
    if flights is None:
        return FLIGHTS
    for name in flights:
        if name not in FLIGHTS:
            raise InputError("usage", "flights", f"there is no flight '{name}'", "some of " + ", ".join(FLIGHTS))
    if not flights:
        raise InputError("usage", "flights", "the list is empty", "some of " + ", ".join(FLIGHTS))
    return tuple(name for name in FLIGHTS if name in flights)


def stick(name: str, time: Array) -> tuple[int, Array]:
    """Which control a flight moves (its place in lon lat col ped), and how, in units of the amplitude.

    Steps happen at samples of 154 Hz or at their own times; the value at a step's time is the one after it.

    Source: Hamel and Kaletka, Progress in Aerospace Sciences 33 (1997) (3-2-1-1); Tischler and Remple, Aircraft and
    Rotorcraft System Identification, chapter 5 (doublets, sweeps with an exponential rise of frequency).
    """
    kind, control = name.split("_")[:2]
    place = CONTROL_NAMES.index(control)
    since = time - QUIET
    if kind == "f321":
        return place, _steps(since, (3 * UNIT, 5 * UNIT, 6 * UNIT, 7 * UNIT), (1.0, -1.0, 1.0, -1.0))
    if kind == "dbl":
        sign = 1.0 if name.endswith("p") else -1.0
        return place, _steps(since, (HALF, 2 * HALF), (sign, -sign))
    low, high = SWEEP_BAND
    growth = np.log(high / low)
    phase = 2.0 * np.pi * low * SWEEP_TIME / growth * np.expm1(growth * since / SWEEP_TIME)
    return place, np.where((since >= 0.0) & (since < SWEEP_TIME), np.sin(phase), 0.0)


def _steps(since: Array, ends: tuple[float, ...], levels: tuple[float, ...]) -> Array:
    """Levels that hold until their ends, zero before and after."""
    edges = np.round(np.array([0.0, *ends]) * SAMPLE_RATE) / SAMPLE_RATE
    return np.concatenate([[0.0], levels, [0.0]])[np.searchsorted(edges, since, side="right")]


SAMPLE_RATE = 154.0  # Hz


def pilot(flights: Sequence[str], time: Array, limits: Sequence[tuple[float, float]]) -> Array:
    """Stick inputs of all flights, rad, [4, T, flight]."""
    out = np.zeros((4, len(time), len(flights)))
    for k, name in enumerate(flights):
        place, shape = stick(name, time)
        low, high = limits[place]
        out[place, :, k] = AMPLITUDE * (high - low) * shape
    return out
