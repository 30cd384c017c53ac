"""Recursions over records in native code: one sample's step traced once, then run over all samples of all series."""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core.native.build import address, library, threads
from rotorid_torch.core.native.dynamics import evaluation, sizes
from rotorid_torch.core.native.graph.emit import Constants
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.native.graph.tracing import scalarise

Step = Callable[..., Tensor]
"""y[k] from y[k-1] and the inputs at k, entry by entry."""
SERIES = 64
"""Series below which threads cost more than they save."""


class _Input(ctypes.Structure):
    _fields_ = [("values", ctypes.c_void_p), ("batch", ctypes.c_int64), ("sample", ctypes.c_int64)]


@dataclass(frozen=True, eq=False)
class CompiledRecursion:
    """y[k] = step(y[k-1], u1[k], u2[k], ...): C++ of the step and its derivatives, and the numbers in it."""

    source: str
    numbers: Tensor

    @classmethod
    @functools.lru_cache(maxsize=64)
    def of(cls, step: Step, count: int) -> CompiledRecursion:
        """Trace a step with this many inputs.

        Raises Unsupported: native code does not know an operation in the step.
        """
        graph = Graph()
        last, inputs = torch.tensor([0.3], dtype=torch.float64), torch.linspace(0.5, 1.0, count, dtype=torch.float64)
        (value,) = scalarise(graph, lambda x, u: step(x, *u.split(1)), {"x": last, "u": inputs})
        slopes, none = graph.gradient(value), graph.constant(0.0)
        by = [graph.input("x", 0), *(graph.input("u", i) for i in range(count))]
        constants = Constants(graph, 0)
        body = evaluation(graph, "step", [value, *(slopes.get(node, none) for node in by)], constants)
        text = f'#include "lanes.h"\n{sizes(NU=count)}{constants.prepare()}{body}#include "recursion.h"\n'
        return cls(text, constants.numbers())

    def run(self, start: Tensor, inputs: Sequence[Tensor]) -> tuple[Tensor, ...]:
        """Outputs and the derivatives of each step by y[k-1] and by each input, all [..., T, n].

        start : [..., n] y before the first sample. inputs : [..., T or 1, n], float64; dimensions broadcast.

        Raises Unsupported: there is no compiler, or it refuses the step.
        """
        code = library(self.source)
        lead = np.broadcast_shapes(start.shape[:-1], *(u.shape[:-2] for u in inputs))
        columns = np.broadcast_shapes(start.shape[-1:], *(u.shape[-1:] for u in inputs))[0]
        samples, batch = max(u.shape[-2] for u in inputs), math.prod(lead)
        first = start.expand(*lead, columns).contiguous()
        arrays = [u.expand(*lead, u.shape[-2], columns).contiguous() for u in inputs]
        pointers = (_Input * len(arrays))(
            *(_Input(u.data_ptr(), u.shape[-2] * columns, 0 if u.shape[-2] == 1 else columns) for u in arrays)
        )
        results = tuple(first.new_empty(*lead, samples, columns) for _ in range(2 + len(arrays)))
        slopes = (ctypes.c_void_p * (1 + len(arrays)))(*(slope.data_ptr() for slope in results[1:]))
        series = batch * columns
        code.follow(
            *(ctypes.c_int64(number) for number in (series, columns, samples)),
            ctypes.byref(pointers),
            *(address(array) for array in (first, self.numbers, results[0])),
            ctypes.byref(slopes),
            threads() if series >= SERIES else 1,
        )
        return results
