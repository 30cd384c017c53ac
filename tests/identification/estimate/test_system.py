"""The control path's derivatives: those of differences, by the parameters that reach it alone."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from rotorid_torch.effects.signal_operations import lagged, rate_limited
from rotorid_torch.identification.estimate.system import System

DT = 0.02


class Path(nn.Module):
    """A control path of two parts, beside a parameter of the rates."""

    def __init__(self) -> None:
        super().__init__()
        self.damping = nn.Parameter(torch.tensor(-1.0))
        self.lag = nn.Parameter(torch.tensor(0.07))
        self.inverse = nn.Parameter(torch.tensor([0.4, 0.1]))

    def tape(self, controls: Tensor, dt: float) -> Tensor:
        return rate_limited(lagged(controls, self.lag.expand(2), dt), self.inverse, dt)

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        return self.damping * x + u.sum(-1, keepdim=True)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        return x


def record() -> Tensor:
    return torch.randn(3, 50, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64).cumsum(-2)


@pytest.mark.parametrize("free", [["damping", "lag", "inverse"], ["inverse[1]", "damping"]])
def test_slopes_of_the_control_path_are_those_of_differences(free: list[str]):
    system, controls = System(Path(), free), record()
    which, slopes = system.tape_jacobian(system.theta, controls, DT)
    assert [system.names[k] for k in which] == [n for n in system.names if n != "damping"]
    for k, column in zip(which.tolist(), slopes.unbind(-1), strict=True):
        step = 1e-6 * torch.eye(len(system.theta), dtype=torch.float64)[k]
        ahead, behind = (system.tape(system.theta + s, controls, DT) for s in (step, -step))
        torch.testing.assert_close(column, (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-6)


def test_a_control_path_that_is_held_has_no_slopes():
    which, slopes = System(Path(), ["damping"]).tape_jacobian(torch.tensor([-1.0]).double(), record(), DT)
    assert which.tolist() == []
    assert slopes.shape == (3, 50, 2, 0)
