"""Floors: the gain above which a candidate counts, measured on clean aircraft and on shuffled residuals.

No number in here decides: floors are quantiles of gains that candidates reach where they are not the cause.
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
