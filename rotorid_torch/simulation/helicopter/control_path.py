"""What may lie between a recorded control and the swashplate: delay, lag, rate limit and backlash, in this order.

A clean aircraft has none of it: there the recorded control is the blade angle. The states are the differences of output
and input of each piece, which are zero in trim whatever the controls are.
"""

from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.rigid import Array

CATCH_UP = 100.0  # 1/s: how fast a limiter or a play closes what the integration left open


@dataclass(frozen=True)
class ControlPath:
    """The same for lon lat col ped: `delay` and `lag` in s, `rate_limit` in rad/s, `play` (whole width) in rad."""

    delay: float = 0.0
    lag: float = 0.0
    rate_limit: float = np.inf
    play: float = 0.0

    @property
    def states(self) -> int:
        """Number of states: four for each piece that has a memory of its own (the delay has the record)."""
        return 4 * ((self.lag > 0.0) + (self.rate_limit < np.inf) + (self.play > 0.0))


def follow(path: ControlPath, inside: Array, value: Array, rate: Array) -> tuple[Array, Array]:
    """Angles at the swashplate and the rates of the path's states.

    inside : [path.states, flight] output minus input of each piece, rad.
    value, rate : [4, flight] the control behind the delay, rad, and its rate, rad/s.

    Returns [4, flight] rad, and [path.states, flight] rad/s.

    Source: Krasnosel'skii and Pokrovskii, Systems with Hysteresis, chapter 1 (the play operator).
    """
    pieces = iter(inside.reshape(-1, 4, value.shape[1]))
    rates = np.empty_like(inside).reshape(-1, 4, value.shape[1])
    place = iter(rates)
    if path.lag > 0.0:
        gap, out = next(pieces), next(place)
        out[:] = -gap / path.lag - rate
        value, rate = value + gap, rate + out
    if path.rate_limit < np.inf:
        gap, out = next(pieces), next(place)
        out[:] = np.clip(rate - CATCH_UP * gap, -path.rate_limit, path.rate_limit) - rate
        value, rate = value + gap, rate + out
    if path.play > 0.0:
        gap, out = next(pieces), next(place)
        half = 0.5 * path.play
        pushed = ((gap <= -half) & (rate > 0.0)) | ((gap >= half) & (rate < 0.0))
        out[:] = np.where(pushed, CATCH_UP * (np.clip(gap, -half, half) - gap), -rate)
        value = value + gap
    return value, rates.reshape(inside.shape)


class History:
    """Controls of the steps flown so far, to be read a delay later.

    Between steps the record is linear; where the delay is shorter than a step it goes on with its last rate. Before the
    first step it is held.
    """

    def __init__(self, delay: float, dt: float) -> None:
        self.steps = delay / dt
        self.dt = dt
        self.values: list[Array] = []
        self.rate: Array | None = None

    def keep(self, value: Array) -> None:
        """Append the controls [4, flight] at the start of a step; its rate is told later, by setting `rate`."""
        self.values.append(value.copy())
        self.rate = None

    def read(self, part: float) -> tuple[Array, Array]:
        """Control and its rate, [4, flight] each, at this part (0 to 1) of the running step less the delay."""
        last = len(self.values) - 1
        place = last + part - self.steps
        if place <= 0.0:
            return self.values[0], np.zeros_like(self.values[0])
        before = min(int(place), last)
        if before == last:
            rate = np.zeros_like(self.values[last]) if self.rate is None else self.rate
            return self.values[last] + (place - last) * self.dt * rate, rate
        step = self.values[before + 1] - self.values[before]
        return self.values[before] + (place - before) * step, step / self.dt
