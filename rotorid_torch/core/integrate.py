"""THE time loop: one Runge-Kutta step and the simulation of a trajectory, for filter, output error and free run alike.

The tableau is the 3/8 rule, torchdiffeq's "rk4", so that `step` (many samples at once, for filters and
sensitivities) and `simulate` (one sample after the other, through torchdiffeq) give the same numbers.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

Rates = Callable[[Tensor, Tensor, Tensor], Tensor]
"""rates(t, x[..., nx], u[..., nu]) -> dx/dt [..., nx]"""

NODES = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
"""Places of the four stages within a step."""


def integral(record: Tensor, dt: float, dim: int = 0) -> Tensor:
    """Trapezoidal integral of a record along its samples, which stand dt (s) apart; zero at the first one."""
    start = torch.zeros_like(record.narrow(dim, 0, 1))
    return torch.cat([start, torch.cumulative_trapezoid(record, dx=dt, dim=dim)], dim=dim)


def step(rates: Rates, t: Tensor, x: Tensor, u0: Tensor, u1: Tensor, dt: float) -> Tensor:
    """One step of the 3/8 rule from t to t + dt, controls linear in between.

    rates : right-hand side.
    t : time at the start of the step, s; broadcasts against the leading dimensions of x.
    x : [..., nx] state at t.
    u0, u1 : [..., nu] controls at t and t + dt.
    dt : step, s.

    Source: Kutta (1901); Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, table 1.2.
    """
    return step_stages(rates, t, x, u0, u1, dt)[0]


def step_stages(rates: Rates, t: Tensor, x: Tensor, u0: Tensor, u1: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """The step, and the states of its four stages [4, ..., nx], where `step_jacobian` wants the rates' derivatives."""
    third, du = dt / 3.0, u1 - u0
    k1 = rates(t, x, u0)
    x2 = x + third * k1
    k2 = rates(t + third, x2, u0 + du / 3.0)
    x3 = x + dt * (k2 - k1 / 3.0)
    k3 = rates(t + 2.0 * third, x3, u0 + du * (2.0 / 3.0))
    x4 = x + dt * (k1 - k2 + k3)
    k4 = rates(t + dt, x4, u1)
    return x + (k1 + 3.0 * (k2 + k3) + k4) * (dt / 8.0), torch.stack([x, x2, x3, x4])


def step_jacobian(by_state: Tensor, by_other: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Exact derivatives of one step by its start and by anything else, from those of the rates at its four stages.

    by_state : [4, ..., nx, nx] derivatives of the rates by the state at the stages.
    by_other : [4, ..., nx, n] derivatives by n other quantities, the state held.

    Returns [..., nx, nx] and [..., nx, n].
    """
    nx = by_state.shape[-1]
    both = torch.cat([by_state, by_other], dim=-1)
    k1 = both[0]
    k2 = both[1] + by_state[1] @ k1 * (dt / 3.0)
    k3 = both[2] + by_state[2] @ torch.sub(k2, k1, alpha=1.0 / 3.0) * dt
    k4 = both[3] + by_state[3] @ (k1 - k2 + k3) * dt
    total = k2.add_(k3).mul_(3.0).add_(k1).add_(k4).mul_(dt / 8.0)
    return total[..., :nx] + torch.eye(nx, dtype=both.dtype, device=both.device), total[..., nx:]


def simulate(rates: Rates, x0: Tensor, controls: Tensor, dt: float, solver: str = "rk4", hold: bool = False) -> Tensor:
    """Trajectory from x0 under sampled controls, linear between samples, or held from each to the next.

    x0 : [..., nx] state at the first sample.
    controls : [..., T, nu] controls at the samples.
    dt : sample interval, s.
    solver : any method of torchdiffeq; fixed-step ones take one step per sample.

    Returns [..., T, nx] states at the samples, the first one being x0.
    """
    samples = controls.shape[-2]
    shape = np.broadcast_shapes(x0.shape[:-1], controls.shape[:-2])
    x0 = x0.expand(*shape, x0.shape[-1])
    if samples == 1:
        return x0.unsqueeze(-2)
    rows = controls.movedim(-2, 0).contiguous()
    slopes = rows[1:] - rows[:-1]

    def right_hand_side(t: Tensor, x: Tensor) -> Tensor:
        place = float(t) / dt
        k = min(max(int(place + 1e-9), 0), samples - 2)
        return rates(t, x, rows[k] + (place - k) * slopes[k])

    from torchdiffeq import odeint  # here: it brings SciPy, half a second that compiled models do without

    times = torch.arange(samples, dtype=x0.dtype, device=x0.device) * dt
    if hold:
        path = [x0]
        for k in range(samples - 1):  # a jump at each sample ends a step there
            held = lambda t, x, k=k: rates(t, x, rows[k])  # noqa: E731
            ends = odeint(held, path[-1], times[k : k + 2], method=solver)
            assert isinstance(ends, Tensor)
            path.append(ends[-1])
        return torch.stack(path, dim=-2)
    states = odeint(right_hand_side, x0, times, method=solver)
    assert isinstance(states, Tensor)
    return states.movedim(0, -2)
