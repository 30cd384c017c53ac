"""The unscented filter and smoother in native code: a model's functions traced, compiled and run over all flights."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.native.build import library, ready
from rotorid_torch.core.native.dynamics import evaluation, sizes
from rotorid_torch.core.native.graph.emit import Constants
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.native.graph.tracing import Unsupported, scalarise

Function = Callable[[Tensor, Tensor], Tensor]
"""(x [..., nx], u [..., nu]) -> [..., n]"""


@dataclass(frozen=True)
class Weights:
    """Where sigma points lie and what they count: mean +- reach times the columns of the covariance's root.

    other : weight of each such point. centre : weight of the mean itself in covariances (in means: the rest to one).
    """

    reach: float
    centre: float
    other: float


@dataclass(frozen=True, eq=False)
class FlightsToFilter:
    """Flights F of T samples each, and what is known beforehand.

    mean, covariance : [F, nx], [F, nx, nx] of the first sample's state. R : [ny, ny]. controls : [F, T, nu].
    outputs : [F, T, ny], NaN where missing. rows, columns : [n] places of the process noise's entries, rows <= columns.
    values : [F or 1, T - 1 or 1, n] these entries. dt : s. parts : steps that a sample is taken in.
    """

    mean: Tensor
    covariance: Tensor
    R: Tensor
    controls: Tensor
    outputs: Tensor
    rows: Tensor
    columns: Tensor
    values: Tensor
    dt: float
    parts: int = 1


@dataclass(frozen=True, eq=False, repr=False)
class FilteredFlights:
    """[F, T, ...] as in `identification.reconstruct.unscented_filter.Filtered`; None where not asked for."""

    means: Tensor
    covariances: Tensor
    innovations: Tensor
    innovation_covariances: Tensor | None
    log_likelihood: Tensor
    smoothed_means: Tensor | None
    smoothed_covariances: Tensor | None


class _Settings(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in ("dt", "parts", "reach", "centre", "other")]


class _Task(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int64) for name in ("flights", "samples", "entries", "noise_flights", "noise_samples")),
        *((name, ctypes.c_void_p) for name in ("controls", "outputs", "mean", "covariance", "R", "noise", "numbers")),
        *((name, ctypes.c_void_p) for name in ("row", "column", "means", "covariances", "innovations", "spreads")),
        *((name, ctypes.c_void_p) for name in ("likelihood", "smoothed_means", "smoothed_covariances")),
    ]


@dataclass(frozen=True, eq=False)
class CompiledFilter:
    """Filter and smoother for dx/dt = f(x, u), y = h(x, u): C++ and the numbers in it."""

    source: str
    numbers: Tensor

    @classmethod
    def of(cls, f: Function, h: Function, x: Tensor, u: Tensor, ny: int) -> CompiledFilter:
        """Trace both functions at a point.

        x, u : [F, nx], [F, nu] a state and controls of each flight, where the functions are tried. ny : outputs.

        Raises Unsupported: native code does not know an operation in them, or they are not the same for every flight.
        """
        graph, bodies = Graph(), []
        constants = Constants(graph, 0)
        for name, function, n in (("rates", f, x.shape[-1]), ("outputs", h, ny)):
            _check_one_point(name, function, x, u, n)
            nodes = scalarise(graph, function, {"x": x[:1], "u": u[:1]})
            bodies.append(evaluation(graph, name, nodes, constants))
        size = sizes(NX=x.shape[-1], NU=u.shape[-1], NY=ny)
        text = f'#include "lanes.h"\n{size}{constants.prepare()}{"".join(bodies)}#include "filter.h"\n'
        return cls(text, constants.numbers())

    def run(
        self, problem: FlightsToFilter, weights: Weights, smooth: bool = True, spreads: bool = True, threads: int = 1
    ) -> FilteredFlights:
        """Filter, and smooth, all flights; the answer does not depend on the number of threads.

        spreads : write down the innovations' covariances.

        Raises Unsupported: it cannot be compiled here; MemoryError: the smoother's memory does not suffice.
        """
        arrays = {n: ready(getattr(problem, n)) for n in ("controls", "outputs", "mean", "covariance", "R")}
        noise, places = ready(problem.values), [ready(p, torch.int64) for p in (problem.rows, problem.columns)]
        (flights, samples, ny), nx = problem.outputs.shape, problem.mean.shape[-1]

        def empty(*shape: int, wanted: bool = True) -> Tensor | None:
            return torch.empty(flights, *shape, dtype=torch.float64) if wanted else None

        answer = {
            "means": empty(samples, nx),
            "covariances": empty(samples, nx, nx),
            "innovations": empty(samples, ny),
            "spreads": empty(samples, ny, ny, wanted=spreads),
            "likelihood": empty(),
            "smoothed_means": empty(samples, nx, wanted=smooth),
            "smoothed_covariances": empty(samples, nx, nx, wanted=smooth),
        }
        arrays |= {"numbers": self.numbers, "noise": noise, "row": places[0], "column": places[1]}
        addresses = {name: array.data_ptr() for name, array in (arrays | answer).items() if array is not None}
        task = _Task(flights, samples, len(places[0]), noise.shape[0], noise.shape[1], **addresses)
        settings = _Settings(problem.dt, problem.parts, weights.reach, weights.centre, weights.other)
        if library(self.source).unscented(ctypes.byref(settings), ctypes.byref(task), threads):
            raise MemoryError(f"smoothing {samples} samples of {nx} states")
        answer["innovation_covariances"], answer["log_likelihood"] = answer.pop("spreads"), answer.pop("likelihood")
        return FilteredFlights(**answer)  # pyright: ignore[reportArgumentType]


def _check_one_point(name: str, function: Function, x: Tensor, u: Tensor, n: int) -> None:
    """What is traced for one flight must hold for all: constants of single flights have to come in with u."""
    try:
        together = function(x.unsqueeze(-2), u.unsqueeze(-2))
        pairs = [(function(x[i : i + 1], u[i : i + 1]), together[i]) for i in (0, len(x) - 1)]
    except (RuntimeError, IndexError, ValueError) as error:
        raise Unsupported(f"for one state, its {name} fail: {str(error).splitlines()[0]}") from error
    for alone, among_all in pairs:
        if alone.shape != (1, n) or together.shape != (len(x), 1, n):
            raise Unsupported(f"for one state, its {name} have shape {tuple(alone.shape[1:])}, not ({n},)")
        if not torch.allclose(alone, among_all, rtol=1e-9, atol=1e-12, equal_nan=True):
            raise Unsupported(f"its {name} differ from flight to flight; what does must come in with the controls")
