"""Effects seen in forces and moments on the measured motion, where trajectories of a model without them lead astray.

A vehicle that sways with its load is flown for a while, by a model without the load, on derivatives that imitate the
swaying; beside those, a little of the load explains nothing, and the screen by trajectories, a straight line, passes it
over. On the measured motion the derivatives are found anew beside the effect, in closed form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import torch
from torch import Tensor

from rotorid_torch.core.bounded_least_squares import bounded_least_squares
from rotorid_torch.identification.step2 import regress_model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.fits import Fitted
from rotorid_torch.trace.floor import FALSE_ALARMS
from rotorid_torch.trace.residual import AT_ONCE, LeftOver, by_chance, left_over
from rotorid_torch.trace.screen import Signature, signatures, sized


@dataclass(frozen=True)
class Seen:
    """What an effect explains of forces and moments on the measured motion, where it is best, and its values there.

    chance : what residuals that know nothing of the motion let it explain in at most 5 % of cases.
    """

    gain: float
    chance: float
    start: Mapping[str, float]


def seen_in_forces(
    null: Fitted, accepted: Sequence[str], effects: Sequence[str], seed: int, whole: bool = False
) -> dict[str, Seen]:
    """What these effects explain in forces.

    accepted : effects of the null that have a name. seed : of the residuals that know nothing of the motion.
    whole : all of these effects; else those alone that have parameters which are tried at several values.
    """
    flights, found = null.flights, {}
    over: LeftOver | None = None
    for effect in effects:
        model = build(null.spec.with_effects(effect))
        model.start_from(null.values)
        own = [one for one in signatures(model, [effect]) if whole or one.beside]
        if not own:
            continue
        listed = flights.dataset, flights.reconstruction, flights.dataset.identify
        over = over or left_over(null.model, *listed, accepted)
        gains, starts = [], []
        for _, together in groupby(own, key=lambda one: one.kind):
            variant, changes = tuple(together), []
            for one in variant:
                with sized(model, one):
                    changes.append(over.residual - left_over(model, *listed).residual)
            gained, sizes = _explained(over, torch.stack(changes, dim=-1), variant, seed)
            values = {s.parameter: s.null + a * s.step for s, a in zip(variant, sizes.tolist(), strict=True)}
            gains.append(gained)
            starts.append({**dict(variant[0].beside), **values})
        table = torch.stack(gains)
        best = int(table[:, 0].argmax())
        by_chance = torch.quantile(table[:, 1:].amax(dim=0), 1.0 - FALSE_ALARMS, interpolation="higher")
        found[effect] = Seen(float(table[best, 0]), float(by_chance), starts[best])
    return found


def derivatives_beside(null: Fitted, effect: str, own: Mapping[str, float], held: Sequence[str]) -> dict[str, float]:
    """The parameters of a null with an effect of this size, derivatives found anew beside it on the measured motion.

    held : parameters that keep their values.
    """
    model = build(null.spec.with_effects(effect))
    model.start_from({**null.values, **own})
    found = regress_model(model, null.flights.dataset, null.flights.reconstruction).theta
    anew = dict(zip(model.parameter_set.names, found.tolist(), strict=True))
    return {n: v for n, v in anew.items() if n not in held}


def _explained(over: LeftOver, changes: Tensor, variant: Sequence[Signature], seed: int) -> tuple[Tensor, Tensor]:
    """Gains [1 + R] of the residual and of those that know nothing, and the sizes [K] in steps for the first.

    changes : of forces and moments [N, rows, K] at typical size, which is one for all rows, each as sharp as its rest.
    """
    residuals = torch.cat([over.residual[..., None], by_chance(over, seed)], dim=-1)
    low, high = torch.tensor([one.reach for one in variant], dtype=torch.float64).mT
    moved = over.residual.any(dim=0).tolist()
    rows = [k for k, row in enumerate(over.rows) if row not in AT_ONCE and moved[k]]
    if not rows:
        return residuals.new_zeros(residuals.shape[-1]), residuals.new_zeros(len(variant))
    tried = torch.stack([over.beyond(changes[:, k], k) for k in rows])  # [rows, N, K]
    left = torch.stack([over.beyond(residuals[:, k], k) for k in rows])  # [rows, N, 1 + R]
    power = left.square().sum(dim=1)
    G = torch.einsum("rni,rnj,rc->cij", tried, tried, 1.0 / power)
    d = torch.einsum("rni,rnc,rc->ci", tried, left, 1.0 / power)
    sizes = torch.stack(
        [bounded_least_squares(*one, low, high) for one in zip(G, d, strict=True)], dim=-1
    )  # [K, 1 + R]
    rest = (left - tried @ sizes).square().sum(dim=1)
    return (power / rest).log().sum(dim=0), sizes[:, 0]
