"""The model linearised at its reference: its modes, with the field's names for them, and what gusts do to it."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.names import FLAPPING, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.model.derivatives import FOLLOWED
from rotorid_torch.model.inflow import INDUCED
from rotorid_torch.model.model import Model

SLOW = 1.0
"""rad/s: a longitudinal oscillation slower than this is the phugoid, a faster one the short period."""
INFLOWS = {INDUCED: "inflow", FOLLOWED: "tail rotor's inflow"}
LONGITUDINAL, LATERAL = ("u", "w", "q", "theta"), ("v", "p", "r", "phi")


@dataclass(frozen=True)
class Mode:
    """An eigenvalue, 1/s, and what the field calls such a motion; of a complex pair the one with positive frequency."""

    eigenvalue: complex
    name: str


def _by_state(model: Model, of: Callable[[Tensor, Tensor, Tensor], Tensor]) -> Tensor:
    """Derivatives by the states, at the reference, of what the model makes of theta, states and controls."""
    x, u = model.reference_point
    theta = model.theta.detach()
    jacobian = torch.autograd.functional.jacobian(lambda a: of(theta, a, u), x)
    assert isinstance(jacobian, Tensor)
    return jacobian


def state_matrix(model: Model) -> Tensor:
    """A [nx, nx] of dx/dt = A (x - x0) at the reference."""
    return _by_state(model, model.rates)


def control_matrix(model: Model) -> Tensor:
    """B [nx, nu] of dx/dt = A (x - x0) + B (u - u0) at the reference."""
    x, u = model.reference_point
    theta = model.theta.detach()
    jacobian = torch.autograd.functional.jacobian(lambda a: model.rates(theta, x, a), u)
    assert isinstance(jacobian, Tensor)
    return jacobian


def gust_response(model: Model) -> dict[str, float]:
    """What a gust of 1 m/s along its axis does to each accelerometer of the model, m/s2.

    Before the body moves, with the rotor's own motion settled: flapping and inflow follow within tenths of a second.
    """
    n, names = len(model.body.states), model.layout.names
    output, matrix = _by_state(model, model.outputs_at), state_matrix(model)
    settled = output[:, :n] - output[:, n:] @ torch.linalg.pinv(matrix[n:, n:]) @ matrix[n:, :n]
    along = dict(zip(SPECIFIC_FORCES, VELOCITIES, strict=True))
    return {
        c: abs(float(settled[k, names.index(along[c])]))
        for k, c in enumerate(model.body.outputs)
        if c in along and along[c] in names[:n]
    }


def modes(model: Model, sizes: dict[str, float]) -> list[Mode]:
    """All modes, slowest first; eigenvectors are weighed in units of the states' usual excursions `sizes`."""
    matrix, n = state_matrix(model), len(model.body.states)
    moving = [i for i in range(len(matrix)) if i < n or bool(matrix[i].any())]  # not what stays as it is
    names = [model.layout.names[i] for i in moving]
    scale = torch.tensor([max(sizes.get(n, 1.0), 1e-9) for n in names], dtype=torch.float64)
    values, vectors = torch.linalg.eig(matrix[moving][:, moving] * scale / scale[:, None])
    left = torch.linalg.pinv(vectors)
    share = (vectors * left.mT).abs()  # participation of state i in mode k
    unnamed = [
        Mode(complex(v), _name(complex(v), dict(zip(names, share[:, k].tolist(), strict=True))))
        for k, v in enumerate(values)
    ]
    return sorted((m for m in unnamed if m.eigenvalue.imag >= 0.0), key=lambda m: abs(m.eigenvalue))


def _name(value: complex, share: dict[str, float]) -> str:
    most = max(share, key=lambda n: share[n])
    if most in FLAPPING or most not in (*LONGITUDINAL, *LATERAL):
        return "flapping" if most in FLAPPING else INFLOWS.get(most, most)
    total = lambda names: sum(share.get(n, 0.0) for n in names)  # noqa: E731
    lateral = total(LATERAL) > total(LONGITUDINAL)
    if abs(value.imag) > 1e-6 * (1.0 + abs(value)):
        if most in ("p", "q") and value.real < -0.5 * abs(value):
            return "roll and pitch subsidence"
        return "lateral oscillation" if lateral else "phugoid" if abs(value) < SLOW else "short period"
    named = {"p": "roll subsidence", "q": "pitch subsidence", "w": "heave subsidence", "r": "yaw subsidence"}
    return named.get(most, "spiral" if lateral else "speed")
