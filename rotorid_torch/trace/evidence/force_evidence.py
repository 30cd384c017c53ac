"""Effects seen in forces and moments on the measured motion, where trajectories of a model without them lead astray.

A vehicle that sways with its load is flown for a while, by a model without the load, on derivatives that imitate the
swaying; beside those, a little of the load explains nothing, and the screen by trajectories, a straight line, passes it
over. On the measured motion the derivatives are found anew beside the effect, in closed form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.effects.registry import make
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.model_regression import Before, before, end_to_end, regress_model
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import Fitted
from rotorid_torch.trace.evidence.held_out import FlightEquations
from rotorid_torch.trace.evidence.residual import AT_ONCE, LeftOver, Source, compared, residuals
from rotorid_torch.trace.evidence.screen import Screen, Signature, signatures, sized
from rotorid_torch.trace.terms.candidate import Candidate


def seen_in_forces(null: Fitted, over: LeftOver, candidates: Sequence[Candidate], whole: bool = False) -> Screen:
    """Signatures in forces of those candidates that have parameters which are tried at several values.

    over : what the null leaves over of the identify flights. whole : of the others too.
    """
    dataset, reconstruction = null.flights.dataset, null.flights.reconstruction
    flapping, listed = compared(null.model, dataset, dataset.identify)
    groups = {names[0]: names for names in end_to_end(dataset, listed)}
    chosen, changes = list[Signature](), list[Tensor]()
    tried = [c for c in candidates if whole or any(p.tried for p in make(c.effect, c.joined_to(null.spec)).declared)]
    for candidate in tried:
        model = build(candidate.joined_to(null.spec), null.values)

        def begun(first: str, model: Model = model, effect: str = candidate.effect) -> Before | None:
            return before(model, dataset, reconstruction, groups[first], effect)

        at_effect = OnDemand(groups, begun)
        for one in (s for s in signatures(model, [candidate.effect]) if whole or s.others):
            chosen.append(one)
            with sized(model, one):
                sources = (Source(dataset, reconstruction, names, at_effect[n]) for n, names in groups.items())
                with_it = torch.cat([residuals(model, flapping, source) for source in sources])
            changes.append(over.residual[:, : with_it.shape[1]] - with_it)
    nothing = over.residual[..., None][..., :0]
    return Screen(tuple(chosen), (), equations_of(over, torch.stack(changes, dim=-1) if changes else nothing))


def equations_of(over: LeftOver, changes: Tensor) -> FlightEquations:
    """Of each flight, by force and moment that moves, each as sharp as its residual.

    changes : of forces and moments [N, rows, K] at typical sizes.
    """
    moved = over.residual.any(dim=0).tolist()
    rows = [k for k, row in enumerate(over.rows) if row not in AT_ONCE and moved[k]]
    columns = changes.new_zeros(1, len(changes), changes.shape[-1] + 1)  # no evidence where nothing moves
    if rows:
        both = [(over.beyond(changes[:, k], k), over.beyond(over.residual[:, k, None], k)) for k in rows]
        columns = torch.stack([torch.cat(pair, dim=1) for pair in both])
    columns = columns / columns[:, :, -1].square().mean(dim=1).sqrt().clamp_min(1e-300)[:, None, None]
    each = torch.stack([(part := columns[:, over.flight == f]).mT @ part for f in over.flight.unique()])
    no_prior = each.new_zeros(0, 0), each.new_zeros(0)
    return FlightEquations.of(each, each[:0], no_prior, 1)


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
