"""The model linearised at its reference: its modes, its derivatives with the rotor settled, what gusts do to it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.core.rigid import join
from rotorid_torch.effects.base import Effect, Role, Stage
from rotorid_torch.model.derivatives import FOLLOWED
from rotorid_torch.model.inflow import INDUCED
from rotorid_torch.model.model import Model

STEP = 1e-3
"""Standard errors that a parameter is moved by for the errors of what follows from the parameters."""
INFLOWS = {INDUCED: "inflow", FOLLOWED: "tail rotor's inflow"}
PHUGOID, SHORT_PERIOD, LATERAL = ("u", "theta"), ("w", "q"), ("v", "p", "r", "phi")
"""States of a kind of motion; an oscillation has the name of the kind whose states take part most."""
LONGITUDINAL = (*PHUGOID, *SHORT_PERIOD)


@dataclass(frozen=True)
class Mode:
    """An eigenvalue, 1/s, and what the field calls such a motion; of a complex pair the one with positive frequency."""

    eigenvalue: complex
    name: str


def jacobian(of: Callable[[Tensor], Tensor], at: Tensor) -> Tensor:
    """Derivatives of a function at a point."""
    matrix = torch.autograd.functional.jacobian(of, at)
    assert isinstance(matrix, Tensor)
    return matrix


def state_matrix(model: Model) -> Tensor:
    """A [nx, nx] of dx/dt = A (x - x0) at the reference."""
    x, u = model.reference_point
    return jacobian(lambda a: model.rates(model.theta.detach(), a, u), x)


def control_matrix(model: Model) -> Tensor:
    """B [nx, nu] of dx/dt = A (x - x0) + B (u - u0) at the reference."""
    x, u = model.reference_point
    return jacobian(lambda a: model.rates(model.theta.detach(), x, a), u)


@dataclass(frozen=True)
class Derivative:
    """A derivative of a force or moment on the body, "L.p", with its standard error; None where none is known."""

    name: str
    value: float
    se: float | None


def settled_derivatives(
    model: Model, names: Sequence[str] = (), covariance: Tensor | None = None
) -> tuple[Derivative, ...]:
    """Derivatives X Y Z (specific) and L M N (over inertia) by u v w, p q r and controls, with the rotor settled.

    Forces and moments F1 x + F2 y + G u, x of the body and y of rotor and inflow, dy/dt = A21 x + A22 y + B2 u:

        dF = (F1 - F2 A22^-1 A21) x + (G - F2 A22^-1 B2) u

    names, covariance : parameters and the covariance of their estimates [P, P], NaN where one is held.

    Source: Padfield, Helicopter Flight Dynamics, sec. 4.2 (six degrees of freedom, quasi-steady rotor); Tischler and
    Remple, Aircraft and Rotorcraft System Identification (2nd ed.), ch. 15 (the same of an identified hybrid model).
    """
    theta, se = model.theta.detach(), torch.zeros(len(names), dtype=torch.float64)
    rows = theta.expand(1 + len(names), -1).clone()
    if covariance is not None:
        covariance = covariance.nan_to_num(0.0)
        se = covariance.diagonal().clamp_min(0.0).sqrt()
    for k, name in enumerate(names):
        rows[1 + k, model.parameter_set.index(name)] += STEP * se[k]
    derivatives = _settled(model, rows)
    slopes = (derivatives[1:] - derivatives[:1]) / (STEP * torch.where(se > 0.0, se, 1.0))[:, None, None]
    errors = None
    if covariance is not None:
        errors = torch.einsum("kij,kl,lij->ij", slopes, covariance, slopes).clamp_min(0.0).sqrt()
    moments = MOMENTS if derivatives.shape[1] == len(MOMENTS) else (*FORCES, *MOMENTS)
    inputs = [n for n in (*VELOCITIES, *RATES) if n in model.body.states] + [*model.body.controls]
    places = [(i, j, f"{row}.{by}") for i, row in enumerate(moments) for j, by in enumerate(inputs)]
    return tuple(
        Derivative(name, float(derivatives[0, i, j]), None if errors is None else float(errors[i, j]))
        for i, j, name in places
        if bool(derivatives[:, i, j].any())
    )


def _settled(model: Model, theta: Tensor) -> Tensor:
    """Those derivatives [K, rows, inputs] at parameters theta [K, P]."""
    x, u = model.reference_point
    nx, place = len(x), model.layout.names.index

    def total(z: Tensor) -> Tensor:
        frame, rates = model.frame(theta, z[:, :nx], z[:, nx:])
        return join(*(part for part in (frame.force, frame.moment) if part is not None), rates).sum(0)

    slope = jacobian(total, torch.cat([x, u]).expand(len(theta), -1)).movedim(1, 0)
    n = len(model.body.states)
    forces = len(slope[0]) - (nx - n)
    rotor = [place(name) for k, e in enumerate(model.chain) if _of_rotor(e) for name in model.state_names(k)]
    rotor = [i for i in rotor if bool(slope[0, forces + i - n, n:nx].any())]
    inputs = [place(name) for name in (*VELOCITIES, *RATES) if name in model.layout.names]
    inputs += range(nx, nx + len(u))
    rotor_slope = slope[:, [forces + i - n for i in rotor]]
    follows = torch.linalg.pinv(rotor_slope[:, :, rotor]) @ rotor_slope[:, :, inputs]
    return slope[:, :forces][:, :, inputs] - slope[:, :forces][:, :, rotor] @ follows


def _of_rotor(effect: Effect) -> bool:
    """Whether own states of an effect are the rotor's, which settle: no load on a cable, nor what else was traced."""
    return effect.stage is Stage.ROTOR or effect.role in (Role.NOMINAL, Role.STRUCTURE)


def gust_response(model: Model) -> dict[str, float]:
    """What a gust of 1 m/s along its axis does to each accelerometer of the model, m/s2.

    Before the body moves, with the rotor's own motion settled: flapping and inflow follow within tenths of a second.
    """
    n, names, (x, u) = len(model.body.states), model.layout.names, model.reference_point
    output, matrix = jacobian(lambda a: model.outputs_at(model.theta.detach(), a, u), x), state_matrix(model)
    settled = output[:, :n] - output[:, n:] @ torch.linalg.pinv(matrix[n:, n:]) @ matrix[n:, :n]
    along = {c: v for c, v in zip(SPECIFIC_FORCES, VELOCITIES, strict=True) if v in names[:n]}
    measured = [(k, c) for k, c in enumerate(model.body.outputs) if c in along]
    return {c: abs(float(settled[k, names.index(along[c])])) for k, c in measured}


def modes(model: Model, sizes: dict[str, float]) -> list[Mode]:
    """All modes, slowest first; eigenvectors are weighed in units of the states' usual excursions `sizes`."""
    matrix, n = state_matrix(model), len(model.body.states)
    moving = [i for i in range(len(matrix)) if i < n or bool(matrix[i].any())]  # not what stays as it is
    names = [model.layout.names[i] for i in moving]
    scale = torch.tensor([max(sizes.get(n, 1.0), 1e-9) for n in names], dtype=torch.float64)
    values, vectors = torch.linalg.eig(matrix[moving][:, moving] * scale / scale[:, None])
    left = torch.linalg.pinv(vectors)
    share = (vectors * left.mT).abs()  # participation of state i in mode k
    pairs = [(v, s) for v, s in zip(values.tolist(), share.mT.tolist(), strict=True) if v.imag >= 0.0]
    named = [Mode(v, _name(v, dict(zip(names, s, strict=True)))) for v, s in pairs]
    return sorted(named, key=lambda m: abs(m.eigenvalue))


def _name(value: complex, share: dict[str, float]) -> str:
    """Name of a mode by the states that take part in it, whatever their units (participation factors)."""
    most = max(share, key=lambda n: share[n])
    if most in FLAPPING or most not in (*LONGITUDINAL, *LATERAL):
        return "flapping" if most in FLAPPING else INFLOWS.get(most, most)
    total = lambda names: sum(share.get(n, 0.0) for n in names)  # noqa: E731
    lateral = total(LATERAL) > total(LONGITUDINAL)
    if abs(value.imag) > 1e-6 * (1.0 + abs(value)):
        if most in ("p", "q") and value.real < -0.5 * abs(value):
            return "roll and pitch subsidence"
        slow = total(PHUGOID) >= total(SHORT_PERIOD)
        return "lateral oscillation" if lateral else "phugoid" if slow else "short period"
    named = {"p": "roll subsidence", "q": "pitch subsidence", "w": "heave subsidence", "r": "yaw subsidence"}
    return named.get(most, "spiral" if lateral else "speed")
