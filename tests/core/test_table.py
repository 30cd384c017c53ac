"""Table look-up against NumPy's, in torch and traced."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.native.graph.tracing import scalarise
from rotorid_torch.core.table import lookup
from rotorid_torch.errors import InputError

KNOTS = torch.tensor([-2.0, -0.5, 0.0, 1.0, 4.0], dtype=torch.float64)
VALUES = torch.tensor([1.0, 3.0, -1.0, -1.5, 2.0], dtype=torch.float64)
places = st.floats(-6.0, 6.0, allow_subnormal=False)


@given(st.lists(places, min_size=1, max_size=6))
def test_values_are_linear_between_knots_and_held_outside(x: list[float]) -> None:
    got = lookup(torch.tensor(x, dtype=torch.float64), KNOTS, VALUES)
    assert np.allclose(got.numpy(), np.interp(x, KNOTS.numpy(), VALUES.numpy()), rtol=1e-14, atol=1e-14)


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30, unique=True), st.integers(0, 1000))
def test_any_table_gives_its_values_at_its_knots(knots: list[float], seed: int) -> None:
    k = torch.tensor(sorted(knots), dtype=torch.float64)
    values = torch.randn(len(k), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    assert torch.allclose(lookup(k, k, values), values, rtol=0.0, atol=1e-13)


def test_tables_and_places_broadcast() -> None:
    x, values = torch.linspace(-3.0, 5.0, 7).double(), torch.stack([VALUES, 2.0 * VALUES, -VALUES])
    got = lookup(x, KNOTS, values.unsqueeze(1))
    assert got.shape == (3, 7)
    for row, factor in zip(got, (1.0, 2.0, -1.0), strict=True):
        assert torch.allclose(row, factor * lookup(x, KNOTS, VALUES), atol=1e-14)


def test_derivatives_by_place_and_values() -> None:
    """At a knot the slope from below, so never the sum of both."""
    x = torch.tensor([-3.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 4.0, 5.0], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(lookup(x, KNOTS, VALUES).sum(), x)
    wanted = [0.0, 0.0, 4 / 3, 4 / 3, -8.0, -0.5, -0.5, 3.5 / 3, 0.0]
    assert torch.allclose(slope, torch.tensor(wanted, dtype=torch.float64), atol=1e-14)
    assert torch.autograd.gradcheck(
        lambda v: lookup(torch.tensor([-9.0, 0.3, 2.5]).double(), KNOTS, v), VALUES.clone().requires_grad_()
    )


@pytest.mark.parametrize("x", [-3.0, -2.0, -0.7, 0.0, 0.25, 1.0, 3.9, 4.0, 7.0])
def test_native_code_gives_the_same_values_and_derivatives(x: float) -> None:
    def f(place: Tensor, theta: Tensor) -> Tensor:
        return torch.stack([lookup(place[..., 0], KNOTS, VALUES * theta), lookup(2.0 * place[..., 0], KNOTS, VALUES)])

    graph, theta = Graph(), 1.0 + 0.1 * VALUES
    nodes = scalarise(graph, f, {"x": torch.tensor([0.3]).double(), "th": theta})
    at = {"x": [x], "th": theta.tolist()}
    place = torch.tensor([x], dtype=torch.float64)
    assert graph.evaluated(nodes, at) == pytest.approx(f(place, theta).tolist(), abs=1e-13)
    by_place, by_theta = torch.autograd.functional.jacobian(f, (place, theta))
    for i, node in enumerate(nodes):
        slopes = graph.gradient(node)
        values = dict(zip(slopes, graph.evaluated(list(slopes.values()), at), strict=True))
        for name, wanted in (("x", by_place[i]), ("th", by_theta[i])):
            got = [values.get(graph.input(name, k), 0.0) for k in range(len(wanted))]
            assert got == pytest.approx(wanted.tolist(), abs=1e-13)


def test_a_place_that_is_not_a_number_gives_none() -> None:
    assert lookup(torch.tensor(torch.nan).double(), KNOTS, VALUES).isnan()


@pytest.mark.parametrize(
    ("knots", "values", "word"),
    [
        ([0.0, 2.0, 1.0], [1.0, 1.0, 1.0], "knots: are"),
        ([0.0], [1.0], "knots: are"),
        ([0.0, 1.0], [1.0, 1.0, 1.0], r"values: have shape \(3,\)"),
    ],
)
def test_wrong_tables_are_told(knots: list[float], values: list[float], word: str) -> None:
    with pytest.raises(InputError, match=word):
        lookup(torch.zeros(()), torch.tensor(knots), torch.tensor(values))
