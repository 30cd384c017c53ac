"""Systems with known parameters for output error: an unstable short period, a drone's rate loop, a roll axis."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from rotorid_torch.core.integrate import simulate, step

SHORT_PERIOD = {"Zw": -1.4249, "Zde": -6.2632, "Mw": 0.2163, "Mq": -3.7067, "Mde": -12.784}
SPEED = 44.57  # m/s
RATE_LOOP = {"lag": 0.05, "gain": 120.0, "damping": -1.5, "bias": 0.3}
ROLL = (-1.2, -2.0, 3.0)


class Named(nn.Module):
    """Each number a parameter of its own name."""

    def __init__(self, **numbers: float) -> None:
        super().__init__()
        for name, number in numbers.items():
            setattr(self, name, nn.Parameter(torch.tensor(float(number), dtype=torch.float64)))


class ShortPeriod(Named):
    """Plunge speed w (m/s) and pitch rate q (rad/s) by elevator; outputs w, q and the specific force along z."""

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        w, q = x.unbind(-1)
        de = u[..., 0]
        return torch.stack([self.Zw * w + SPEED * q + self.Zde * de, self.Mw * w + self.Mq * q + self.Mde * de], dim=-1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        w, q = x.unbind(-1)
        return torch.stack([w, q, self.Zw * w + self.Zde * u[..., 0]], dim=-1)


class RateLoop(Named):
    """A drone's roll rate behind first-order motors; only the rate is measured, the motors' state is not."""

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        p, motor = x.unbind(-1)
        return torch.stack([self.gain * motor + self.damping * p + self.bias, (u[..., 0] - motor) / self.lag], dim=-1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x[..., :1]


class Roll(nn.Module):
    """Bank angle and roll rate, damping, stiffness and control power in one vector."""

    def __init__(self, numbers: Sequence[float] = ROLL) -> None:
        super().__init__()
        self.theta = nn.Parameter(torch.tensor(numbers, dtype=torch.float64))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        phi, p = x.unbind(-1)
        damping, stiffness, power = self.theta.unbind(-1)
        return torch.stack([p, damping * p + stiffness * phi + power * u[..., 0]], dim=-1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x


def steps(time: np.ndarray, edges: Sequence[float], signs: Sequence[float]) -> np.ndarray:
    """A multistep: signs between successive edges, zero outside."""
    place = np.searchsorted(edges, time, side="right")
    return np.concatenate([[0.0], np.asarray(signs, float), [0.0]])[np.minimum(place, len(signs) + 1)]


def unstable_flight(seconds: float, noise: Sequence[float], seed: int, dt: float = 0.05) -> dict[str, Tensor]:
    """Short period flown through a stabilising feedback, 3-2-1-1 and doublet; controls known, outputs noisy."""
    model, rng = ShortPeriod(**SHORT_PERIOD), np.random.default_rng(seed)
    time = dt * np.arange(round(seconds / dt))
    pilot = 0.05 * steps(time, (1.0, 2.5, 3.5, 4.0, 4.5), (1, -1, 1, -1)) + 0.05 * steps(time, (6.0, 7.0, 8.0), (1, -1))
    feedback = torch.tensor([0.01, 0.25], dtype=torch.float64)
    x, u = [torch.zeros(2, dtype=torch.float64)], [torch.zeros(1, dtype=torch.float64)]
    with torch.no_grad():
        for k in range(1, len(time)):
            following = (pilot[k] + feedback @ x[-1]).reshape(1)
            x.append(step(model, torch.tensor(0.0), x[-1], u[-1], following, dt))
            u.append(following)
        states, controls = torch.stack(x), torch.stack(u)
        outputs = model.output(states, controls) + torch.tensor(rng.standard_normal((len(time), 3)) * np.asarray(noise))
    return {"time": torch.tensor(time), "controls": controls, "outputs": outputs, "x0": states[0]}


def flown(model: nn.Module, time: np.ndarray, controls: np.ndarray, x0: Sequence[float]) -> tuple[Tensor, Tensor]:
    """States and outputs of a model without noise."""
    u, start = torch.as_tensor(controls), torch.tensor(x0, dtype=torch.float64)
    with torch.no_grad():
        states = simulate(model, start, u, float(time[1] - time[0]))
        output: Callable[[Tensor, Tensor], Tensor] = model.output  # type: ignore[assignment]
        return states, output(states, u)


def roll_flight(
    rng: np.random.Generator, seconds: float = 15.0, colour: float = 0.0, shift: float = 0.0
) -> dict[str, object]:
    """A noisy flight of the roll axis; residuals white or first-order autoregressive with this coefficient."""
    time = 0.05 * np.arange(round(seconds / 0.05))
    controls = 0.1 * (steps(time, (1, 2, 3), (1, -1)) + steps(time, (6 + shift, 7.5 + shift), (1,)))[:, None]
    _, clean = flown(Roll(), time, controls, (0.0, 0.0))
    noise = rng.standard_normal((len(time), 2))
    for k in range(1, len(time)):
        noise[k] = colour * noise[k - 1] + np.sqrt(1.0 - colour**2) * noise[k]
    return {"time": time, "controls": controls, "outputs": clean.numpy() + noise * (0.01, 0.02), "x0": np.zeros(2)}
