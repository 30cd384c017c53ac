"""Which states of the body's motion the channels tell: rank of the stacked Jacobian, before any filter runs."""

from collections.abc import Collection, Sequence

import torch
from torch import Tensor
from torch.autograd.functional import jacobian

from rotorid_torch.core.names import ATTITUDES, FORCES, MOMENTS, POSITIONS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.identification.reconstruct.motion import ACCELERATIONS, GaussMarkovForces, Motion

GROUPS = (VELOCITIES, ATTITUDES[:2], ATTITUDES[2:], POSITIONS[:2], POSITIONS[2:], *((axis,) for axis in FORCES))
"""States that are there together or not at all; the rates and the moments that turn them are always there."""
NEEDS = {
    VELOCITIES: (ATTITUDES[:2],),
    ATTITUDES[2:]: (ATTITUDES[:2],),
    POSITIONS[2:]: (VELOCITIES,),
    POSITIONS[:2]: (VELOCITIES, ATTITUDES[2:], POSITIONS[2:]),
}
"""Groups without which a group has no equation."""
SIZES = dict.fromkeys((*RATES, *ATTITUDES, *MOMENTS), 0.1)
"""Usual size of a state's change, its unit; of those not listed one. What the rank is judged in."""
DUST = 1e-9
"""Rows of the stacked Jacobian below this are rounding."""
TOLERATED = 1e-3
"""Part of the largest singular value below which a direction is not seen, and of a state that may lie in such ones."""


def observable(dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """States that the channels of a data set tell, and the channels that see them.

    States that the stacked Jacobian leaves open are taken out, with those that have no equation without them, until the
    channels tell all that are left. Channels that were made from others say where a state begins and tell nothing.
    """
    groups, left = GROUPS, tuple(group for group in GROUPS if _begun(dataset, group))
    while left != groups:
        groups = left
        left = tuple(g for g in groups if set(NEEDS.get(g, ())) <= set(groups))
        if left == groups:
            visible = visible_in(*_at_reference(dataset, groups))
            left = tuple(g for g in groups if visible.issuperset(g))
    motion, _ = _at_reference(dataset, groups)
    return motion.states, motion.outputs


def left_out(dataset: Dataset, states: Collection[str]) -> tuple[str, ...]:
    """Beside the states that the channels tell: velocities, attitude, forces, and others where a channel is there."""
    usual = (*VELOCITIES, *ATTITUDES[:2], *FORCES)
    every = (name for group in GROUPS for name in group)
    return tuple(name for name in every if name not in states and (name in usual or _recorded(dataset, name)))


def visible_in(motion: Motion, at: Tensor) -> frozenset[str]:
    """States that the outputs and their derivatives tell near a state [nx], forces and moments being steady.

    C, CA, CA^2, ... of the linear motion, stacked: a state is told if no direction that these leave open has part in
    it. Source: Kalman, Mathematical description of linear dynamical systems, SIAM J. Control 1 (1963).
    """
    u = motion.inputs(torch.ones(1, dtype=torch.float64))[0, 0]
    size = torch.tensor([SIZES.get(name, 1.0) for name in motion.states], dtype=torch.float64)
    A = jacobian(lambda x: motion.rates(x, u), at) * size / size[:, None]
    A[[motion.states.index(axis) for axis in motion.axes]] = 0.0
    stacked = [jacobian(lambda x: motion.measure(x, u), at) * size]
    for _ in motion.states[1:]:
        stacked.append(stacked[-1] @ A)
    rows = torch.cat(stacked)
    rows = rows[rows.norm(dim=1) > DUST]  # each as one: at high speed later derivatives would drown what is measured
    _, strength, directions = torch.linalg.svd(rows / rows.norm(dim=1, keepdim=True))
    open_to = directions[int((strength > TOLERATED * strength[0]).sum()) :].square().sum(dim=0).sqrt()
    return frozenset(name for name, part in zip(motion.states, open_to.tolist(), strict=True) if part < TOLERATED)


def _recorded(dataset: Dataset, *channels: str) -> bool:
    """Whether a flight has all of these, as sensors gave them."""
    derived = dataset.derived.intersection(channels)
    return not derived and any(facts.has(*channels) for facts in dataset.facts.values())


def _begun(dataset: Dataset, group: Sequence[str]) -> bool:
    """Whether a filter knows where these begin: forces by their trims, all else by channels, measured or made."""
    return set(group) <= set(FORCES) or any(facts.has(*group) for facts in dataset.facts.values())


def _at_reference(dataset: Dataset, groups: Sequence[Sequence[str]]) -> tuple[Motion, Tensor]:
    """Motion with these states, steady at the data set's reference without turning, and that state [nx]."""
    chosen = {*RATES, *MOMENTS, *(name for group in groups for name in group)}
    states = tuple(c for c in (*VELOCITIES, *RATES, *ATTITUDES, *POSITIONS, *FORCES, *MOMENTS) if c in chosen)
    sensors = [c for c in (*states, *ACCELERATIONS) if _recorded(dataset, c)]
    sensors += [c for c, axis in zip(SPECIFIC_FORCES, FORCES, strict=True) if axis in chosen and _recorded(dataset, c)]
    one = torch.ones(1, 1, 1, dtype=torch.float64)
    vehicle = dataset.vehicle
    forces = GaussMarkovForces(one.new_ones(6), one.new_zeros(1, 1, 6))
    motion = Motion.of(vehicle, states, tuple(sensors), forces, one)
    reference = {c: v for c, v in dataset.reference().items() if c in (*VELOCITIES, *ATTITUDES)}
    return motion, torch.tensor([reference.get(name, 0.0) for name in states], dtype=torch.float64)
