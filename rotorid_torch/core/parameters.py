"""Parameters: declared with name, unit and bounds; one flat vector with data beside it; as a table of a result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from importlib import import_module
from textwrap import shorten
from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor

from rotorid_torch.errors import InputError
from rotorid_torch.printable import html_table

T = TypeVar("T")


@dataclass(frozen=True)
class Parameter:
    """One named number of the model.

    `prior_sd` is the standard deviation (in the parameter's unit) by which the data may move it away from `value`
    before the physics behind `value` objects; infinite where there is no such physics. `typical` is a size at which an
    effect is usually met: where tracing starts; `met`: other sizes it is met at, where a little of it does nothing and
    twice as much is not twice the change (a rate limit). `tried`: values that it starts from, where one start does not
    lead to another (the length of a pendulum). `nuisance`: how flights begin, no size of anything; any value within
    the bounds is physics.

    Raises
    ------
    InputError : no name, bounds that are no pair of numbers in this order, or equal though it is free, a value outside
        of them.
    """

    name: str
    value: float = 0.0
    unit: str = ""
    bounds: tuple[float, float] = (-math.inf, math.inf)
    prior_sd: float = math.inf
    free: bool = True
    doc: str = ""
    typical: float = 0.0
    met: tuple[float, ...] = ()
    tried: tuple[float, ...] = ()
    nuisance: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InputError("Parameter", "name", f"is {self.name!r}", "a word, as 'drag' or 'drag.x'")
        if not isinstance(self.unit, str):
            raise self._wrong(f"unit is {self.unit!r}", "SI units in words, as '1/s', or ''")
        low, high = self._take("bounds", _pair, "two numbers, the lower one first")
        if low == high and self.free:
            raise self._wrong(f"bounds {low} to {high} leave it no room", "free=False for a number that is held")
        if not low <= high:
            raise self._wrong(f"bounds {low} to {high} are reversed, or no numbers", "the lower one first")
        values = self._take("value", _plain, "a number"), self._take("typical", _plain, "a number") or self.value
        sizes = dict(zip(("value", "typical"), values, strict=True))
        for name in ("met", "tried"):
            sizes |= {f"{name}[{k}]": v for k, v in enumerate(self._take(name, _plain_numbers, "a tuple of numbers"))}
        for what, size in sizes.items():
            if not low <= size <= high:
                raise self._wrong(f"{what} {size} lies outside its bounds {low} to {high}", "a number within them")

    def renamed(self, name: str) -> Parameter:
        """The same under another name."""
        other = copy(self)  # its numbers have been looked at
        object.__setattr__(other, "name", name)
        return other

    def _take(self, name: str, kind: Callable[[Any], T], expected: str) -> T:
        """Holds a field as plain numbers, whatever kind of numbers it was declared by."""
        declared = getattr(self, name)
        try:
            numbers = kind(declared)
        except (TypeError, ValueError, RuntimeError):  # the last is torch's, of many numbers for one
            raise self._wrong(f"{name}: {shorten(repr(declared), 80)}", expected) from None
        object.__setattr__(self, name, numbers)
        return numbers

    def _wrong(self, wrong: str, expected: str) -> InputError:
        return InputError("Parameter", self.name, wrong, expected)


def _plain(declared: Any) -> float:
    if isinstance(declared, str | bytes):
        raise TypeError("text is no number")
    return float(declared)


def _plain_numbers(declared: Any) -> tuple[float, ...]:
    return tuple(map(_plain, declared))


def _pair(declared: Any) -> tuple[float, float]:
    low, high = _plain_numbers(declared)
    return low, high


def alike(names: Iterable[str], unit: str, bounds: tuple[float, float], doc: str, **more: Any) -> tuple[Parameter, ...]:
    """Parameters that begin at zero and differ by their names, which stand for {} in `doc`."""
    return tuple(Parameter(name, 0.0, unit, bounds, doc=doc.format(name), **more) for name in names)


@dataclass(frozen=True)
class ParameterSet:
    """Declarations in the order of the flat vector theta; knows names, bounds, units, priors and the free mask."""

    parameters: tuple[Parameter, ...]
    _places: dict[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        places = {p.name: i for i, p in enumerate(self.parameters)}
        if len(places) != len(self.parameters):
            names = [p.name for p in self.parameters]
            raise ValueError(f"declared twice: {sorted({n for n in names if names.count(n) > 1})}")
        object.__setattr__(self, "_places", places)

    def __len__(self) -> int:
        return len(self.parameters)

    def __contains__(self, name: str) -> bool:
        return name in self._places

    def index(self, name: str) -> int:
        """Place of a parameter in theta; KeyError names those that exist."""
        if name not in self._places:
            raise KeyError(f"no parameter {name!r}; there are {', '.join(self._places)}")
        return self._places[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of theta."""
        return tuple(self._places)

    @property
    def units(self) -> tuple[str, ...]:
        """Units in the order of theta."""
        return tuple(p.unit for p in self.parameters)

    @property
    def values(self) -> Tensor:
        """Declared values [P]."""
        return self._column([p.value for p in self.parameters])

    @property
    def lower(self) -> Tensor:
        """Lower bounds [P]."""
        return self._column([p.bounds[0] for p in self.parameters])

    @property
    def upper(self) -> Tensor:
        """Upper bounds [P]."""
        return self._column([p.bounds[1] for p in self.parameters])

    @property
    def prior_sd(self) -> Tensor:
        """Standard deviations of the physics prior about the declared values [P], infinite where there is none."""
        return self._column([p.prior_sd for p in self.parameters])

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p in self.parameters if p.free)

    def sizes(self, effect: str) -> tuple[Parameter, ...]:
        """The parameters of an effect by its id, without nuisance."""
        return tuple(p for p in self.parameters if p.name.startswith(f"{effect}.") and not p.nuisance)

    def clamp(self, theta: Tensor) -> Tensor:
        """Theta [..., P] moved onto its bounds where it lies outside."""
        low, high = self._bounds
        return torch.minimum(torch.maximum(theta, low), high)

    @cached_property
    def _bounds(self) -> tuple[Tensor, Tensor]:
        return self.lower, self.upper

    @staticmethod
    def _column(numbers: Sequence[float]) -> Tensor:
        return torch.tensor(numbers, dtype=torch.float64)


SHOWN = 12
"""Parameters that a result shows of itself; `table` has all."""
COLUMNS = ("name", "value", "se", "unit", "bounds", "at_bound", "status")
SHOWN_COLUMNS = ("name", "value", "se", "unit", "bounds", "status")


class ParameterTable:
    """A result with parameters: `result["Mq"]`, `result.table()`, `result.to_dict()`.

    columns : of each entry, in tables of pandas and dicts. shown : those of text and notebooks. entry : its noun.
    """

    entry: ClassVar[str] = "parameter"
    columns: ClassVar[tuple[str, ...]] = COLUMNS
    shown: ClassVar[tuple[str, ...]] = SHOWN_COLUMNS

    @property
    def title(self) -> str:
        """One line that says what the result is."""
        return type(self).__name__

    @property
    def _estimates(self) -> Sequence[Any]:
        """Each with name, value, se, unit, bounds and status; None where there is no number."""
        return self.parameters  # pyright: ignore[reportAttributeAccessIssue]

    def __getitem__(self, name: str) -> Any:
        """The parameter of a name, or of the last parts of one: "M.q" is "forces.M.q" where no other name ends so.

        Raises KeyError: there is none, or several; with the nearest names.
        """
        names = [p.name for p in self._estimates]
        ends = [n for n in names if n == str(name)] or [n for n in names if n.endswith(f".{name}")]
        if len(ends) == 1:
            return self._estimates[names.index(ends[0])]
        short = [".".join(n.split(".")[-2:]) for n in names if n.replace(".", "").endswith(str(name))]  # "Mq"
        near = ends or short or get_close_matches(str(name), names, n=3, cutoff=0.4)
        hint = f"did you mean {', '.join(near[:5])}?" if near else f"there are {', '.join(names[:12])}"
        raise KeyError(f"no {self.entry} {name!r}; {hint}")

    def __iter__(self) -> Iterator[Any]:
        return iter(self._estimates)

    def __contains__(self, name: str) -> bool:
        try:
            return bool(self[name])
        except KeyError:
            return False

    def table(self) -> Any:
        """The parameters one a line: a DataFrame where pandas is installed, else text."""
        try:
            pandas = import_module("pandas")
        except ImportError:
            return self.text()
        return pandas.DataFrame([{field: getattr(p, field) for field in self.columns} for p in self._estimates])

    def text(self) -> str:
        """The parameters as text, one a line."""
        rows = [self.shown, *self._rows()]
        widths = [max(len(row[i]) for row in rows) for i in range(len(self.shown))]
        return "\n".join("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)

    def to_dict(self) -> dict[str, Any]:
        """Value, standard error, unit, bounds and status of each parameter by its name."""
        return {p.name: {field: getattr(p, field) for field in self.columns[1:]} for p in self._estimates}

    def __repr__(self) -> str:
        some = "\n".join(self.text().splitlines()[: SHOWN + 1])
        more = len(self._estimates) - SHOWN
        return f"{self.title}\n{some}" + (f"\n... and {more} more: .table()" if more > 0 else "")

    def _repr_html_(self) -> str:
        """The same for a notebook."""
        return html_table(self.title, self.shown, self._rows())

    def _rows(self) -> list[tuple[str, ...]]:
        """What is shown of each parameter."""
        return [tuple(_cell(p, column) for column in self.shown) for p in self._estimates]


def _cell(p: Any, column: str) -> str:
    """What a table shows of a parameter."""
    value = getattr(p, column)
    if column == "bounds":
        low, high = (_number(b, ".4g") for b in value)
        return f"{low} .. {high}"
    if column == "status":
        return "on a bound" if p.at_bound else value
    return value if isinstance(value, str) else _number(value, ".5g" if column == "value" else ".2g")


def _number(value: float | None, how: str) -> str:
    """A number for a table; a dash where there is none."""
    return "-" if value is None or math.isnan(value) else format(value, how)
