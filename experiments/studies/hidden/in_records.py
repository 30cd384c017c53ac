"""Causes put into records of other people's simulators, where that needs no simulator.

What acts is in the records; what is recorded of it is changed. A control path that is late, slow or loose: the record
of the control becomes the command that such a path would have turned into what acted. A wind: flights are turned to
other headings and carried along, for motion through uniformly moving air is the same motion. A control run that slips
after 6 s: a cause that no library holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hidden.changed_records import Records, changed, smoothed
from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.data import Dataset
from rotorid_torch.data.flight import Flight

DELAY, LAG, WIDTH = 0.06, 0.08, 0.4  # s, s, width of the play over the mean rms of the controls' motion
NORTH, EAST = -4.6, -3.9  # m/s
PASSING = {"ax": 0.3, "ay": 0.3, "az": 0.8, "p": 0.01, "q": 0.008, "r": 0.004}  # m/s² and rad/s
SLIPPED, ONSET, LEFT, SLIP = "lat", 6.0, 0.5, 0.015  # s, part that arrives, shift as a part of the range
TRIM_S, QUIET_S = 0.5, 0.06


@dataclass(frozen=True)
class Made:
    """A data set with a cause in its records, and what its parameters are, by full name."""

    dataset: Dataset
    true: Mapping[str, float]


def _delay(data: Dataset) -> Made:
    return Made(without_errors(data, {"delay.controls": DELAY}), {"control.delay.common": DELAY})


def _lag(data: Dataset) -> Made:
    return Made(without_errors(data, {"filter.controls": LAG}), {"control.lag.common": LAG})


def _backlash(data: Dataset) -> Made:
    """The command leads what acts by half the play on the side to which it moves, and crosses it where that turns.

    The noise of the record stays; the play that is found is larger by some of it, for noise moves nothing behind it.
    """
    scales = data.scales()
    width = WIDTH * float(np.mean([scales[c] for c in data.controls]))

    def change(k: int, flight: Flight) -> Records:
        out = {}
        for c in data.controls:
            acts = smoothed(flight.channels[c].numpy(), max(1, round(QUIET_S / flight.dt)))
            side, turned = np.zeros_like(acts), 0  # where it went furthest to the side to which it moves
            for i, x in enumerate(acts):
                side[i] = side[i - 1] if i else float(np.sign(acts[-1] - x)) or 1.0
                if (x - acts[turned]) * side[i] >= 0.0:
                    turned = i
                elif abs(x - acts[turned]) > 0.25 * width:  # more than noise
                    side[turned + 1 : i + 1] *= -1.0
                    turned = i
            command = acts + 0.5 * width * side
            out[c] = command + (flight.channels[c].numpy() - acts)
        return out

    return Made(changed(data, change), {"control.backlash.width": width})


def _wind(data: Dataset) -> Made:
    """A quarter turn more for each flight, and the air's motion added to that over ground."""
    if any(data.facts[name].has(c) for name in data.flights for c in ("north", "east")):
        raise ValueError("positions over ground would have to be carried along")

    def change(k: int, flight: Flight) -> Records:
        x = {c: v.numpy() for c, v in flight.channels.items()}
        psi, theta, phi = x["psi"] + 0.5 * np.pi * (k % 4), x["theta"], x["phi"]
        ahead = NORTH * np.cos(psi) + EAST * np.sin(psi)
        right = EAST * np.cos(psi) - NORTH * np.sin(psi)
        down = ahead * np.sin(theta)
        return {
            "psi": psi,
            "u": x["u"] + ahead * np.cos(theta),
            "v": x["v"] + right * np.cos(phi) + down * np.sin(phi),
            "w": x["w"] - right * np.sin(phi) + down * np.cos(phi),
        }

    return Made(changed(data, change), {"environment.wind.north": NORTH, "environment.wind.east": EAST})


def _vibration(data: Dataset) -> Made:
    """A line at the passing of the blades, felt where the sensors are mounted."""
    rotor = data.vehicle.rotor
    if rotor is None or rotor.blades is None or rotor.speed is None:
        raise ValueError("no rotor is declared whose blades pass")
    passing = rotor.blades * rotor.speed

    def change(k: int, flight: Flight) -> Records:
        rng = np.random.default_rng(k)
        return {
            c: flight.channels[c].numpy() + size * np.cos(passing * flight.time.numpy() + rng.uniform(0.0, 2.0 * np.pi))
            for c, size in PASSING.items()
            if c in flight.channels
        }

    return Made(changed(data, change), {})


def _slipped(data: Dataset) -> Made:
    low, high = data.control_specs[SLIPPED].limits or (-1.0, 1.0)

    def change(k: int, flight: Flight) -> Records:
        acts = flight.channels[SLIPPED].numpy()
        trim = acts[: round(TRIM_S / flight.dt)].mean()
        command = trim + (acts - trim - SLIP * (high - low)) / LEFT
        return {SLIPPED: np.where(flight.time.numpy() >= ONSET, command, acts)}

    return Made(changed(data, change), {})


CAUSES: dict[str, Callable[[Dataset], Made]] = {
    "control.delay": _delay,
    "control.lag": _lag,
    "control.backlash": _backlash,
    "environment.wind": _wind,
    "environment.vibration": _vibration,
    "outside.slipped_control": _slipped,
}
