"""Trims that differ from flight to flight: what heading or height explains of them, before any run is fitted.

Where flights lie in a wind, or at several heights above the ground, a model with one trim for all of them fits none;
what it is like then says little of single effects. But each equation of step 2 has a constant of its own in every
flight. An effect of where the vehicle flies says how these constants differ, and few numbers explain all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import bounded_least_squares
from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.statistics import jackknife_variance
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.base import Showing
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.model_regression import regress_model, trims_of_flights
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.terms.settings import SETTINGS


@dataclass(frozen=True)
class Explained:
    """An effect of where the vehicle flies, and the share of the differences between unseen flights that it explains.

    start : parameters of the model with it, as step 2 finds them beside it.
    scatter : standard errors of the effect's own parameters by their scatter over flights (jackknife).
    """

    start: Mapping[str, float]
    share: float
    scatter: Mapping[str, float]


@dataclass(frozen=True)
class _Trims:
    """Constants [rows, F] of flights in units of their rows, and their change by each parameter [rows, F, n]."""

    constants: Tensor
    slopes: Tensor

    def take(self, flights: Tensor) -> _Trims:
        """Those of some flights: a mask, or their places."""
        return _Trims(self.constants[:, flights], self.slopes[:, flights])


def explained_trims(
    spec: ModelSpec, values: Mapping[str, float], flights: Flights, effects: Sequence[str]
) -> dict[str, Explained]:
    """What those of these effects that depend on where the vehicle flies explain of the flights' trims, best first.

    Asked where flights begin further apart, in heading or height, than they move. Sizes come from the identify flights;
    only effects that explain at least half of what trims of the unseen flights differ by are told.

    values : parameters that regressions do not find, of effects that the spec has already.
    """
    other = [e for e in effects if registered()[e].showing is Showing.OTHER_FLIGHTS]
    models = {e: build(spec.with_effects(e)) for e in other}
    placed = {e: m for e, m in models.items() if any(_apart(flights.dataset, s.channel) for s in m.layout.states)}
    if not placed:
        return {}
    nominal = build(spec, values)
    theta = regress_model(nominal, flights.dataset, flights.reconstruction).theta
    derivatives = dict(zip(nominal.parameter_set.names, theta.tolist(), strict=True))
    trims = {e: _explained(model, e, derivatives, spec.sizes, flights) for e, model in placed.items()}
    best = sorted(trims.items(), key=lambda one: -one[1].share)
    return {e: one for e, one in best if one.share >= SETTINGS.adequate}


def _apart(dataset: Dataset, channel: str | None) -> bool:
    """Whether the identify flights begin further apart in a channel than they move in it; headings on the circle."""
    if channel is None or len(dataset.identify) < 2:
        return False
    records = [dataset.flights[name].bridged([channel])[:, 0] for name in dataset.identify]
    starts = torch.stack([record[0] for record in records])
    apart, moved = starts - starts.mean(), torch.cat([record - record[0] for record in records])
    if channel == "psi":
        middle = torch.atan2(starts.sin().mean(), starts.cos().mean())
        apart, moved = (torch.atan2(x.sin(), x.cos()) for x in (starts - middle, moved))
    return float(apart.square().mean()) > float(moved.square().mean())


def _explained(
    model: Model, effect: str, derivatives: Mapping[str, float], sizes: Mapping[str, float], flights: Flights
) -> Explained:
    """Least squares for the effect's free parameters, the constants in units of their rows."""
    model.start_from(derivatives)
    parameter_set, dataset = model.parameter_set, flights.dataset
    parameters = [p for p in parameter_set.sizes(effect) if p.free and p.typical != p.value]
    trims = _trims(model, parameters, sizes, flights, dataset.identify)
    count = len(dataset.identify)
    without = [trims.take(torch.arange(count) != f) for f in range(count)]
    recorded = [n for n in dataset.validate if _records_as_much(dataset, n)]
    if recorded:
        remaining = [_left(parameters, trims, _trims(model, parameters, sizes, flights, recorded))]
    else:  # each flight by the others
        remaining = [_left(parameters, left_out, trims.take(torch.tensor([f]))) for f, left_out in enumerate(without)]
    left, differ = (sum(float(part) for part in parts) for parts in zip(*remaining, strict=True))
    scatter = jackknife_variance(torch.stack([_sizes(parameters, left_out) for left_out in without])).sqrt()
    share, names = 1.0 - left / max(differ, 1e-300), [p.name for p in parameters]
    model.start_from(dict(zip(names, _sizes(parameters, trims).tolist(), strict=True)))
    if share >= SETTINGS.adequate:
        model.put(regress_model(model, dataset, flights.reconstruction).theta)
    return Explained(model.named_values, share, dict(zip(names, scatter.tolist(), strict=True)))


def _records_as_much(dataset: Dataset, flight: str) -> bool:
    """Whether a flight has every channel that all identify flights have."""
    common = set.intersection(*(set(dataset.facts[n].channels) for n in dataset.identify))
    return all(dataset.facts[flight].has(c) for c in common if all(dataset.facts[n].has(c) for n in dataset.identify))


def _sizes(parameters: Sequence[Parameter], trims: _Trims) -> Tensor:
    """The effect's parameters [n] that leave least of what constants differ by, within their bounds."""
    A = (trims.slopes - trims.slopes.mean(-2, keepdim=True)).flatten(0, 1)
    b = (trims.constants - trims.constants.mean(-1, keepdim=True)).flatten()
    lower, upper = (torch.tensor([p.bounds[k] for p in parameters], dtype=torch.float64) for k in (0, 1))
    start = torch.tensor([p.value for p in parameters], dtype=torch.float64)
    return start + bounded_least_squares(A.mT @ A, -A.mT @ b, lower - start, upper - start)


def _left(parameters: Sequence[Parameter], trims: _Trims, others: _Trims) -> tuple[Tensor, Tensor]:
    """Squares of what other flights' constants differ by from the mean of those seen: with the effect, and without."""
    size = _sizes(parameters, trims) - torch.tensor([p.value for p in parameters], dtype=torch.float64)
    differ = others.constants - trims.constants.mean(-1, keepdim=True)
    explained = (others.slopes - trims.slopes.mean(-2, keepdim=True)) @ size
    return (differ + explained).square().sum(), differ.square().sum()


def _trims(
    model: Model, parameters: Sequence[Parameter], sizes: Mapping[str, float], flights: Flights, listed: Sequence[str]
) -> _Trims:
    """Of these flights, without the effect and by each of its parameters."""
    dataset = replace(flights.dataset, identify=tuple(listed))
    null = model.theta.detach().clone()
    changes = []
    with model.restored():
        rows, base = trims_of_flights(model, null, dataset, flights.reconstruction)
        unit = torch.tensor([sizes[f"row.{row}"] for row in rows], dtype=torch.float64)[:, None]
        for parameter in parameters:
            moved = null.clone()
            moved[model.parameter_set.index(parameter.name)] = parameter.typical
            other = trims_of_flights(model, moved, dataset, flights.reconstruction)[1]
            changes.append((other - base) / (parameter.typical - parameter.value) / unit)
    return _Trims(base / unit, torch.stack(changes, dim=-1))
