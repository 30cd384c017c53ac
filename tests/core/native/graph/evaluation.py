"""Traced functions as numbers: values and derivatives by every input."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from rotorid_torch.core.native.graph.derivatives import derivatives
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.native.graph.tracing import scalarise


def traced_value(function: Callable[..., Tensor], traced_at: Mapping[str, Tensor], at: Mapping[str, Tensor]) -> Tensor:
    """A function traced at one place, evaluated at another [n]."""
    graph = Graph()
    nodes = scalarise(graph, function, traced_at)
    return torch.tensor(graph.evaluated(nodes, listed(at)), dtype=torch.float64)


def traced_jacobian(function: Callable[..., Tensor], at: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Derivatives of a function's results by each input [n, m]."""
    graph = Graph()
    nodes = scalarise(graph, function, at)
    found = {name: torch.zeros(len(nodes), value.numel(), dtype=torch.float64) for name, value in at.items()}
    for i, row in enumerate(derivatives(graph, nodes)):
        for (name, place), slope in zip(row, graph.evaluated(list(row.values()), listed(at)), strict=True):
            found[name][i, place] = slope
    return found


def listed(at: Mapping[str, Tensor]) -> dict[str, list[float]]:
    """Inputs as `Graph.evaluated` wants them."""
    return {name: value.reshape(-1).tolist() for name, value in at.items()}
