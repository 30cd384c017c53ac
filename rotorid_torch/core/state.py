"""States: declared by name and unit, held as one flat vector whose slices have names."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from rotorid_torch.errors import InputError


@dataclass(frozen=True)
class State:
    """One state of the flat vector; `doc` says what it is.

    `channel`: the measured channel at whose value it starts (height, psi); None starts it at rest in equilibrium.
    `spread`: standard deviation of its value where a segment begins, about what it follows from the motion before;
    infinite where the segment alone tells.

    Raises
    ------
    InputError : no name, or a unit that is no text.
    """

    name: str
    unit: str = ""
    doc: str = ""
    channel: str | None = None
    spread: float = math.inf

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InputError("State", "name", f"is {self.name!r}", "a word, as 'lag'")
        if not isinstance(self.unit, str):
            raise InputError("State", self.name, f"unit is {self.unit!r}", "SI units in words, as 'rad', or ''")


@dataclass(frozen=True)
class StateLayout:
    """Names of the flat state in order; answers where each one lies."""

    states: tuple[State, ...]

    def __post_init__(self) -> None:
        twice = sorted({n for n in self.names if self.names.count(n) > 1})
        if twice:
            raise ValueError(f"states declared twice: {twice}")

    def __len__(self) -> int:
        return len(self.states)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the flat state."""
        return tuple(s.name for s in self.states)

    def has(self, *names: str) -> bool:
        """Whether all these states exist."""
        return set(names) <= set(self.names)

    def places(self, names: Sequence[str]) -> list[int]:
        """Places of these names in the flat state; KeyError names those that exist."""
        try:
            return [self.names.index(n) for n in names]
        except ValueError as e:
            raise KeyError(f"no state among {list(names)}; there are {', '.join(self.names)}") from e

    def pick(self, x: Tensor, *names: str) -> Tensor:
        """These components of x [..., nx] as [..., len(names)]; neighbours come as a view."""
        places = self.places(names)
        if places == list(range(places[0], places[0] + len(places))):
            return x[..., places[0] : places[0] + len(places)]
        return x[..., places]
