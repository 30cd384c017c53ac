"""Folding, sharing and exact derivatives of expressions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch.core.native.graph.symbols import Graph, Term


@pytest.fixture
def graph() -> Graph:
    return Graph()


def test_what_is_there_is_not_made_again(graph: Graph) -> None:
    a, b = graph.input("x", 0), graph.input("x", 1)
    assert graph.input("x", 0) == a
    assert graph.apply("add", a, b) == graph.apply("add", b, a)
    assert graph.apply("mul", a, b) == graph.apply("mul", b, a)
    assert graph.apply("sub", a, b) != graph.apply("sub", b, a)
    count = len(graph.nodes)
    graph.apply("sin", graph.apply("add", b, a))
    assert len(graph.nodes) == count + 1


@pytest.mark.parametrize(
    ("rule", "simple"),
    [
        (lambda a, b: a + 0.0, lambda a, b: a),
        (lambda a, b: 0.0 + a, lambda a, b: a),
        (lambda a, b: a - 0.0, lambda a, b: a),
        (lambda a, b: 0.0 - a, lambda a, b: -a),
        (lambda a, b: a - a, lambda a, b: 0.0),
        (lambda a, b: a * 1.0, lambda a, b: a),
        (lambda a, b: a * 0.0, lambda a, b: 0.0),
        (lambda a, b: -1.0 * a, lambda a, b: -a),
        (lambda a, b: a / 4.0, lambda a, b: a * 0.25),
        (lambda a, b: 0.0 / a, lambda a, b: 0.0),
        (lambda a, b: (-a).to("neg"), lambda a, b: a),
        (lambda a, b: a + (-b), lambda a, b: a - b),
        (lambda a, b: (-a) + b, lambda a, b: b - a),
        (lambda a, b: a - (-b), lambda a, b: a + b),
        (lambda a, b: (-a) * b, lambda a, b: -(a * b)),
        (lambda a, b: (-a) * (-b), lambda a, b: a * b),
        (lambda a, b: (a * 0.0 + 2.0).to("sqrt"), lambda a, b: math.sqrt(2.0)),
        (lambda a, b: (a * 0.0).to("gt", 1.0).to("where", a, b), lambda a, b: b),
        (lambda a, b: a.to("gt", 0.0).to("where", b, b), lambda a, b: b),
    ],
)
def test_algebra_that_saves_an_operation(graph: Graph, rule: Callable[..., Any], simple: Callable[..., Any]) -> None:
    a, b = (Term(graph, graph.input("x", k)) for k in (0, 1))
    assert rule(a, b).node == Term.of(graph, simple(a, b)).node


def test_what_has_no_number_stays_an_operation(graph: Graph) -> None:
    """The C++ then gives the infinity or NaN that torch gives."""
    zero, minus = graph.constant(0.0), graph.constant(-1.0)
    for made in (graph.apply("div", minus, zero), graph.apply("log", minus), graph.apply("exp", graph.constant(1e4))):
        assert graph.value(made) is None
        assert math.isnan(graph.evaluated([made], {})[0])
    assert graph.constant(-0.0) == zero


def test_only_what_is_needed_is_looked_at(graph: Graph) -> None:
    a, b = graph.input("x", 0), graph.input("y", 5)
    unused, wanted = graph.apply("sin", b), graph.apply("cos", a)
    assert graph.needed([wanted]) == [a, wanted]
    assert graph.needed([wanted], lambda node: node == wanted) == [wanted]
    assert graph.evaluated([wanted, a], {"x": [0.0]}) == [1.0, 0.0]
    assert unused not in graph.needed([wanted])


def test_derivatives_of_what_does_not_depend_are_left_out(graph: Graph) -> None:
    a, b = (Term(graph, graph.input("x", k)) for k in (0, 1))
    step = a.to("gt", 0.0).to("where", 1.0, -1.0)
    assert graph.gradient((step * b).node) == {b.node: step.node}
    assert graph.gradient(graph.constant(3.0)) == {}
    assert graph.gradient(a.node) == {a.node: graph.constant(1.0)}


# Each keeps its values moderate wherever it is entered, and is smooth but for the corners of the last four.
ONE = {
    "sin": (lambda a: a.to("sin"), torch.sin),
    "cos": (lambda a: a.to("cos"), torch.cos),
    "tanh": (lambda a: a.to("tanh"), torch.tanh),
    "sigmoid": (lambda a: a.to("sigmoid"), torch.sigmoid),
    "atan": (lambda a: a.to("atan"), torch.atan),
    "neg": (lambda a: -a, torch.neg),
    "root of square": (lambda a: (1.0 + a * a).to("sqrt"), lambda a: (1.0 + a * a).sqrt()),
    "log of square": (lambda a: (1.0 + a * a).to("log"), lambda a: (1.0 + a * a).log()),
    "log1p of square": (lambda a: (a * a).to("log1p"), lambda a: (a * a).log1p()),
    "bell": (lambda a: (-a * a).to("exp"), lambda a: (-a * a).exp()),
    "asin": (lambda a: (0.9 * a.to("sin")).to("asin"), lambda a: (0.9 * a.sin()).asin()),
    "acos": (lambda a: (0.9 * a.to("cos")).to("acos"), lambda a: (0.9 * a.cos()).acos()),
    "power": (lambda a: (1.0 + a * a).to("pow", 0.3), lambda a: (1.0 + a * a) ** 0.3),
    "abs": (lambda a: a.to("abs"), torch.abs),
}
TWO = {
    "add": (lambda a, b: a + b, torch.add),
    "sub": (lambda a, b: a - b, torch.sub),
    "mul": (lambda a, b: a.to("tanh") * b, lambda a, b: a.tanh() * b),
    "div": (lambda a, b: a / (1.0 + b * b), lambda a, b: a / (1.0 + b * b)),
    "atan2": (lambda a, b: a.to("atan2", 1.0 + b * b), lambda a, b: torch.atan2(a, 1.0 + b * b)),
    "maximum": (lambda a, b: a.to("maximum", b), torch.maximum),
    "minimum": (lambda a, b: a.to("minimum", b), torch.minimum),
    "where": (lambda a, b: a.to("gt", b).to("where", a, -b), lambda a, b: torch.where(a > b, a, -b)),
}
LEAVES = st.one_of(
    st.integers(0, 2).map(lambda k: ("input", k)),
    st.sampled_from([0.0, 1.0, -1.0, 0.7, -2.5]).map(lambda v: ("number", v)),
)
EXPRESSIONS = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(sorted(ONE)), inner), st.tuples(st.sampled_from(sorted(TWO)), inner, inner)
    ),
    max_leaves=25,
)


def written(expression: tuple[Any, ...], engine: int, inputs: list[Any], number: Callable[[float], Any]) -> Any:
    """The expression in terms (engine 0) or in torch (engine 1)."""
    name, *arguments = expression
    if name == "input":
        return inputs[arguments[0]]
    if name == "number":
        return number(arguments[0])
    parts = [written(a, engine, inputs, number) for a in arguments]
    return {**ONE, **TWO}[name][engine](*parts)


@given(EXPRESSIONS, st.tuples(*[st.floats(-3.0, 3.0, allow_subnormal=False)] * 3))
def test_values_and_derivatives_are_those_of_torch(expression: tuple[Any, ...], at: tuple[float, ...]) -> None:
    graph = Graph()
    terms = [Term(graph, graph.input("x", k)) for k in range(3)]
    result = written(expression, 0, terms, lambda v: Term.of(graph, v)).node
    x = torch.tensor(at, dtype=torch.float64, requires_grad=True)
    wanted = written(expression, 1, list(x), lambda v: torch.tensor(v, dtype=torch.float64)) + 0.0 * x.sum()
    (slopes,) = torch.autograd.grad(wanted, x)
    gradient = graph.gradient(result)
    got = graph.evaluated([result, *gradient.values()], {"x": at})
    assert got[0] == pytest.approx(wanted.item(), rel=1e-12, abs=1e-13)
    found = dict(zip(gradient, got[1:], strict=True))
    assert [found.get(t.node, 0.0) for t in terms] == pytest.approx(slopes.tolist(), rel=1e-10, abs=1e-11)


SMOOTH = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(sorted(set(ONE) - {"abs"})), inner),
        st.tuples(st.sampled_from(sorted(set(TWO) - {"maximum", "minimum", "where"})), inner, inner),
    ),
    max_leaves=8,
)


@given(SMOOTH, st.tuples(*[st.floats(-2.0, 2.0, allow_subnormal=False)] * 3))
def test_derivatives_are_those_of_central_differences(expression: tuple[Any, ...], at: tuple[float, ...]) -> None:
    graph, step = Graph(), 1e-5
    terms = [Term(graph, graph.input("x", k)) for k in range(3)]
    result = written(expression, 0, terms, lambda v: Term.of(graph, v)).node
    gradient = graph.gradient(result)
    found = dict(zip(gradient, graph.evaluated(list(gradient.values()), {"x": at}), strict=True))
    for k, term in enumerate(terms):
        beside = [[v + sign * step * (i == k) for i, v in enumerate(at)] for sign in (1.0, -1.0)]
        ahead, behind = (graph.evaluated([result], {"x": x})[0] for x in beside)
        slope = found.get(term.node, 0.0)
        assert (ahead - behind) / (2.0 * step) == pytest.approx(slope, rel=1e-4, abs=1e-4)
