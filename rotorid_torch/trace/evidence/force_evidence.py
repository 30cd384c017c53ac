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

from rotorid_torch.core.least_squares import bounded_least_squares
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.effects.registry import make
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.model_regression import before, regress_model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import Fitted
from rotorid_torch.trace.evidence.held_out import FlightEquations
from rotorid_torch.trace.evidence.residual import AT_ONCE, LeftOver, left_over
from rotorid_torch.trace.evidence.screen import Signature, signatures, sized
from rotorid_torch.trace.terms.candidate import Candidate


@dataclass(frozen=True)
class ForceEvidence:
    """An effect in forces and moments on the measured motion.

    start : its values where it explains most. evidence : held-out log ratio of the rms of forces and moments [F].
    """

    start: Mapping[str, float]
    evidence: Tensor


def seen_in_forces(
    null: Fitted, over: LeftOver, candidates: Sequence[Candidate], whole: bool = False
) -> dict[Candidate, ForceEvidence]:
    """Evidence in forces of those candidates that have parameters which are tried at several values.

    over : what the null leaves over of the identify flights. whole : of the others too.
    """
    flights, residuals = null.flights.dataset, {}
    source = flights, null.flights.reconstruction
    tried = [c for c in candidates if whole or any(p.tried for p in make(c.effect, c.joined_to(null.spec)).declared)]
    for candidate in tried:
        model = build(candidate.joined_to(null.spec), null.values)
        results = []
        chosen = [one for one in signatures(model, [candidate.effect]) if whole or one.others]
        begun = OnDemand(flights.identify, lambda name, m=model, e=candidate.effect: before(m, *source, name, e))
        for _, together in groupby(chosen, key=lambda one: one.kind):
            variant, changes = tuple(together), []
            for one in variant:
                with sized(model, one):
                    changes.append(over.residual - left_over(model, *source, flights.identify, (), begun).residual)
            sizes, evidence = _held_out(over, torch.stack(changes, dim=-1), variant)
            values = {s.parameter: s.null + a * s.step for s, a in zip(variant, sizes.tolist(), strict=True)}
            results.append(ForceEvidence({**dict(variant[0].others), **values}, evidence))
        if results:
            residuals[candidate] = max(results, key=lambda one: float(one.evidence.sum()))
    return residuals


def derivatives_beside(
    null: Fitted, spec: ModelSpec, sizes: Mapping[str, float], held: Sequence[str]
) -> dict[str, float]:
    """The parameters of a richer spec with effects of these sizes, derivatives from the measured motion beside them.

    held : parameters that keep their values.
    """
    model = build(spec, {**null.values, **sizes})
    theta = regress_model(model, null.flights.dataset, null.flights.reconstruction).theta
    anew = dict(zip(model.parameter_set.names, theta.tolist(), strict=True))
    return {**null.values, **sizes} | {n: v for n, v in anew.items() if n not in held}


def _held_out(over: LeftOver, changes: Tensor, variant: Sequence[Signature]) -> tuple[Tensor, Tensor]:
    """Sizes [K] in steps, and evidence [F] by `FlightEquations`, none where a single flight was fitted.

    changes : of forces and moments [N, rows, K] at typical size, which is one for all rows, each as sharp as its
    residual.
    """
    moved = over.residual.any(dim=0).tolist()
    rows = [k for k, row in enumerate(over.rows) if row not in AT_ONCE and moved[k]]
    if not rows:
        return over.residual.new_zeros(len(variant)), over.residual.new_zeros(0)
    both = [(over.beyond(changes[:, k], k), over.beyond(over.residual[:, k, None], k)) for k in rows]
    columns = torch.stack([torch.cat(pair, dim=1) for pair in both])
    columns = columns / columns[:, :, -1].square().mean(dim=1).sqrt().clamp_min(1e-300)[:, None, None]
    each = torch.stack([(part := columns[:, over.flight == f]).mT @ part for f in over.flight.unique()])
    low, high = torch.tensor([one.reach for one in variant], dtype=torch.float64).mT
    no_prior = each.new_zeros(0, 0), each.new_zeros(0)
    equations = FlightEquations.of(each, each[:0], no_prior, 1)  # [F, rows, K + 1, K + 1]
    whole = equations.total
    sizes = bounded_least_squares(whole[:-1, :-1], whole[:-1, -1], low, high)
    return sizes, equations.held_out([*range(len(variant))], low, high)
