"""From a torch function to scalar expressions: it runs once, and node numbers go beside the entries of every tensor.

A symbolic tensor is an int64 tensor of node numbers, so torch itself does all views, joins and look-ups by constant
index; only arithmetic is spelled out. What does not depend on an input torch computes as it is. The function is
watched through a dispatch mode under functionalisation (no in-place writes are left), which sees the same operations
as make_fx but takes a tenth of its time.
"""

from __future__ import annotations

import functools
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch._decomp import core_aten_decompositions
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from rotorid_torch.core.native.operations import COMPARISONS, OPERATIONS
from rotorid_torch.core.native.symbols import Graph, Term


class Unsupported(Exception):
    """A model that cannot become native code; the text says which operation, and where it was called."""


@dataclass(frozen=True)
class Symbols:
    """A tensor whose entries are node numbers."""

    ids: Tensor


VIEWS = set(
    "select slice stack cat unsqueeze squeeze expand view _unsafe_view reshape permute transpose t alias clone detach "
    "index index_select index_put slice_scatter select_scatter diagonal flip roll split split_with_sizes unbind "
    "lift_fresh_copy _to_copy contiguous repeat gather diag_embed".split()
)
IN_PLACE_VIEWS = {"squeeze_", "unsqueeze_", "t_"}  # torch's own matrix products use them on tensors of their own
FILLS = {"full_like": None, "zeros_like": 0.0, "ones_like": 1.0}
COMPOSITE: dict[str, Callable[..., Term]] = {
    "rsub": lambda a, b: b - a,
    "reciprocal": lambda a: 1.0 / a,
    "relu": lambda a: a.to("maximum", 0.0),
    "tan": lambda a: a.to("sin") / a.to("cos"),
    "sigmoid": lambda a: 1.0 / (1.0 + (-a).to("exp")),
    "square": lambda a: a * a,
    "rsqrt": lambda a: 1.0 / a.to("sqrt"),
    "clamp_min": lambda a, low: a.to("maximum", low),
    "clamp_max": lambda a, high: a.to("minimum", high),
}
PRODUCTS = {"mv", "mm", "dot", "bmm", "addmm"}
SPELLED_OUT = {"sum", "mean", "pow", "clamp", "linalg_cross", "linalg_vector_norm", "_linalg_solve_ex", "linalg_inv_ex"}
LARGEST_SOLVE = 3
"""Order up to which a linear system is solved by Cramer's rule."""


@functools.cache
def _decompositions() -> dict[Any, Any]:
    """Torch's own rules for operations that are not spelled out here."""
    ours = VIEWS | PRODUCTS | SPELLED_OUT | set(FILLS) | set(COMPOSITE) | set(OPERATIONS)
    return {op: rule for op, rule in core_aten_decompositions().items() if getattr(op, "_opname", "") not in ours}


def scalarise(graph: Graph, function: Callable[..., Tensor], examples: Mapping[str, Tensor]) -> list[int]:
    """Nodes of all entries of function(*examples), in order; the examples' names become those of the inputs.

    Raises
    ------
    Unsupported : an operation that is not known here, or a branch that depends on an input.
    """
    watch = _Scalars(graph)
    inputs = [example.detach().clone() for example in examples.values()]
    for name, value in zip(examples, inputs, strict=True):
        ids = [graph.input(name, k) for k in range(value.numel())]
        watch.note(value, Symbols(torch.tensor(ids, dtype=torch.int64).view_as(value)))
    try:
        with torch.no_grad(), watch:
            result = torch.func.functionalize(function, remove="mutations")(*inputs)
    except Unsupported as error:
        raise Unsupported(f"{error}{_place(error)}") from None
    return watch.boxed(watch.symbols_of(result)).ids.reshape(-1).tolist()


class _Scalars(TorchDispatchMode):
    """Follows every operation on node numbers beside its values."""

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self.graph = graph
        self._known: dict[int, tuple[Tensor, Symbols]] = {}  # by identity; the tensors are kept, so identities stay

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        """No compiler of torch's ever meets this mode; its guard would cost the import of that compiler, seconds."""
        return False

    def note(self, value: Tensor, symbols: Symbols) -> None:
        """Remember what a tensor's entries are."""
        self._known[id(value)] = value, symbols

    def symbols_of(self, value: Any) -> Any:
        """Symbols in the place of a tensor that depends on an input."""
        return self._known[id(value)][1] if isinstance(value, Tensor) and id(value) in self._known else value

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        given, named = tree_map(self.symbols_of, (args, kwargs))
        if not _symbolic((given, named)):
            return func(*args, **kwargs)
        if func in _decompositions():
            with self:
                return _decompositions()[func](*args, **kwargs)
        values = func(*args, **kwargs)
        made = self._follow(func, given, named)
        pairs = zip(tree_leaves(values), tree_leaves(made, is_leaf=_is_symbols), strict=True)
        for value, symbols in pairs:
            if isinstance(symbols, Symbols):
                self.note(value, symbols)
        return values

    def _follow(self, func: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """The operation on symbols."""
        name = func._opname
        name = name.removesuffix("_") if name in IN_PLACE_VIEWS else name
        if name in OPERATIONS:
            scale = kwargs.get("alpha", 1)
            second = args[1:2] if scale == 1 else [self._each("mul", args[1], scale)]
            return self._each(name, args[0], *second, *args[2:])
        if name in COMPOSITE:
            return self._each(name, *args)
        if name in PRODUCTS:
            return self._product(name, *args)
        if name in SPELLED_OUT:
            return getattr(self, f"_{name.strip('_')}")(*args, **kwargs)
        if name in FILLS:
            value = args[1] if FILLS[name] is None else FILLS[name]
            return self.boxed(torch.full(args[0].ids.shape, float(value), dtype=torch.float64))
        if name == "copy":
            return Symbols(self.boxed(args[1]).ids.expand(self.boxed(args[0]).ids.shape))
        if name == "_to_copy" and self._is_condition(args[0]):
            return self._each("where", args[0], 1.0, 0.0)
        if name in VIEWS:
            return self._view(name, args, kwargs)
        if name in ("_local_scalar_dense", "is_nonzero", "equal"):
            raise Unsupported("a branch or a number that depends on the inputs cannot become native code")
        raise Unsupported(f"the operation {name} is not known to native code")

    def boxed(self, value: Any) -> Symbols:
        """Numbers and constant tensors as symbols."""
        if isinstance(value, Symbols):
            return value
        tensor = torch.as_tensor(value, dtype=torch.float64)
        ids = [self.graph.constant(v) for v in tensor.reshape(-1).tolist()]
        return Symbols(torch.tensor(ids, dtype=torch.int64).view(tensor.shape))

    def _is_condition(self, value: Any) -> bool:
        ids = self.boxed(value).ids
        return ids.numel() > 0 and self.graph.operation(int(ids.reshape(-1)[0])) in COMPARISONS

    def _each(self, name: str, *arguments: Any) -> Symbols:
        """An operation entry by entry, arguments broadcast."""
        ids = torch.broadcast_tensors(*(self.boxed(a).ids for a in arguments))
        entries = zip(*(i.reshape(-1).tolist() for i in ids), strict=True)
        if name in COMPOSITE:
            made = [COMPOSITE[name](*(Term(self.graph, n) for n in entry)).node for entry in entries]
        else:
            made = [self.graph.apply(name, *entry) for entry in entries]
        return Symbols(torch.tensor(made, dtype=torch.int64).view(ids[0].shape))

    def _view(self, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """Whatever only moves entries about, done by torch on the numbers."""
        where = {"index": 1, "index_put": 1, "index_select": 2, "gather": 2}.get(name)
        if where is not None and _symbolic(args[where]):
            raise Unsupported(f"{name} by an index that depends on the inputs is not known to native code")
        if not kwargs.get("dtype", torch.float64).is_floating_point:
            raise Unsupported("a conversion to integers is not known to native code")

        def numbers(value: Any) -> Any:
            if isinstance(value, Symbols):
                return value.ids
            floating = isinstance(value, Tensor) and value.is_floating_point()
            return self.boxed(value).ids if floating else value

        kept = {key: value for key, value in kwargs.items() if key in ("dim", "accumulate")}
        made = getattr(torch.ops.aten, name)(*tree_map(numbers, args, is_leaf=_is_symbols), **kept)
        return tree_map(lambda value: Symbols(value) if isinstance(value, Tensor) else value, made)

    def _total(self, ids: Tensor, dim: int, keep: bool = False) -> Symbols:
        parts = [Symbols(part) for part in ids.unbind(dim)]
        if not parts:
            return self.boxed(torch.zeros(ids.sum(dim, keepdim=keep).shape, dtype=torch.float64))
        summed = functools.reduce(lambda a, b: self._each("add", a, b), parts)
        return Symbols(summed.ids.unsqueeze(dim)) if keep else summed

    def _product(self, name: str, *arguments: Any) -> Symbols:
        if name == "addmm":
            return self._each("add", arguments[0], self._product("mm", *arguments[1:]))
        x, y = (self.boxed(a).ids for a in arguments)
        if name in ("mv", "dot"):
            return self._total(self._each("mul", Symbols(x), Symbols(y)).ids, -1)
        return self._total(self._each("mul", Symbols(x.unsqueeze(-1)), Symbols(y.unsqueeze(-3))).ids, -2)

    def _sum(self, x: Any, dims: Sequence[int] | None = None, keep: bool = False, **_: Any) -> Symbols:
        ids = self.boxed(x).ids
        for dim in sorted((d % max(ids.dim(), 1) for d in (dims or range(ids.dim()))), reverse=True):
            ids = self._total(ids, dim, keep).ids
        return Symbols(ids)

    def _mean(self, x: Any, dims: Sequence[int] | None = None, keep: bool = False, **_: Any) -> Symbols:
        total = self._sum(x, dims, keep)
        return self._each("mul", total, total.ids.numel() / self.boxed(x).ids.numel())

    def _pow(self, x: Any, power: Any) -> Symbols:
        if isinstance(power, (int, float)) and float(power).is_integer() and 1 <= abs(power) <= 4:
            whole = functools.reduce(lambda a, _: self._each("mul", a, x), range(int(abs(power)) - 1), self.boxed(x))
            return whole if power > 0 else self._each("reciprocal", whole)
        if power == 0.5:
            return self._each("sqrt", x)
        return self._each("exp", self._each("mul", self._each("log", x), power))

    def _clamp(self, x: Any, low: Any = None, high: Any = None, **named: Any) -> Symbols:
        low, high = named.get("min", low), named.get("max", high)
        held = x if low is None else self._each("maximum", x, low)
        return held if high is None else self._each("minimum", held, high)

    def _linalg_cross(self, a: Any, b: Any, dim: int = -1) -> Symbols:
        x, y = (self.boxed(v).ids for v in (a, b))
        x, y = torch.broadcast_tensors(x, y)

        def turned(v: Tensor, k: int) -> Symbols:
            return Symbols(v.roll(-k, dim))

        return self._each(
            "sub", self._each("mul", turned(x, 1), turned(y, 2)), self._each("mul", turned(x, 2), turned(y, 1))
        )

    def _linalg_vector_norm(
        self, x: Any, order: float = 2, dims: Sequence[int] | None = None, keep: bool = False, **_: Any
    ) -> Symbols:
        if order != 2:
            raise Unsupported("a norm other than the Euclidean is not known to native code")
        return self._each("sqrt", self._sum(self._each("mul", x, x), dims, keep))

    def _linalg_inv_ex(self, matrix: Any, **_: Any) -> tuple[Symbols, Tensor]:
        """Inverse by cofactors."""
        ids = self.boxed(matrix).ids
        n = ids.shape[-1]
        if n > LARGEST_SOLVE or ids.dim() != 2:
            raise Unsupported(f"a linear system of order above {LARGEST_SOLVE} is not known to native code")
        a = [[Term(self.graph, int(ids[i, j])) for j in range(n)] for i in range(n)]
        if n == 1:
            return self._each("reciprocal", matrix), torch.zeros((), dtype=torch.int32)
        minors = [[_determinant(_without(a, j, i)) * (-1.0) ** (i + j) for j in range(n)] for i in range(n)]
        whole = _determinant(a)
        made = [[(minors[i][j] / whole).node for j in range(n)] for i in range(n)]
        return Symbols(torch.tensor(made, dtype=torch.int64)), torch.zeros((), dtype=torch.int32)

    def _linalg_solve_ex(self, matrix: Any, right: Any, **_: Any) -> tuple[Any, ...]:
        """Solution by the inverse; the factors that come with it are nobody's input."""
        inverse, told = self._linalg_inv_ex(matrix)
        name = "mv" if self.boxed(right).ids.dim() == 1 else "mm"
        return self._product(name, inverse, right), told, told, told


def _without(rows: list[list[Term]], i: int, j: int) -> list[list[Term]]:
    return [[t for k, t in enumerate(row) if k != j] for m, row in enumerate(rows) if m != i]


def _determinant(rows: list[list[Term]]) -> Term:
    if len(rows) == 1:
        return rows[0][0]
    parts = [rows[0][j] * _determinant(_without(rows, 0, j)) * (-1.0) ** j for j in range(len(rows))]
    return functools.reduce(lambda a, b: a + b, parts)


def _is_symbols(value: Any) -> bool:
    return isinstance(value, Symbols)


def _symbolic(value: Any) -> bool:
    return any(isinstance(leaf, Symbols) for leaf in tree_leaves(value, is_leaf=_is_symbols))


def _place(error: Unsupported) -> str:
    """Where in the model's own code the operation was called: effect, file and line."""
    effect, place = "", ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        module, file = frame.f_globals.get("__name__", ""), frame.f_code.co_filename
        if not module.startswith(("torch", __package__ or "")) and file != __file__:
            place = f"{file}, line {line}"
            owner = getattr(frame.f_locals.get("self"), "id", None)
            effect = f"effect '{owner}', " if isinstance(owner, str) and owner else effect
    return f" ({effect}{place})" if place else ""
