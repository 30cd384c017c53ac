"""Derivatives of traced functions, where their columns lie, and that only what is not zero is written."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from rotorid_torch.core.native.dynamics import traced
from rotorid_torch.core.native.graph.derivatives import Columns, Tangent, derivatives
from rotorid_torch.core.native.graph.emit import SHARED, Constants
from rotorid_torch.core.native.graph.symbols import Graph
from tests.core.native.graph.evaluation import listed

X, U, THETA = (torch.tensor(v, dtype=torch.float64) for v in ([0.3, -0.8, 1.2], [0.5], [0.7, -1.1, 2.0, 0.4]))


def rates(x: Tensor, u: Tensor, theta: Tensor) -> Tensor:
    return torch.stack([theta[0] * x[1].sin() + x[2], theta[1] * x[0] * u[0] + theta[0], -x[2] * theta[3].exp()])


def test_derivatives_are_exact_and_sparse() -> None:
    graph = Graph()
    rows = derivatives(graph, traced(graph, rates, X, U, THETA))
    inputs = {"x": X, "u": U, SHARED: THETA}
    exact = dict(zip(inputs, torch.func.jacrev(rates, argnums=(0, 1, 2))(X, U, THETA), strict=True))
    for i, row in enumerate(rows):
        found = dict(zip(row, graph.evaluated(list(row.values()), listed(inputs)), strict=True))
        for name, jacobian in exact.items():
            for k, slope in enumerate(jacobian[i].tolist()):
                assert abs(found.get((name, k), 0.0) - slope) < 1e-15
    assert [set(row) for row in rows] == [
        {("x", 1), ("x", 2), (SHARED, 0)},
        {("x", 0), ("u", 0), (SHARED, 0), (SHARED, 1)},
        {("x", 2), (SHARED, 3)},
    ]


def test_only_what_is_not_zero_is_written() -> None:
    graph = Graph()
    constants = Constants(graph, 4)
    results = traced(graph, rates, X, U, THETA)
    columns = Columns.arranged([derivatives(graph, results)], 4, (), 3, 4)
    text = Tangent(graph, "rates", results, columns, constants).text()
    by_state = text[text.index("rates_by_state") : text.index("rates_by_control")].splitlines()[1:4]
    assert [line.count("D[") for line in by_state] == [2, 1, 1]
    assert "* D[2]" not in by_state[0], "a derivative of one needs no product"
    assert "* D[2]" in by_state[2]
    assert "c[" in by_state[2], "minus exp(th3) does not vary"
    by_control = text[text.index("rates_by_control") :].splitlines()[1:4]
    assert [line.count("U[") for line in by_control] == [0, 1, 0]


@given(
    st.integers(0, 9).flatmap(lambda n: st.tuples(st.just(n), st.sets(st.integers(0, max(n - 1, 0)), max_size=n))),
    st.integers(0, 6),
    st.sampled_from([2, 4, 8]),
    st.integers(0, 100),
)
def test_every_unknown_has_a_column_of_its_own(
    chosen: tuple[int, set[int]], starts: int, width: int, seed: int
) -> None:
    count, on_path = chosen[0], sorted(p for p in chosen[1] if p < chosen[0])
    generator = torch.Generator().manual_seed(seed)
    reach = (torch.rand(3, count, generator=generator) < 0.4).tolist()
    rows = [{(SHARED, p): 0 for p in range(count) if reached[p]} for reached in reach]
    c = Columns.arranged([rows], count, on_path, starts, width)
    starting = range(c.loop + c.path, c.loop + c.path + c.starts)
    taken = [*c.parameters, *starting, c.residual]
    assert len(set(taken)) == len(taken) == count + starts + 1
    assert min(taken) >= 0
    assert max(taken) < c.total
    assert c.total % width == c.loop % width == c.path % width == 0
    assert [c.loop <= c.parameters[p] < c.loop + c.path for p in range(count)] == [p in on_path for p in range(count)]
    assert c.total - len(taken) < 3 * width, "no more room than filling up needs"


def test_parameters_with_the_same_results_lie_beside_each_other() -> None:
    rows = [{(SHARED, p): 0 for p in (0, 2, 4)}, {(SHARED, p): 0 for p in (1, 3, 5)}]
    c = Columns.arranged([rows], 6, (), 0, 2)
    first, second = ({c.parameters[p] for p in group} for group in ((0, 2, 4), (1, 3, 5)))
    assert max(first) < min(second) or max(second) < min(first)
