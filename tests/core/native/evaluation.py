"""A graph's nodes as numbers, one after the other in Python: what traced and compiled code must give."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from rotorid_torch.core.native.operations import OPERATIONS
from rotorid_torch.core.native.symbols import Graph
from rotorid_torch.core.native.trace import scalarise


def evaluated(graph: Graph, nodes: Sequence[int], inputs: Mapping[str, Tensor]) -> Tensor:
    """Values of nodes [n] at the inputs."""
    values: list[float] = []
    for kind, *rest in graph.nodes[: max(nodes, default=-1) + 1]:
        if kind == "constant":
            values.append(float(rest[0]))
        elif kind == "input":
            values.append(float(inputs[str(rest[0])].reshape(-1)[int(rest[1])]))
        else:
            values.append(float(OPERATIONS[str(kind)].evaluate(*(values[int(a)] for a in rest))))
    return torch.tensor([values[n] for n in nodes], dtype=torch.float64)


def traced_value(function: Callable[..., Tensor], traced_at: Mapping[str, Tensor], at: Mapping[str, Tensor]) -> Tensor:
    """A function traced at one place, evaluated at another [n]."""
    graph = Graph()
    return evaluated(graph, scalarise(graph, function, traced_at), at)
