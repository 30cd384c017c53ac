"""From expressions to C++: straight-line code for a double or a vector of them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rotorid_torch.core.native.operations import COMPARISONS, OPERATIONS
from rotorid_torch.core.native.symbols import Graph

SHARED = "th"
"""Name of the input that is the same in all lanes and at all times: the parameters."""


class Constants:
    """Expressions of the parameters alone; they are computed once, before the loop, as c[0], c[1], ..."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.places: dict[int, int] = {}
        self._shared: dict[int, bool] = {}

    def shared(self, node: int) -> bool:
        """Whether a node depends on nothing but parameters."""
        if node not in self._shared:
            kind = self.graph.operation(node)
            if kind == "constant":
                self._shared[node] = True
            elif kind == "input":
                self._shared[node] = self.graph.nodes[node][1] == SHARED
            else:
                self._shared[node] = all(self.shared(a) for a in self.graph.arguments(node))
        return self._shared[node]

    def name(self, node: int) -> str:
        """What the loop calls such an expression."""
        value = self.graph.value(node)
        if value is not None:
            return _number(value)
        return f"c[{self.places.setdefault(node, len(self.places))}]"

    def prepare(self) -> str:
        """The function that fills c from th."""
        body = straight_line(self.graph, {f"c[{k}]": node for node, k in self.places.items()}, None, "double")
        count = max(len(self.places), 1)
        return f"enum {{ NC = {count} }};\nstatic void prepare(const double* th, double* c) {{\n{body}\n}}\n"


def _number(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return repr(value) if value >= 0 else f"({value!r})"


def straight_line(graph: Graph, results: Mapping[str, int], constants: Constants | None, kind: str = "T") -> str:
    """Assignments "result = expression;" of {result: node} and of all that they need, in order.

    `constants` None: everything is computed here, for parameters too.
    """
    text: dict[int, str] = {}
    varies: dict[int, bool] = {}
    pairs: set[int] = set()
    code: list[str] = []
    for node in _needed(graph, results, constants):
        operation = graph.operation(node)
        if constants is not None and constants.shared(node):
            text[node], varies[node] = constants.name(node), False
            continue
        varies[node] = True
        if operation == "constant":
            text[node], varies[node] = _number(float(graph.nodes[node][1])), False
        elif operation == "input":
            _, name, place = graph.nodes[node]
            text[node] = f"{name}[{place}]"
        elif operation in ("sin", "cos"):
            (argument,) = graph.arguments(node)
            if argument not in pairs:
                pairs.add(argument)
                angle = _as(kind, text[argument], varies[argument])
                code.append(f"{kind} s{argument}, c{argument}; SinCos({angle}, s{argument}, c{argument});")
            text[node] = f"{operation[0]}{argument}"
        else:
            text[node] = f"t{node}"
            code.append(f"const {_type(operation, kind)} t{node} = {_expression(graph, node, text, varies, kind)};")
    for result, node in results.items():
        code.append(f"{result} = {_as(kind, text[node], varies[node])};")
    return "\n".join(f"  {line}" for line in code)


def _needed(graph: Graph, results: Mapping[str, int], constants: Constants | None) -> list[int]:
    """Nodes that the results depend on, earlier ones first; what is shared is not looked into."""
    wanted, seen = list(results.values()), set()
    while wanted:
        node = wanted.pop()
        if node not in seen:
            seen.add(node)
            if constants is None or not constants.shared(node):
                wanted.extend(graph.arguments(node))
    return sorted(seen)


def _as(kind: str, text: str, varies: bool) -> str:
    """A number that is the same in all lanes, as a vector."""
    return text if varies or kind == "double" else f"({kind}() + {text})"


def _type(operation: str, kind: str) -> str:
    return "auto" if operation in COMPARISONS else kind


def _expression(graph: Graph, node: int, text: Mapping[int, str], varies: Mapping[int, bool], kind: str) -> str:
    operation, arguments = graph.operation(node), graph.arguments(node)
    plain = [text[a] for a in arguments]
    if operation in ("where", "maximum", "minimum", "atan2") or operation in COMPARISONS:
        first = 1 if operation == "where" else 0  # a condition is what it is
        plain[first:] = [_as(kind, text[a], varies[a]) for a in arguments[first:]]
    return OPERATIONS[operation].text.format(*plain)
