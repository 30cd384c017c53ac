"""Least squares of a multirotor's accelerations at measured states, all parameters at once.

Nothing is integrated, so that no error grows. In every flight each response has a small constant and trend of its own:
the attitude's tilt, the accelerometers' bias, battery, mass and the motors' warmth differ from flight to flight or
drift, and are no size of any effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Linear, Options, Region, minimise
from rotorid_torch.core.least_squares import bounded_least_squares, least_squares
from rotorid_torch.core.names import RATES, SPECIFIC_FORCES
from rotorid_torch.effects.signal_operations import but_gaps, half_of
from rotorid_torch.identification.rotor_equations import SMOOTHED_S, RotorEquations, Seen
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model

SPREAD = 0.03
"""Standard deviation of a flight's constant, and of the rms of its trend, over gravity or the usual rotor speed."""
BLOCK_S = 2.0
"""Residuals of one such block may resemble each other; those of two do not."""
WEIGHED = 3
"""Times that the responses are weighed by what is left of them, at least."""
SEARCHES = (*[Options(max_iterations=2)] * 2, *[Options(max_iterations=10, absolute=0.01)] * 6)
"""One for each time, at most: a response that was explained badly weighs little at first, and holds others back."""
SETTLED = 1e-3
"""Fall of a response's rms on average, over itself, below which the weights stay as they are."""


@dataclass(frozen=True, eq=False)
class MeasuredFit:
    """What least squares at measured states come to.

    theta : [P]. errors : standard errors by full name, for residuals that resemble their neighbours; infinite on a
    bound and in a direction that no response shows. lines : of each flight, in order, measured less modelled by
    response: level, and slope per s about the flight's middle. without : theta [P] of all flights but one, for each, by
    one step from theta. explained : R2 of each response on all flights, constants taken out.
    """

    theta: Tensor
    errors: Mapping[str, float]
    lines: tuple[Mapping[str, tuple[float, float]], ...]
    without: tuple[Tensor, ...]
    explained: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class _Place:
    """A place of the search: theta of the free parameters [n] and the cost there."""

    theta: Tensor
    cost: float


@dataclass(frozen=True, eq=False)
class MeasuredStates:
    """Responses of flights at measured states, and their model.

    equations : on means over `SMOOTHED_S`. measured : responses of each flight behind the same means, rates
    differentiated; those that a flight has measured, missing where a gap reaches into a mean.
    """

    equations: RotorEquations
    measured: Sequence[Mapping[str, Tensor]]

    @classmethod
    def of(cls, model: Model, flights: Sequence[Seen]) -> MeasuredStates:
        """Of whole records."""
        means = [flight.condense(*_condensed(flight)) for flight in flights]
        equations = RotorEquations(model, tuple(means))
        outputs = model.body.outputs
        rows = [o for group in equations.groups for o in group if o in ANGULAR_ACCELERATIONS or o in outputs]
        measured = ({row: _response(row, outputs, flight) for row in rows} for flight in means)
        return cls(equations, [{row: r for row, r in one.items() if not r.isnan().all()} for one in measured])

    @cached_property
    def _rows(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(row for one in self.measured for row in one))

    def _together(self, flights: Sequence[Mapping[str, Tensor]]) -> dict[str, Tensor]:
        """Records of all flights that have a response, about their means, one behind the other; gaps left out."""
        parts = {row: [centred(one[row]) for one in flights if row in one] for row in self._rows}
        return {row: whole[~whole.isnan()] for row, whole in zip(parts, map(torch.cat, parts.values()), strict=True)}

    def fitted(self, theta: Tensor, names: Sequence[str]) -> MeasuredFit:
        """Theta with these parameters by least squares from there on.

        Each response counts by what is left of it, so that what the model does not explain weighs little.
        """
        if not names:
            without = (theta,) * len(self.measured)
            return MeasuredFit(theta, {}, self._lines(theta), without, self._explained(theta))
        parameter_set = self.equations.model.parameter_set
        places = [parameter_set.index(name) for name in names]
        bounds = [parameter_set.parameters[i].bounds for i in places]
        region = Region(*torch.tensor(bounds, dtype=torch.float64).T)
        prior = parameter_set.values[places], parameter_set.prior_sd[places]

        def whole(part: Tensor) -> Tensor:
            moved = theta.clone()
            moved[places] = part
            return moved

        best, determined, before = theta[places], torch.ones(len(names), dtype=torch.bool), math.inf
        for k, options in enumerate(SEARCHES):
            sigma = self._sigma(whole(best))
            now = sum(map(math.log, sigma.values())) / max(len(sigma), 1)
            if k >= WEIGHED and before - now < SETTLED:
                break
            before = now

            def evaluate(part: Tensor, base: _Place | None, share: float, sigma: Mapping[str, float] = sigma) -> _Place:
                records = ((torch.stack([*one.values()]), tuple(one)) for one in self.remainders(whole(part)))
                left = sum(float(self.weighed(r, rows, sigma, ~r.isnan()).square().sum()) for r, rows in records)
                return _Place(part, 0.5 * (left + float(((part - prior[0]) / prior[1]).square().sum())))

            def linearise(place: _Place, sigma: Mapping[str, float] = sigma) -> Linear:
                return self._linear(whole(place.theta), names, sigma, prior)

            minimum = minimise(evaluate, linearise, best, region, options)
            best, determined = minimum.point.theta, minimum.determined
        theta, estimated = whole(best), list(compress(names, determined.tolist()))
        errors = dict.fromkeys(names, math.inf) | self._errors(theta, estimated, prior[1][determined])
        without = self._without(theta, names, prior, region)
        return MeasuredFit(theta, errors, self._lines(theta), without, self._explained(theta))

    def misfit(self, theta: Tensor, names: Sequence[str]) -> Callable[[Tensor], float]:
        """Minus log-likelihood, at thetas near one, with these parameters after a step of least squares from there.

        Each response counts by what is left of it there: weighed by what is left elsewhere, one that two effects
        explain alike would hold the search at the values that suit it alone.
        """
        parameter_set, sigma = self.equations.model.parameter_set, self._sigma(theta)
        places = [parameter_set.index(name) for name in names]
        prior = parameter_set.values[places], parameter_set.prior_sd[places]

        def at(other: Tensor) -> float:
            flights, triangles = self._columns(other, names, sigma), dict[str, tuple[Tensor, int]]()
            for row in self._rows:
                parts = [torch.cat([one[row][0], one[row][1][:, None]], dim=1) for one in flights if row in one]
                triangles[row] = torch.linalg.qr(torch.cat(parts), mode="r").R, sum(map(len, parts))
            scales, expected = dict.fromkeys(triangles, 1.0), prior_rows(other[places], *prior)
            for _ in range(WEIGHED):
                every = torch.cat([expected, *(R / scales[row] for row, (R, _) in triangles.items())])
                step = least_squares(every[:, :-1], every[:, -1:])[:, 0]
                left = {row: float((R[:, -1] - R[:, :-1] @ step).norm()) for row, (R, _) in triangles.items()}
                scales = {row: max(left[row] / math.sqrt(count), 1e-300) for row, (_, count) in triangles.items()}
            return sum(count * math.log(scales[row]) for row, (_, count) in triangles.items())

        return at

    def remainders(self, theta: Tensor) -> list[dict[str, Tensor]]:
        """Measured less modelled, of each flight by row."""
        return [
            {row: record - modelled[row] for row, record in measured.items()}
            for measured, modelled in zip(self.measured, self.equations.at(theta), strict=True)
        ]

    @cached_property
    def spreads(self) -> dict[str, float]:
        """Standard deviation of a flight's constant in each response."""
        rows = {row: torch.cat([one[row] for one in self.measured if row in one]) for row in self._rows}
        sizes = {row: record.square().nanmean().sqrt() for row, record in rows.items()}
        gravity = self.equations.model.body.gravity
        return {row: SPREAD * (gravity if row in SPECIFIC_FORCES else float(size)) for row, size in sizes.items()}

    def weighed(self, values: Tensor, rows: Sequence[str], sigma: Mapping[str, float], present: Tensor) -> Tensor:
        """Rows [..., R, T] of a flight in units of what is left: about a straight line, and its level and slope.

        The latter [..., R, 2], behind T others, count as constant and trend of a flight are expected: squares add up to
        what they are if these are taken out. present : samples [R, T] that were measured; others are zero.
        """
        lines, count = shapes(present), present.sum(-1, keepdim=True)
        values = torch.where(present, values, 0.0)
        parts = torch.einsum("...rt,rlt->...rl", values, lines) / count
        left = values.new_tensor([sigma[row] for row in rows])[:, None]
        spread = values.new_tensor([self.spreads[row] for row in rows])[:, None]
        spread = (spread.square() + left.square() / count).sqrt()
        about = values - torch.einsum("...rl,rlt->...rt", parts, lines)
        return torch.cat([about / left, parts / spread], dim=-1)

    def _lines(self, theta: Tensor) -> tuple[Mapping[str, tuple[float, float]], ...]:
        flights = zip(self.remainders(theta), self.equations.flights, strict=True)
        return tuple({row: _line(r, flight.step) for row, r in one.items()} for one, flight in flights)

    def _explained(self, theta: Tensor) -> dict[str, float]:
        """R2 of each response, the constants of flights taken out."""
        left = self._sigma(theta)
        moved = {row: float(record.square().mean()) for row, record in self._together(self.measured).items()}
        return {row: 1.0 - left[row] ** 2 / max(moved[row], 1e-300) for row in self._rows}

    def _sigma(self, theta: Tensor) -> dict[str, float]:
        """Rms of what is left of each response."""
        left = self._together(self.remainders(theta))
        return {row: max(math.sqrt(float(record.square().mean())), 1e-300) for row, record in left.items()}

    def _columns(
        self, theta: Tensor, names: Sequence[str], sigma: Mapping[str, float]
    ) -> list[dict[str, tuple[Tensor, Tensor]]]:
        """Of each flight and response, columns [T' + 2, n] and residual [T' + 2], weighed."""
        flights = []
        for measured, one in zip(self.measured, self.equations.linear(theta, names), strict=True):
            values, slopes = one.of(measured)
            left = torch.stack([*measured.values()]) - values
            columns = torch.cat([slopes, left[None]])
            weighed = self.weighed(columns, tuple(measured), sigma, ~left.isnan()).unbind(1)
            flights.append({row: (w[:-1].mT, w[-1]) for row, w in zip(measured, weighed, strict=True)})
        return flights

    def _without(
        self, theta: Tensor, names: Sequence[str], prior: tuple[Tensor, Tensor], region: Region
    ) -> tuple[Tensor, ...]:
        """Theta of all flights but one, for each: a step of Gauss and Newton within the bounds from the theta of all.

        Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), ch. 11 (jackknife).
        """
        if len(self.measured) < 2:
            return ()
        places = [self.equations.model.parameter_set.index(name) for name in names]
        columns = self._columns(theta, names, self._sigma(theta))
        parts = [torch.cat([torch.cat([z, y[:, None]], dim=1) for z, y in one.values()]) for one in columns]
        triangles = [torch.linalg.qr(part, mode="r").R for part in parts]
        expected = prior_rows(theta[places], *prior)
        lower, upper = region.lower - theta[places], region.upper - theta[places]
        thetas = []
        for k in range(len(triangles)):
            others = torch.cat([expected, *(one for i, one in enumerate(triangles) if i != k)])
            columns, left = others[:, :-1], others[:, -1]
            moved = theta.clone()
            moved[places] += bounded_least_squares(columns.mT @ columns, columns.mT @ left, lower, upper)
            thetas.append(moved)
        return tuple(thetas)

    def _linear(
        self, theta: Tensor, names: Sequence[str], sigma: Mapping[str, float], prior: tuple[Tensor, Tensor]
    ) -> Linear:
        """Triangle of the weighed columns, with the prior's rows."""
        places = [self.equations.model.parameter_set.index(name) for name in names]
        stacked = [prior_rows(theta[places], *prior)]
        for one in self._columns(theta, names, sigma):
            stacked += [torch.cat([z, y[:, None]], dim=1) for z, y in one.values()]
        triangle = torch.linalg.qr(torch.cat(stacked), mode="r").R
        return Linear(triangle[:, :-1], triangle[:, -1])

    def _errors(self, theta: Tensor, names: Sequence[str], sd: Tensor) -> dict[str, float]:
        """Standard errors that hold for residuals which resemble each other within a block, or within a flight.

        With B the normal equations, P the prior's part of them and s_k the score of cluster k of K about the mean,
        C = B^-1 (P + K/(K - 1) sum_k s_k s_k') B^-1; clusters are blocks, or whole flights, whichever says more.

        Source: Liang and Zeger (1986), Biometrika 73; Cameron and Miller (2015), Journal of Human Resources 50.
        """
        sigma = self._sigma(theta)
        prior = (1.0 / sd).nan_to_num(0.0).square().diag()
        bread, blocks, whole = prior, list[Tensor](), list[Tensor]()
        for one, flight in zip(self._columns(theta, names, sigma), self.equations.flights, strict=True):
            length = max(1, round(BLOCK_S / flight.step))
            bread = bread + sum(z.mT @ z for z, _ in one.values())
            each = torch.stack([z * y[:, None] for z, y in one.values()]).sum(0)
            blocks.extend(part.sum(0) for part in each.split(length))
            whole.append(each.sum(0))
        scale = bread.diagonal().sqrt().clamp(min=1e-300)
        inverse = torch.linalg.pinv(bread / scale / scale[:, None], hermitian=True) / scale / scale[:, None]

        def variances(clusters: list[Tensor]) -> Tensor:
            score = torch.stack(clusters)
            score = score - score.mean(dim=0)  # the mean is a gradient that the prior or a bound holds, no scatter
            few = len(score) / max(len(score) - 1, 1)
            return (inverse @ (few * score.mT @ score + prior) @ inverse).diagonal()

        variance = torch.maximum(variances(blocks), variances(whole)).clamp(min=0.0)
        return dict(zip(names, variance.sqrt().tolist(), strict=True))


def _condensed(flight: Seen) -> tuple[int, int]:
    half = half_of(SMOOTHED_S, flight.dt)
    return half, max(1, 2 * half)


def _response(row: str, outputs: Sequence[str], flight: Seen) -> Tensor:
    """What was measured, where the flight's means lie."""
    channel = RATES[ANGULAR_ACCELERATIONS.index(row)] if row in ANGULAR_ACCELERATIONS else row
    record = flight.outputs[:, outputs.index(channel)]
    if row in ANGULAR_ACCELERATIONS:
        record = torch.gradient(record, spacing=flight.dt)[0]
    return but_gaps(flight.means, record[:, None])[:, 0]


def shapes(present: Tensor) -> Tensor:
    """One, and a straight line about zero of rms 1 [..., 2, T], over the samples [..., T] that are present."""
    one = present.double()
    count = one.sum(-1, keepdim=True).clamp(min=1.0)
    line = torch.linspace(-1.0, 1.0, one.shape[-1], dtype=one.dtype) * one
    line = line - one * line.sum(-1, keepdim=True) / count
    rms = (line.square().sum(-1, keepdim=True) / count).sqrt()
    return torch.stack([one, line / rms.clamp(min=1e-300)], dim=-2)


def _line(record: Tensor, step: float) -> tuple[float, float]:
    """Level about the middle of a record [T] with samples every `step` s, and slope per s, by least squares."""
    time = step * (torch.arange(len(record), dtype=record.dtype) - 0.5 * (len(record) - 1))
    present = ~record.isnan()
    columns = torch.stack([torch.ones_like(time), time], dim=-1)[present]
    level, slope = least_squares(columns, record[present, None])[:, 0].tolist()
    return level, slope


def prior_rows(theta: Tensor, values: Tensor, sd: Tensor) -> Tensor:
    """Rows of what is known of parameters beforehand, and what is left of them [P, P + 1]."""
    weight = (1.0 / sd).nan_to_num(0.0)
    return torch.cat([weight.diag(), (weight * (values - theta))[:, None]], dim=1)


def centred(values: Tensor) -> Tensor:
    """Values [..., T] less the mean of those that are not missing."""
    return values - values.nanmean(dim=-1, keepdim=True)
