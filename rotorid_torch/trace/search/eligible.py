"""Which effects can be tested on a data set, and what is to be told where that is not as it should be."""

from collections.abc import Sequence
from dataclasses import replace

from rotorid_torch.arguments import listed
from rotorid_torch.core.names import FLAPPING
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.base import Role, Showing
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.trace.search.decide import Row
from rotorid_torch.trace.search.words import finding
from rotorid_torch.trace.terms.finding import EffectFinding

ELSEWHERE = (Showing.KINEMATICS, Showing.INNOVATIONS)
"""What trajectories do not show is found elsewhere: sensors against each other, and spectra."""


def untried(dataset: Dataset) -> tuple[str, ...]:
    """A note where no flight is held back: what is said of unseen flights then holds for those that were fitted."""
    said = "no validate flight judges effects: where this report speaks of flights that no fit has seen, the identify"
    more = "flights stand in; give it some to tell effects from what a fit makes of noise"
    return () if dataset.validate else (f"{said} {more}",)


def judging(dataset: Dataset, states: Sequence[str]) -> tuple[Dataset, tuple[str, ...]]:
    """The data set with those validate flights alone that measure the body's states, and a note on the others.

    On a flight without velocities every effect of the air does nothing, and would be rejected for that. Flapping that
    is not measured stands still.
    """
    measured = {s for name in dataset.identify for s in states if dataset.facts[name].has(s)}
    wanted = [s for s in states if s in measured and s not in FLAPPING]
    lacking = {name: [s for s in wanted if not dataset.facts[name].has(s)] for name in dataset.validate}
    whole = tuple(name for name, states in lacking.items() if not states)
    notes = tuple(
        f"flight {name}: no {listed(states)}, which the model has as states: the flight judges no effect"
        for name, states in lacking.items()
        if states
    )
    return replace(dataset, validate=whole), notes


def candidates(spec: ModelSpec) -> tuple[list[str], list[EffectFinding]]:
    """Effects that can act inside the time loop of this model, and findings for the others.

    Those are what the nominal model has from the start or takes up, and what cannot be tested.
    """
    testable, settled = list[str](), list[EffectFinding]()
    for name, effect in sorted(registered().items()):
        if name in spec.effects or effect.role is Role.LEARNT or effect.showing in ELSEWHERE:
            continue
        part, lacking = effect.within(spec), effect.untestable(spec)
        taken_up = effect.absorbed_by(spec) if effect.role is Role.UNDECLARED else ""
        if part or lacking or taken_up:
            row = Row(testable=not lacking, part=bool(part), taken_up=bool(taken_up))
            one = finding(name, row, lacking=lacking, part=part or taken_up)
            settled.append(replace(one, part=part, group=(taken_up,) if one.verdict == "indistinguishable" else ()))
        else:
            testable.append(name)
    return testable, settled
