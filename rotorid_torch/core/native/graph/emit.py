"""From expressions to C++: straight-line code for a double or a vector of them."""

from collections.abc import Callable, Mapping, Sequence

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

    def prepare(self, whole: bool = False) -> str:
        """The function that fills c from th; asked for when the loop's functions are written; `whole` for C."""
        results = {f"c[{k}]": node for node, k in self._places.items()}
        body = straight_line(self.graph, results, self._given, "double", whole)
        count = max(len(self._places), 1)
        return f"enum {{ NC = {count} }};\nstatic void prepare(const double* th, double* c) {{\n{body}\n}}\n"

    def numbers(self) -> Tensor:
        """The model's numbers, in order; complete after `prepare`."""
        return torch.tensor([self.graph.value(node) for node in self._numbers], dtype=torch.float64)


def _number(value: float) -> str:
    return repr(value) if value >= 0 else f"({value!r})"


MANY = 64
"""Products in one array, from which on a loop over a table takes them: compilers take long over lines."""


PART = 500
"""Lines in one function, more or less: the time that compilers take grows faster than the length of a function."""


def straight_line(
    graph: Graph,
    results: Mapping[str, int],
    named: Callable[[int], str | None],
    kind: str = "T",
    whole: bool = False,
) -> str:
    """Assignments "result = expression;" of {result: node} and of all that they need, in order.

    named : name of a node that is there already, None for one that is computed here. kind : type of what varies.
    whole : in one piece, as C needs it; else long code stands in parts, functions of their own.
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
    return "\n".join([*before, _Lines(graph, named, kind, whole).code(remaining), *after])


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


class _Lines:
    """Straight-line code, in parts of some `PART` lines; parts share results through an array m.

    named, kind : as `straight_line` has them. whole : one part alone, however long.
    """

    def __init__(self, graph: Graph, named: Callable[[int], str | None], kind: str, whole: bool) -> None:
        self.graph, self.named, self.kind, self.whole = graph, named, kind, whole
        self.parts: list[list[str]] = [[]]
        self._names: dict[int, str] = {}
        self._homes: dict[int, int] = {}
        """Part that computes a node; none of what is there already."""
        self._places: dict[int, int] = {}
        self._pairs: dict[int, int] = {}

    def code(self, results: Mapping[str, int]) -> str:
        """Assignments of {result: node} and of all that they need."""
        for node in self.graph.needed(list(results.values()), lambda n: self.named(n) is not None):
            self._turn()
            self._write(node)
        for result, node in results.items():
            self._turn()
            self._add(f"{result} = {self._as_kind(node)};")
        if len(self.parts) == 1:
            return _indented(self.parts[0])
        bodies = (f"  [&]() __attribute__((noinline)) {{\n{_indented(part)}\n  }}();" for part in self.parts)
        return "\n".join([f"  {self.kind} m[{max(len(self._places), 1)}];", *bodies])

    def _turn(self) -> None:
        """Begins another part where the last one is full."""
        if not self.whole and len(self.parts[-1]) >= PART:
            self.parts.append([])

    def _add(self, line: str) -> None:
        self.parts[-1].append(line)

    def _write(self, node: int) -> None:
        """The line that computes a node, if it needs one."""
        operation, name = self.graph.operation(node), self.named(node)
        if operation == "input" and name is None:
            _, array, place = self.graph.nodes[node]
            name = f"{array}[{place}]"
        if name is not None:
            self._names[node] = name
            return
        if operation in ("sin", "cos") and self.kind != "double":  # of one double the compiler joins them
            self._names[node] = self._of_pair(operation, *self.graph.arguments(node))
        else:
            self._names[node] = f"t{node}"
            self._add(f"const {_type(operation, self.kind)} t{node} = {self._expression(node)};")
        self._homes[node] = len(self.parts) - 1

    def _of_pair(self, operation: str, argument: int) -> str:
        """Sine or cosine of an angle; both are computed together, once in a part."""
        if self._pairs.get(argument) != len(self.parts) - 1:
            angle = self._as_kind(argument)
            self._add(f"{self.kind} s{argument}, c{argument}; SinCos({angle}, s{argument}, c{argument});")
            self._pairs[argument] = len(self.parts) - 1
        return f"{operation[0]}{argument}"

    def _name(self, node: int) -> str:
        """What a node is called in the last part."""
        name, home = self._names[node], self._homes.get(node)
        if home is None or home == len(self.parts) - 1:
            return name
        if self.graph.operation(node) in COMPARISONS:  # a mask is no number
            self._write(node)
            return name
        if node not in self._places:
            self._places[node] = len(self._places)
            self.parts[home].append(f"m[{self._places[node]}] = {name};")
        return f"m[{self._places[node]}]"

    def _as_kind(self, node: int) -> str:
        """A node as a vector, though it be the same in all lanes."""
        varies = node in self._homes or (self.graph.operation(node) == "input" and self.named(node) is None)
        return self._name(node) if varies or self.kind == "double" else f"({self.kind}() + {self._names[node]})"

    def _expression(self, node: int) -> str:
        operation, arguments = self.graph.operation(node), self.graph.arguments(node)
        alike = operation in ("where", "maximum", "minimum", "atan2", "pow") or operation in COMPARISONS
        conditions = 1 if operation == "where" else 0  # a condition is what it is
        texts = [self._as_kind(a) if alike and k >= conditions else self._name(a) for k, a in enumerate(arguments)]
        return OPERATIONS[operation].text.format(*texts)


def _indented(lines: Sequence[str]) -> str:
    return "\n".join(f"  {line}" for line in lines)


def _type(operation: str, kind: str) -> str:
    """Of a result: a comparison of doubles is a number, in C too; of vectors it is a mask."""
    return ("int" if kind == "double" else "auto") if operation in COMPARISONS else kind
