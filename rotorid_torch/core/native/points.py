"""A function at many points in native code, with its derivatives by parameters: nothing is integrated."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.native.build import address, library, ready
from rotorid_torch.core.native.dynamics import Function, evaluation, sizes, traced
from rotorid_torch.core.native.graph.derivatives import derivatives
from rotorid_torch.core.native.graph.emit import SHARED, Constants
from rotorid_torch.core.native.graph.symbols import Graph


@dataclass(frozen=True, eq=False)
class PointFunction:
    """y = f(x, u, theta) and those derivatives by theta that are not zero everywhere.

    source, numbers : C++, and the numbers in it. count : entries of y. slopes : entry and parameter of each derivative.
    """

    source: str
    numbers: Tensor
    count: int
    slopes: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, function: Function, x: Tensor, u: Tensor, theta: Tensor) -> PointFunction:
        """Trace a function at a point x [nx], u [nu], theta [P], and compile it.

        Raises Unsupported: native code does not know an operation in it, or there is no compiler.
        """
        graph = Graph()
        values = traced(graph, function, x, u, theta)
        slopes = {
            (entry, place): node
            for entry, row in enumerate(derivatives(graph, values))
            for (kind, place), node in row.items()
            if kind == SHARED
        }
        constants, results = Constants(graph, len(theta)), [*values, *slopes.values()]
        code = evaluation(graph, "values", values, constants) + evaluation(graph, "linear", results, constants)
        size = sizes(NX=len(x), NU=len(u), VALUES=len(values), RESULTS=len(results))
        source = f'#include "lanes.h"\n{size}{constants.prepare()}{code}#include "points.h"\n'
        library(source)
        return cls(source, constants.numbers(), len(values), tuple(slopes))

    def __call__(self, theta: Tensor, x: Tensor, u: Tensor, places: Sequence[int] = ()) -> tuple[Tensor, Tensor]:
        """Values at points x [T, nx], u [T, nu], and their derivatives by the parameters at some places.

        [n, T] and [len(places), n, T].
        """
        name, count = ("linear_at", self.count + len(self.slopes)) if places else ("values_at", self.count)
        x, u, theta = ready(x), ready(u), ready(torch.cat([theta, self.numbers]))
        results = x.new_empty(count, len(x))
        getattr(library(self.source), name)(ctypes.c_int64(len(x)), *(address(a) for a in (x, u, theta, results)))
        values, slopes = results[: self.count], x.new_zeros(len(places), self.count, len(x))
        order = {place: k for k, place in enumerate(places)}
        for (entry, place), slope in zip(self.slopes, results[self.count :], strict=False):  # none without places
            if place in order:
                slopes[order[place], entry] = slope
        return values, slopes
