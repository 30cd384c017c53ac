"""The filter's model for step 1: the body's motion under unknown forces and moments, and the sensors that see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, FORCES, MOMENTS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset

ACCELERATIONS = ("pdot", "qdot", "rdot")
AXES = (*FORCES, *MOMENTS)


@dataclass(frozen=True, eq=False)
class Motion:
    """Which states and outputs the channels of a data set support, and the equations between them.

    Forces and moments are states per mass and per inertia (m/s2, rad/s2): Gauss-Markov about the flight's trim. Without
    a declared inertia the moments are the whole angular acceleration. A vibration line of a channel is a pair of slowly
    wandering amplitudes on cos and sin of its phase, which come in as inputs: an undamped oscillator in a frame that
    turns with it, exact at any sample rate.

    Attributes
    ----------
    states, outputs : names in order; a line of channel c has the states "c cos", "c sin".
    tau : [6] s, time constants of X Y Z L M N; trim : [F, 1, 6] their mean values in each flight.
    dt : [F, 1, 1] s, sample interval of each flight; rates are per sample.
    lines : Hz by channel.
    """

    states: tuple[str, ...]
    outputs: tuple[str, ...]
    tau: Tensor
    trim: Tensor
    dt: Tensor
    gravity: float
    inertia: Tensor | None
    imu: Tensor | None
    lines: Mapping[str, float] = field(default_factory=dict)

    def has(self, *names: str) -> bool:
        """Whether all of these are states."""
        return all(name in self.states for name in names)

    def pick(self, x: Tensor, names: tuple[str, ...]) -> Tensor:
        """Neighbouring states by name."""
        first = self.states.index(names[0])
        return x[..., first : first + len(names)]

    def angular_acceleration(self, x: Tensor) -> Tensor:
        """d(p, q, r)/dt, rad/s2 [..., 3]."""
        moments = self.pick(x, MOMENTS)
        return moments if self.inertia is None else moments + rigid.gyroscopic(self.pick(x, RATES), self.inertia)

    def rates(self, x: Tensor, u: Tensor) -> Tensor:
        """Change of the state per sample interval [..., nx]."""
        omega, parts = self.pick(x, RATES), []
        attitude = self.pick(x, self._attitudes()) if self.has("phi") else omega
        if self.has("u"):
            velocity, force = self.pick(x, VELOCITIES), self.pick(x, FORCES)
            parts.append(rigid.velocity_rates(velocity, omega, attitude, force, self.gravity))
        parts.append(self.angular_acceleration(x))
        if self.has("phi"):
            parts.append(rigid.euler_rates(omega, attitude)[..., : attitude.shape[-1]])
        if self.has("height"):
            heading = attitude if self.has("psi") else torch.nn.functional.pad(attitude, (0, 1))
            moved = rigid.position_rates(self.pick(x, VELOCITIES), heading)
            parts.append(moved if self.has("north") else moved[..., 2:])
        loads = AXES if self.has("X") else MOMENTS
        n = len(loads)
        parts.append((self.trim[..., 6 - n :] - self.pick(x, loads)) / self.tau[6 - n :])
        change = torch.cat(parts, dim=-1) * self.dt
        return torch.nn.functional.pad(change, (0, 2 * len(self.lines)))

    def measure(self, x: Tensor, u: Tensor) -> Tensor:
        """Outputs [..., ny]; u holds cos and sin of each line's phase."""
        columns, turn = [], None
        force = None
        for name in self.outputs:
            if name in SPECIFIC_FORCES:
                force = self._at_imu(x) if force is None else force
                value = force[..., SPECIFIC_FORCES.index(name)]
            elif name in ACCELERATIONS:
                turn = self.angular_acceleration(x) if turn is None else turn
                value = turn[..., ACCELERATIONS.index(name)]
            else:
                value = x[..., self.states.index(name)]
            columns.append(value)
        for k, channel in enumerate(self.lines):
            i, j = self.outputs.index(channel), self.states.index(f"{channel} cos")
            columns[i] = columns[i] + x[..., j] * u[..., 2 * k] + x[..., j + 1] * u[..., 2 * k + 1]
        return torch.stack(columns, dim=-1)

    def phases(self, samples: int) -> Tensor:
        """Cosine and sine of each line's phase, [F, T, 2 x lines]."""
        time = torch.arange(samples, dtype=torch.float64) * self.dt[..., 0]
        angles = [2.0 * torch.pi * hertz * time for hertz in self.lines.values()]
        pairs = [part for angle in angles for part in (angle.cos(), angle.sin())]
        return torch.stack(pairs, dim=-1) if pairs else time.new_zeros(*time.shape, 0)

    def _attitudes(self) -> tuple[str, ...]:
        return ATTITUDES if self.has("psi") else ATTITUDES[:2]

    def _at_imu(self, x: Tensor) -> Tensor:
        force = self.pick(x, FORCES)
        if self.imu is None:
            return force
        return rigid.specific_force_at(self.imu, force, self.pick(x, RATES), self.angular_acceleration(x))


def supported(dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """States that the channels of a data set support, and the channels that see them."""

    def seen(*names: str) -> bool:
        return any(flight.has(*names) for flight in dataset.flights.values())

    states: list[str] = []
    attitude = seen("phi", "theta")
    velocity = attitude and seen(*VELOCITIES)
    states += VELOCITIES if velocity else ()
    states += RATES
    states += () if not attitude else ATTITUDES if seen(*ATTITUDES) else ATTITUDES[:2]
    if velocity and "psi" in states and seen("north", "east", "height"):
        states += ["north", "east", "height"]
    elif velocity and seen("height"):
        states.append("height")
    states += FORCES if velocity or any(seen(name) for name in SPECIFIC_FORCES) else ()
    sensors = [name for name in (*states, *ACCELERATIONS) if seen(name)]
    sensors += [name for name in SPECIFIC_FORCES if "X" in states and seen(name)]
    return (*states, *MOMENTS), tuple(sensors)
