"""Parameters: declared with name, unit and bounds; one flat vector, with names, bounds and priors as data beside it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Parameter:
    """One named number of the model.

    `prior_sd` is the standard deviation (in the parameter's unit) by which the data may move it away from `value`
    before the physics behind `value` objects; infinite where there is no such physics. `typical` is a size at which an
    effect is usually met: where tracing starts; `met`: other sizes it is met at, where a little of it does nothing and
    twice as much is not twice the change (a rate limit). `tried`: values that it starts from, where one start does not
    lead to another (the length of a pendulum). `nuisance`: how flights begin, no size of anything; any value within
    the bounds is physics.
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
        low, high = self.bounds
        if not low <= high:
            raise ValueError(f"{self.name}: bounds {low} to {high} are reversed, or no numbers")
        sizes = {"value": self.value, "typical": self.typical or self.value}
        sizes |= {f"met[{k}]": size for k, size in enumerate(self.met)}
        sizes |= {f"tried[{k}]": size for k, size in enumerate(self.tried)}
        for what, size in sizes.items():
            if not low <= size <= high:
                raise ValueError(f"{self.name}: {what} {size} lies outside its bounds {low} to {high}")


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

    def with_free(self, names: Iterable[str]) -> ParameterSet:
        """The same set with exactly these parameters free."""
        chosen = set(names)
        unknown = chosen - set(self.names)
        if unknown:
            raise KeyError(f"no parameters {sorted(unknown)}; there are {', '.join(self.names)}")
        return ParameterSet(tuple(replace(p, free=p.name in chosen) for p in self.parameters))

    def clamp(self, theta: Tensor) -> Tensor:
        """Theta [..., P] moved onto its bounds where it lies outside."""
        return torch.minimum(torch.maximum(theta, self.lower), self.upper)

    def table(self, theta: Tensor, errors: Tensor | None = None) -> str:
        """Name, value, standard error (where given), unit, bounds and status as text, one parameter a line."""
        rows = [("name", "value", "se", "unit", "bounds", "status")]
        for i, p in enumerate(self.parameters):
            error = "" if errors is None or not math.isfinite(float(errors[i])) else f"{float(errors[i]):.2g}"
            bounds = f"{p.bounds[0]:.4g} .. {p.bounds[1]:.4g}"
            status = "frozen" if not p.free else "nuisance" if p.nuisance else "free"
            rows.append((p.name, f"{float(theta.detach()[i]):.5g}", error, p.unit, bounds, status))
        return _aligned(rows)

    @staticmethod
    def _column(numbers: Sequence[float]) -> Tensor:
        return torch.tensor(numbers, dtype=torch.float64)


def _aligned(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
