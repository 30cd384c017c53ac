"""Critical values and p-values: what candidates reach on clean aircraft and shuffled residuals, where no effect acts.

Floors are quantiles of gains. Clean aircraft are drawn in the likeness of the data, and their flights go through the
same fit and the same evidence; the p-value of an effect is adjusted for the whole family of effects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.trace.screen import Screen

FALSE_ALARMS = 0.05
"""Family-wise: share of clean vehicles on which any candidate at all may pass its floor."""

EACH = " of each control"
"""After the ids of effects that are tried on each control."""


@dataclass(frozen=True)
class Null:
    """The model whose candidates need floors: its structure, its parameters' values, and those that are held."""

    spec: ModelSpec
    values: Mapping[str, float]
    held: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Floors:
    """Gains of every candidate on clean drawn aircraft [D], by effect; empty where none could be drawn.

    The gain of a clean aircraft is at least what chance gives: that of its residual once its time has been shuffled.

    each_control : the same of effects of the control path, each control by itself.
    note : how many were drawn, or why none.
    traces : weight, by equation and kind, of what looks like something unknown [D].
    sizes : what delays and lags of the controls seem to be there, by parameter [D].
    in_forces : what effects explain there of forces and moments on the measured motion, by effect [D].
    evidence : of each candidate, flight by flight [D, F + V].
    """

    gains: Mapping[str, Tensor]
    note: str
    traces: Mapping[str, Tensor] = field(default_factory=dict)
    in_forces: Mapping[str, Tensor] = field(default_factory=dict)
    each_control: Mapping[str, Tensor] = field(default_factory=dict)
    sizes: Mapping[str, Tensor] = field(default_factory=dict)
    evidence: Mapping[str, Tensor] = field(default_factory=dict)

    def of_traces(self) -> dict[str, float]:
        """Floor of each equation and kind; empty where no aircraft was drawn: nothing tells how much is ordinary."""
        return family_wise(self.traces)

    def of_forces(self) -> dict[str, float]:
        """Floor of what each effect explains of forces; empty where no aircraft was drawn."""
        return family_wise(self.in_forces)

    def scatter(self, effect: str) -> dict[str, float]:
        """Standard deviation, from one clean aircraft to the next, of what an effect's parameters seem to be there.

        About their mean: by how much all of them seem to lead is due to the drawn rotors, simpler than real ones.
        """
        return {n: float(found.std()) for n, found in self.sizes.items() if n.startswith(f"{effect}.")}

    def of(self, screened: Screen, effects: Sequence[str]) -> dict[str, float]:
        """Floor of each effect: that of clean aircraft; without any, that of the data's own shuffled residual."""
        return _one_family(self.gains, self.each_control)[0] if self.gains else self.chance(screened, effects)

    def with_each_control(
        self, screened: Screen, effects: Sequence[str], alone: Screen, path: Sequence[str]
    ) -> tuple[dict[str, float], dict[str, float]]:
        """The same, and beside it those of effects of the control path where each control has a size of its own.

        alone : the latter's screen. path : their ids.
        """
        if self.gains:
            return _one_family(self.gains, self.each_control)
        return _one_family({e: screened.by_chance(e) for e in effects}, {e: alone.by_chance(e) for e in path})

    @staticmethod
    def chance(screened: Screen, effects: Sequence[str]) -> dict[str, float]:
        """Floors by the data's own shuffled residual alone."""
        return family_wise({e: screened.by_chance(e) for e in effects})


def _one_family(common: Mapping[str, Tensor], each: Mapping[str, Tensor]) -> tuple[dict[str, float], dict[str, float]]:
    """Floors of effects on all controls alike, and of those on each control: one family."""
    levels = family_wise({**common, **{f"{e}{EACH}": gained for e, gained in each.items()}})
    return {e: levels[e] for e in common}, {e: levels[f"{e}{EACH}"] for e in each}


def family_wise(gains: Mapping[str, Tensor]) -> dict[str, float]:
    """Levels that the gains [D] of all effects together stay below in 95 % of the draws.

    Each effect's gain is taken in units of its own mean, so that a candidate which rarely gains anything is not
    measured by one that often does.
    """
    if not gains:
        return {}
    names = list(gains)
    table = torch.stack([gains[e] for e in names])
    usual = table.mean(dim=1).clamp_min(1e-300)
    largest = (table / usual[:, None]).amax(dim=0)
    factor = float(torch.quantile(largest, 1.0 - FALSE_ALARMS, interpolation="higher"))
    return {e: factor * float(m) for e, m in zip(names, usual, strict=True)}


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
