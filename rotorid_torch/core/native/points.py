"""A function at many points in native code, with its derivatives by parameters: nothing is integrated."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.native.build import address, library, ready
from rotorid_torch.core.native.dynamics import Function, evaluation, sizes, traced
from rotorid_torch.core.native.graph.derivatives import derivatives
from rotorid_torch.core.native.graph.emit import SHARED, Constants
from rotorid_torch.core.native.graph.symbols import Graph


@dataclass(frozen=True, eq=False)
class PointFunction:
    """y = f(x, u, theta), and those derivatives by theta that are not zero everywhere: compiled when first asked for.

    graph, entries : the operations, and the nodes of y. nx, nu, count : entries of x, u, theta.
    """

    graph: Graph
    entries: Sequence[int]
    nx: int
    nu: int
    count: int

    @classmethod
    def of(cls, function: Function, x: Tensor, u: Tensor, theta: Tensor) -> PointFunction:
        """Trace a function at a point x [nx], u [nu], theta [P], and compile it.

        Raises Unsupported: native code does not know an operation in it, or there is no compiler.
        """
        graph = Graph()
        compiled = cls(graph, traced(graph, function, x, u, theta), len(x), len(u), len(theta))
        library(compiled._values[0])
        return compiled

    @cached_property
    def slopes(self) -> dict[tuple[int, int], int]:
        """Nodes of the derivatives, by entry and parameter."""
        return {
            (entry, place): node
            for entry, row in enumerate(derivatives(self.graph, self.entries))
            for (kind, place), node in row.items()
            if kind == SHARED
        }

    @cached_property
    def _values(self) -> tuple[str, Tensor]:
        """C++ of the values, and the numbers in it."""
        return self._source(self.entries)

    @cached_property
    def _linear(self) -> tuple[str, Tensor]:
        """C++ of the values and of the derivatives behind them, and the numbers in it."""
        return self._source([*self.entries, *self.slopes.values()])

    def _source(self, nodes: Sequence[int]) -> tuple[str, Tensor]:
        constants = Constants(self.graph, self.count)
        code = evaluation(self.graph, "results", nodes, constants)
        size = sizes(NX=self.nx, NU=self.nu, RESULTS=len(nodes))
        source = f'#include "lanes.h"\n{size}{constants.prepare()}{code}#include "points.h"\n'
        return source, constants.numbers()

    def __call__(self, theta: Tensor, x: Tensor, u: Tensor, places: Sequence[int] = ()) -> tuple[Tensor, Tensor]:
        """Values at points x [T, nx], u [T, nu], and their derivatives by the parameters at some places.

        [n, T] and [len(places), n, T].
        """
        source, numbers = self._linear if places else self._values
        order, entries = {place: k for k, place in enumerate(places)}, len(self.entries)
        x, u, theta = ready(x), ready(u), ready(torch.cat([theta, numbers]))
        results = x.new_empty(entries + (len(self.slopes) if places else 0), len(x))
        library(source).results_at(ctypes.c_int64(len(x)), *(address(a) for a in (x, u, theta, results)))
        slopes = x.new_zeros(len(places), entries, len(x))
        for (entry, place), slope in zip(self.slopes if places else (), results[entries:], strict=True):
            if place in order:
                slopes[order[place], entry] = slope
        return results[:entries], slopes
