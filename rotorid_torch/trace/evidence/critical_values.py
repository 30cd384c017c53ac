"""p-values, and critical values (`floor` in a report): statistics where nothing is missing.

The statistic of a candidate is T = sum over flights of the evidence d_f. Clean aircraft are drawn in the likeness of
the data, and their flights go through the same fit and the same evidence; where none can be drawn, the data's own
residuals, turned in time, stand for them. p-values are adjusted for the whole family of candidates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.gusts import Weather
from rotorid_torch.trace.terms.candidate import UNATTRIBUTED, effect_of
from rotorid_torch.trace.terms.settings import SETTINGS


@dataclass(frozen=True)
class Joined:
    """Undeclared effects of a model, which an aircraft with nothing more missing has too.

    candidate : the effect that is tested beside them, with a fit in full.
    """

    effects: Sequence[str] = ()
    candidate: str = ""


@dataclass(frozen=True)
class Null:
    """A fitted model without what may be missing: its structure, its parameters' values, and those that are held.

    weather : that it was fitted in, where its inputs are gusts. joined : what stands in it beside a bare vehicle.
    """

    spec: ModelSpec
    values: Mapping[str, float]
    held: Sequence[str] = ()
    weather: Weather | None = None
    joined: Joined = Joined()

    @property
    def sizes(self) -> dict[str, dict[str, float]]:
        """Values of the parameters, by name, of each effect that joined."""
        return {
            effect: {n.removeprefix(f"{effect}."): v for n, v in self.values.items() if n.startswith(f"{effect}.")}
            for effect in self.joined.effects
        }


@dataclass(frozen=True, eq=False)
class Draws:
    """Statistics T [D] of each member of the family on flights with nothing missing.

    note : what was drawn, for the report. clean : whether clean aircraft were flown; else residuals were turned in
    time. sizes : of each effect's parameters beyond nothing, by the straight line of the screen [D], by full name.
    least : mean size of a member below which its statistic is no more than that of any one more parameter.
    """

    statistics: Mapping[str, Tensor]
    note: str = ""
    clean: bool = False
    least: Mapping[str, float] = field(default_factory=dict)
    sizes: Mapping[str, Tensor] = field(default_factory=dict)

    def errors(self, sizes: Mapping[str, float]) -> dict[str, float]:
        """Standard errors of sizes beyond nothing by what they seem to be on clean aircraft, where there is nothing.

        Standard deviation, and the mean where it has the sign of the size: a mean of the other sign hides a size, and
        makes none.
        """
        drawn = {n: (size, self.sizes[n]) for n, size in sizes.items() if len(self.sizes.get(n, ())) > 1}
        means = {n: max(math.copysign(1.0, size) * float(seemed.mean()), 0.0) for n, (size, seemed) in drawn.items()}
        return {n: math.hypot(float(seemed.std()), means[n]) for n, (_, seemed) in drawn.items()}

    def visible(self, name: str, critical: float) -> float:
        """T that an effect must bring to reach its critical value in 80 % of cases, beside what no effect gives."""
        return critical - float(torch.quantile(self.statistics[name], SETTINGS.missed))

    def critical_values(self, observed: Mapping[str, float]) -> dict[str, float]:
        """T of each member of the library above which p is at most the level; none below zero.

        In the same units as p: with q the quantile 1 - level of the draws' largest statistics, n draws, S the sum of
        the sizes of a member's draws and s0 the size of the usual member, T = q ((S + T)/(n + 1) + s0). Step-down: the
        largest are those of the members that are no more extreme; members whose p is larger than the level share one q.
        """
        library = [n for n in self.statistics if n in observed and not n.startswith(UNATTRIBUTED)]
        if not library:
            return {}
        family = _Family.of({name: observed[name] for name in library}, self)
        count, critical, q, exceeds = family.table.shape[1], {}, 0.0, True
        for k, place in enumerate(family.order):
            if exceeds:
                q = float(torch.quantile(family.largest(k), 1.0 - SETTINGS.level, interpolation="higher"))
                exceeds = float(family.data[place]) > q
            total = float((family.table[place] * family.unit[place]).abs().sum())
            most = q * (total + (count + 1.0) * float(family.usual[place])) / max(count + 1.0 - q, 1e-300)
            critical[family.names[place]] = max(most, 0.0)
        return {name: critical[name] for name in library}

    def clear(self, observed: Mapping[str, float], effect: str = "") -> bool:
        """Whether draws so far show as much as the data so often that no further draws can make any p small.

        effect : whose p is asked for; all by default.

        Source: Besag and Clifford, Biometrika 78 (1991), sequential Monte Carlo p-values.
        """
        p = {name: one for name, one in self.p_values(observed).items() if effect in ("", effect_of(name))}
        count = len(next(iter(self.statistics.values()), ()))
        exceeding = [round(one * (1 + count)) - 1 for one in p.values()]
        return bool(p) and count >= SETTINGS.earliest and min(exceeding) >= SETTINGS.exceeding

    def p_values(self, observed: Mapping[str, float]) -> dict[str, float]:
        """Adjusted p of each member that is drawn.

        Effects of the library are a family. What has no name is compared with all members: some of it is in every model
        of a real aircraft.
        """
        shared = {n: t for n, t in observed.items() if n in self.statistics}
        library = {n: t for n, t in shared.items() if not n.startswith(UNATTRIBUTED)}
        return self.adjusted_p(shared) | self.adjusted_p(library)

    def adjusted_p(self, observed: Mapping[str, float]) -> dict[str, float]:
        """Family-wise adjusted p of each member, p = (1 + k) / (1 + n): k of n draws show as much.

        Statistics are compared in units of their mean size over the data and the draws, so that all members count alike
        and the data and the draws stay exchangeable: the level holds for any distribution. Step-down: a member is
        compared with the largest of those that are no more extreme. What predicts flights worse is no evidence: p is
        one.

        observed : statistic of each member, large where it is missing.

        Source: Westfall and Young, Resampling-Based Multiple Testing (1993), algorithm 2.8.
        """
        if not observed:
            return {}
        family, adjusted, largest = _Family.of(observed, self), {}, 0.0
        for k, place in enumerate(family.order):
            reached = int((family.largest(k) >= family.data[place]).sum())
            p = (1.0 + reached) / (1.0 + family.table.shape[1])
            largest = max(largest, p if float(family.data[place]) > 0.0 else 1.0)
            adjusted[family.names[place]] = largest
        return {e: adjusted[e] for e in observed}


@dataclass(frozen=True, eq=False)
class _Family:
    """Statistics of members in units of their sizes [members], those of the data [members] and of draws [members, n].

    A statistic that is not finite is no evidence. usual : the part s0 of the units. order : of the members, the most
    extreme first.
    """

    names: list[str]
    unit: Tensor
    usual: Tensor
    data: Tensor
    table: Tensor

    @classmethod
    def of(cls, observed: Mapping[str, float], drawn: Draws) -> _Family:
        """Of the members that are observed."""
        names = list(observed)
        data = torch.tensor([[observed[name]] for name in names], dtype=torch.float64)
        whole = torch.cat([data, torch.stack([drawn.statistics[name] for name in names])], dim=1)
        whole = torch.where(whole.isfinite(), whole, 0.0)
        size, usual = whole.abs().mean(dim=1), whole.new_tensor([drawn.least.get(name, 0.0) for name in names])
        in_motion = usual > 0.0
        for kind in (k for k in (in_motion, ~in_motion) if k.any()):
            usual[kind] = torch.maximum(usual[kind], size[kind].median())
        unit = (size + usual).clamp_min(1e-300)
        scaled = whole / unit[:, None]
        return cls(names, unit, usual, scaled[:, 0], scaled[:, 1:])

    @cached_property
    def order(self) -> list[int]:
        """Places of the members."""
        return self.data.argsort(descending=True, stable=True).tolist()

    def largest(self, k: int) -> Tensor:
        """Of each draw among the members from the k-th on [n]."""
        return self.table[self.order[k:]].amax(dim=0)
