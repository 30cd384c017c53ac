"""A candidate: an effect that a model may lack, nested in it, with one size of all controls or one of each."""

from collections.abc import Iterable
from dataclasses import dataclass

from rotorid_torch.effects.base import Stage
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec

EACH = " of each control"
"""Behind the id of an effect that has a size of each control."""
IN_FORCES = " in forces"
"""Behind the id of an effect in the forces on the measured motion."""
UNATTRIBUTED = "unattributed "
"""Before a pseudo-effect, which has no name: a family of its own."""


def effect_of(member: str) -> str:
    """Id of the effect of a member of the library, by its name in a family."""
    return member.removesuffix(IN_FORCES).removesuffix(EACH)


def of_control_path(effects: Iterable[str]) -> list[str]:
    """Those of these effects that act on the control path: on all controls alike, or on each by itself."""
    return [e for e in effects if registered()[e].stage is Stage.CONTROL]


@dataclass(frozen=True, order=True)
class Candidate:
    """An effect of the library. each_control : whether each control has a size of its own."""

    effect: str
    each_control: bool = False

    @property
    def name(self) -> str:
        """As tables and messages show it."""
        return f"{self.effect}{EACH}" if self.each_control else self.effect

    def brings(self, spec: ModelSpec) -> tuple[str, ...]:
        """The effect through which this one acts on a multirotor, where the spec lacks that and can test it."""
        through = registered()[self.effect].acts_through
        needed = bool(through) and bool(spec.motors) and through not in spec.effects
        return (through,) if needed and registered()[through].untestable(spec) is None else ()

    def joined_to(self, spec: ModelSpec) -> ModelSpec:
        """The spec with the effect, and with what it brings."""
        return spec.with_effects(*self.brings(spec), self.effect, each_control=self.each_control)
