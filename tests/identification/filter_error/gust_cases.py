"""Systems flown in moving air: a roll axis and a transport's roll and yaw, linear and exactly; a jet's pitch plane."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from scipy.linalg import expm
from torch import Tensor, nn

from tests.identification.estimate.output_error_cases import ROLL, Named, steps

LATERAL = {
    **{"Lp": -5.82, "Lr": 1.782, "Lda": -16.4, "Ldr": 0.434, "Lv": -0.097},
    **{"Np": -0.665, "Nr": -0.712, "Nda": -0.428, "Ndr": -2.82, "Nv": 0.0084},
    **{"Yp": -0.278, "Yr": 1.41, "Yda": -0.447, "Ydr": 2.66, "Yv": -0.18},
}
BIASES = {"L0": 0.02, "N0": -0.01, "bpdot": 0.03, "brdot": -0.01, "bay": 0.05}
LATERAL_GUSTS, LATERAL_NOISE = (0.3, 0.08), (0.05, 0.02, 0.05, 0.005, 0.003)


class Lateral(Named):
    """Roll and yaw rate by aileron, rudder and lateral velocity; outputs pdot, rdot, ay, p, r."""

    states = ("p", "r")

    def moments(self, x: Tensor, u: Tensor) -> Tensor:
        """Angular accelerations."""
        (p, r), (da, dr, v) = x.unbind(-1), u.unbind(-1)
        roll = self.L0 + self.Lp * p + self.Lr * r + self.Lda * da + self.Ldr * dr + self.Lv * v
        yaw = self.N0 + self.Np * p + self.Nr * r + self.Nda * da + self.Ndr * dr + self.Nv * v
        return torch.stack([roll, yaw], dim=-1)

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.moments(x, u)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        (p, r), (da, dr, v) = x.unbind(-1), u.unbind(-1)
        pdot, rdot = self.moments(x, u).unbind(-1)
        ay = self.Yp * p + self.Yr * r + self.Yda * da + self.Ydr * dr + self.Yv * v
        return torch.stack([pdot + self.bpdot, rdot + self.brdot, ay + self.bay, p, r], dim=-1)


def linear_motion(
    A: np.ndarray, B: np.ndarray, Q: np.ndarray, u: np.ndarray, dt: float, rng: np.random.Generator
) -> np.ndarray:
    """States [T, nx] of dx = (A x + B u) dt + dw from rest, exactly, controls linear between samples.

    Q : spectral density of the noise. Source: Van Loan (1978), IEEE Trans. Autom. Control 23.
    """
    n, m = B.shape
    big = np.zeros((n + 2 * m, n + 2 * m))
    big[:n, :n], big[:n, n : n + m], big[n : n + m, n + m :] = A, B, np.eye(m) / dt
    whole = expm(big * dt)[:n]
    pair = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * dt)
    covariance = pair[n:, n:].T @ pair[:n, n:]
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    x = np.zeros((len(u), n))
    for k in range(len(u) - 1):
        x[k + 1] = whole @ np.concatenate([x[k], u[k], u[k + 1] - u[k]]) + root @ rng.standard_normal(n)
    return x


def gusty_roll(
    rng: np.random.Generator,
    seconds: float = 15.0,
    gusts: Sequence[float] = (0.0, 0.1),
    noise: Sequence[float] = (0.01, 0.02),
    shift: float = 0.0,
) -> dict[str, Any]:
    """The roll axis of `output_error_cases` with noise in its rates."""
    time = 0.05 * np.arange(round(seconds / 0.05))
    controls = 0.1 * (steps(time, (1, 2, 3), (1, -1)) + steps(time, (6 + shift, 7.5 + shift), (1,)))[:, None]
    A, B = np.array([[0.0, 1.0], [ROLL[1], ROLL[0]]]), np.array([[0.0], [ROLL[2]]])
    states = linear_motion(A, B, np.diag(np.square(gusts)), controls, 0.05, rng)
    outputs = states + np.asarray(noise) * rng.standard_normal(states.shape)
    return {"time": time, "controls": controls, "outputs": outputs, "x0": np.zeros(2)}


def lateral_model(factor: float = 1.0) -> nn.Module:
    """The model with all derivatives times a factor, without biases."""
    return Lateral(**{name: factor * value for name, value in LATERAL.items()}, **dict.fromkeys(BIASES, 0.0))


def lateral_flight(
    rng: np.random.Generator, seconds: float = 16.0, gusts: Sequence[float] = LATERAL_GUSTS
) -> dict[str, Any]:
    """Aileron and rudder multisteps in turbulence at 20 Hz; lateral velocity is measured and taken as a control."""
    dt = 0.05
    time = dt * np.arange(round(seconds / dt) + 1)
    aileron = 0.04 * (steps(time, (1, 2.4, 3.4, 3.9, 4.4), (1, -1, 1, -1)) + steps(time, (10.5, 11.5, 12.5), (1, -1)))
    rudder = 0.06 * (steps(time, (6, 7, 8), (-1, 1)) + steps(time, (13, 14, 14.7), (1, -1)))
    v = np.zeros_like(time)
    for k in range(len(time) - 1):
        v[k + 1] = 0.96 * v[k] + 2.0 * rudder[k] + 0.3 * rng.standard_normal()
    u = np.stack([aileron, rudder, v], axis=-1)
    truth = Lateral(**LATERAL, **BIASES)
    with torch.no_grad():
        x, one = torch.eye(2, dtype=torch.float64), torch.eye(3, dtype=torch.float64)
        still = truth.moments(0.0 * x[0], 0.0 * one[0])
        A = (truth.moments(x, torch.zeros(2, 3)) - still).T.numpy()
        B = torch.cat([truth.moments(torch.zeros(3, 2), one) - still, still[None]]).T.numpy()
        constant = np.concatenate([u, np.ones((len(time), 1))], axis=1)
        states = linear_motion(A, B, np.diag(np.square(gusts)), constant, dt, rng)
        outputs = truth.output(torch.as_tensor(states), torch.as_tensor(u)).numpy()
    outputs = outputs + np.asarray(LATERAL_NOISE) * rng.standard_normal(outputs.shape)
    return {"time": time, "controls": u, "outputs": outputs, "x0": np.zeros(2)}


JET = {
    **{"CD0": 0.12, "CDV": -0.06, "CDa": 0.32, "CL0": -0.09, "CLV": 0.15, "CLa": 4.33},
    **{"Cm0": 0.11, "CmV": 0.004, "Cma": -0.97, "Cmq": -34.7, "Cmde": -1.53},
}
"""Coefficients of the size that flights of a business jet give."""
JET_GUSTS, JET_NOISE = (0.3, 0.003, 0.0, 0.004), (0.15, 0.002, 0.002, 0.001, 0.006, 0.05, 0.08)
JET_LIFT, JET_PITCH, JET_SPEED, JET_MASS, TILT, GRAVITY = 0.0016, 3.17e-4, 105.0, 7470.0, 0.05, 9.81


class Jet(Named):
    """Speed, incidence, pitch angle and rate by elevator and thrust; outputs these, pitch acceleration, ax, az."""

    states = ("V", "alpha", "theta", "q")

    def coefficients(self, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Drag and lift, m/s2, and pitch acceleration."""
        (V, a, _, q), (de, thrust) = x.unbind(-1), u.unbind(-1)
        v, square = V / JET_SPEED, V * V
        drag = JET_LIFT * square * (self.CD0 + self.CDV * v + self.CDa * a)
        lift = JET_LIFT * square * (self.CL0 + self.CLV * v + self.CLa * a)
        moment = self.Cm0 + self.CmV * v + self.Cma * a + self.Cmq * q * 1.2 / JET_SPEED + self.Cmde * de
        return drag, lift, JET_PITCH * square * moment - 7e-6 * thrust

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        (V, a, theta, q), push = x.unbind(-1), u[..., 1] / JET_MASS
        drag, lift, pitch = self.coefficients(x, u)
        speed = -drag + push * torch.cos(a + TILT) + GRAVITY * torch.sin(a - theta)
        turn = (-lift - push * torch.sin(a + TILT) + GRAVITY * torch.cos(a - theta)) / V
        return torch.stack([speed, turn + q, q, pitch], dim=-1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        a, push = x[..., 1], u[..., 1] / JET_MASS
        drag, lift, pitch = self.coefficients(x, u)
        ax = lift * torch.sin(a) - drag * torch.cos(a) + push
        az = -lift * torch.cos(a) - drag * torch.sin(a) - TILT * push
        return torch.cat([x, torch.stack([pitch, ax, az], dim=-1)], dim=-1)


def jet_flight(rng: np.random.Generator, seconds: float = 60.0, substeps: int = 10) -> dict[str, Any]:
    """A multistep of the elevator and a doublet in turbulence at 10 Hz, near trim; controls linear between samples."""
    dt, truth = 0.1, Jet(**JET)
    time = dt * np.arange(round(seconds / dt))
    elevator = 0.012 * steps(time, (2, 5, 7, 8, 9), (1, -1, 1, -1)) + 0.008 * steps(time, (25, 27, 29), (1, -1))
    u = torch.as_tensor(np.stack([elevator - 0.0106, np.full_like(time, 12800.0)], axis=-1))
    x, h = torch.tensor([106.0, 0.108, 0.108, 0.0], dtype=torch.float64), dt / substeps
    states = [x]
    with torch.no_grad():
        for k in range(len(time) - 1):
            for j in range(substeps):
                now = u[k] + (u[k + 1] - u[k]) * (j + 0.5) / substeps
                middle = x + 0.5 * h * truth(0.0, x, now)
                x = x + h * truth(0.0, middle, now) + h**0.5 * torch.as_tensor(rng.standard_normal(4) * JET_GUSTS)
            states.append(x)
        outputs = truth.output(torch.stack(states), u).numpy()
    outputs = outputs + rng.standard_normal(outputs.shape) * JET_NOISE
    return {"time": time, "controls": u.numpy(), "outputs": outputs, "x0": states[0].numpy()}
