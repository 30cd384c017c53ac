"""A batch of flights: trim, augmentation and pilot make the commands, the aircraft answers, samples are taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.fly.aircraft import EULER, Aircraft, Motion, rates
from rotorid_torch.fly.augmentation import FEEDBACK, Augmentation
from rotorid_torch.fly.manoeuvres import SAMPLE_RATE, pilot
from rotorid_torch.fly.section import Array
from rotorid_torch.fly.stepping import runge_kutta
from rotorid_torch.fly.trim import STEP_ANGLE, Trim

Progress = Callable[[int, int], None]
"""progress(done, total) in samples."""


@dataclass(frozen=True)
class Record:
    """What happened, without noise: `time` [T], `states` [T, states, flight], and `Motion`'s parts [T, 3, flight]."""

    time: Array
    states: Array
    specific_force: Array
    angular: Array
    force: Array
    moment: Array


def fly_batch(
    aircraft: Aircraft,
    trim: Trim,
    augmentation: Augmentation,
    flights: Sequence[str],
    seconds: float,
    progress: Progress | None = None,
    *,
    substeps: int | None = None,
) -> Record:
    """Fly manoeuvres from trim, all in one batch.

    Parameters
    ----------
    flights : names of manoeuvres.
    seconds : length of each flight.
    progress : called about a hundred times.
    substeps : integration steps per sample; by default so many that the rotor turns at most 5.1 degrees in each.
    """
    samples = round(seconds * SAMPLE_RATE) + 1
    dt = 1.0 / SAMPLE_RATE
    substeps = substeps or int(np.ceil(aircraft.rotor.speed * dt / STEP_ANGLE - 1e-6))
    times = _stage_times(samples, substeps, dt)
    stick = pilot(flights, times.ravel(), aircraft.limits).reshape(4, *times.shape, len(flights))
    x = np.repeat(trim.state[:, None], len(flights), axis=1)
    neutral, controls, gains = x[FEEDBACK].copy(), trim.controls[:, None], augmentation.gains
    kept: dict[str, list[Array]] = {name: [] for name in ("x", "specific_force", "angular", "force", "moment")}

    def respond(state: Array, hand: Array) -> tuple[Array, Motion]:
        return rates(aircraft, state, controls + hand + gains @ (state[FEEDBACK] - neutral))

    def slope(state: Array, hand: Array) -> Array:
        return respond(state, hand)[0]

    for k in range(samples):
        first, motion = respond(x, stick[:, k * substeps, 0])
        kept["x"].append(x)
        for name in ("specific_force", "angular", "force", "moment"):
            kept[name].append(getattr(motion, name))
        for step in range(k * substeps, (k + 1) * substeps if k < samples - 1 else 0):
            hands = stick[:, step, 0], stick[:, step, 1], stick[:, step, 2]
            first = first if step == k * substeps else slope(x, hands[0])
            x = runge_kutta(slope, x, first, hands, dt / substeps)
        if progress is not None and (k % 23 == 0 or k == samples - 1):
            progress(k + 1, samples)
    stacked = {name: np.stack(rows) for name, rows in kept.items()}
    return Record(np.arange(samples, dtype=np.float64) * dt, stacked.pop("x"), **stacked)


def _stage_times(samples: int, substeps: int, dt: float) -> Array:
    """Start, middle and end of every step, [steps, 3], drawn in a little so that a stick's jump belongs to one side."""
    starts = np.arange(samples * substeps) * (dt / substeps)
    return starts[:, None] + np.array([1e-6, 0.5, 1.0 - 1e-6]) * (dt / substeps)


def with_heading(trim: Trim, heading: float) -> Trim:
    """The same trim, flown towards another heading (rad)."""
    state = trim.state.copy()
    state[EULER.stop - 1] += heading
    return Trim(state, trim.controls, trim.speed, trim.residual)
