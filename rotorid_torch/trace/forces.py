"""Effects seen in forces and moments on the measured motion, where trajectories of a model without them lead astray.

A vehicle that sways with its load is flown for a while, by a model without the load, on derivatives that imitate the
swaying; beside those, a little of the load explains nothing, and the screen by trajectories, a straight line, passes it
over. On the measured motion the derivatives are found anew beside the effect, in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import msgspec
import torch
from torch import Tensor

from rotorid_torch.model.nominal import build
from rotorid_torch.trace.fits import Fitted
from rotorid_torch.trace.residual import LeftOver, by_chance, left_over
from rotorid_torch.trace.screen import Signature, signatures, sized


def seen_in_forces(
    null: Fitted, accepted: Sequence[str], effects: Sequence[str], seed: int
) -> dict[str, dict[str, float]]:
    """Effects with parameters that are tried at several values which explain more than chance, and their best values.

    accepted : effects of the null that have a name. seed : of the residuals that know nothing of the motion.
    """
    flights, found = null.flights, {}
    over: LeftOver | None = None
    for effect in effects:
        model = build(msgspec.structs.replace(null.spec, effects=(*null.spec.effects, effect)))
        model.start_from(null.values)
        own = [one for one in signatures(model, [effect]) if one.beside]
        if not own:
            continue
        listed = flights.dataset, flights.reconstruction, flights.dataset.identify
        over = over or left_over(null.model, *listed, accepted)
        worth = {}
        for beside, together in groupby(own, key=lambda one: one.beside):
            variant, changes = tuple(together), []
            for one in variant:
                with sized(model, one):
                    changes.append(over.residual - left_over(model, *listed).residual)
            gains, sizes = _explained(over, torch.stack(changes, dim=-1), variant, seed)
            if float(gains[0]) > float(gains[1:].max()):
                values = {s.parameter: s.null + a * s.step for s, a in zip(variant, sizes.tolist(), strict=True)}
                worth[float(gains[0])] = {**dict(beside), **values}
        if worth:
            found[effect] = worth[max(worth)]
    return found


def _explained(over: LeftOver, changes: Tensor, variant: Sequence[Signature], seed: int) -> tuple[Tensor, Tensor]:
    """Gains [1 + R] of the residual and of those that know nothing, and the sizes [K] in steps for the first.

    changes : of forces and moments [N, rows, K] at typical size, which is one for all rows, each as sharp as its rest.
    """
    residuals = torch.cat([over.residual[..., None], by_chance(over, seed)], dim=-1)
    low, high = torch.tensor([one.reach for one in variant], dtype=torch.float64).mT[..., None]
    rows = [k for k in range(len(over.rows)) if bool(over.residual[:, k].any())]  # where anything moved
    if not rows:
        return residuals.new_zeros(residuals.shape[-1]), residuals.new_zeros(len(variant))
    tried = torch.stack([over.beyond(changes[:, k], k) for k in rows])  # [rows, N, K]
    left = torch.stack([over.beyond(residuals[:, k], k) for k in rows])  # [rows, N, 1 + R]
    power = left.square().sum(dim=1)
    G = torch.einsum("rni,rnj,rc->cij", tried, tried, 1.0 / power)
    d = torch.einsum("rni,rnc,rc->ci", tried, left, 1.0 / power)
    sizes = torch.linalg.lstsq(G, d[..., None], driver="gelsd").solution[..., 0].mT.clamp(low, high)  # [K, 1 + R]
    rest = (left - tried @ sizes).square().sum(dim=1)
    return (power / rest).log().sum(dim=0), sizes[:, 0]
