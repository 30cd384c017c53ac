"""What torch's operations do to tensors of node numbers: one rule each, or torch's own decomposition into those."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch._decomp import decomposition_table
from torch.utils._python_dispatch import TorchDispatchMode

from rotorid_torch.core.native.graph.operations import COMPARISONS, COMPOSITE, LOGICAL, OPERATIONS
from rotorid_torch.core.native.graph.small_systems import LARGEST, Matrix, determinant, inverse
from rotorid_torch.core.native.graph.symbols import Graph, Term
from rotorid_torch.errors import Unsupported


@dataclass(frozen=True)
class Symbols:
    """A tensor whose entries are node numbers."""

    ids: Tensor


VIEWS = set(
    "select slice stack cat unsqueeze squeeze expand view _unsafe_view reshape permute transpose t alias clone detach "
    "index index_select index_put slice_scatter select_scatter diagonal flip roll split split_with_sizes unbind "
    "lift_fresh_copy _to_copy contiguous repeat gather diag diag_embed triu tril scatter".split()
)
IN_PLACE_VIEWS = {"squeeze_", "unsqueeze_", "t_"}  # torch's own matrix products use them on tensors of their own
FILLS = {"full_like": None, "zeros_like": 0.0, "ones_like": 1.0}
CONNECTIVES = {f"{kind}_{name}": name for kind in ("bitwise", "logical") for name in LOGICAL}
PRODUCTS = {"mv", "mm", "dot", "bmm", "addmm"}
SPELLED_OUT = {
    *("sum", "mean", "pow", "clamp", "linalg_cross", "linalg_vector_norm", "constant_pad_nd", "to", "_to_copy"),
    *("_linalg_solve_ex", "linalg_inv_ex", "_linalg_det"),
}
READ_OUT = {"_local_scalar_dense", "is_nonzero", "equal"}
LONGEST_PRODUCT = 4
"""Whole exponents beyond it are powers like any other."""


@functools.cache
def _decompositions() -> dict[Any, Any]:
    """Torch's own rules for operations that are not spelled out here."""
    ours = VIEWS | PRODUCTS | SPELLED_OUT | set(FILLS) | set(CONNECTIVES) | set(COMPOSITE) | set(OPERATIONS)
    return {op: rule for op, rule in decomposition_table.items() if getattr(op, "_opname", "") not in ours}


class Scalars(TorchDispatchMode):
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
        positional, named = _each_leaf(self.symbols_of, args), _each_leaf(self.symbols_of, kwargs)
        if not _symbolic((positional, named)):
            return func(*args, **kwargs)
        if func in _decompositions():
            with self:
                return _decompositions()[func](*args, **kwargs)
        values = func(*args, **kwargs)
        result = self._follow(func, positional, named)
        for value, symbols in zip(_leaves(values), _leaves(result), strict=True):
            if isinstance(symbols, Symbols):
                self.note(value, symbols)
        return values

    def _follow(self, func: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """The operation on symbols."""
        name = func._opname
        name = name.removesuffix("_") if name in IN_PLACE_VIEWS else name
        if name in SPELLED_OUT:
            return getattr(self, f"_{name.strip('_')}")(*args, **kwargs)
        if name in OPERATIONS or name in COMPOSITE or name in PRODUCTS:
            args = self._scaled(name, args, kwargs)
            return self._product(name, *args) if name in PRODUCTS else self._each(name, *args)
        if name in CONNECTIVES:
            return self._each(CONNECTIVES[name], *args)
        if name in FILLS:
            value = args[1] if FILLS[name] is None else FILLS[name]
            return self.boxed(torch.full(args[0].ids.shape, float(value), dtype=torch.float64))
        if name == "copy":
            return Symbols(self.boxed(args[1]).ids.expand(self.boxed(args[0]).ids.shape))
        if name in VIEWS:
            return self._view(name, args, kwargs)
        if name in READ_OUT:
            raise Unsupported("a branch or a number that depends on the inputs cannot become native code")
        if name == "copy_":
            raise Unsupported("what is handed in is overwritten, which native code does not do")
        raise Unsupported(f"the operation {name} is not known to native code")

    def boxed(self, value: Any) -> Symbols:
        """Numbers and constant tensors as symbols."""
        if isinstance(value, Symbols):
            return value
        tensor = torch.as_tensor(value, dtype=torch.float64)
        ids = [self.graph.constant(v) for v in tensor.reshape(-1).tolist()]
        return Symbols(torch.tensor(ids, dtype=torch.int64).view(tensor.shape))

    def numbers(self, value: Any) -> Symbols:
        """Symbols with one and zero for conditions."""
        boxed = self.boxed(value)
        nodes = [self._number(n) for n in boxed.ids.reshape(-1).tolist()]
        return Symbols(torch.tensor(nodes, dtype=torch.int64).view(boxed.ids.shape))

    def _number(self, node: int) -> int:
        if self.graph.operation(node) not in COMPARISONS:
            return node
        return self.graph.apply("where", node, self.graph.constant(1.0), self.graph.constant(0.0))

    def _condition(self, node: int) -> int:
        if self.graph.operation(node) in COMPARISONS or self.graph.value(node) is not None:
            return node
        raise Unsupported("a number taken for a condition is not known to native code")

    def _each(self, name: str, *arguments: Any) -> Symbols:
        """An operation entry by entry, arguments broadcast."""
        ids = torch.broadcast_tensors(*(self.boxed(a).ids for a in arguments))
        lists = [i.reshape(-1).tolist() for i in ids]
        conditions = len(lists) if name in LOGICAL else 1 if name == "where" else 0
        for k, nodes in enumerate(lists):
            lists[k] = [self._condition(n) if k < conditions else self._number(n) for n in nodes]
        rule = COMPOSITE.get(name) or LOGICAL.get(name)
        if rule is None:
            results = [self.graph.apply(name, *entry) for entry in zip(*lists, strict=True)]
        else:
            results = [rule(*(Term(self.graph, n) for n in entry)).node for entry in zip(*lists, strict=True)]
        return Symbols(torch.tensor(results, dtype=torch.int64).view(ids[0].shape))

    def _scaled(self, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[Any, ...]:
        """Arguments with what torch's alpha does to one of them."""
        scale, taken = kwargs.get("alpha", 1), {"add": 1, "sub": 1, "rsub": 0}.get(name)
        if set(kwargs) - ({"alpha"} if taken is not None else set()):
            raise Unsupported(f"{name} with {', '.join(sorted(kwargs))} is not known to native code")
        if taken is None or scale == 1:
            return args
        return tuple(self._each("mul", a, scale) if k == taken else a for k, a in enumerate(args))

    def _view(self, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """Whatever only moves entries about, done by torch on the numbers."""
        where = {"index": 1, "index_put": 1, "index_select": 2, "gather": 2}.get(name)
        if where is not None and _symbolic(args[where]):
            raise Unsupported(f"{name} by an index that depends on the inputs is not known to native code")
        if (args[3:4] or [kwargs.get("accumulate")])[0] and name == "index_put":
            raise Unsupported("index_put that adds to what is there is not known to native code")
        zero = self.graph.constant(0.0)  # node numbers count from here, so that the zeros torch fills in are zeros

        def numbers(value: Any) -> Any:
            if isinstance(value, Symbols):
                return value.ids - zero
            floating = isinstance(value, Tensor) and value.is_floating_point()
            return self.boxed(value).ids - zero if floating else value

        options = {key: value for key, value in kwargs.items() if key in ("dim", "accumulate")}
        view = getattr(torch.ops.aten, name)(*_each_leaf(numbers, args), **options)
        return _each_leaf(lambda value: Symbols(value + zero) if isinstance(value, Tensor) else value, view)

    def _to(self, x: Symbols, *args: Any, **kwargs: Any) -> Symbols:
        """A conversion: to float64, conditions become one and zero."""
        wanted = next((a for a in (*args, *kwargs.values()) if isinstance(a, torch.dtype)), torch.float64)
        if wanted == torch.bool:
            return self._each("ne", x, 0.0)
        if wanted != torch.float64:
            raise Unsupported(f"a conversion to {str(wanted).removeprefix('torch.')} is not known to native code")
        return self.numbers(x)

    _to_copy = _to

    def _constant_pad_nd(self, x: Any, pad: Sequence[int], value: float = 0.0) -> Symbols:
        return Symbols(torch.constant_pad_nd(self.boxed(x).ids, list(pad), self.graph.constant(float(value))))

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
        base, exponent = torch.broadcast_tensors(self.numbers(x).ids, self.numbers(power).ids)
        pairs = zip(base.reshape(-1).tolist(), exponent.reshape(-1).tolist(), strict=True)
        nodes = [self._power(Term(self.graph, b), Term(self.graph, e)).node for b, e in pairs]
        return Symbols(torch.tensor(nodes, dtype=torch.int64).view(base.shape))

    def _power(self, x: Term, exponent: Term) -> Term:
        """Products where the exponent is a small whole number."""
        power = self.graph.value(exponent.node)
        if power == 0.0:
            return Term.of(self.graph, 1.0)
        if power is not None and abs(power) == 0.5:
            return x.to("sqrt") if power > 0.0 else 1.0 / x.to("sqrt")
        if power is None or not power.is_integer() or abs(power) > LONGEST_PRODUCT:
            return x.to("pow", exponent)
        whole = functools.reduce(lambda a, b: a * b, [x] * int(abs(power)))
        return whole if power > 0.0 else 1.0 / whole

    def _clamp(self, x: Any, low: Any = None, high: Any = None, **named: Any) -> Symbols:
        low, high = named.get("min", low), named.get("max", high)
        held = x if low is None else self._each("clamp_min", x, low)
        return held if high is None else self._each("clamp_max", held, high)

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
        return self._each("root", self._sum(self._each("mul", x, x), dims, keep))

    def _matrices(self, matrix: Any) -> list[Matrix]:
        """Square matrices [..., n, n] as terms."""
        ids = self.boxed(matrix).ids
        if ids.shape[-1] > LARGEST:
            raise Unsupported(f"a linear system of order above {LARGEST} is not known to native code")
        return [
            [[Term(self.graph, n) for n in row] for row in one] for one in ids.reshape(-1, *ids.shape[-2:]).tolist()
        ]

    def _linalg_inv_ex(self, matrix: Any, **_: Any) -> tuple[Symbols, Any]:
        nodes = [[[term.node for term in row] for row in inverse(rows)] for rows in self._matrices(matrix)]
        return Symbols(torch.tensor(nodes, dtype=torch.int64).view(self.boxed(matrix).ids.shape)), None

    def _linalg_det(self, matrix: Any, **_: Any) -> tuple[Symbols, Any, Any]:
        nodes = [determinant(rows).node for rows in self._matrices(matrix)]
        return Symbols(torch.tensor(nodes, dtype=torch.int64).view(self.boxed(matrix).ids.shape[:-2])), None, None

    def _linalg_solve_ex(self, matrix: Any, right: Any, *, left: bool = True, **_: Any) -> tuple[Any, ...]:
        """Solution by the inverse; the factors that come with it are nobody's input."""
        if not left:
            raise Unsupported("a linear system solved from the right is not known to native code")
        inverse, b = self._linalg_inv_ex(matrix)[0].ids, self.boxed(right).ids
        if b.dim() == 1 or b.shape == inverse.shape[:-1]:
            return self._total(self._each("mul", Symbols(inverse), Symbols(b.unsqueeze(-2))).ids, -1), None, None, None
        return self._product("mm", Symbols(inverse), Symbols(b)), None, None, None


def _each_leaf(change: Callable[[Any], Any], value: Any) -> Any:
    """A value of an operation changed, in whatever lists and dictionaries; torch's own walk takes ten times as long."""
    if isinstance(value, list | tuple):
        return [_each_leaf(change, one) for one in value]
    if isinstance(value, dict):
        return {key: _each_leaf(change, one) for key, one in value.items()}
    return change(value)


def _leaves(value: Any) -> list[Any]:
    """What lies in a value's lists and dictionaries, in order."""
    leaves: list[Any] = []
    _each_leaf(leaves.append, value)
    return leaves


def _symbolic(value: Any) -> bool:
    return any(isinstance(leaf, Symbols) for leaf in _leaves(value))
