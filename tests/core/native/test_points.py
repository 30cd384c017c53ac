"""Functions at many points in native code, against torch."""

import pytest
import torch
from torch import Tensor

from rotorid_torch.core.native.points import PointFunction
from rotorid_torch.errors import Unsupported

THETA = torch.tensor([0.7, -1.3, 2.1, 0.4], dtype=torch.float64)


def function(x: Tensor, u: Tensor, theta: Tensor) -> Tensor:
    """Two entries: one by the first two parameters, one by the third; the fourth is in neither."""
    wave = torch.sin(theta[0] * x[..., 0]) + theta[1] ** 2 * u[..., 0]
    return torch.stack([wave, torch.exp(-theta[2] * x[..., 1].square()) * x[..., 0]], dim=-1)


def points(count: int) -> tuple[Tensor, Tensor]:
    """Points by chance."""
    generator = torch.Generator().manual_seed(count)
    x, u = (torch.randn(count, n, generator=generator, dtype=torch.float64) for n in (2, 1))
    return x, u


@pytest.mark.parametrize("count", [1, 3, 8, 21])
def test_values_and_derivatives_are_those_of_torch(count):
    x, u = points(count)
    compiled = PointFunction.of(function, x[0], u[0], THETA)
    values, slopes = compiled(THETA, x, u, places=(2, 0, 3))
    jacobian = torch.func.jacfwd(lambda theta: function(x, u, theta))(THETA)
    torch.testing.assert_close(values.mT, function(x, u, THETA), rtol=1e-13, atol=1e-14)
    torch.testing.assert_close(slopes, jacobian.movedim(-1, 0).mT[[2, 0, 3]], rtol=1e-12, atol=1e-13)
    torch.testing.assert_close(compiled(THETA, x, u)[0], values, rtol=1e-14, atol=0.0)


def test_a_parameter_that_is_not_in_the_function_has_no_derivative():
    x, u = points(5)
    compiled = PointFunction.of(function, x[0], u[0], THETA)
    assert {place for _, place in compiled.slopes} == {0, 1, 2}
    assert not compiled(THETA, x, u, places=(3,))[1].any()


def test_a_function_that_branches_is_refused():
    x, u = points(1)
    with pytest.raises(Unsupported):
        PointFunction.of(lambda x, u, theta: x if x[0] > 0 else -x, x[0], u[0], THETA)
