"""A model as native code: rates and outputs traced once; trajectories, sensitivities and normal equations from it."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.native.build import address, lanes, library, ready
from rotorid_torch.core.native.graph.derivatives import Columns, Tangent, derivatives
from rotorid_torch.core.native.graph.emit import SHARED, Constants, straight_line
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.native.graph.tracing import scalarise

Function = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(x [nx], u [nu], theta [P]) -> [n]: one point, no leading dimensions."""
Motion = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""The same for rates [nx] and outputs [ny] together."""


def traced(graph: Graph, function: Function, x: Tensor, u: Tensor, theta: Tensor) -> list[int]:
    """Nodes of a function's results; the inputs are called x, u and th."""
    return scalarise(graph, function, {"x": x, "u": u, SHARED: theta})


def evaluation(graph: Graph, name: str, results: Sequence[int], constants: Constants) -> str:
    """C++ of a function's values: name(x, u, c, out) for a double or a vector of them."""
    body = straight_line(graph, {f"out[{i}]": node for i, node in enumerate(results)}, constants.name)
    arguments = "const T* x, const T* u, const double* c, T* out"
    return f"template <class T> static inline void {name}({arguments}) {{\n{body}\n}}\n"


def sizes(**numbers: int) -> str:
    """The sizes that the loops are compiled for."""
    return f"enum {{ {', '.join(f'{name} = {number}' for name, number in numbers.items())} }};\n"


@dataclass(frozen=True, eq=False)
class Dynamics:
    """dx/dt = rates(x, u, theta), y = outputs(x, u, theta) in native code; libraries are built when first asked for.

    nx, nu, ny, count : numbers of states, controls, outputs, parameters.
    path : parameters that the controls depend on (their derivatives come with the controls).
    initial : whether initial states are unknowns.
    hold : controls stay as they are within a step; else they are linear.
    """

    graph: Graph
    rates: tuple[int, ...]
    outputs: tuple[int, ...]
    nx: int
    nu: int
    ny: int
    count: int
    path: tuple[int, ...] = ()
    initial: bool = True
    hold: bool = False

    @classmethod
    def of(cls, motion: Motion, x: Tensor, u: Tensor, theta: Tensor) -> Dynamics:
        """Trace rates and outputs at a point; what both need is traced once. `replace` gives the other settings.

        Raises Unsupported: an operation in the function is not known to native code.
        """
        graph = Graph()
        nodes = traced(graph, lambda *point: torch.cat(motion(*point)), x, u, theta)
        f, h = nodes[: len(x)], nodes[len(x) :]
        return cls(graph, tuple(f), tuple(h), len(x), len(u), len(h), len(theta))

    @cached_property
    def columns(self) -> Columns:
        """Where the tangents of the parameters lie."""
        rows = [derivatives(self.graph, results) for results in (self.rates, self.outputs)]
        starts = self.nx if self.initial else 0
        return Columns.arranged(rows, self.count, self.path, starts, lanes())

    @cached_property
    def simulation(self) -> tuple[str, Tensor]:
        """C++ for trajectories, and the numbers in it."""
        constants = Constants(self.graph, self.count)
        f = evaluation(self.graph, "rates", self.rates, constants)
        h = evaluation(self.graph, "outputs", self.outputs, constants)
        size = sizes(NX=self.nx, NU=self.nu, NY=self.ny)
        return f'{self._head}{size}{constants.prepare()}{f}{h}#include "simulate.h"\n', constants.numbers()

    @cached_property
    def sensitivity(self) -> tuple[str, Tensor]:
        """C++ for derivatives, and the numbers in it."""
        constants, columns = Constants(self.graph, self.count), self.columns
        f = Tangent(self.graph, "rates", self.rates, columns, constants).text()
        h = Tangent(self.graph, "outputs", self.outputs, columns, constants).text()
        size = sizes(NX=self.nx, NU=self.nu, NY=self.ny, LOOP=columns.loop, PATH=columns.path, STARTS=columns.starts)
        size += sizes(RESIDUAL=columns.residual, WIDTH=columns.total)
        return f'{self._head}{size}{constants.prepare()}{f}{h}#include "sensitivity.h"\n', constants.numbers()

    def build(self, derivatives: bool = False) -> None:
        """Compile the trajectories' code now, and that of the derivatives beside it.

        Raises Unsupported: there is no compiler, or it refuses the model.
        """
        sources = [self.simulation[0]] + ([self.sensitivity[0]] if derivatives else [])
        with ThreadPoolExecutor() as side_by_side:
            list(side_by_side.map(library, sources))

    def depends_on(self, name: str, place: int) -> bool:
        """Whether rates or outputs depend on an input, "x" or "u"."""
        wanted = self.graph.input(name, place)
        return any(wanted in self.graph.gradient(node) for node in (*self.rates, *self.outputs))

    @property
    def _head(self) -> str:
        return ("#define HOLD\n" if self.hold else "") + '#include "lanes.h"\n'

    def simulate(
        self, theta: Tensor, x0: Tensor, controls: Tensor, dt: float, limit: float = math.inf, threads: int = 1
    ) -> tuple[Tensor, Tensor]:
        """Trajectories [B, T, nx] and outputs [B, T, ny] from x0 [B, nx] under controls [B, T, nu] linear in between.

        limit : states and rates beyond it are held there; infinite for none.
        """
        source, numbers = self.simulation
        x0, controls, theta = ready(x0), ready(controls), ready(torch.cat([theta, numbers]))
        count, samples = controls.shape[:2]
        states, outputs = (torch.empty(count, samples, n, dtype=torch.float64) for n in (self.nx, self.ny))
        places = [address(a) for a in (controls, x0, theta, states, outputs)]
        library(source).simulate(count, samples, ctypes.c_double(dt), ctypes.c_double(limit), *places, threads)
        return states, outputs

    def normal_equations(self, problem: LinearProblem, threads: int = 1) -> tuple[Tensor, Tensor]:
        """Products of the whitened rows' columns [S, n, n] (upper part), and the last states by the first [S, nx, nx].

        Columns: initial states where they are unknowns (else the second is NaN), parameters, residual.
        """
        order = self.columns.order()
        count, n = len(problem.x0), len(order)
        H = torch.zeros(count, n, n, dtype=torch.float64)
        passage = torch.full((count, self.nx, self.nx), math.nan, dtype=torch.float64)
        self._call("normal_equations", problem, order, (H, passage), threads)
        return H, passage

    def whitened_rows(self, problem: LinearProblem, threads: int = 1) -> Tensor:
        """The whitened rows themselves [S, T ny, n], zero beyond a segment's end; columns as in `normal_equations`."""
        order = self.columns.order()
        rows = torch.zeros(len(problem.x0), problem.samples * self.ny, len(order), dtype=torch.float64)
        self._call("whitened_rows", problem, order, (rows,), threads)
        return rows

    def triangles(self, H: Tensor, first: int, weak: float) -> tuple[Tensor, Tensor]:
        """The first rows of the triangles of symmetric matrices [B, n, n] (upper part), and what is left of the rest.

        A column that depends on those before it to rounding gets zeros, among the first on the diagonal `weak` times
        its length; the last one, a residual, stays as it is:
        [B, first, n] and [B, n - first, n - first].
        """
        reduced, top = H.clone(), torch.zeros(len(H), first, H.shape[-1], dtype=torch.float64)
        places = address(reduced), address(top)
        library(self.sensitivity[0]).triangles(len(H), H.shape[-1], first, ctypes.c_double(weak), *places)
        return top, reduced[:, first:, first:]

    def _call(
        self, name: str, problem: LinearProblem, order: Tensor, results: tuple[Tensor, ...], threads: int
    ) -> None:
        source, numbers = self.sensitivity
        theta = ready(torch.cat([problem.theta, numbers]))
        path, whitening = self.columns.padded(problem.path), (problem.weight, problem.pattern, problem.table)
        arrays = problem.length, problem.controls, path, problem.residual, problem.x0, theta, *whitening
        places, filled = [address(a) for a in arrays], [address(a) for a in (order, *results)]
        call, sizes = getattr(library(source), name), (len(problem.x0), problem.samples)
        call(*sizes, ctypes.c_double(problem.dt), *places, len(order), *filled, threads)


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """Segments to linearise: all float64 and contiguous.

    controls [S, T, nu]; path [S, T, nu, n] derivatives of the controls by the control path's parameters; residual
    [S, T, ny], NaN = missing; x0 [S, nx]; length [S] samples (int32); theta [P]; weight [ny] one over the standard
    deviations, or a table [patterns, ny, ny] of lower triangular whitening matrices with pattern [S, T] (int32).
    """

    dt: float
    length: Tensor
    controls: Tensor
    path: Tensor
    residual: Tensor
    x0: Tensor
    theta: Tensor
    weight: Tensor
    pattern: Tensor | None = None
    table: Tensor | None = None

    @property
    def samples(self) -> int:
        """Samples of the longest segment."""
        return self.controls.shape[1]
