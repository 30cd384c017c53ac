"""Expressions as C++: numbers are data, what does not vary is computed once, conditions hold in lanes."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from rotorid_torch.core.native.dynamics import Dynamics
from rotorid_torch.core.native.graph import emit
from rotorid_torch.core.native.graph.emit import SHARED, Constants, straight_line
from rotorid_torch.core.native.graph.symbols import Graph, Term


@pytest.fixture
def graph() -> Graph:
    return Graph()


def terms(graph: Graph, name: str, count: int) -> list[Term]:
    return [Term(graph, graph.input(name, k)) for k in range(count)]


def test_what_does_not_vary_is_computed_once_before_the_loop(graph: Graph) -> None:
    (x,), (a, b) = terms(graph, "x", 1), terms(graph, SHARED, 2)
    constants = Constants(graph, 2)
    body = straight_line(graph, {"out[0]": ((a * b).to("sin") * x).node}, constants.name)
    assert body.splitlines()[-2:] == [
        f"  const T t{len(graph.nodes) - 1} = {order(graph, 'c[0]', 'x[0]')};",
        last(graph),
    ]
    assert "sin" not in body.lower()
    assert "sin" in constants.prepare()
    assert "NC = 1" in constants.prepare()


def order(graph: Graph, shared: str, varies: str) -> str:
    """The product's arguments stand by their numbers."""
    first = graph.operation(graph.arguments(len(graph.nodes) - 1)[0])
    return f"{varies} * {shared}" if first == "input" else f"{shared} * {varies}"


def last(graph: Graph) -> str:
    return f"  out[0] = t{len(graph.nodes) - 1};"


def test_numbers_are_data_but_for_plain_ones() -> None:
    bodies = []
    for number in (0.37, 41.5):
        graph = Graph()
        (x,) = terms(graph, "x", 1)
        constants = Constants(graph, 3)
        bodies.append(straight_line(graph, {"out[0]": (2.0 * x + number).node}, constants.name) + constants.prepare())
        assert constants.numbers().tolist() == [number]
    assert bodies[0] == bodies[1]
    assert "th[3]" in bodies[0]
    assert "2.0" in bodies[0]


def test_sine_and_cosine_of_an_angle_come_together(graph: Graph) -> None:
    (x,) = terms(graph, "x", 1)
    body = straight_line(graph, {"out[0]": (x.to("sin") * x.to("cos")).node}, lambda node: None)
    assert body.count("SinCos") == 1


def test_only_what_results_need_is_written(graph: Graph) -> None:
    (x,) = terms(graph, "x", 1)
    x.to("exp")
    assert "exp" not in straight_line(graph, {"out[0]": x.to("tanh").node}, lambda node: None)


def test_one_value_for_all_lanes_becomes_a_vector(graph: Graph) -> None:
    (x,), (a,) = terms(graph, "x", 1), terms(graph, SHARED, 1)
    constants = Constants(graph, 1)
    assert straight_line(graph, {"out[0]": a.node}, constants.name) == "  out[0] = (T() + c[0]);"
    assert straight_line(graph, {"out[0]": a.node}, constants.name, "double") == "  out[0] = c[0];"
    assert "F_maximum(x[0], (T() + c[0]))" in straight_line(graph, {"o": x.to("maximum", a).node}, constants.name)


def outputs(x: Tensor, u: Tensor, theta: Tensor) -> Tensor:
    """Every operation whose arguments must be alike, with one that varies and one that does not."""
    a, b = theta[0], theta[1]
    return torch.stack(
        [
            torch.where(a > 0.0, x[0], x[1]),
            torch.where(b > a, 1.5, x[1]),
            torch.where((x[0] > a) & (b < 0.0), a, x[1]),
            x[0].maximum(a) + a.minimum(x[1]) + x[2].clamp(min=a) + x[2].clamp(-0.3, 0.2),
            torch.atan2(a, x[0]) + torch.atan2(x[1], b),
            x[0].abs() ** a + a ** x[1] + x[2].abs() ** 2.5,
            (x[0] > b) * x[1] + (a > 0.0) * x[2] + (x[0] > x[1]).double(),
            torch.where(x[2] > math.inf, x[0], -1e300 * x[1]) + 1e-300 * x[0],
            a * b + 0.0 * x[0],
            torch.full_like(a, -7.25),
            torch.log(-a.abs()) + x[0],
            x[0].neg().neg() - (-2.0) * x[1],
            x[2].sin() + (x[0] * x[1]).cos(),
            x[2].cos() * (x[0] * x[1]).sin(),
            torch.where(x[0] > x[1], a, x[2].sin()),
        ]
    )


@pytest.mark.parametrize("part", [emit.PART, 20, 3, 1])
def test_what_varies_and_what_does_not_go_together_in_lanes(part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emit, "PART", part)
    generator = torch.Generator().manual_seed(3)
    x = torch.randn(11, 3, generator=generator, dtype=torch.float64)
    theta = torch.tensor([0.4, -0.7], dtype=torch.float64)
    u = torch.zeros(0, dtype=torch.float64)
    model = Dynamics.of(lambda x, u, theta: (0.0 * x, outputs(x, u, theta)), x[0], u, theta)
    for values in (theta, torch.tensor([0.9, 1.3], dtype=torch.float64)):
        _, got = model.simulate(values, x, torch.zeros(11, 1, 0).double(), 0.1)
        wanted = torch.stack([outputs(row, u, values) for row in x])
        assert torch.allclose(got[:, 0], wanted, rtol=1e-14, atol=1e-14, equal_nan=True)


def test_a_long_sum_of_parameters_is_a_constant():
    """As of a wide layer of a network: longer than Python's calls may be nested."""
    graph, count = Graph(), 3000
    total, varying = graph.input(SHARED, 0), graph.input("x", 0)
    for place in range(1, count):
        total = graph.apply("add", total, graph.input(SHARED, place))
        varying = graph.apply("add", varying, graph.input(SHARED, place))
    constants = Constants(graph, count)
    assert constants.shared(total)
    assert not constants.shared(varying)
