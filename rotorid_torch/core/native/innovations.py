"""The extended Kalman filter of a model as native code: innovations, and normal equations of its likelihood's rows."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.native.build import address, lanes, library
from rotorid_torch.core.native.dynamics import sizes, traced
from rotorid_torch.core.native.graph.derivatives import Columns, Derivatives, Tangent, derivatives
from rotorid_torch.core.native.graph.emit import SHARED, Constants
from rotorid_torch.core.native.graph.symbols import Graph, Term

Parts = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor, Tensor]]
"""(x [nx], u [nu], psi [n]) -> rates [nx], outputs [ny], spectral density [nx, nx], noise covariance [ny, ny]."""


@dataclass(frozen=True, eq=False)
class FlightsToFollow:
    """Flights F of T samples at most: all float64 and contiguous.

    controls [F, T, nu]; path [F, T, nu, n] derivatives of the controls by the control path's parameters; outputs
    [F, T, ny], NaN = missing; length [F] samples (int32); x0 [F, nx] and P0 [F, nx, nx] mean and covariance of the
    first state.
    """

    dt: float
    length: Tensor
    controls: Tensor
    path: Tensor
    outputs: Tensor
    x0: Tensor
    P0: Tensor


@dataclass(frozen=True, eq=False)
class FollowedFlights:
    """What the filter makes of each flight.

    cost [F]; lost [F, 2] sample and state where it diverged, -1 where it did not; if asked for,
    innovations [F, T, ny], spreads [F, T, ny, ny], states [F, T, nx], covariances [F, T, nx, nx]; gains
    [F, T, nx, ny] and white [F, T, ny, ny], factor of the spreads' inverse, with zeros where samples are missing.
    """

    cost: Tensor
    lost: Tensor
    innovations: Tensor | None = None
    spreads: Tensor | None = None
    states: Tensor | None = None
    covariances: Tensor | None = None
    gains: Tensor | None = None
    white: Tensor | None = None

    def histories(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """All that can be asked for."""
        recorded = [h for h in (self.innovations, self.spreads, self.states, self.covariances) if h is not None]
        return recorded[0], recorded[1], recorded[2], recorded[3]


@dataclass(frozen=True, eq=False)
class Innovations:
    """State and covariance as one vector of rates, outputs with their derivatives and noise as one of outputs.

    H, R : rows and columns of the entries of dh/dx, and of the upper half of R, behind the ny outputs.
    varies : whether entries of dh/dx do. path : parameters that the controls depend on.
    held : how many of psi, the first ones, are no unknowns; then nor are the initial states. Where all are held the
    code filters alone, and is made in a fraction of the time.
    """

    graph: Graph
    rates: tuple[int, ...]
    outputs: tuple[int, ...]
    by: tuple[Derivatives, Derivatives]
    H: tuple[tuple[int, int], ...]
    R: tuple[tuple[int, int], ...]
    varies: bool
    nx: int
    nu: int
    ny: int
    count: int
    path: tuple[int, ...] = ()
    held: int = 0

    @classmethod
    def of(cls, parts: Parts, x: Tensor, u: Tensor, psi: Tensor, held: int = 0) -> Innovations:
        """Trace a model and its noise at a point.

        Raises Unsupported: an operation in the functions is not known to native code.
        """
        graph, nx = Graph(), len(x)
        nodes = traced(graph, lambda *point: torch.cat([p.reshape(-1) for p in parts(*point)]), x, u, psi)
        ny = round((len(nodes) - nx - nx * nx + 0.25) ** 0.5 - 0.5)
        f, h = nodes[:nx], nodes[nx : nx + ny]
        Q, R = nodes[nx + ny : nx + ny + nx * nx], nodes[nx + ny + nx * nx :]
        rates = [*f, *_covariance_rates(graph, f, Q)]
        slopes = [(i, j, node) for i, row in enumerate(_by_state(graph, h)) for j, node in sorted(row.items())]
        noise = [(i, j, R[i * ny + j]) for i in range(ny) for j in range(i, ny) if graph.value(R[i * ny + j]) != 0.0]
        outputs = [*h, *(node for _, _, node in slopes), *(node for _, _, node in noise)]
        by = _unknown(graph, rates, psi, held), _unknown(graph, outputs, psi, held)
        of_H, of_R = (tuple((i, j) for i, j, _ in entries) for entries in (slopes, noise))
        varies = any(graph.value(node) is None for _, _, node in slopes)
        return cls(graph, tuple(rates), tuple(outputs), by, of_H, of_R, varies, nx, len(u), ny, len(psi), held=held)

    @cached_property
    def columns(self) -> Columns:
        """Where the tangents of the unknowns lie."""
        starts = 0 if self.held else self.nx
        return Columns.arranged(self.by, self.count - self.held, self.path, starts, lanes())

    @cached_property
    def code(self) -> tuple[str, Tensor]:
        """C++ of the filter, and the numbers in it."""
        constants, columns = Constants(self.graph, self.count), self.columns
        f = Tangent(self.graph, "rates", self.rates, columns, constants, self.by[0]).text()
        h = Tangent(self.graph, "outputs", self.outputs, columns, constants, self.by[1]).text()
        size = sizes(NX=len(self.rates), NU=self.nu, NY=len(self.outputs), N=self.nx, M=self.ny)
        size += sizes(LOOP=columns.loop, PATH=columns.path, STARTS=columns.starts)
        size += sizes(RESIDUAL=columns.residual, WIDTH=columns.total)
        size += sizes(NH=len(self.H), NR=len(self.R), H_VARIES=int(self.varies))
        tables: dict[str, Sequence[int]] = {}
        for name, places in (("H", self.H), ("R", self.R)):
            tables |= {f"{name}_ROW": [i for i, _ in places], f"{name}_COL": [j for _, j in places]}
        size += "".join(f"static const int {k}[] = {{{', '.join(map(str, (*v, 0)))}}};\n" for k, v in tables.items())
        return f'#include "lanes.h"\n{size}{constants.prepare()}{f}{h}#include "innovations.h"\n', constants.numbers()

    def build(self) -> None:
        """Compile now.

        Raises Unsupported: there is no compiler, or it refuses the model.
        """
        library(self.code[0])

    def depends_on(self, name: str, place: int) -> bool:
        """Whether rates or outputs depend on an input, "x" or "u"."""
        needed = self.graph.needed([*self.rates, *self.outputs])
        return self.graph.input(name, place) in needed

    def normal_equations(
        self, psi: Tensor, flights: FlightsToFollow, threads: int = 1
    ) -> tuple[FollowedFlights, Tensor]:
        """The same, and of each flight the products of the rows' columns [F, m, m]: x0, psi, b."""
        n = len(self.columns.order())
        H = torch.zeros(len(flights.length), n, n, dtype=torch.float64)
        answer = self.filter(psi, flights, threads, H=H)
        return answer, H + H.triu(1).mT

    def rows(self, psi: Tensor, flights: FlightsToFollow, threads: int = 1) -> Tensor:
        """The rows themselves [F, T, ny + ny (ny + 1) / 2, m], zero beyond a flight's end."""
        shape = flights.outputs.shape[:2], self.ny + self.ny * (self.ny + 1) // 2, len(self.columns.order())
        rows = torch.zeros(*shape[0], *shape[1:], dtype=torch.float64)
        self.filter(psi, flights, threads, rows=rows)
        return rows

    def filter(
        self,
        psi: Tensor,
        flights: FlightsToFollow,
        threads: int = 1,
        histories: bool = False,
        H: Tensor | None = None,
        rows: Tensor | None = None,
    ) -> FollowedFlights:
        """The flights filtered; histories : with all that the answer can hold. H, rows : are filled in besides."""
        source, numbers = self.code
        (count, samples, ny), nx, order = flights.outputs.shape, self.nx, self.columns.order()
        cost, lost = torch.zeros(count, dtype=torch.float64), torch.full((count, 2), -1, dtype=torch.int32)
        shapes = ((ny,), (ny, ny), (nx,), (nx, nx), (nx, ny), (ny, ny))
        empty = (torch.full((count, samples, *shape), torch.nan, dtype=torch.float64) for shape in shapes)
        written = [*empty] if histories else [None] * len(shapes)
        path = self.columns.padded(flights.path)
        theta = torch.cat([psi, numbers]).contiguous()
        records = flights.length, flights.controls, path, flights.outputs, flights.x0, flights.P0, theta, cost, lost
        places, filled = [address(a) for a in (*records, *written)], [address(a) for a in (order, H, rows)]
        library(source).innovations(count, samples, ctypes.c_double(flights.dt), *places, len(order), *filled, threads)
        return FollowedFlights(cost, lost, *written)


def _unknown(graph: Graph, results: Sequence[int], psi: Tensor, held: int) -> Derivatives:
    """Derivatives without those by the first parameters, the others counted from there; none where all are held."""
    if held and held == len(psi):
        return [{} for _ in results]
    return [
        {(n, k - held if n == SHARED else k): node for (n, k), node in row.items() if n != SHARED or k >= held}
        for row in derivatives(graph, results)
    ]


def _by_state(graph: Graph, results: Sequence[int]) -> list[dict[int, int]]:
    """Of each result the nodes of its derivatives by the states it depends on."""
    return [{place: node for (kind, place), node in row.items() if kind == "x"} for row in derivatives(graph, results)]


def _covariance_rates(graph: Graph, rates: Sequence[int], Q: Sequence[int]) -> list[int]:
    """Nodes of the upper half of A P + P A' + Q, row by row; P is the input behind the states, in the same order."""
    n, slopes = len(rates), _by_state(graph, rates)
    places = {(i, j): n + k for k, (i, j) in enumerate((i, j) for i in range(n) for j in range(i, n))}
    P = lambda i, j: Term(graph, graph.input("x", places[min(i, j), max(i, j)]))  # noqa: E731
    terms = []
    for i, j in places:
        value = Term(graph, Q[i * n + j])
        for k, slope in sorted(slopes[i].items()):
            value = value + Term(graph, slope) * P(k, j)
        for k, slope in sorted(slopes[j].items()):
            value = value + Term(graph, slope) * P(i, k)
        terms.append(value.node)
    return terms
