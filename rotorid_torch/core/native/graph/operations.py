"""Every scalar operation that native code knows: its value, its derivatives and its C++, one row each.

Where a function has a corner, its derivative there is what torch says.
"""

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


def _sigmoid(a: float) -> float:
    return 1.0 / (1.0 + math.exp(-a)) if a > -700.0 else math.exp(a)


def _by_exponent(y: Any, a: Any) -> Any:
    return a.to("gt", 0.0).to("where", y * a.to("log"), 0.0)


def _larger(a: Any, b: Any) -> Any:
    """One where a is the larger, zero where b is, one half where neither."""
    return a.to("gt", b).to("where", 1.0, a.to("lt", b).to("where", 0.0, 0.5))


def _sign(a: Any) -> Any:
    return a.to("gt", 0.0).to("where", 1.0, a.to("lt", 0.0).to("where", -1.0, 0.0))


def _pick(condition: float, a: float, b: float) -> float:
    return a if condition else b


OPERATIONS: dict[str, Operation] = {
    "add": Operation(lambda a, b: a + b, lambda y, a, b: (1.0, 1.0), "{0} + {1}"),
    "sub": Operation(lambda a, b: a - b, lambda y, a, b: (1.0, -1.0), "{0} - {1}"),
    "mul": Operation(lambda a, b: a * b, lambda y, a, b: (b, a), "{0} * {1}"),
    "div": Operation(lambda a, b: a / b, lambda y, a, b: (1.0 / b, -(y / b)), "{0} / {1}"),
    "neg": Operation(lambda a: -a, lambda y, a: (-1.0,), "-{0}"),
    "sin": Operation(math.sin, lambda y, a: (a.to("cos"),), "F_sin({0})"),
    "cos": Operation(math.cos, lambda y, a: (-a.to("sin"),), "F_cos({0})"),
    "sqrt": Operation(math.sqrt, lambda y, a: (0.5 / y,), "F_sqrt({0})"),
    "root": Operation(  # of a sum of squares: a norm's derivative where all is zero is zero
        math.sqrt, lambda y, a: (y.to("gt", 0.0).to("where", 0.5 / y, 0.0),), "F_sqrt({0})"
    ),
    "pow": Operation(math.pow, lambda y, a, b: (b * a.to("pow", b - 1.0), _by_exponent(y, a)), "F_pow({0}, {1})"),
    "sigmoid": Operation(_sigmoid, lambda y, a: (y * (1.0 - y),), "F_sigmoid({0})"),
    "exp": Operation(math.exp, lambda y, a: (y,), "F_exp({0})"),
    "log": Operation(math.log, lambda y, a: (1.0 / a,), "F_log({0})"),
    "log1p": Operation(math.log1p, lambda y, a: (1.0 / (1.0 + a),), "F_log1p({0})"),
    "tanh": Operation(math.tanh, lambda y, a: (1.0 - y * y,), "F_tanh({0})"),
    "asin": Operation(math.asin, lambda y, a: (1.0 / ((1.0 - a) * (1.0 + a)).to("sqrt"),), "F_asin({0})"),
    "acos": Operation(math.acos, lambda y, a: (-1.0 / ((1.0 - a) * (1.0 + a)).to("sqrt"),), "F_acos({0})"),
    "atan": Operation(math.atan, lambda y, a: (1.0 / (1.0 + a * a),), "F_atan({0})"),
    "atan2": Operation(math.atan2, lambda y, a, b: (b / (a * a + b * b), -(a / (a * a + b * b))), "F_atan2({0}, {1})"),
    "abs": Operation(math.fabs, lambda y, a: (_sign(a),), "F_abs({0})"),
    "maximum": Operation(max, lambda y, a, b: (_larger(a, b), _larger(b, a)), "F_maximum({0}, {1})"),
    "minimum": Operation(min, lambda y, a, b: (_larger(b, a), _larger(a, b)), "F_minimum({0}, {1})"),
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


def _both(a: Any, b: Any) -> Any:
    return a.to("where", b.to("where", 1.0, 0.0), 0.0).to("gt", 0.5)


def _equal(a: Any, b: Any) -> Any:
    return _both(a.to("ge", b), a.to("le", b))


def _not(a: Any) -> Any:
    return a.to("where", 0.0, 1.0).to("gt", 0.5)


def _softplus(a: Any, beta: Any = 1.0, threshold: Any = 20.0) -> Any:
    """Torch's, straight beyond the threshold; the exponential never overflows, nor do its derivatives."""
    x = a * beta
    smooth = (x.to("maximum", 0.0) + (-x.to("abs")).to("exp").to("log1p")) / beta
    return x.to("gt", threshold).to("where", a, smooth)


COMPOSITE: dict[str, Callable[..., Any]] = {
    "rsub": lambda a, b: b - a,
    "reciprocal": lambda a: 1.0 / a,
    "square": lambda a: a * a,
    "rsqrt": lambda a: 1.0 / a.to("sqrt"),
    "hypot": lambda a, b: (a * a + b * b).to("root"),
    "tan": lambda a: a.to("sin") / a.to("cos"),
    "softplus": _softplus,
    "sign": _sign,
    "relu": lambda a: a.to("le", 0.0).to("where", 0.0, a),
    "clamp_min": lambda a, low: a.to("lt", low).to("where", low, a),
    "clamp_max": lambda a, high: a.to("gt", high).to("where", high, a),
    "eq": _equal,
    "ne": lambda a, b: _not(_equal(a, b)),
}
"""Torch's operations that are written with those above."""
LOGICAL: dict[str, Callable[..., Any]] = {"and": _both, "or": lambda a, b: _not(_both(_not(a), _not(b))), "not": _not}
"""The same, of conditions."""
