"""Trims that differ from flight to flight: what heading or height explains of them, before any run is fitted.

Where flights lie in a wind, or at several heights above the ground, a model with one trim for all of them fits none;
what it is like then says little of single effects. But each equation of step 2 has a constant of its own in every
flight. An effect of where the vehicle flies says how these constants differ, and few numbers explain all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.step2 import regress_model, trims_of_flights
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.fits import Flights

EXPLAINED = 0.5
"""Share of the differences between flights that no fit has seen which an effect explains if it is worth a full fit."""


@dataclass(frozen=True)
class Explained:
    """An effect of where the vehicle flies, and the share of the differences between unseen flights that it explains.

    start : parameters of the model with it, as step 2 finds them beside it.
    """

    start: Mapping[str, float]
    share: float


def explained_trims(spec: ModelSpec, flights: Flights, effects: Sequence[str]) -> dict[str, Explained]:
    """What those of these effects that depend on where the vehicle flies explain of the flights' trims.

    Asked where flights begin further apart, in heading or height, than they move. Sizes come from the identify flights;
    only effects that explain at least half of what trims of the unseen flights differ by are told.
    """
    models = {e: build(msgspec.structs.replace(spec, effects=(*spec.effects, e))) for e in effects}
    placed = {e: m for e, m in models.items() if any(_apart(flights.dataset, s.channel) for s in m.layout.states)}
    if not placed:
        return {}
    nominal = build(spec)
    theta = regress_model(nominal, flights.dataset, flights.reconstruction).theta
    derivatives = dict(zip(nominal.parameter_set.names, theta.tolist(), strict=True))
    found = {e: _explained(model, e, derivatives, spec.sizes, flights) for e, model in placed.items()}
    return {e: one for e, one in found.items() if one.share >= EXPLAINED}


def _apart(dataset: Dataset, channel: str | None) -> bool:
    """Whether the identify flights begin further apart in a channel than they move in it."""
    if channel is None or len(dataset.identify) < 2:
        return False
    records = [dataset.flights[name].bridged([channel])[:, 0] for name in dataset.identify]
    starts = torch.stack([record[0] for record in records])
    moved = torch.cat([record - record[0] for record in records]).square().mean().sqrt()
    return float(starts.std()) > float(moved)


def _explained(
    model: Model, effect: str, derivatives: Mapping[str, float], sizes: Mapping[str, float], flights: Flights
) -> Explained:
    """Least squares for the effect's free parameters, the constants in units of their rows."""
    model.start_from(derivatives)
    known = model.parameter_set
    own = [p for p in known.parameters if p.name.startswith(f"{effect}.") and p.free and p.typical != p.value]
    seen, slopes = _lines(model, own, sizes, flights, flights.dataset.identify)
    unseen, unseen_slopes = _lines(model, own, sizes, flights, flights.dataset.unseen)
    centre, mean = seen.mean(-1, keepdim=True), slopes.mean(-2, keepdim=True)
    A, b = (slopes - mean).flatten(0, 1), (seen - centre).flatten()
    lower, upper = (torch.tensor([p.bounds[k] for p in own], dtype=torch.float64) for k in (0, 1))
    start = torch.tensor([p.value for p in own], dtype=torch.float64)
    size = torch.linalg.lstsq(A, -b.unsqueeze(-1), driver="gelsd").solution.squeeze(-1)
    size = (start + size).clamp(lower, upper) - start
    differ = unseen - centre
    left = differ + (unseen_slopes - mean) @ size
    share = 1.0 - float(left.square().sum() / differ.square().sum().clamp_min(1e-300))
    with torch.no_grad():
        model.theta[[known.index(p.name) for p in own]] = start + size
    if share >= EXPLAINED:
        beside = regress_model(model, flights.dataset, flights.reconstruction).theta
        with torch.no_grad():
            model.theta.copy_(beside)
    return Explained(model.named_values, share)


def _lines(
    model: Model, own: Sequence[Parameter], sizes: Mapping[str, float], flights: Flights, listed: Sequence[str]
) -> tuple[Tensor, Tensor]:
    """Constants [rows, F] without the effect, and their change by each of its parameters [rows, F, n]."""
    dataset = replace(flights.dataset, identify=tuple(listed))
    null = model.theta.detach().clone()
    rows, base = trims_of_flights(model, null, dataset, flights.reconstruction)
    unit = torch.tensor([sizes[f"row.{row}"] for row in rows], dtype=torch.float64)[:, None]
    changes = []
    for parameter in own:
        moved = null.clone()
        moved[model.parameter_set.index(parameter.name)] = parameter.typical
        other = trims_of_flights(model, moved, dataset, flights.reconstruction)[1]
        changes.append((other - base) / (parameter.typical - parameter.value) / unit)
    with torch.no_grad():
        model.theta.copy_(null)
    return base / unit, torch.stack(changes, dim=-1)
