"""Which effects can be tested on a data set, and what is to be told where that is not as it should be."""

from __future__ import annotations

from collections.abc import Iterable

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.base import Role, Showing, Stage
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.trace.terms.finding import EffectFinding

UNMOVED = "no size of it within its bounds moves what these flights measured"
ELSEWHERE = (Showing.KINEMATICS, Showing.INNOVATIONS)
"""What trajectories do not show is found elsewhere: sensors against each other, and spectra."""
UNSEEN_STATE = "it has a motion of its own, which no channel tells; accelerations at measured states show nothing of it"
NOT_IN_TRAJECTORIES = "trajectories do not show it; rotorid close-loop looks for it in sensors and spectra"


def untried(dataset: Dataset) -> tuple[str, ...]:
    """A note where no flight is held back: what is said of unseen flights then holds for those that were fitted."""
    said = (
        "no validate flights: where this report speaks of flights that no fit has seen, the identify flights stand in"
    )
    return () if dataset.validate else (f"{said}; give it some to tell effects from what a fit makes of noise",)


def of_control_path(effects: Iterable[str]) -> list[str]:
    """Those of these effects that act on the control path: on all controls alike, or on each by itself."""
    return [e for e in effects if registered()[e].stage is Stage.CONTROL]


def candidates(spec: ModelSpec) -> tuple[list[str], list[EffectFinding]]:
    """Effects that can act inside the time loop of this model, and findings for the others.

    Those are what the nominal model has from the start or takes up, and what cannot be tested.
    """
    testable, settled = [], []
    for name, effect in sorted(registered().items()):
        if name in spec.effects or effect.role is Role.LEARNT or effect.showing in ELSEWHERE:
            continue
        part, reason = effect.within(spec), effect.untestable(spec)
        absorbed = effect.absorbed_by(spec) if effect.role is Role.UNDECLARED else ""
        if part:
            said = f"the nominal model has it from the start, as its part '{part}'"
            settled.append(EffectFinding(name, effect.role.value, "accepted", said, part=part))
        elif reason is not None:
            settled.append(EffectFinding(name, effect.role.value, "not testable", reason))
        elif spec.motors and effect.swings:
            settled.append(EffectFinding(name, effect.role.value, "not testable", UNSEEN_STATE))
        elif absorbed:
            said = f"{absorbed} stand for it in these flights; weigh the vehicle, or swing it, to tell"
            settled.append(EffectFinding(name, effect.role.value, "indistinguishable", said, group=(absorbed,)))
        else:
            testable.append(name)
    return testable, settled
