"""Calibration: how often flights with nothing missing show as much evidence as the data do.

Clean aircraft are drawn in the likeness of the data, and their flights go through the same fit and the same evidence.
The p-value of an effect is adjusted for the whole family of effects.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from rotorid_torch.trace.floor import EACH, Floors
from rotorid_torch.trace.screen import Screen


def flight_by_flight(common: Screen, each: Screen) -> dict[str, Tensor]:
    """Evidence [F + V] of each candidate: effects with a size of all controls, and with a size of each control."""
    apart = {f"{e}{EACH}": each.evidence(e) for e in each.effects}
    return {e: common.evidence(e) for e in common.effects} | apart


def total(evidence: Tensor) -> Tensor:
    """The statistic: the sum of the evidence of all flights."""
    return evidence.sum(-1)


def p_values(evidence: Mapping[str, Tensor], floors: Floors) -> dict[str, float]:
    """Adjusted p of each effect, the smaller of those of its candidates; nothing where no clean aircraft were drawn."""
    observed = {name: float(total(d)) for name, d in evidence.items() if len(d) and name in floors.evidence}
    adjusted = adjusted_p(observed, {name: total(floors.evidence[name]) for name in observed})
    smallest = dict[str, float]()
    for name, p in adjusted.items():
        effect = name.removesuffix(EACH)
        smallest[effect] = min(p, smallest.get(effect, 1.0))
    return smallest


def adjusted_p(observed: Mapping[str, float], clean: Mapping[str, Tensor]) -> dict[str, float]:
    """Family-wise adjusted p of each effect, p = (1 + k) / (1 + n): k of n clean aircraft show as much.

    Statistics are compared in units of their mean size over the data and the draws, so that all effects count alike
    and the data and the draws stay exchangeable: the level holds for any distribution. Step-down: an effect is compared
    with the largest of those that are no more extreme.

    Parameters
    ----------
    observed : statistic of each effect, large where it is missing. clean : the same of n draws [n].

    Source: Westfall and Young, Resampling-Based Multiple Testing (1993), algorithm 2.8.
    """
    if not observed:
        return {}
    names = list(observed)
    data = torch.tensor([observed[e] for e in names], dtype=torch.float64)
    table = torch.stack([clean[e] for e in names])
    size = torch.cat([table, data[:, None]], dim=1).abs().mean(dim=1).clamp_min(1e-300)
    data, table = data / size, table / size[:, None]
    order = data.argsort(descending=True, stable=True).tolist()
    adjusted, least = {}, 0.0
    for k, place in enumerate(order):
        largest = table[order[k:]].amax(dim=0)
        p = (1.0 + int((largest >= data[place]).sum())) / (1.0 + table.shape[1])
        least = max(least, p)
        adjusted[names[place]] = least
    return {e: adjusted[e] for e in names}
