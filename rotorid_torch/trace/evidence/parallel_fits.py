"""Full fits of several candidates, each by one of the ranks: what was found travels, every rank builds its engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from rotorid_torch.core.gauss_newton import Options
from rotorid_torch.core.processes.ranks import Ranks
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.estimate import progressive_fit
from rotorid_torch.identification.estimate.engine import engine_for
from rotorid_torch.identification.estimate.segments import cut
from rotorid_torch.identification.estimate.sensitivity import Run
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import Care, Fitted, Flights, refit
from rotorid_torch.trace.terms.settings import SETTINGS


@dataclass(frozen=True)
class _Message:
    """A fit as it travels: without model, and its likelihood without flights and engine.

    theta : all the model's numbers. samples : of a segment. runs : the last trajectories with the segments of each,
    None where they are too large to be kept.
    """

    theta: Tensor
    names: tuple[str, ...]
    samples: int
    runs: list[tuple[Tensor, Run]] | None
    fit: progressive_fit.Fit


@dataclass(frozen=True)
class Wanted:
    """A fit to be made: of which spec, from which values, and near which fit.

    short_first : from the measured states instead, over short segments first, where a model that lacks much, or starts
    far off, does not drift away before it is corrected.
    """

    spec: ModelSpec
    start: Mapping[str, float]
    near: Fitted
    short_first: bool = False


def fits(wanted: Sequence[Wanted], held: Sequence[str], options: Options, ranks: Ranks) -> list[Fitted]:
    """`refit` of each, spread over the ranks; to the last digit the same at all."""

    def fitted(one: Wanted) -> Fitted:
        lengths = (SETTINGS.settled_s, SETTINGS.segment_s) if one.short_first else (SETTINGS.segment_s,)
        near = None if one.short_first else one.near
        return refit(one.spec, one.near.flights, one.start, held, near, Care(options, lengths))

    return ranks.carry(wanted, fitted, _message, lambda one, message: _again(message, one.spec, one.near.flights))


def _message(fitted: Fitted) -> _Message:
    fit = fitted.fit
    problem, place = fit.likelihood, fit.minimum.point
    runs = None if place.parts is None else [(part.which, part.run) for part in place.parts]
    lean = replace(place, parts=None, locals=None, passage=None, transitions=[], blocks=[])
    nothing: Any = None
    bare = replace(problem, system=nothing, engine=nothing, records=nothing, segments=nothing)
    fit = replace(fit, likelihood=bare, minimum=replace(fit.minimum, point=lean), computed=fit.uncertainty)
    return _Message(fitted.model.theta.detach().clone(), fitted.names, problem.segments.samples, runs, fit)


def _again(message: _Message, spec: ModelSpec, flights: Flights) -> Fitted:
    """The fit on this rank's flights, with a model and an engine of its own."""
    model = build(spec)
    model.put(message.theta)
    records, system = flights.records(model, flights.dataset.identify), System(model, message.names)
    engine = engine_for(system, records.typical(), progressive_fit.Settings().solver)
    segments, bare = cut(records, message.samples), message.fit.likelihood
    likelihood = replace(bare, system=system, engine=engine, records=records, segments=segments)
    fit = replace(message.fit, likelihood=likelihood)
    if message.runs is not None:
        fit.minimum.point.parts = [likelihood.part(which, run) for which, run in message.runs]
    return Fitted(spec, model, flights, fit)
