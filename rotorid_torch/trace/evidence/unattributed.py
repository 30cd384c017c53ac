"""Pseudo-effects: what a model may lack and the library has no name for, by equation and kind.

The residual of an equation is compared with products of the motion and the controls, with curves over one channel, and
with what begins at some time. No model of an aircraft is perfect, so what has no name must be large and must stand out:
with the residual r_f of a flight and the description a x_f, whose size a other flights give, the statistic is

    T = sum_f (|r_f|^2 - |r_f - a x_f|^2) / sqrt(N sum_f |r_f|^2),

the fall of the mean square over the rms of the residual, in the unit of the equation; N samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import DEPENDENT
from rotorid_torch.trace.evidence.residual import TIME, LeftOver, Regressor, by_chance, onsets, shapes
from rotorid_torch.trace.terms.candidate import UNATTRIBUTED


class Shape(Enum):
    """Kinds of descriptions, each with draws of its own: ordinary aircraft leave curves over, hardly ever a step."""

    CURVE = "curve"
    ONSET = "onset"
    STEP = "step"

    @classmethod
    def of(cls, regressor: Regressor) -> Shape:
        """The kind of what is described."""
        if regressor.since_s is None:
            return cls.CURVE
        return cls.STEP if regressor.signal == TIME else cls.ONSET


def member_of(row: str, regressor: Regressor) -> str:
    """The pseudo-effect that is described, by equation and kind, as a member of a family."""
    return f"{UNATTRIBUTED}{row}, {Shape.of(regressor).value}"


@dataclass(frozen=True, eq=False)
class Description:
    """What the residual of an equation goes with.

    evidence : the parts of T by flight [F + V]. log_ratio : sum over flights of log(rms without / rms with it), held
    out, of the equation's residual.
    """

    row: str
    regressor: Regressor
    evidence: Tensor
    log_ratio: float

    @property
    def member(self) -> str:
        """The pseudo-effect."""
        return member_of(self.row, self.regressor)

    @property
    def statistic(self) -> float:
        """T."""
        return float(self.evidence.sum())


@dataclass(frozen=True, eq=False)
class Falls:
    """Held-out falls of the squares of residuals by columns [R, F + V, m], the squares [R, F + V, 1], and samples N."""

    falls: Tensor
    squares: Tensor
    samples: int

    @property
    def statistics(self) -> Tensor:
        """Parts of T by flight [R, F + V, m]."""
        return self.falls / (self.samples * self.squares.sum(1, keepdim=True)).clamp_min(1e-300).sqrt()

    def description(self, row: str, regressor: Regressor, column: int) -> Description:
        """What a column describes of the residual itself."""
        share = self.falls[0, :, column] / self.squares[0, :, 0].clamp_min(1e-300)
        log_ratio = -0.5 * float(torch.log1p(-share.clamp_max(1.0 - 1e-12)).sum())
        return Description(row, regressor, self.statistics[0, :, column], log_ratio)


@dataclass(frozen=True, eq=False)
class Residuals:
    """What a model leaves over of the identify flights, and of those that no fit has seen where there are any."""

    fitted: LeftOver
    unseen: LeftOver | None = None

    @property
    def sides(self) -> list[LeftOver]:
        """Both, or the identify flights alone."""
        return [side for side in (self.fitted, self.unseen) if side is not None]

    def descriptions(self) -> dict[str, Description]:
        """The best description of each equation and kind, by `Description.member`.

        A step counts beyond a straight line in time, which motion that dies away leaves over too, and beyond the change
        of level that motors and batteries bring by getting warm and empty.
        """
        descriptions = {}
        for row, names, falls, drift in self._by_kind():
            best = int(falls.statistics[0].sum(0).argmax())
            one = falls.description(row, names[best], best)
            evidence = one.evidence - drift[0] / len(one.evidence)
            ordinary = float(evidence.sum()) < self._least
            descriptions[one.member] = replace(one, evidence=torch.zeros_like(evidence) if ordinary else evidence)
        return descriptions

    @property
    def _least(self) -> float:
        """The least T: zero where levels change, for what changes no more than usual is no evidence of less."""
        return -math.inf if self.fitted.levels is None else 0.0

    def by_chance(self, count: int, seed: int) -> dict[str, Tensor]:
        """Statistics [R] of the best descriptions of so many residuals that know nothing of the motion."""
        turned = [by_chance(side, count, seed) for side in self.sides]
        return {
            member_of(row, names[0]): (falls.statistics.sum(1).amax(1) - drift).clamp_min(self._least)
            for row, names, falls, drift in self._by_kind(turned)
        }

    def _by_kind(self, turned: Sequence[Tensor] | None = None) -> Iterator[tuple[str, list[Regressor], Falls, Tensor]]:
        """Names and falls of all descriptions of each equation and kind, and what a step must exceed [R]."""
        names, columns = self.columns()
        for row in self.fitted.rows:
            whole, drift = self._falls(row, columns, turned), self._drift(row, turned)
            for shape in Shape:
                places = [i for i, regressor in enumerate(names) if Shape.of(regressor) is shape]
                if places:
                    least = drift if shape is Shape.STEP else torch.zeros_like(drift)
                    yield row, [names[i] for i in places], replace(whole, falls=whole.falls[..., places]), least

    def of(self, row: str, regressor: Regressor) -> Description:
        """A description of another equation."""
        return self._falls(row, self.columns([regressor])[1]).description(row, regressor, 0)

    def less_beginning(self, onset: float, signals: bool) -> Residuals:
        """The same with steps at an onset among the linear terms, and signals that begin there."""
        return Residuals(*(side.less_beginning(onset, signals) for side in self.sides))

    def columns(self, wanted: Sequence[Regressor] | None = None) -> tuple[list[Regressor], list[Tensor]]:
        """Names of descriptions, and their columns [N, m] on both sides; zero where a flight ends before one begins."""
        usual, step = self.fitted.usual, self.fitted.onset_s
        columns = dict([*shapes(self.fitted, usual), *onsets(self.fitted, step)])
        names = list(columns) if wanted is None else list(wanted)
        sides = [torch.stack([columns[name] for name in names], dim=-1)]
        for side in self.sides[1:]:
            others, none = dict([*shapes(side, usual), *onsets(side, step)]), torch.zeros_like(side.time)
            sides.append(torch.stack([others.get(name, none) for name in names], dim=-1))
        return names, sides

    def _drift(self, row: str, turned: Sequence[Tensor] | None = None) -> Tensor:
        """T of a straight line in time, or of a level that changes as much as usual, whichever is more [R]."""
        line, levels = self._falls(row, [side.time[:, None] for side in self.sides], turned), self.fitted.levels
        level = 0.0 if levels is None else float(levels[self.fitted.rows.index(row)])
        rms = (line.squares.sum((1, 2)) / line.samples).sqrt()
        return torch.maximum(line.statistics.sum((1, 2)), level**2 / rms.clamp_min(1e-300)).clamp_min(0.0)

    def _falls(self, row: str, columns: Sequence[Tensor], turned: Sequence[Tensor] | None = None) -> Falls:
        """Falls of squares by columns [N, m] on both sides; of the residual itself where none are turned."""
        products, samples = [], 0
        for k, side in enumerate(self.sides):
            if row not in side.rows:
                continue
            place = side.rows.index(row)
            residuals = side.residual[:, place, None] if turned is None else turned[k][:, place]
            x, y = side.beyond(columns[k], place), side.beyond(residuals, place)
            lengths = side.flight.unique(return_counts=True)[1].tolist()
            parts = [*zip(x.split(lengths), y.split(lengths), strict=True)]
            xx, yy = (torch.stack([one.square().sum(0) for one in sides]) for sides in zip(*parts, strict=True))
            xy = torch.stack([b.mT @ a for a, b in parts], dim=1)  # [R, F, m]
            products.append((xx, xy, yy.mT[..., None]))
            samples += len(side.time)
        (xx, xy, yy), *others = products
        whole = xx.sum(0)
        least = DEPENDENT * whole + 1e-300
        size = (xy.sum(1, keepdim=True) - xy) / torch.maximum(whole - xx, least)
        falls = [2.0 * size * xy - size.square() * xx]
        size = xy.sum(1, keepdim=True) / torch.maximum(whole, least)
        falls += [2.0 * size * oxy - size.square() * oxx for oxx, oxy, _ in others]
        squares = torch.cat([yy, *(oyy for _, _, oyy in others)], dim=1)
        return Falls(torch.cat(falls, dim=1), squares, samples)
