"""Which control a step goes with: one that loses its place moves every equation as its own deflection would."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch

from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS
from rotorid_torch.model.gusts import GUSTS
from rotorid_torch.model.model import Model
from rotorid_torch.trace.evidence.residual import AT_ONCE, SECOND_ORDER, LeftOver, loads, on_measured
from rotorid_torch.trace.terms.settings import SETTINGS

DEFLECTION = 1e-3
"""By which controls are moved for what they do, rad or as declared."""
Deflected = Mapping[str, Mapping[str, float]]
"""What each control does to each equation, per unit."""


def deflected(model: Model) -> Deflected:
    """What a model's controls do at its reference: forces, moments, and the rates of a disc that follows them."""
    controls = [n for n in model.body.controls if n not in GUSTS]
    one = DEFLECTION * torch.eye(len(controls), dtype=torch.float64)
    moved = dict(zip(controls, torch.cat([one, -one]).mT, strict=True))
    still = torch.zeros(2 * len(controls), dtype=torch.float64)
    signals = {n: moved.get(n, still) + model.reference.get(n, 0.0) for n in (*model.layout.names, *controls)}
    frame = on_measured(model, signals, {SECOND_ORDER: 0.0})
    change = dict(zip((*FORCES, *MOMENTS), loads(frame).mT, strict=True))
    change |= {row: frame.rates[n] for row, n in AT_ONCE.items() if n in frame.rates}
    up, down = torch.stack([*change.values()], dim=1).chunk(2)
    slopes = ((up - down) / (2.0 * DEFLECTION)).tolist()
    return {control: dict(zip(change, slope, strict=True)) for control, slope in zip(controls, slopes, strict=True)}


def slipped(row: str, onset: float, left: LeftOver, unseen: LeftOver, does: Deflected) -> str | None:
    """The one control whose deflection makes all steps that begin at an onset, on unseen flights too; or None.

    row : where the step stands. On the disc's own motion the body says nothing of the rotor's controls: their work is
    the disc's; and where the disc follows its controls, the disc says nothing of the others.
    """
    rows = tuple(AT_ONCE) if row in (*FLAPPING, *AT_ONCE) else (*FORCES, *MOMENTS)
    here, confirmed = (_likeness(rows, onset, side, does) for side in (left, unseen))
    alike = [control for control in here if here[control] ** 2 >= SETTINGS.slipped]
    again = [c for c in alike if here[c] * confirmed.get(c, 0.0) > 0.0 and confirmed[c] ** 2 >= SETTINGS.slipped]
    return again[0] if alike == again and len(again) == 1 else None


def _likeness(rows: Sequence[str], onset: float, side: LeftOver, does: Deflected) -> dict[str, float]:
    """Cosine between the steps in these equations, each beside its own rest, and those that each control makes."""
    after = (side.time[:, None] >= onset).to(torch.float64)
    steps, units = [], []
    moved = dict(zip(side.rows, side.residual.any(dim=0).tolist(), strict=True))
    equations = [row for row in rows if moved.get(row) and all(row in response for response in does.values())]
    for row in equations:
        k = side.rows.index(row)
        tried, signals = side.beyond(torch.cat([after, side.residual[:, k, None]], dim=1), k).mT
        size = (tried @ signals) / (tried @ tried).clamp_min(1e-300)
        units.append(tried.norm() / (signals - size * tried).norm().clamp_min(1e-300))
        steps.append(size * units[-1])
    if len(equations) < 2:  # one equation is like any control
        return {}
    observed, unit = torch.stack(steps), torch.stack(units)
    directions = {
        c: torch.tensor([response[row] for row in equations], dtype=torch.float64) * unit
        for c, response in does.items()
    }
    return {
        c: float(torch.nn.functional.cosine_similarity(observed, one, dim=0, eps=1e-300))
        for c, one in directions.items()
    }
