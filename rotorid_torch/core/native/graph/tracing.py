"""From a torch function to scalar expressions: it runs once, and node numbers go beside the entries of every tensor.

A symbolic tensor is an int64 tensor of node numbers, so torch itself does all views, joins and look-ups by constant
index; only arithmetic is spelled out (`rules`). What does not depend on an input torch computes as it is. The function
is watched through a dispatch mode under functionalisation (no in-place writes are left), which sees the same operations
as make_fx but takes a tenth of its time. What came of it is held against torch at another point, so that nothing goes
on that was not followed.
"""

import traceback
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from rotorid_torch.core.native.graph.rules import Scalars, Symbols
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.errors import Unsupported as Unsupported

AGREE = 1e-8
"""Of the largest result: what tracing may change at another point, by rounding."""
FAILURES = (RuntimeError, TypeError, ValueError, IndexError, KeyError, AttributeError)
"""What torch raises where a function leaves the path that can be watched, as tolist() and numpy() do."""
NATIVE = "rotorid_torch.core.native"
"""Modules whose lines are none of the model."""


def scalarise(graph: Graph, function: Callable[..., Tensor], examples: Mapping[str, Tensor]) -> list[int]:
    """Nodes of all entries of function(*examples), in order; the examples' names become those of the inputs.

    Raises Unsupported: an operation that is not known here, a branch that depends on an input, or results that are not
    torch's, such as random ones.
    """
    watch = Scalars(graph)
    inputs = [example.detach().clone() for example in examples.values()]
    for name, value in zip(examples, inputs, strict=True):
        ids = [graph.input(name, k) for k in range(value.numel())]
        watch.note(value, Symbols(torch.tensor(ids, dtype=torch.int64).view_as(value)))
    try:
        with torch.no_grad(), watch:
            result = torch.func.functionalize(function, remove="mutations")(*inputs)
            nodes = watch.numbers(watch.symbols_of(result)).ids.reshape(-1).tolist()
        _compare(graph, nodes, function, examples)
        return nodes
    except (Unsupported, *FAILURES) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise Unsupported(f"{reason}{_place(error)}") from None


def _compare(graph: Graph, nodes: list[int], function: Callable[..., Tensor], examples: Mapping[str, Tensor]) -> None:
    """Traced and true results at another point."""
    near = {name: _beside(value.detach()) for name, value in examples.items()}
    with torch.no_grad():
        true = torch.as_tensor(function(*(v.clone() for v in near.values()))).reshape(-1).double()
    values = graph.evaluated(nodes, {name: v.reshape(-1).tolist() for name, v in near.items()})
    traced = torch.tensor(values, dtype=torch.float64)
    defined = true.isfinite()
    miss = torch.where(defined, traced - true, 0.0).abs().nan_to_num(nan=torch.inf)
    if nodes and miss.max() > AGREE * (1.0 + torch.where(defined, true, 0.0).abs().max()):
        worst = int(miss.argmax())
        difference = f"result {worst} is {float(traced[worst]):g} where torch says {float(true[worst]):g}"
        raise Unsupported(f"traced at one point and tried at another, {difference}: random, or not followed")


def _beside(value: Tensor) -> Tensor:
    """A little away, differently in all entries."""
    turn = torch.cos(torch.arange(1.0, value.numel() + 1.0, dtype=value.dtype)).view_as(value)
    return value + 1e-3 * (1.0 + value.abs()) * turn


def _place(error: Exception) -> str:
    """Where in the model's own code the operation was called: effect, file and line."""
    effect, place = "", ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        module, file = frame.f_globals.get("__name__", ""), frame.f_code.co_filename
        if not module.startswith(("torch", NATIVE)) and file != __file__:
            place = f"{file}, line {line}"
            owner = getattr(frame.f_locals.get("self"), "id", None)
            effect = f"effect '{owner}', " if isinstance(owner, str) and owner else effect
    return f" ({effect}{place})" if place else ""
