"""Scalar expressions as one graph of shared nodes, folded while it grows, and differentiated in reverse."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rotorid_torch.core.native.graph.operations import COMMUTATIVE, OPERATIONS

Node = tuple[str | int | float, ...]
"""("constant", value), ("input", name, place) or (operation, argument, ...); arguments are numbers of earlier nodes."""


class Graph:
    """Nodes by number; an expression that is already there gets its old number, so that it is computed once."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._places: dict[Node, int] = {}
        self._values: list[float | None] = []
        self._arguments: list[tuple[int, ...]] = []

    def constant(self, value: float) -> int:
        """A number; minus zero is zero."""
        number = float(value) + 0.0
        return self._node(("constant", number), number)

    def input(self, name: str, place: int) -> int:
        """Entry of an input vector."""
        return self._node(("input", name, place))

    def value(self, node: int) -> float | None:
        """The number that a node is, or None where it varies."""
        return self._values[node]

    def operation(self, node: int) -> str:
        """Name of a node's operation, "constant" or "input"."""
        return str(self.nodes[node][0])

    def arguments(self, node: int) -> tuple[int, ...]:
        """Numbers of a node's arguments."""
        return self._arguments[node]

    def apply(self, operation: str, *arguments: int) -> int:
        """The operation on nodes, in its simplest form."""
        values = [self.value(a) for a in arguments]
        if None not in values:
            try:
                return self.constant(OPERATIONS[operation].evaluate(*values))
            except (ValueError, ZeroDivisionError, OverflowError):
                return self._node((operation, *arguments), None, arguments)  # the C++ gives infinity or NaN
        simpler = self._simpler(operation, arguments, values)
        if simpler is not None:
            return simpler
        if operation in COMMUTATIVE:
            arguments = tuple(sorted(arguments))
        return self._node((operation, *arguments), None, arguments)

    def _node(self, node: Node, value: float | None = None, arguments: tuple[int, ...] = ()) -> int:
        place = self._places.get(node)
        if place is None:
            place = self._places[node] = len(self.nodes)
            self.nodes.append(node)
            self._values.append(value)
            self._arguments.append(arguments)
        return place

    def _negated(self, node: int) -> int | None:
        """What a node is the negative of."""
        return self.arguments(node)[0] if self.operation(node) == "neg" else None

    def _simpler(self, operation: str, a: tuple[int, ...], v: list[float | None]) -> int | None:
        """Algebra that saves an operation; None where there is nothing to save."""
        if operation == "add":
            return self._simpler_sum(a, v)
        if operation == "sub":
            return self._simpler_difference(a, v)
        if operation == "mul":
            return self._simpler_product(a, v)
        if operation == "div":
            if v[0] == 0.0:
                return self.constant(0.0)
            return None if not v[1] else self.apply("mul", a[0], self.constant(1.0 / v[1]))
        if operation == "neg":
            return self._negated(a[0])
        if operation == "where":
            if v[0] is not None:
                return a[1] if v[0] else a[2]
            return a[1] if a[1] == a[2] else None
        return None

    def _simpler_sum(self, a: tuple[int, ...], v: list[float | None]) -> int | None:
        for k in (0, 1):
            if v[k] == 0.0:
                return a[1 - k]
        for k in (1, 0):
            taken = self._negated(a[k])
            if taken is not None:
                return self.apply("sub", a[1 - k], taken)
        return None

    def _simpler_difference(self, a: tuple[int, ...], v: list[float | None]) -> int | None:
        if v[1] == 0.0:
            return a[0]
        if v[0] == 0.0:
            return self.apply("neg", a[1])
        if a[0] == a[1]:
            return self.constant(0.0)
        negative = self._negated(a[1])
        return None if negative is None else self.apply("add", a[0], negative)

    def _simpler_product(self, a: tuple[int, ...], v: list[float | None]) -> int | None:
        for k in (0, 1):
            if v[k] == 0.0:
                return self.constant(0.0)
            if v[k] == 1.0:
                return a[1 - k]
            if v[k] == -1.0:
                return self.apply("neg", a[1 - k])
            turned = self._negated(a[k])
            if turned is not None:
                return self.apply("neg", self.apply("mul", turned, a[1 - k]))
        return None

    def evaluated(self, nodes: Sequence[int], inputs: Mapping[str, Sequence[float]]) -> list[float]:
        """Numbers that nodes are for given inputs; NaN where an operation is not defined."""
        values: dict[int, float] = {}
        for node in self.needed(nodes):
            kind, *operands = self.nodes[node]
            if kind == "constant":
                values[node] = float(operands[0])
            elif kind == "input":
                values[node] = inputs[str(operands[0])][int(operands[1])]
            else:
                try:
                    values[node] = float(OPERATIONS[str(kind)].evaluate(*(values[a] for a in self._arguments[node])))
                except (ValueError, ZeroDivisionError, OverflowError):
                    values[node] = math.nan
        return [values[node] for node in nodes]

    def needed(self, nodes: Sequence[int], is_input: Callable[[int], bool] = lambda node: False) -> list[int]:
        """Nodes that others depend on, earlier ones first; what is known is not looked into."""
        wanted, visited = list(nodes), set()
        while wanted:
            node = wanted.pop()
            if node not in visited:
                visited.add(node)
                if not is_input(node):
                    wanted.extend(self.arguments(node))
        return sorted(visited)

    def gradient(self, output: int) -> dict[int, int]:
        """Derivative of a node by every input that it depends on: {input node: derivative node}, zeros left out.

        Source: reverse accumulation; Griewank and Walther, Evaluating Derivatives, 2nd ed., ch. 3.
        """
        adjoint, waiting, slopes = {output: self.constant(1.0)}, [-output], {}
        while waiting:
            node = -heapq.heappop(waiting)
            if self.operation(node) == "input":
                slopes[node] = adjoint[node]
                continue
            for argument, slope in self._partials(node):
                term = self.apply("mul", adjoint[node], slope)
                if argument in adjoint:
                    adjoint[argument] = self.apply("add", adjoint[argument], term)
                else:
                    adjoint[argument] = term
                    heapq.heappush(waiting, -argument)
        return {node: slope for node, slope in slopes.items() if self.value(slope) != 0.0}

    def _partials(self, node: int) -> list[tuple[int, int]]:
        """Arguments that vary, and the derivative by each."""
        arguments = self.arguments(node)
        if all(self.value(a) is not None for a in arguments):
            return []
        slopes = OPERATIONS[self.operation(node)].partials(Term(self, node), *(Term(self, a) for a in arguments))
        pairs = zip(arguments, slopes, strict=True)
        return [(a, Term.of(self, s).node) for a, s in pairs if s is not None and self.value(a) is None]


@dataclass(frozen=True)
class Term:
    """A node that formulas can be written with."""

    graph: Graph
    node: int

    @classmethod
    def of(cls, graph: Graph, number: Term | float) -> Term:
        """A term from a term or a plain number."""
        return number if isinstance(number, Term) else cls(graph, graph.constant(number))

    def to(self, operation: str, *others: Term | float) -> Term:
        """An operation with this term as its first argument."""
        operands = [Term.of(self.graph, other).node for other in others]
        return Term(self.graph, self.graph.apply(operation, self.node, *operands))

    def __add__(self, other: Term | float) -> Term:
        return self.to("add", other)

    def __sub__(self, other: Term | float) -> Term:
        return self.to("sub", other)

    def __mul__(self, other: Term | float) -> Term:
        return self.to("mul", other)

    def __truediv__(self, other: Term | float) -> Term:
        return self.to("div", other)

    def __neg__(self) -> Term:
        return self.to("neg")

    def __radd__(self, other: float) -> Term:
        return self.to("add", other)

    def __rmul__(self, other: float) -> Term:
        return self.to("mul", other)

    def __rsub__(self, other: float) -> Term:
        return Term.of(self.graph, other) - self

    def __rtruediv__(self, other: float) -> Term:
        return Term.of(self.graph, other) / self
