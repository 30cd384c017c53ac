"""What a page tells of a model besides its report: what parameters mean, and the model linearised."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ModelFacts:
    """A model as tables.

    meanings : of parameters, by name. states, controls : names in the order of A [nx, nx] and B [nx, nu] of
    dx/dt = A (x - x0) + B (u - u0) at the reference.
    """

    meanings: Mapping[str, str] = field(default_factory=dict)
    states: Sequence[str] = ()
    controls: Sequence[str] = ()
    A: Sequence[Sequence[float]] = ()
    B: Sequence[Sequence[float]] = ()
