"""Every scalar operation that native code knows: its value, its derivatives and its C++, one row each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Partials = Callable[..., tuple[Any, ...]]
"""From a node and its arguments, written as numbers, the derivative by each argument; None where there is none."""


@dataclass(frozen=True)
class Operation:
    """One scalar operation.

    evaluate : on floats. partials : see `Partials`; it writes formulas with the node and its arguments.
    text : C++ with {0}, {1} ... for the arguments; it holds for a double as for a vector of them.
    """

    evaluate: Callable[..., float]
    partials: Partials
    text: str


def _none(y: Any, *args: Any) -> tuple[None, ...]:
    return (None,) * len(args)


def _pick(condition: float, a: float, b: float) -> float:
    return a if condition else b


OPERATIONS: dict[str, Operation] = {
    "add": Operation(lambda a, b: a + b, lambda y, a, b: (1.0, 1.0), "{0} + {1}"),
    "sub": Operation(lambda a, b: a - b, lambda y, a, b: (1.0, -1.0), "{0} - {1}"),
    "mul": Operation(lambda a, b: a * b, lambda y, a, b: (b, a), "{0} * {1}"),
    "div": Operation(lambda a, b: a / b, lambda y, a, b: (1.0 / b, -(y / b)), "{0} / {1}"),
    "neg": Operation(lambda a: -a, lambda y, a: (-1.0,), "-{0}"),
    "sin": Operation(math.sin, lambda y, a: (a.to("cos"),), ""),
    "cos": Operation(math.cos, lambda y, a: (-a.to("sin"),), ""),
    "sqrt": Operation(math.sqrt, lambda y, a: (0.5 / y,), "F_sqrt({0})"),
    "exp": Operation(math.exp, lambda y, a: (y,), "F_exp({0})"),
    "log": Operation(math.log, lambda y, a: (1.0 / a,), "F_log({0})"),
    "log1p": Operation(math.log1p, lambda y, a: (1.0 / (1.0 + a),), "F_log1p({0})"),
    "tanh": Operation(math.tanh, lambda y, a: (1.0 - y * y,), "F_tanh({0})"),
    "asin": Operation(math.asin, lambda y, a: (1.0 / (1.0 - a * a).to("sqrt"),), "F_asin({0})"),
    "acos": Operation(math.acos, lambda y, a: (-(1.0 / (1.0 - a * a).to("sqrt")),), "F_acos({0})"),
    "atan": Operation(math.atan, lambda y, a: (1.0 / (1.0 + a * a),), "F_atan({0})"),
    "atan2": Operation(math.atan2, lambda y, a, b: (b / (a * a + b * b), -(a / (a * a + b * b))), "F_atan2({0}, {1})"),
    "abs": Operation(math.fabs, lambda y, a: (a.to("lt", 0.0).to("where", -1.0, 1.0),), "F_abs({0})"),
    "maximum": Operation(
        max,
        lambda y, a, b: (a.to("gt", b).to("where", 1.0, 0.0), a.to("gt", b).to("where", 0.0, 1.0)),
        "F_maximum({0}, {1})",
    ),
    "minimum": Operation(
        min,
        lambda y, a, b: (a.to("lt", b).to("where", 1.0, 0.0), a.to("lt", b).to("where", 0.0, 1.0)),
        "F_minimum({0}, {1})",
    ),
    "where": Operation(
        _pick, lambda y, c, a, b: (None, c.to("where", 1.0, 0.0), c.to("where", 0.0, 1.0)), "{0} ? {1} : {2}"
    ),
    "gt": Operation(lambda a, b: a > b, _none, "{0} > {1}"),
    "lt": Operation(lambda a, b: a < b, _none, "{0} < {1}"),
    "ge": Operation(lambda a, b: a >= b, _none, "{0} >= {1}"),
    "le": Operation(lambda a, b: a <= b, _none, "{0} <= {1}"),
}

COMMUTATIVE = {"add", "mul"}
COMPARISONS = {"gt", "lt", "ge", "le"}
