"""The filter's model for step 1: the body's motion under unknown forces and moments, and the sensors that see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, FORCES, MOMENTS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.schema import Vehicle

ACCELERATIONS = ("pdot", "qdot", "rdot")
AXES = (*FORCES, *MOMENTS)


class GaussMarkovForces(NamedTuple):
    """Forces and moments as first-order Gauss-Markov processes: time constants [6], s, and mean values [F, 1, 6]."""

    tau: Tensor
    trim: Tensor


@dataclass(frozen=True, eq=False)
class Motion:
    """Which states and outputs the channels of a data set support, and the equations between them.

    Forces and moments are states per mass and per inertia (m/s2, rad/s2): Gauss-Markov about the flight's trim. Without
    a declared inertia the moments are the whole angular acceleration. A vibration line of a channel is a pair of slowly
    wandering amplitudes on cos and sin of its phase, which come in as inputs: an undamped oscillator in a frame that
    turns with it, exact at any sample rate.

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

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        states: tuple[str, ...],
        outputs: tuple[str, ...],
        forces: GaussMarkovForces,
        dt: Tensor,
        lines: Mapping[str, float] | None = None,
    ) -> Motion:
        """Motion of a vehicle as it is declared."""
        return cls(
            states=states,
            outputs=outputs,
            tau=forces.tau,
            trim=forces.trim,
            dt=dt,
            gravity=vehicle.gravity,
            inertia=None if vehicle.inertia is None else torch.tensor(vehicle.inertia, dtype=torch.float64),
            imu=None if not any(vehicle.imu or ()) else torch.tensor(vehicle.imu, dtype=torch.float64),
            lines=lines or {},
        )

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
        """Change of the state per sample interval [..., nx]; u as `inputs` makes it.

        The equations of `core.rigid` as one linear and one bilinear product plus the trigonometric part: the filter
        spends most of its time here, and few large operations are several times faster than many small ones.
        """
        omega = self.pick(x, RATES)
        partners = torch.cat([omega, self.pick(x, VELOCITIES)], dim=-1) if self.has("u") else omega
        products = (omega.unsqueeze(-1) * partners.unsqueeze(-2)).flatten(-2)
        toward_trim = u[..., -1 - len(self.axes) : -1] @ self._push
        change = x @ self._linear + products @ self._bilinear + toward_trim
        if self.has("phi"):
            change = change + self._turning(x, omega)
        return change * u[..., -1:]

    def _turning(self, x: Tensor, omega: Tensor) -> Tensor:
        """Gravity, Euler angles and position: what depends on attitude, in the places of the state."""
        attitude = self.pick(x, ATTITUDES if self.has("psi") else ATTITUDES[:2])
        sine, cosine = attitude.sin(), attitude.cos()
        (sin_phi, sin_theta), (cos_phi, cos_theta) = sine.unbind(-1)[:2], cosine.unbind(-1)[:2]
        p, q, r = omega.unbind(-1)
        about_z = (q * sin_phi + r * cos_phi) / cos_theta
        parts = [p + sin_theta * about_z, q * cos_phi - r * sin_phi, about_z][: attitude.shape[-1]]
        empty = torch.zeros_like(p)
        if self.has("u"):
            down = [-sin_theta, cos_theta * sin_phi, cos_theta * cos_phi]
            parts = [*(self.gravity * part for part in down), empty, empty, empty, *parts]
            if self.has("north"):
                heading = sine[..., 2], cosine[..., 2]
                parts += _horizontal(self.pick(x, VELOCITIES), (sin_phi, cos_phi), (sin_theta, cos_theta), heading)
            if self.has("height"):
                u, v, w = self.pick(x, VELOCITIES).unbind(-1)
                parts.append(-(u * down[0] + v * down[1] + w * down[2]))
        else:
            parts = [empty, empty, empty, *parts]
        parts += [empty] * (x.shape[-1] - len(parts))
        return torch.stack(parts, dim=-1)

    @cached_property
    def _linear(self) -> Tensor:
        """[nx, nx], from the right: forces drive velocity, moments the rates, both decay to their trim."""
        A = torch.zeros(len(self.states), len(self.states), dtype=torch.float64)
        for i, (axis, driven) in enumerate(zip(AXES, (*VELOCITIES, *RATES), strict=True)):
            if axis in self.states:
                f = self.states.index(axis)
                A[f, f] = -1.0 / self.tau[i]
                if driven in self.states:
                    A[f, self.states.index(driven)] = 1.0
        return A

    @property
    def axes(self) -> tuple[str, ...]:
        """Forces and moments that are states."""
        return tuple(axis for axis in AXES if axis in self.states)

    @cached_property
    def _push(self) -> Tensor:
        """[axes, nx], from the trim of each force to its rate."""
        table = torch.zeros(len(self.axes), len(self.states), dtype=torch.float64)
        for i, axis in enumerate(self.axes):
            table[i, self.states.index(axis)] = 1.0 / self.tau[AXES.index(axis)]
        return table

    @cached_property
    def _bilinear(self) -> Tensor:
        """[3 x 3 or 3 x 6, nx]: from products of rates with rates and velocities to gyroscopic and Coriolis terms."""
        width = 6 if self.has("u") else 3
        table = torch.zeros(3, width, len(self.states), dtype=torch.float64)
        unit = torch.eye(3, dtype=torch.float64)
        turn, push = self.states.index("p"), 0
        for i in range(3):
            for j in range(3):
                if self.inertia is not None:
                    total = rigid.gyroscopic(unit[i] + unit[j], self.inertia)
                    gyroscopic = rigid.gyroscopic(unit[i], self.inertia) + rigid.gyroscopic(unit[j], self.inertia)
                    mixed = total - gyroscopic if i != j else 2.0 * rigid.gyroscopic(unit[i], self.inertia)
                    table[i, j, turn : turn + 3] = 0.5 * mixed
                if width == 6:
                    table[i, 3 + j, push : push + 3] = -rigid.cross(unit[i], unit[j])
        return table.flatten(0, 1)

    def measure(self, x: Tensor, u: Tensor) -> Tensor:
        """Outputs [..., ny]; u as `inputs` makes it."""
        y = x @ self._seen
        if self._turns:
            turn, force = self.angular_acceleration(x), None
            if self.imu is not None:
                force = rigid.specific_force_at(self.imu, torch.zeros_like(turn), self.pick(x, RATES), turn)
            more = [self._by_rotation(name, turn, force) for name in self.outputs]
            y = y + torch.stack([torch.zeros_like(y[..., 0]) if part is None else part for part in more], dim=-1)
        if self.lines:
            amplitudes = x[..., -2 * len(self.lines) :] * u[..., : 2 * len(self.lines)]
            y = y + amplitudes @ self._line_places
        return y

    def _by_rotation(self, name: str, turn: Tensor, force: Tensor | None) -> Tensor | None:
        """Part of an output that rotation makes: angular acceleration, or an accelerometer's lever arm."""
        if name in ACCELERATIONS:
            return turn[..., ACCELERATIONS.index(name)]
        return force[..., SPECIFIC_FORCES.index(name)] if force is not None and name in SPECIFIC_FORCES else None

    @cached_property
    def _turns(self) -> bool:
        return self.imu is not None or any(name in ACCELERATIONS for name in self.outputs)

    @cached_property
    def _seen(self) -> Tensor:
        """[nx, ny]: the state that each output shows."""
        table = torch.zeros(len(self.states), len(self.outputs), dtype=torch.float64)
        for j, name in enumerate(self.outputs):
            shown = FORCES[SPECIFIC_FORCES.index(name)] if name in SPECIFIC_FORCES else name
            if shown in self.states:
                table[self.states.index(shown), j] = 1.0
        return table

    @cached_property
    def _line_places(self) -> Tensor:
        """[2 x lines, ny]: the output that each pair of amplitudes is part of."""
        table = torch.zeros(2 * len(self.lines), len(self.outputs), dtype=torch.float64)
        for k, channel in enumerate(self.lines):
            table[2 * k : 2 * k + 2, self.outputs.index(channel)] = 1.0
        return table

    def inputs(self, lengths: Tensor) -> Tensor:
        """What differs between flights and samples, as controls [F, T, nu].

        Cosine and sine of each line's phase; the trim of each force that is a state; last, the sample interval while a
        flight of `lengths` [F] lasts. After its end that is zero: the flight stands still, with nothing measured.
        """
        count = torch.arange(int(lengths.max()), dtype=torch.float64)
        time = count * self.dt[..., 0]
        angles = [2.0 * torch.pi * hertz * time for hertz in self.lines.values()]
        pairs = [part for angle in angles for part in (angle.cos(), angle.sin())]
        trims = [self.trim[..., AXES.index(axis)].expand_as(time) for axis in self.axes]
        return torch.stack([*pairs, *trims, (count < lengths.unsqueeze(-1)) * self.dt[..., 0]], dim=-1)


def _horizontal(
    velocity: Tensor, roll: tuple[Tensor, Tensor], pitch: tuple[Tensor, Tensor], heading: tuple[Tensor, Tensor]
) -> list[Tensor]:
    """d(north, east)/dt, m/s, from body velocity and (sine, cosine) of the Euler angles."""
    u, v, w = velocity.unbind(-1)
    level = u * pitch[1] + (v * roll[0] + w * roll[1]) * pitch[0]
    side = v * roll[1] - w * roll[0]
    return [level * heading[1] - side * heading[0], level * heading[0] + side * heading[1]]
