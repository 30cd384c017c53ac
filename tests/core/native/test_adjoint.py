"""Derivatives of native trajectories, carried back through their steps, against torch's own."""

from __future__ import annotations

import pytest
import torch

from rotorid_torch.core.native.adjoint import Adjoint, trajectories
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
    (slope,) = torch.autograd.grad(outputs.square().sum(), theta, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()
