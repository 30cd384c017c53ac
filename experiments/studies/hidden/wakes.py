"""A cause that no library has: wakes of a like vehicle blow down on each flight of a multirotor, three times.

A vehicle feels them that hides `propulsion.axial_inflow`, which other vehicles of the simulator have switched off.
Momentum theory gives a fully developed wake twice the induced velocity of hover (Leishman, sec. 2.3).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from rotorid_torch.simulation.multirotor import flight
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.rigid import Array

WAKE = "outside.wake"
PASSES, WIDTH, ASIDE = 3, 0.5, 0.4
"""Wakes of a flight; s; horizontal velocities, as a share of the vertical one, as a standard deviation."""


@contextmanager
def wakes(seconds: float) -> Iterator[None]:
    """Flights of so many seconds that are flown within are disturbed."""
    calm = flight.turbulence

    def disturbed(craft: Sequence[Multirotor], names: Sequence[str], steps: int, dt: float, seed: int) -> Array:
        gusts = calm(craft, names, steps, dt, seed)
        rows = np.zeros((steps + 1, 3, len(craft))) if gusts is None else gusts
        time = np.linspace(seconds - steps * dt, seconds, steps + 1)  # a record begins behind a while of hover
        for column, (one, name) in enumerate(zip(craft, names, strict=True)):
            rows[:, :, column] += _passes(one, name, time, seed)
        return rows

    flight.turbulence = disturbed
    try:
        yield
    finally:
        flight.turbulence = calm


def _passes(craft: Multirotor, name: str, time: Array, seed: int) -> Array:
    """Velocities of the air, north east down, m/s, [steps, 3]; one wake in each third of the record."""
    chance = np.random.default_rng([seed, zlib.crc32(f"{name}/passes".encode())])
    thrust_area = 2.0 * craft.air_density * craft.count * craft.propeller.disc
    down = 2.0 * float(np.sqrt(craft.mass * craft.gravity / thrust_area))
    third, air = time[-1] / PASSES, np.zeros((len(time), 3))
    for k in range(PASSES):
        middle = third * (k + chance.uniform(0.2, 0.8))
        inside = np.abs(time - middle) < 0.5 * WIDTH
        shape = np.where(inside, np.cos(np.pi * (time - middle) / WIDTH) ** 2, 0.0)
        air += down * shape[:, None] * np.array([*(ASIDE * chance.standard_normal(2)), 1.0])
    return air
