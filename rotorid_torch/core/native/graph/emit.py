"""From expressions to C++: straight-line code for a double or a vector of them."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from rotorid_torch.core.native.graph.operations import COMPARISONS, OPERATIONS
from rotorid_torch.core.native.graph.symbols import Graph

SHARED = "th"
"""Name of the input that is the same in all lanes and at all times: the parameters."""


PLAIN = (0.0, 1.0, -1.0, 2.0, -2.0, 0.5, -0.5)
"""Numbers that are written into the code; all others are data, so that models which differ in numbers share it."""


class Constants:
    """Expressions of parameters and numbers alone; they are computed once, before the loop, as c[0], c[1], ...

    The loop is handed one vector th: `count` parameters, then the numbers of the model.
    """

    def __init__(self, graph: Graph, count: int) -> None:
        self.graph, self.count = graph, count
        self._places: dict[int, int] = {}
        self._numbers: dict[int, int] = {}
        self._shared: list[bool] = []

    def shared(self, node: int) -> bool:
        """Whether a node depends on nothing but parameters."""
        for one in range(len(self._shared), node + 1):  # arguments stand before what is made of them
            kind = self.graph.operation(one)
            of_parameters = kind == "input" and self.graph.nodes[one][1] == SHARED
            of_shared = kind != "input" and all(self._shared[a] for a in self.graph.arguments(one))
            self._shared.append(of_parameters or of_shared)
        return self._shared[node]

    def name(self, node: int) -> str | None:
        """What the loop calls such an expression; None for any other."""
        if not self.shared(node):
            return None
        value = self.graph.value(node)
        if value in PLAIN:
            return _number(value)
        return f"c[{self._places.setdefault(node, len(self._places))}]"

    def _given(self, node: int) -> str | None:
        """What a number is called before the loop."""
        value = self.graph.value(node)
        if value is None or value in PLAIN:
            return None if value is None else _number(value)
        return f"th[{self.count + self._numbers.setdefault(node, len(self._numbers))}]"

    def prepare(self) -> str:
        """The function that fills c from th; asked for when the loop's functions are written."""
        body = straight_line(self.graph, {f"c[{k}]": node for node, k in self._places.items()}, self._given, "double")
        count = max(len(self._places), 1)
        return f"enum {{ NC = {count} }};\nstatic void prepare(const double* th, double* c) {{\n{body}\n}}\n"

    def numbers(self) -> Tensor:
        """The model's numbers, in order; complete after `prepare`."""
        return torch.tensor([self.graph.value(node) for node in self._numbers], dtype=torch.float64)


def _number(value: float) -> str:
    return repr(value) if value >= 0 else f"({value!r})"


MANY = 64
"""Products in one array, from which on a loop over a table takes them: compilers take long over lines."""


def straight_line(graph: Graph, results: Mapping[str, int], named: Callable[[int], str | None], kind: str = "T") -> str:
    """Assignments "result = expression;" of {result: node} and of all that they need, in order.

    named : name of a node that is there already, None for one that is computed here. kind : type of what varies.
    """
    before, after, remaining = [], [], dict(results)
    for array, entries in _arrays(results).items():
        factors = {k: f for k, node in entries.items() if (f := _factors(graph, node, named)) is not None}
        if len(factors) >= MANY:
            slots: dict[int, int] = {}
            for pair in factors.values():
                for node in pair:
                    slots.setdefault(node, len(slots))
            for k in factors:
                del remaining[f"{array}[{k}]"]
            remaining |= {f"{array}_of[{slot}]": node for node, slot in slots.items()}
            before.append(f"  {kind} {array}_of[{len(slots)}];")
            after.append(_table(array, {k: (slots[a], slots[b]) for k, (a, b) in factors.items()}))
    return "\n".join([*before, _lines(graph, remaining, named, kind), *after])


def _arrays(results: Mapping[str, int]) -> dict[str, dict[int, int]]:
    """Entries by the arrays they lie in: node by place."""
    arrays: dict[str, dict[int, int]] = {}
    for result, node in results.items():
        array, bracket, place = result.removesuffix("]").partition("[")
        if bracket:
            arrays.setdefault(array, {})[int(place)] = node
    return arrays


def _factors(graph: Graph, node: int, named: Callable[[int], str | None]) -> tuple[int, int] | None:
    """The two factors of a product that is computed here; None for anything else."""
    if named(node) is not None:
        return None
    if graph.operation(node) == "neg":
        pair = _factors(graph, graph.arguments(node)[0], named)
        return None if pair is None else (graph.apply("neg", pair[0]), pair[1])
    if graph.operation(node) != "mul":
        return None
    a, b = graph.arguments(node)
    return a, b


def _table(array: str, factors: Mapping[int, tuple[int, int]]) -> str:
    """A loop that multiplies factors out."""
    columns = {"to": list(factors), "left": [a for a, _ in factors.values()], "right": [b for _, b in factors.values()]}
    tables = "".join(
        f"  static const unsigned short {array}_{name}[] = {{{', '.join(map(str, numbers))}}};\n"
        for name, numbers in columns.items()
    )
    left, right = (f"{array}_of[{array}_{side}[e]]" for side in ("left", "right"))
    return f"{tables}  for (int e = 0; e < {len(factors)}; e++) {array}[{array}_to[e]] = {left} * {right};"


def _lines(graph: Graph, results: Mapping[str, int], named: Callable[[int], str | None], kind: str) -> str:
    """Straight-line code alone."""
    text: dict[int, str] = {}
    varies: dict[int, bool] = {}
    pairs: set[int] = set()
    code: list[str] = []
    for node in graph.needed(list(results.values()), lambda n: named(n) is not None):
        operation, name = graph.operation(node), named(node)
        if name is not None:
            text[node], varies[node] = name, False
            continue
        varies[node] = True
        if operation == "input":
            _, name, place = graph.nodes[node]
            text[node] = f"{name}[{place}]"
        elif operation in ("sin", "cos") and kind != "double":  # of one double the compiler joins them
            (argument,) = graph.arguments(node)
            if argument not in pairs:
                pairs.add(argument)
                angle = _as(kind, text[argument], varies[argument])
                code.append(f"{kind} s{argument}, c{argument}; SinCos({angle}, s{argument}, c{argument});")
            text[node] = f"{operation[0]}{argument}"
        else:
            text[node] = f"t{node}"
            code.append(f"const {_type(operation, kind)} t{node} = {_expression(graph, node, text, varies, kind)};")
    for result, node in results.items():
        code.append(f"{result} = {_as(kind, text[node], varies[node])};")
    return "\n".join(f"  {line}" for line in code)


def _as(kind: str, text: str, varies: bool) -> str:
    """A number that is the same in all lanes, as a vector."""
    return text if varies or kind == "double" else f"({kind}() + {text})"


def _type(operation: str, kind: str) -> str:
    """Of a result: a comparison of doubles is a number, in C too; of vectors it is a mask."""
    return ("int" if kind == "double" else "auto") if operation in COMPARISONS else kind


def _expression(graph: Graph, node: int, text: Mapping[int, str], varies: Mapping[int, bool], kind: str) -> str:
    operation, arguments = graph.operation(node), graph.arguments(node)
    plain = [text[a] for a in arguments]
    if operation in ("where", "maximum", "minimum", "atan2", "pow") or operation in COMPARISONS:
        first = 1 if operation == "where" else 0  # a condition is what it is
        plain[first:] = [_as(kind, text[a], varies[a]) for a in arguments[first:]]
    return OPERATIONS[operation].text.format(*plain)
