"""Derivatives of native trajectories, carried back through their steps, against torch's own."""

from __future__ import annotations

import itertools

import pytest
import torch
from torch import Tensor

from rotorid_torch.core import integrate
from rotorid_torch.core.native.adjoint import Adjoint, trajectories
from rotorid_torch.core.native.dynamics import Dynamics, LinearProblem
from rotorid_torch.errors import InputError
from tests.core.native.test_dynamics import DT, THETA, draw, dynamics, reference, starts, sticks


@pytest.mark.parametrize("flights", [1, 11])
@pytest.mark.parametrize("samples", [1, 2, 80])
def test_derivatives_are_those_of_torch(flights: int, samples: int) -> None:
    """By parameters, initial states and controls, whatever the cost asks of states and outputs."""
    leaves = [v.clone().requires_grad_() for v in (THETA, starts(flights), sticks(flights, samples))]
    theta, x0, controls = leaves
    mine, true = trajectories(Adjoint(dynamics()), theta, x0, controls, DT), reference(x0, controls, theta)
    weights = [draw(40 + k, *part.shape) for k, part in enumerate(true)]
    got, wanted = (
        torch.autograd.grad([(p * w).sum() for p, w in zip(parts, weights, strict=True)], leaves)
        for parts in (mine, true)
    )
    for g, w in zip(got, wanted, strict=True):
        assert (g - w).abs().max() < 1e-12 * w.abs().max()


def test_the_number_of_threads_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    gradients = []
    for threads in ("1", "3"):
        monkeypatch.setenv("ROTORID_THREADS", threads)
        theta = THETA.clone().requires_grad_()
        _, outputs = trajectories(Adjoint(dynamics()), theta, starts(40), sticks(40, 30), DT)
        gradients += torch.autograd.grad(outputs.square().sum(), theta)
    assert torch.equal(*gradients)


def test_nothing_is_differentiated_twice() -> None:
    theta = THETA.clone().requires_grad_()
    _, outputs = trajectories(Adjoint(dynamics()), theta, starts(2), sticks(2, 10), DT)
    cost = outputs.square().sum() + theta.pow(3).sum()  # what has second derivatives beside it
    with pytest.raises(InputError, match="first derivatives alone"):
        torch.autograd.grad(cost, theta, create_graph=True)


SIZES = (3, 12, 8, 2)
"""Layers of a network with more products than are written line by line."""


def dense(x: Tensor, theta: Tensor) -> Tensor:
    """The network of all weights in a vector."""
    first, value = 0, x
    for inputs, outputs in itertools.pairwise(SIZES):
        weight = theta[first : first + inputs * outputs].view(outputs, inputs)
        first += inputs * outputs
        value = (value @ weight.mT + theta[first : first + outputs]).tanh()
        first += outputs
    return value


def dense_motion(x: Tensor, u: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
    force = dense(torch.cat([x, u], dim=-1), theta)
    return torch.stack([x[..., 1], -x[..., 0] + force[..., 0]], dim=-1), force + x


def test_a_network_of_many_weights_has_torchs_derivatives() -> None:
    """In reverse, and forward as the rows of a fit."""
    count, (flights, samples) = sum((a + 1) * b for a, b in itertools.pairwise(SIZES)), (3, 25)
    leaves = [0.5 * draw(50, count), draw(51, flights, 2), draw(52, flights, samples, 1)]
    theta, x0, controls = (v.requires_grad_() for v in leaves)
    native = Dynamics.of(dense_motion, draw(53, 2), draw(54, 1), draw(55, count))
    states = integrate.simulate(lambda t, x, u: dense_motion(x, u, theta)[0], x0, controls, DT)
    true, weights = dense_motion(states, controls, theta)[1], draw(56, flights, samples, 2)
    wanted = torch.autograd.grad((true * weights).sum(), [theta, x0, controls])
    _, outputs = trajectories(Adjoint(native), theta, x0, controls, DT)
    got = torch.autograd.grad((outputs * weights).sum(), [theta, x0, controls])
    for g, w in zip(got, wanted, strict=True):
        assert (g - w).abs().max() < 1e-12 * w.abs().max()
    problem = LinearProblem(
        dt=DT,
        length=torch.full((flights,), samples, dtype=torch.int32),
        controls=controls.detach(),
        path=torch.zeros(0),
        residual=torch.zeros(flights, samples, 2, dtype=torch.float64),
        x0=x0.detach(),
        theta=theta.detach(),
        weight=torch.ones(2, dtype=torch.float64),
    )
    columns = (native.whitened_rows(problem) * weights.reshape(flights, -1, 1)).sum(dim=1)
    assert (columns[:, 2:-1].sum(dim=0) - wanted[0]).abs().max() < 1e-12 * wanted[0].abs().max()
    assert (columns[:, :2] - wanted[1]).abs().max() < 1e-12 * wanted[1].abs().max()
