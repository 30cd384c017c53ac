"""Every row of the table of operations: its C++ for a number and for lanes, and its derivatives, against torch."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.core.native.build import library
from rotorid_torch.core.native.graph.emit import straight_line
from rotorid_torch.core.native.graph.operations import COMPOSITE, LOGICAL, OPERATIONS
from rotorid_torch.core.native.graph.symbols import Graph, Term

ULP = 2.0**-52
COUNT = 512
"""Places where each is tried: a multiple of the lanes of any machine."""


def spread(low: float, high: float, seed: int = 0) -> Tensor:
    return low + (high - low) * torch.rand(COUNT, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def sizes(seed: int = 0) -> Tensor:
    """Of both signs, over ten decades."""
    signs = torch.where(spread(-1.0, 1.0, seed + 50) > 0.0, 1.0, -1.0)
    return signs * 10.0 ** spread(-5.0, 5.0, seed)


ANY, OTHER, ABOVE = sizes(1), sizes(2), sizes(3).abs()
SMALL, UNIT = spread(-20.0, 20.0, 4), spread(-0.95, 0.95, 5)
CASES = {
    "add": (torch.add, ANY, OTHER),
    "sub": (torch.sub, ANY, OTHER),
    "mul": (torch.mul, ANY, OTHER),
    "div": (torch.div, ANY, OTHER),
    "neg": (torch.neg, ANY),
    "sin": (torch.sin, SMALL),
    "cos": (torch.cos, SMALL),
    "sqrt": (torch.sqrt, ABOVE),
    "root": (torch.sqrt, ABOVE),
    "pow": (torch.pow, spread(0.01, 10.0, 6), spread(-3.0, 3.0, 7)),
    "sigmoid": (torch.sigmoid, SMALL),
    "exp": (torch.exp, SMALL),
    "log": (torch.log, ABOVE),
    "log1p": (torch.log1p, ABOVE),
    "tanh": (torch.tanh, SMALL),
    "asin": (torch.asin, UNIT),
    "acos": (torch.acos, UNIT),
    "atan": (torch.atan, ANY),
    "atan2": (torch.atan2, ANY, OTHER),
    "abs": (torch.abs, ANY),
    "maximum": (torch.maximum, ANY, OTHER),
    "minimum": (torch.minimum, ANY, OTHER),
    "where": (lambda c, a, b: torch.where(c > 0.0, a, b), ANY, OTHER, SMALL),
    **{name: (getattr(torch, name), SMALL.round(), SMALL.flip(0).round()) for name in ("gt", "lt", "ge", "le")},
    "rsub": (torch.rsub, ANY, OTHER),
    "reciprocal": (torch.reciprocal, ANY),
    "square": (torch.square, ANY),
    "rsqrt": (torch.rsqrt, ABOVE),
    "hypot": (torch.hypot, ANY, OTHER),
    "tan": (torch.tan, UNIT),
    "softplus": (torch.nn.functional.softplus, SMALL),
    "sign": (torch.sign, ANY),
    "relu": (torch.relu, ANY),
    "clamp_min": (torch.maximum, ANY, OTHER),
    "clamp_max": (torch.minimum, ANY, OTHER),
    "eq": (torch.eq, SMALL.round(), SMALL.flip(0).round()),
    "ne": (torch.ne, SMALL.round(), SMALL.flip(0).round()),
    "and": (lambda a, b: (a > 0) & (b > 0), ANY, OTHER),
    "or": (lambda a, b: (a > 0) | (b > 0), ANY, OTHER),
    "not": (lambda a: ~(a > 0), ANY),
}
KNOWN = [*OPERATIONS, *COMPOSITE, *LOGICAL]
TRUTHS = {"gt", "lt", "ge", "le", "eq", "ne", "and", "or", "not"}


def written(graph: Graph, name: str, terms: list[Term]) -> Term:
    """The operation on terms; conditions go in and come out as numbers."""
    if name in LOGICAL or name == "where":
        terms = [t.to("gt", 0.0) if name in LOGICAL or k == 0 else t for k, t in enumerate(terms)]
    rule = COMPOSITE.get(name) or LOGICAL.get(name)
    made = rule(*terms) if rule else terms[0].to(name, *terms[1:])
    return made.to("where", 1.0, 0.0) if name in TRUTHS else made


@pytest.fixture(scope="module")
def results() -> dict[str, dict[str, list[Tensor]]]:
    """For "double" and "vd", of each operation the value and the derivatives by its arguments, all from one library."""
    graph, assignments, inputs, places = Graph(), {}, [], {}
    for name in KNOWN:
        terms = [Term(graph, graph.input("x", len(inputs) + k)) for k in range(len(CASES[name]) - 1)]
        inputs += CASES[name][1:]
        value = written(graph, name, terms).node
        slopes = graph.gradient(value)
        nodes = [value, *(slopes.get(t.node, graph.constant(0.0)) for t in terms)]
        places[name] = range(len(assignments), len(assignments) + len(nodes))
        assignments |= {f"out[{len(assignments) + k}]": node for k, node in enumerate(nodes)}

    def plain(node: int) -> str | None:
        value = graph.value(node)
        return None if value is None else f"({value!r})"

    body, nx, n = straight_line(graph, assignments, plain), len(inputs), len(assignments)
    source = f"""#include "lanes.h"
template <class T> static void all(const T* x, T* out) {{
{body}
}}
extern "C" void run_double(int count, const double* x, double* out) {{
  for (int i = 0; i < count; i++) all(x + i * {nx}, out + i * {n});
}}
extern "C" void run_vd(int count, const double* x, double* out) {{
  vd in[{nx}], to[{n}];
  for (int i = 0; i < count; i += W) {{
    for (int l = 0; l < W; l++) for (int k = 0; k < {nx}; k++) in[k][l] = x[(i + l) * {nx} + k];
    all(in, to);
    for (int l = 0; l < W; l++) for (int k = 0; k < {n}; k++) out[(i + l) * {n} + k] = to[k][l];
  }}
}}
"""
    x, found = torch.stack(inputs, dim=-1).contiguous(), {}
    for kind in ("double", "vd"):
        out = torch.empty(COUNT, n, dtype=torch.float64)
        getattr(library(source), f"run_{kind}")(COUNT, *(ctypes.c_void_p(a.data_ptr()) for a in (x, out)))
        found[kind] = {name: [out[:, k] for k in place] for name, place in places.items()}
    return found


def test_every_operation_has_a_case() -> None:
    assert set(CASES) == set(KNOWN)


@pytest.mark.parametrize("kind", ["double", "vd"])
@pytest.mark.parametrize("name", KNOWN)
def test_value_and_derivatives(name: str, kind: str, results: dict[str, dict[str, list[Tensor]]]) -> None:
    function, *arguments = CASES[name]
    arguments = [a.clone().requires_grad_() for a in arguments]
    wanted = function(*arguments)
    value, *slopes = results[kind][name]
    if name in TRUTHS:
        assert torch.equal(value, wanted.double())
        return
    assert within(value, wanted.detach(), 8.0), name
    true = torch.autograd.grad(wanted.sum(), arguments, allow_unused=True)
    for slope, exact in zip(slopes, true, strict=True):
        assert within(slope, torch.zeros(COUNT).double() if exact is None else exact, 32.0), name


def within(value: Tensor, wanted: Tensor, ulps: float) -> bool:
    """Relative, or of one where a result is a small difference of numbers of that size."""
    return bool(((value - wanted).abs() <= ulps * ULP * wanted.abs().clamp(min=1.0)).all())


def test_sine_and_cosine_in_lanes_are_right_to_two_ulp_for_large_angles() -> None:
    graph = Graph()
    x = Term(graph, graph.input("x", 0))
    body = straight_line(graph, {"out[0]": x.to("sin").node, "out[1]": x.to("cos").node}, lambda node: None)
    source = f"""#include "lanes.h"
template <class T> static void both(const T* x, T* out) {{
{body}
}}
extern "C" void run(int n, const double* x, double* out) {{
  for (int i = 0; i < n; i += W) {{
    vd in, to[2];
    memcpy(&in, x + i, sizeof in);
    both(&in, to);
    memcpy(out + i, &to[0], sizeof in);
    memcpy(out + n + i, &to[1], sizeof in);
  }}
}}
"""
    turns = torch.arange(-32.0, 32.0, dtype=torch.float64) * (torch.pi / 4.0)
    angles = torch.cat([spread(-1e5, 1e5, k) for k in range(8)] + [turns, turns * 1e-9, turns + 1e-7, 1000.0 * turns])
    out = torch.empty(2, len(angles), dtype=torch.float64)
    library(source).run(len(angles), *(ctypes.c_void_p(a.data_ptr()) for a in (angles, out)))
    exact = angles.numpy().astype(np.longdouble)
    for got, wanted in zip(out.numpy(), (np.sin(exact), np.cos(exact)), strict=True):
        assert (np.abs(got - wanted) <= 2.0 * np.spacing(np.abs(wanted).astype(np.float64))).all()


@pytest.mark.parametrize(
    ("name", "at", "torch_function"),
    [
        ("abs", [0.0], torch.abs),
        ("maximum", [1.5, 1.5], torch.maximum),
        ("minimum", [1.5, 1.5], torch.minimum),
        ("relu", [0.0], torch.relu),
        ("clamp_min", [0.5, 0.5], lambda a, b: a.clamp_min(0.5)),
        ("clamp_max", [0.5, 0.5], lambda a, b: a.clamp_max(0.5)),
        ("root", [0.0], lambda a: torch.linalg.vector_norm(torch.stack([a, 0.0 * a])) * 0.0),
        ("sigmoid", [-800.0], torch.sigmoid),
        ("sigmoid", [800.0], torch.sigmoid),
        ("softplus", [800.0], torch.nn.functional.softplus),
        ("softplus", [-800.0], torch.nn.functional.softplus),
        ("pow", [0.0, 1.5], torch.pow),
    ],
)
def test_derivatives_at_corners_and_far_out_are_those_of_torch(
    name: str, at: list[float], torch_function: object
) -> None:
    assert callable(torch_function)
    graph = Graph()
    terms = [Term(graph, graph.input("x", k)) for k in range(len(at))]
    gradient = graph.gradient(written(graph, name, terms).node)
    found = dict(zip(gradient, graph.evaluated(list(gradient.values()), {"x": at}), strict=True))
    arguments = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in at]
    true = torch.autograd.grad(torch_function(*arguments), arguments, allow_unused=True)
    for term, exact in zip(terms, true, strict=True):
        if exact is not None:
            assert found.get(term.node, 0.0) == pytest.approx(float(exact), abs=1e-15)
