"""Controls that in one flight do not act as in the others: late, of another unit, sign, order or flight."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from typing import NamedTuple

import numpy as np

from rotorid_torch.consistency.outliers import SURE, large_shares, outliers
from rotorid_torch.consistency.records.answers import LAGS, SHOWN, Stream, products_of, streams_of
from rotorid_torch.consistency.smoothing import EVERY_S, correlated
from rotorid_torch.core import names
from rotorid_torch.core.statistics import paired, regression
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

BOTH_WAYS = range(-LAGS[-1], LAGS[-1] + 1)
"""Lags of the answer that are tried, in `EVERY_S`: controls may be late in all flights."""
MUCH = float(np.sqrt(2.0))
"""Factor from which on controls are nearer to twice, or half, of what they are in the other flights."""
ROUNDS = 3
"""Weights of the responses are found in so many rounds."""
UNKNOWN = 1e3
"""Factor, share, or error of them, that tells nothing."""
FLIGHTS = 40
"""Flights that are looked at one by one, at most."""
AWAY = 125
"""Time by which the controls of one flight are moved, in `EVERY_S`: 5 s."""


class Astray(NamedTuple):
    """Controls of a flight that do not act as in the others, and what explains them best.

    left, left_so : shares of the responses that the others' effects leave as recorded, and so taken. seconds : by which
    they are late. factors : by which they were multiplied. order : those that they act as.
    """

    flight: str
    controls: Sequence[str]
    left: float
    left_so: float
    seconds: float = 0.0
    factors: Sequence[float] = ()
    order: Sequence[str] = ()


@once
def astray_in_flights(dataset: Dataset) -> Sequence[Astray]:
    """Flights in which controls, all of them together or one, do not act as in the others.

    They are in another order, late, or of another unit or sign, where that leaves less than half of what is left as
    recorded, and of the responses: the first that leaves no twice as much as another. Else they are another flight's,
    where the responses follow nothing better than them.
    """
    by, astray = by_flight(dataset), list[Astray]()
    every = [*range(len(by.flights))] if by else []
    while by and (some := dict(_astray(by, every))):
        astray += some.values()
        every = [flight for flight in every if flight not in some]
    return astray


def _astray(by: ByFlight, every: Sequence[int]) -> Iterator[tuple[int, Astray]]:
    """The same among these flights, by their places."""
    odd = {flight: [0] for flight in large_shares(every, partial(by.estimate, 0), by.misfit)}
    for k in range(1, 2 + len(by.controls)):
        for flight in outliers(every, partial(by.estimate, k), 1.0 - 1.0 / MUCH, by.misfit):
            odd.setdefault(flight, []).append(k)
    right = [flight for flight in every if flight not in odd]
    other = {flight: [k for k in places if k in by.other(flight, right)] for flight, places in odd.items()}
    right += [flight for flight, places in other.items() if not places]
    for flight, places in other.items():
        values, causes = by.compared(flight, right)[0], [*by.causes(flight, right)]
        least, left = min(cause.left_so for cause in causes), float(values[0])
        if places and least < 0.5 * min(left, 1.0):
            yield flight, next(cause for cause in causes if cause.left_so < 2.0 * least)
        elif 0 in places and (left > 1.0 or min((values[k] for k in places if k), default=1.0) < 0.5):
            yield flight, Astray(by.flights[flight].name, by.controls, left, left)


class Effects(NamedTuple):
    """Effects (regressors, responses) in flights, of regressors of these products, and which responses they explain.

    variance : of what they leave of each response (responses,).
    """

    values: Array
    variance: Array
    shown: Array
    products: Array


@dataclass(frozen=True, eq=False)
class ByFlight:
    """Flights with their streams, and products of each by the lag of the answer."""

    flights: Sequence[Flight]
    controls: Sequence[str]
    streams: Sequence[Stream]
    responses: int
    lag: int
    products: Sequence[Array]
    samples: Sequence[int]
    results: dict[tuple[int, ...], Array] = field(default_factory=dict)

    def misfit(self, some: Sequence[int]) -> float:
        """Share of the angular accelerations of these flights that no effects in common explain."""
        return float(regression(np.sum([self.products[k] for k in some], axis=0), self.responses)[1][:3].mean())

    def effects(self, flight: int, right: Collection[int]) -> Effects:
        """Those in right flights but for this one."""
        some = [k for k in right if k != flight]
        products = np.sum([self.products[k] for k in some], axis=0)
        values, left = regression(products, self.responses)
        variance = left * np.diag(products)[: self.responses] / sum(self.samples[k] for k in some)
        return Effects(values, variance, left < 1.0 - SHOWN, products)

    def estimate(self, k: int, flight: int, right: Collection[int]) -> tuple[float, float]:
        """One of the values by which a flight is compared, and its error."""
        value, error = self.compared(flight, right)[:, k]
        return float(value), float(error)

    def compared(self, flight: int, right: Collection[int]) -> Array:
        """Values by which a flight is compared with right ones, and their standard errors, (2, 2 + controls).

        The share of its responses that their effects leave, and what errors of these may; by how many times all
        controls act as much as there, and each of them.
        """
        key = (flight, *sorted(right))
        if key not in self.results:
            by = self.effects(flight, right)
            shares = np.array([[self.left(flight, by)], [self._unknown(flight, by)]])
            self.results[key] = np.clip(np.concatenate([shares, self._factors(flight, by)], axis=1), -UNKNOWN, UNKNOWN)
        return self.results[key]

    def other(self, flight: int, right: Collection[int]) -> list[int]:
        """Places of the share, and of the factors that are beyond doubt not one, and nearer to another unit or sign."""
        values, errors = self.compared(flight, right)
        sure = (np.abs(values - 1.0) > SURE * errors) & ~((values > 1.0 / MUCH) & (values < MUCH))
        return [k for k in range(len(values)) if sure[k] or not k]

    def _factors(self, flight: int, by: Effects) -> Array:
        """Factors and their errors (2, 1 + controls), that of all first.

        By least squares of what the motion leaves of the responses on what each control should do, each response
        weighed by the larger variance of what is left of it, there and here. Errors hold those of the effects: with G
        the products of the regressors in those flights and P in this one, P + P G^-1 P stands in the place of P.
        """
        first, count, products = self.responses, len(self.controls), self.products[flight]
        regressors, answered = products[first:, first:], products[first:, :first]
        asked, moved = by.values[:count], answered - regressors[:, count:] @ by.values[count:]

        def weighed(variance: Array) -> tuple[Array, Array]:
            scaled = asked * np.where(by.shown, 1.0 / np.maximum(variance, 1e-300), 0.0)
            normal = scaled @ asked.T * regressors[:count, :count]
            return scaled, normal + 1e-12 * np.diag(np.diag(normal)) + 1e-300 * np.eye(count)

        values, (scaled, normal) = np.ones(count), weighed(by.variance)
        for _ in range(ROUNDS):
            values = np.linalg.solve(normal, (scaled * moved[:count]).sum(axis=1))
            sums = np.concatenate([np.eye(first), -values[:, None] * asked, -by.values[count:]])
            here = np.einsum("ir,ij,jr->r", sums, products, sums) / self.samples[flight]
            scaled, normal = weighed(np.maximum(by.variance, here))
        unknown = regressors @ np.linalg.pinv(by.products[first:, first:], hermitian=True) @ regressors
        spread = scaled @ asked.T * (regressors + unknown)[:count, :count] * correlated(EVERY_S)
        inverse, whole = np.linalg.inv(normal), float(normal.sum())
        errors = np.sqrt(np.diag(inverse @ spread @ inverse))
        of_all = float((normal @ values).sum()) / whole, float(np.sqrt(spread.sum())) / whole
        factors = np.array([[of_all[0], *values], [of_all[1], *errors]])
        still = np.diag(regressors)[:count] <= 0.0  # a control that does not move says no factor
        factors[:, [bool(still.all()), *still]] = [[1.0], [UNKNOWN]]
        return factors

    def _unknown(self, flight: int, by: Effects) -> float:
        """Share of all responses of a flight that errors of the effects would leave, on average.

        Of each response sigma^2 tr(G^-1 P), sigma^2 what is left of it in the others for each independent sample.
        """
        first, products = self.responses, self.products[flight]
        spread = np.trace(np.linalg.pinv(by.products[first:, first:], hermitian=True) @ products[first:, first:])
        size = np.maximum(np.diag(by.products)[:first], 1e-300)
        left, whole = by.variance / size, np.diag(products)[:first] / size
        return float(spread * correlated(EVERY_S) * left[by.shown].sum() / max(float(whole[by.shown].sum()), 1e-300))

    def left(self, flight: int, by: Effects, asked: Array | None = None, later: int = 0) -> float:
        """Share of all responses of a flight that effects in others leave, its controls so much later.

        asked : effects (controls, responses) in the place of those of the controls. Each response counts by its size in
        those flights; one that these do not explain does not.
        """
        first, products = self.responses, self.products[flight]
        if later:
            products, _ = products_of([self.streams[flight]], self.lag + later)
        if not len(products):
            return 1.0
        effects = by.values if asked is None else np.concatenate([asked, by.values[len(asked) :]])
        weights = np.concatenate([np.eye(first), -effects])[:, by.shown]
        weights = weights / np.sqrt(np.maximum(np.diag(by.products)[:first][by.shown], 1e-300))
        whole = float((weights[:first] ** 2).sum(axis=1) @ np.diag(products)[:first])
        return float((weights * (products @ weights)).sum()) / max(whole, 1e-300)

    def causes(self, flight: int, right: Collection[int]) -> Iterator[Astray]:
        """Another order; another time; another factor of all controls, or of some: the simplest first."""
        by, count, values = self.effects(flight, right), len(self.controls), self.compared(flight, right)[0]
        asked, because = by.values[:count], partial(Astray, self.flights[flight].name, left=float(values[0]))
        here = regression(self.products[flight], self.responses)[0]
        unit = [x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300) for x in (here[:count], asked)]
        order = paired(unit[0] @ unit[1].T)
        moved, others = zip(*((c, self.controls[k]) for c, k in zip(self.controls, order, strict=True)), strict=True)
        yield because(moved, left_so=self.left(flight, by, asked[order]), order=others)
        at = {later: self.left(flight, by, later=later) for later in range(-AWAY, AWAY + 1)}
        later = min(at, key=lambda one: at[one])
        if abs(later) > 1:
            yield because(self.controls, left_so=at[later], seconds=-EVERY_S * later)
        some = [k - 2 for k in self.other(flight, right) if k > 1]
        for places, factors in ((range(count), np.full(count, values[1])), (some, values[2:])):
            taken = np.array([factors[k] if k in places else 1.0 for k in range(count)])
            controls, scales = [self.controls[k] for k in places], [float(1.0 / factors[k]) for k in places]
            yield because(controls, left_so=self.left(flight, by, asked * taken[:, None]), factors=scales)


def by_flight(dataset: Dataset) -> ByFlight | None:
    """The flights one by one; None where there are fewer than three."""
    flights = [flight for flight in islice(dataset, FLIGHTS) if flight.has(*names.RATES, *dataset.controls)]
    streams, forces = streams_of(flights, dataset.controls)
    by_lag = {lag: [products_of([one], lag) for one in streams] for lag in BOTH_WAYS}
    count, first = len(flights), len(names.RATES) + len(forces)
    whole = {
        lag: [[*each] for each in zip(*some, strict=True)] for lag, some in by_lag.items() if all(n for _, n in some)
    }
    if not whole or count < 3:
        return None
    every = [
        ByFlight(flights, dataset.controls, streams, first, lag, products, samples)
        for lag, (products, samples) in whole.items()
    ]
    return min(every, key=lambda one: float(np.median([one.misfit([flight]) for flight in range(count)])))
