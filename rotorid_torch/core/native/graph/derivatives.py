"""The linearised model as C++: derivatives at a point, and how tangents of all parameters at once pass through it.

Columns of the tangents lie in SIMD lanes: parameters of the loop, then those of the control path (whose tangents come
with the controls), then initial states. Only what is not zero is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.native.graph.emit import SHARED, Constants, straight_line
from rotorid_torch.core.native.graph.symbols import Graph

Derivatives = list[dict[tuple[str, int], int]]
"""For each result the nodes of its derivatives by (input name, place)."""


def derivatives(graph: Graph, results: Sequence[int]) -> Derivatives:
    """Exact derivatives of all results by all inputs they depend on."""
    rows = []
    for result in results:
        slopes = graph.gradient(result)
        rows.append({(str(graph.nodes[n][1]), int(graph.nodes[n][2])): slope for n, slope in slopes.items()})
    return rows


def pullback(graph: Graph, results: Sequence[int], along: str) -> dict[tuple[str, int], int]:
    """Nodes of the derivatives of a weighted sum of results by all inputs that they depend on.

    along : name of the input vector that holds the weights.
    """
    total = graph.constant(0.0)
    for k, result in enumerate(results):
        total = graph.apply("add", total, graph.apply("mul", graph.input(along, k), result))
    (row,) = derivatives(graph, [total])
    return {place: node for place, node in row.items() if place[0] != along}


@dataclass(frozen=True)
class Columns:
    """Where the tangents of each unknown lie in a row, in vectors of `width` lanes.

    parameters : column of each parameter. loop, path : columns of the loop's and of the control path's parameters, each
    filled up to whole vectors. starts : initial states behind them. residual : its column, in a lane that the others
    leave free where there is one. total : of a row.
    """

    parameters: tuple[int, ...]
    loop: int
    path: int
    starts: int
    residual: int
    total: int
    width: int

    @classmethod
    def arranged(cls, rows: Sequence[Derivatives], count: int, path: Sequence[int], starts: int, width: int) -> Columns:
        """Parameters that reach the same results beside each other, so that few vectors reach each result."""
        reach: list[list[int]] = [[] for _ in range(count)]
        for k, row in enumerate(row for group in rows for row in group):
            for name, place in row:
                if name == SHARED:
                    reach[place].append(k)
        inside = sorted((p for p in range(count) if p not in path), key=lambda p: (reach[p], p))
        loop, behind = (-(-n // width) * width for n in (len(inside), len(path)))
        parameters = [0] * count
        for first, group in ((0, inside), (loop, path)):
            for column, p in enumerate(group):
                parameters[p] = first + column
        last = loop + behind + starts
        residual = next(iter([*range(len(inside), loop), *range(loop + len(path), loop + behind), last]))
        total = -(-max(last, residual + 1) // width) * width
        return cls(tuple(parameters), loop, behind, starts, residual, total, width)

    def order(self) -> Tensor:
        """Columns of a row in the order of results: initial states, parameters, residual."""
        starts = range(self.loop + self.path, self.loop + self.path + self.starts)
        return torch.tensor([*starts, *self.parameters, self.residual], dtype=torch.int32)

    def padded(self, path: Tensor) -> Tensor | None:
        """Derivatives of the controls [S, T, nu, n] by the control path's n parameters, filled up to whole vectors."""
        missing = self.path - path.shape[-1]
        return torch.nn.functional.pad(path, (0, missing)).contiguous() if self.path else None


class Tangent:
    """C++ of one function's values, derivatives and tangents; `name` is "rates" or "outputs".

    rows : its derivatives, where they are known.
    """

    def __init__(
        self,
        graph: Graph,
        name: str,
        results: Sequence[int],
        columns: Columns,
        constants: Constants,
        rows: Derivatives | None = None,
    ) -> None:
        self.graph, self.name, self.columns, self.constants = graph, name, columns, constants
        self.stored: dict[int, int] = {}  # varying derivative by state or control: place in A
        self.pairs: list[tuple[int, int]] = []  # vectors of columns and the results that their parameters reach
        self.values = {f"out[{i}]": node for i, node in enumerate(results)}
        rows = derivatives(graph, results) if rows is None else rows
        self.by_state = [self._terms(row, "x", "D") for row in rows]
        self.by_control = [self._terms(row, "u", "U") for row in rows]
        self.by_parameter = self._parameters(rows)

    def _terms(self, row: dict[tuple[str, int], int], by: str, tangent: str) -> list[str]:
        terms = []
        for (kind, place), node in row.items():
            if kind != by:
                continue
            if self.graph.value(node) == 1.0:
                terms.append(f"{tangent}[{place}]")
            else:
                name = self.constants.name(node) or f"A[{self.stored.setdefault(node, len(self.stored))}]"
                terms.append(f"{name} * {tangent}[{place}]")
        return terms

    def _parameters(self, rows: Derivatives) -> dict[str, int]:
        """Derivatives by parameters, vector by vector of columns, in each the results that they reach."""
        width = self.columns.width
        entries = [
            (self.columns.parameters[place], i, node)
            for i, row in enumerate(rows)
            for (kind, place), node in row.items()
            if kind == SHARED
        ]
        self.pairs = sorted({(column // width, i) for column, i, _ in entries})
        place = {pair: k for k, pair in enumerate(self.pairs)}
        return {f"K[{place[column // width, i] * width + column % width}]": node for column, i, node in entries}

    def text(self) -> str:
        """C++: NAME_linear(x, u, c, out, A, K), the tangents' maps NAME_by_state and NAME_by_control, and where K goes.

        Vector b of the columns takes K[FIRST[b]] to K[FIRST[b + 1]], each into the result that INTO says.
        """
        upper, vectors = self.name.upper(), (self.columns.loop + self.columns.path) // self.columns.width
        first = [sum(b < k for b, _ in self.pairs) for k in range(vectors + 1)]
        assignments = self.values | {f"A[{k}]": node for node, k in self.stored.items()} | self.by_parameter
        return (
            f"enum {{ {upper}_A = {max(len(self.stored), 1)}, "
            f"{upper}_K = {max(len(self.pairs), 1) * self.columns.width} }};\n"
            f"static constexpr int {upper}_FIRST[] = {{{', '.join(map(str, first))}}};\n"
            f"static constexpr int {upper}_INTO[] = {{{', '.join(str(i) for _, i in self.pairs) or '0'}}};\n"
            f"static void {self.name}_linear(const double* x, const double* u, const double* c, double* out, "
            f"double* A, double* K) {{\n{straight_line(self.graph, assignments, self.constants.name, 'double')}\n}}\n"
            + self._map("by_state", "D", self.by_state)
            + self._map("by_control", "U", self.by_control)
        )

    def _map(self, name: str, tangent: str, rows: list[list[str]]) -> str:
        lines = [f"  out[{i}] {'+=' if tangent == 'U' else '='} {' + '.join(r) or 'vd{}'};" for i, r in enumerate(rows)]
        arguments = f"const double* A, const double* c, const vd* {tangent}, vd* out"
        body = "\n".join(lines)
        return f"static inline void {self.name}_{name}({arguments}) {{\n{body}\n}}\n"
