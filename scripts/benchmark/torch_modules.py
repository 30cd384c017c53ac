"""The two defined problems that engines are timed on, as torch modules.

`LoadedBody` (problem A) is what a filter reconstructs: a rigid body with six forces and moments as Gauss-Markov states.
`DerivativeModel` (problem B) is what output error estimates: a body whose forces, moments and flapping rates are linear
in states, flapping and controls; gravity, kinematics and gyroscopic terms are not.

Both take their numbers from `problems`, the module that defines the problems for every competitor.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from rotorid_torch.core import rigid


def numbers(values: Any) -> Tensor:
    """Anything like an array in float64."""
    return torch.as_tensor(values, dtype=torch.float64).clone()


class LoadedBody(nn.Module):
    """Problem A: states u v w p q r phi theta psi north east height X Y Z L M N (SI).

    Outputs are the first twelve states and the specific force at the IMU.
    """

    inertia: Tensor
    imu: Tensor
    trim: Tensor
    tau: Tensor

    def __init__(self, problems: Any) -> None:
        super().__init__()
        self.mass, self.gravity = float(problems.MASS), float(problems.G)
        for name, values in (("inertia", problems.J), ("imu", problems.IMU), ("trim", problems.TRIM)):
            self.register_buffer(name, numbers(values))
        self.register_buffer("tau", numbers([problems.TAU_F] * 3 + [problems.TAU_M] * 3))

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """dx/dt [..., 18]; there are no controls."""
        velocity, rates, attitude = x[..., :3], x[..., 3:6], x[..., 6:9]
        return rigid.join(
            rigid.velocity_rates(velocity, rates, attitude, x[..., 12:15] / self.mass, self.gravity),
            self._turn(x),
            rigid.euler_rates(rates, attitude),
            rigid.position_rates(velocity, attitude),
            (self.trim - x[..., 12:]) / self.tau,
        )

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        """Outputs [..., 15]."""
        force = rigid.specific_force_at(self.imu, x[..., 12:15] / self.mass, x[..., 3:6], self._turn(x))
        return rigid.join(x[..., :12], force)

    def _turn(self, x: Tensor) -> Tensor:
        """Angular acceleration, rad/s2 [..., 3]."""
        inverse = torch.linalg.inv(self.inertia)
        return x[..., 15:] @ inverse.mT + rigid.gyroscopic(x[..., 3:6], self.inertia)


class DerivativeModel(nn.Module):
    """Problem B: states u v w p q r phi theta a0 a1 b1, all measured; controls lon lat col ped; 60 free derivatives.

    `theta` [60] fills the free places of a table [9, 14]: specific forces, angular accelerations and flapping rates by
    a constant, velocities, rates, flapping and controls. Gravity counts from its value at the trimmed attitude.
    """

    held: Tensor
    inertia: Tensor
    gravity_in_trim: Tensor

    def __init__(self, problems: Any, theta: Any) -> None:
        super().__init__()
        self.theta = nn.Parameter(numbers(theta))
        self.gravity = float(problems.G)
        table = torch.zeros(len(problems.ROWS), len(problems.REGS), dtype=torch.float64)
        for row, column, value in problems.FIXED_IDX:
            table[row, column] = value
        trim = rigid.gravity_in_body(numbers([problems.B_PHI0, problems.B_THE0]), self.gravity)
        for name, values in (("held", table), ("inertia", numbers(problems.J)), ("gravity_in_trim", trim)):
            self.register_buffer(name, values)
        self.rows, self.columns = (torch.tensor(places) for places in zip(*problems.IDX, strict=True))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """dx/dt [..., 11]."""
        velocity, rates, attitude = x[..., :3], x[..., 3:6], x[..., 6:8]
        regressors = rigid.join(torch.ones_like(x[..., :1]), x[..., :6], x[..., 8:], u)
        driven = regressors @ self.held.index_put((self.rows, self.columns), self.theta).mT
        push = rigid.velocity_rates(velocity, rates, attitude, driven[..., :3] - self.gravity_in_trim, self.gravity)
        turn = driven[..., 3:6] + rigid.gyroscopic(rates, self.inertia)
        return rigid.join(push, turn, rigid.euler_rates(rates, attitude)[..., :2], driven[..., 6:])

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        """Outputs [..., 11]: the states."""
        return x.clone()
