"""The model's derivative and output functions as an ONNX graph in float64, written from the traced expressions."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from rotorid_torch.core.native.dynamics import Dynamics
from rotorid_torch.core.native.graph.emit import SHARED
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.errors import InputError, Unsupported
from rotorid_torch.exporting.subject import Subject

OPSET, IR = 18, 10
"""Versions that runtimes of the last years read."""
OPERATORS = {
    "add": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "neg": "Neg", "sin": "Sin", "cos": "Cos", "sqrt": "Sqrt",
    "root": "Sqrt", "pow": "Pow", "sigmoid": "Sigmoid", "exp": "Exp", "log": "Log", "tanh": "Tanh", "asin": "Asin",
    "acos": "Acos", "atan": "Atan", "abs": "Abs", "maximum": "Max", "minimum": "Min", "where": "Where",
    "gt": "Greater", "lt": "Less", "ge": "GreaterOrEqual", "le": "LessOrEqual",
}  # fmt: skip
"""Operators by the graph's operations; log1p is written with Log, atan2 has none."""


def write_onnx(subject: Subject, path: Path) -> None:
    """Write the graph: inputs x [N, nx], u [N, nu]; outputs rates [N, nx], outputs [N, ny]; "theta" is an initializer.

    u are the controls behind their way: delays and lags are the caller's. Names and units are the file's metadata.

    Raises InputError: the package onnx is not installed, or an operation of the model has no operator.
    """
    try:
        import onnx
    except ImportError:
        raise InputError(path, "--onnx", "onnx is not installed", "pip install 'rotorid-torch[onnx]'") from None
    model = subject.model
    x, u = model.reference_point
    try:
        dynamics = Dynamics.of(lambda x, u, th: model.motion(th, x, u), x, u, model.theta.detach())
        writer = _Writer(dynamics.graph, model.theta.tolist())
        writer.write({"rates": dynamics.rates, "outputs": dynamics.outputs}, {"x": len(x), "u": len(u)})
    except Unsupported as error:
        wrong = f"the model has no ONNX graph: {error}"
        raise InputError(path, "--onnx", wrong, "torch operations on numbers") from None
    helper, double = onnx.helper, onnx.TensorProto.DOUBLE
    sizes = {"x": len(x), "u": len(u), "rates": len(dynamics.rates), "outputs": len(dynamics.outputs)}
    values = {n: helper.make_tensor_value_info(n, double, ["N", size]) for n, size in sizes.items()}
    inputs, outputs = [values["x"], values["u"]], [values["rates"], values["outputs"]]
    graph = helper.make_graph(writer.nodes, "rotorcraft", inputs, outputs, writer.initializers)
    imports = [helper.make_opsetid("", OPSET)]
    whole = helper.make_model(graph, producer_name=subject.tool, opset_imports=imports, ir_version=IR)
    helper.set_model_props(whole, _facts(subject))
    onnx.checker.check_model(whole)
    path.write_bytes(whole.SerializeToString())


def _facts(subject: Subject) -> dict[str, str]:
    body = subject.model.body
    units = {s.name: s.unit for s in subject.model.layout.states} | {n: subject.unit(n) for n in body.controls}
    lists = {"states": subject.model.layout.names, "controls": body.controls, "outputs": body.outputs}
    lists["parameters"] = subject.model.parameter_set.names
    facts = {name: json.dumps(words) for name, words in lists.items()}
    trim = {n: subject.model.reference.get(n, 0.0) for n in (*subject.model.layout.names, *body.controls)}
    return facts | {"title": subject.title, "units": json.dumps(units), "trim": json.dumps(trim)}


class _Writer:
    """Nodes of ONNX for expressions: each is a column [N, 1], what depends on parameters alone is [1, 1]."""

    def __init__(self, graph: Graph, theta: Sequence[float]) -> None:
        from onnx import helper, numpy_helper

        self.graph, self.nodes, self.initializers = graph, [], []
        self.helper, self.numpy_helper = helper, numpy_helper
        self.names: dict[int, str] = {}
        self.columns: set[int] = set()
        self._constant("theta", torch.tensor([list(theta)], dtype=torch.float64))
        self.theta = len(theta)

    def write(self, results: dict[str, Sequence[int]], inputs: dict[str, int]) -> None:
        """Fill in nodes and initializers."""
        for name, size in {**inputs, "theta": self.theta}.items():
            self._split(name, size)
        self._node("Shape", ["x.0"], "shape")
        for node in self.graph.needed([n for nodes in results.values() for n in nodes]):
            self.names[node] = self._expression(node)
        for name, nodes in results.items():
            self._node("Concat", [self._column(n) for n in nodes], name, axis=1)

    def _split(self, name: str, size: int) -> None:
        if size == 1:
            self._node("Identity", [name], f"{name}.0")
        elif size:
            self._constant(f"{name}.sizes", torch.ones(size, dtype=torch.int64))
            pieces = [f"{name}.{k}" for k in range(size)]
            self.nodes.append(self.helper.make_node("Split", [name, f"{name}.sizes"], pieces, axis=1))

    def _expression(self, node: int) -> str:
        operation, name = self.graph.operation(node), f"t{node}"
        if operation == "constant":
            self._constant(name, torch.tensor([[self.graph.value(node)]], dtype=torch.float64))
            return name
        if operation == "input":
            _, source, place = self.graph.nodes[node]
            if source != SHARED:
                self.columns.add(node)
            return f"{'theta' if source == SHARED else source}.{place}"
        arguments = self.graph.arguments(node)
        if any(a in self.columns for a in arguments):
            self.columns.add(node)
        named = [self.names[a] for a in arguments]
        if operation == "log1p":
            self._constant(f"{name}.one", torch.ones(1, 1, dtype=torch.float64))
            self._node("Add", [*named, f"{name}.one"], f"{name}.sum")
            return self._node("Log", [f"{name}.sum"], name)
        if operation not in OPERATORS:
            raise Unsupported(f"{operation} has no operator")
        return self._node(OPERATORS[operation], named, name)

    def _column(self, node: int) -> str:
        """A result as a column, also where it is the same in all rows."""
        if node in self.columns:
            return self.names[node]
        name = f"t{node}.column"
        if all(name not in node.output for node in self.nodes):
            self._node("Expand", [self.names[node], "shape"], name)
        return name

    def _node(self, operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        self.nodes.append(self.helper.make_node(operator, list(inputs), [output], **attributes))
        return output

    def _constant(self, name: str, value: torch.Tensor) -> None:
        self.initializers.append(self.numpy_helper.from_array(value.numpy(), name))
