"""Which control acts on what: accelerations by regression on the controls and the motion, no model but that."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from rotorid_torch.consistency.pairs.alignment import MOVES
from rotorid_torch.consistency.smoothing import EVERY_S, correlated, kernel, smoothed
from rotorid_torch.core import names
from rotorid_torch.core.statistics import paired, regression, without_line
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

LAGS = range(11)
"""Lags of the answer that are tried, in `EVERY_S`: up to four time constants of the slowest propellers, 0.4 s."""
FLIGHTS = 40
"""Flights that are looked at one by one, at most."""
AWAY = 125
"""Time by which the controls of one flight are moved, in `EVERY_S`: 5 s."""
LEAST = 60
"""Samples of a flight that is used."""
SHOWN = 0.4
"""Share of a response that must be explained for its row to count."""
SURE = 4.0
"""Standard errors of the other flights' effects, below which they do not judge a flight's controls."""
CLEARLY = 2.0
"""Standard errors below which an effect counts as that much."""
RESTS = 1e-9
"""Motion of a control over that of the one that moves most, below which it is rounding."""


class Places(NamedTuple):
    """Cosines between what motors do and what is declared: of each response, of each motor, mean of the best pairing.

    order : that pairing.
    """

    along: Array
    by_motor: Array
    best: float
    order: tuple[int, ...]


@dataclass(frozen=True)
class Answers:
    """Effects (responses, controls) of each control on p' q' r' (and az, where recorded), scaled by both sizes.

    errors : their standard errors. explained : share of each response (responses,). sizes : rms (controls,).
    """

    responses: tuple[str, ...]
    effects: Array
    errors: Array
    explained: Array
    sizes: Array

    def shown(self, responses: Sequence[str]) -> list[str]:
        """Those of the responses that are recorded and explained."""
        return [r for r in responses if r in self.responses and self.explained[self.responses.index(r)] > SHOWN]

    def without(self, still: Collection[str]) -> Answers:
        """The same where these responses explain nothing: what stands still answers nothing."""
        return replace(self, explained=np.where([r in still for r in self.responses], 0.0, self.explained))

    def of(self, response: str) -> Array:
        """Effects (controls,) on a response."""
        return self.effects[self.responses.index(response)]

    def weights(self, response: str) -> Array:
        """The same of one unit of each control, in any scale."""
        return self.of(response) / self.sizes

    def pairing(self, responses: Sequence[str], columns: Sequence[int]) -> tuple[float, tuple[int, ...]]:
        """By how much more (natural logarithm) the best pairing of responses and controls explains than that in order.

        Products of effects, of which each row and column has one, no scale of a response or a control changes. Effects
        below their errors count as these. The second are the places, in `columns`, of each response's control.
        """
        rows = [self.responses.index(r) for r in responses]
        floor = np.maximum(CLEARLY * self.errors[rows], np.finfo(float).tiny)
        sizes = np.log(np.maximum(np.abs(self.effects[rows]), floor))[:, list(columns)]
        order = paired(sizes)
        return float(sizes[np.arange(len(rows)), order].sum() - np.diag(sizes).sum()), tuple(order)

    def places(self, declared: Array, responses: Sequence[str]) -> Places:
        """Motors' effects against declared ones (responses, motors), every row of size 1."""
        measured = np.stack([self.weights(r) for r in responses])
        measured, declared = (
            x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300) for x in (measured, declared)
        )
        columns = [x / np.maximum(np.linalg.norm(x, axis=0), 1e-300) for x in (measured, declared)]
        cosines = columns[0].T @ columns[1]
        order = paired(cosines)
        along = (measured * declared).sum(axis=1)
        return Places(along, np.diag(cosines), float(cosines[np.arange(len(order)), order].mean()), tuple(order))


def answers(dataset: Dataset, controls: Sequence[str], motion: bool = True, least: float = 0.0) -> Answers | None:
    """What the controls, and for flapping angles these, do in the identify flights; None where these are too short.

    motion : whether rates, tilt and velocities explain too. least : share of the power of the combination of controls
    that moves most, below which another one counts as none: what is not modelled of the response goes to such ones.
    """
    flights = [dataset.flights[name] for name in dataset.identify if dataset.flights[name].has(*names.RATES, *controls)]
    streams, forces = _streams(flights, controls, motion)
    by_lag = [one for lag in LAGS if (one := _products(streams, lag))[1]]
    if not by_lag:
        return None
    responses = (*names.RATES, *forces)
    count, first = len(controls), len(responses)
    noise = sum(float((kernel(f.dt)[0] ** 2).sum()) for f in flights) / len(flights)
    noise = noise * np.square([dataset.noise(c) for c in controls])
    ways = [_moving(products[first : first + count, first : first + count], n * noise, least) for products, n in by_lag]
    mixed = [_mixed(products, way, first) for (products, _), way in zip(by_lag, ways, strict=True)]
    fits = [regression(products, first) for products in mixed]
    best = min(range(len(fits)), key=lambda lag: float(fits[lag][1][:3].mean()))
    (x, left), (products, samples), way = fits[best], by_lag[best], ways[best]
    size, moving = np.sqrt(np.maximum(np.diag(products), 1e-300)), way.shape[1]
    effects = (way @ x[:moving] * size[first : first + count, None] / size[:first]).T
    covariance = np.linalg.pinv(mixed[best][first:, first:], rcond=1e-10, hermitian=True)[:moving, :moving]
    spread = ((way @ covariance) * way).sum(axis=1) * size[first : first + count] ** 2
    free = max(samples / correlated(EVERY_S) - len(x), 1.0)
    errors = np.sqrt(np.maximum(left, 0.0)[:, None] * np.maximum(spread, 0.0) / free)
    return Answers(responses, effects, errors, 1.0 - left, size[first : first + count])


@dataclass(frozen=True)
class Turned:
    """A control whose sign is another in one flight, by its response; shares of that left as recorded, and turned."""

    flight: str
    control: str
    left: float
    left_turned: float


def turned_in_flights(dataset: Dataset, acts_on: Mapping[str, str]) -> list[Turned]:
    """Controls that single flights have with another sign than the others, by what these say of their responses.

    The effects of the other flights leave less than half of the response where the control is turned, and more than
    twice as much as recorded. The clearest is set right before the next is looked for.
    """
    by = by_flight(dataset)
    if by is None:
        return []
    controls, flights, responses, first = [*dataset.controls], by.flights, by.responses, by.first
    each = [*by.products[by.lag(range(len(flights)))]]
    pairs = [(c, r) for c, r in acts_on.items() if c in controls and r in responses]
    places = [(responses.index(r), first + controls.index(c)) for c, r in pairs]
    turned = list[Turned]()
    for _ in range(len(flights) // 2):
        suspects = [
            (flight, pair, Turned(flights[flight].name, pairs[pair][0], *shares))
            for flight in range(len(flights))
            for pair, shares in enumerate(_left_by_others(each, flight, places, first))
            if shares[1] < 0.5 < shares[0] and shares[1] < 0.5 * shares[0]
        ]
        if not suspects:
            break
        flight, pair, clearest = max(suspects, key=lambda one: one[2].left / max(one[2].left_turned, 1e-9))
        signs = np.where(np.arange(len(each[flight])) == places[pair][1], -1.0, 1.0)
        each[flight] = signs * each[flight] * signs[:, None]
        turned.append(clearest)
    return turned


@dataclass(frozen=True)
class Astray:
    """Controls that by the other flights are not those of a flight: late by so much, so many times as large, or others.

    left, left_so : shares of the responses that the others' effects leave as recorded, and so taken.
    """

    flight: str
    left: float
    left_so: float
    seconds: float = 0.0
    factor: float = 1.0


def astray_in_flights(dataset: Dataset) -> list[Astray]:
    """Flights whose controls do not make their responses as the other flights say, where these say it of each other.

    Flights are left out, each the one without which the others agree best, until the effects of all others leave less
    than half of every one's responses. Of those left out controls are late, or have another unit, where another time or
    factor leaves less than half, and half of what is left as recorded; they are of another flight where what they
    should do, no small part of the response, makes it harder to explain. Nothing is said where errors of the others'
    effects could leave as much: a control that hardly moves in them, or as a controller answers gusts, is not judged.
    Nor are flights with inputs that contradict such effects together: they explain each other.
    """
    by = by_flight(dataset)
    if by is None:
        return []
    right, astray = [*range(len(by.flights))], list[Astray]()
    while max(by.left_of(k, right).share for k in right) > 0.5:
        without = [[k for k in right if k != other] for other in right]
        right = min(without, key=lambda some: by.left(by.lag(some), some))
        if 3 * len(right) < 2 * len(by.flights) or len(right) < 3:
            return []
    out = [k for k in range(len(by.flights)) if k not in right]
    for k in out:
        name, lag, (left, factor, left_scaled) = by.flights[k].name, by.lag(right), by.left_of(k, right)
        if left < max(SURE**2 * by.unknown_of(k, right), by.fed_back(k, right)):
            continue
        at = {away: by.left_of(k, right, lag + away).share for away in range(-AWAY, AWAY + 1)}
        away = min(at, key=lambda one: at[one])
        enough = 0.5 * min(left, 1.0)
        if abs(away) > 1 and at[away] < min(enough, left_scaled):
            astray.append(Astray(name, left, at[away], seconds=-EVERY_S * away))
        elif left_scaled < enough:
            astray.append(Astray(name, left, left_scaled, factor=1.0 / factor))
        elif left > 1.0 + SHOWN and not (len(out) > 1 and by.left_of(k, out).share < 0.5):
            astray.append(Astray(name, left, 1.0))
    return astray


class Left(NamedTuple):
    """Share of responses that effects leave; the factor of a flight's controls that leaves least, and that share."""

    share: float
    factor: float = 1.0
    scaled: float = 1.0


@dataclass(frozen=True)
class ByFlight:
    """Flights with their streams, and products of each by the lag of the answer."""

    flights: Sequence[Flight]
    streams: Sequence[_Stream]
    responses: tuple[str, ...]
    products: Mapping[int, Sequence[Array]]
    samples: Sequence[int]

    @property
    def first(self) -> int:
        """Column of the first control."""
        return len(self.responses)

    def left(self, lag: int, some: Collection[int]) -> float:
        """Mean share of the angular accelerations of these flights together that is left."""
        return float(regression(np.sum([self.products[lag][k] for k in some], axis=0), self.first)[1][:3].mean())

    def lag(self, some: Collection[int]) -> int:
        """Lag at which least is left."""
        return min(self.products, key=lambda lag: self.left(lag, some))

    def left_of(self, flight: int, right: Collection[int], lag: int | None = None) -> Left:
        """What the effects of right flights leave of all responses of a flight, its controls at a lag.

        Each response counts by its size in those flights; one that these do not explain does not. All is left where the
        flight is too short, or these explain nothing.
        """
        usual, first = self.lag(right), self.first
        others = np.sum([self.products[usual][k] for k in right if k != flight], axis=0)
        effects, left = regression(others, first)
        shown = left < 1.0 - SHOWN
        products, _ = _products([self.streams[flight]], usual if lag is None else lag)
        if not len(products) or not shown.any():
            return Left(1.0)
        weights = np.concatenate([np.eye(first), -effects])[:, shown]
        weights = weights / np.sqrt(np.maximum(np.diag(others)[:first][shown], 1e-300))
        asked = np.zeros_like(weights)
        last = first + self.streams[flight].controls.shape[1]
        asked[first:last] = weights[first:last]
        whole = max(float((weights[:first] ** 2).sum(axis=1) @ np.diag(products)[:first]), 1e-300)
        by_all, both, power = (
            float((a * (products @ b)).sum()) for a, b in ((weights, weights), (weights, asked), (asked, asked))
        )
        more = -both / max(power, 1e-300)
        return Left(by_all / whole, 1.0 + more, (by_all + more * both) / whole)

    def unknown_of(self, flight: int, right: Collection[int]) -> float:
        """Share of all responses of a flight that errors of the effects in right flights would leave, on average.

        Of each response sigma^2 tr(G^-1 P): G products of the regressors in these flights, P in the flight, sigma^2
        what is left of the response for each independent sample.
        """
        spreads = self._spreads(flight, right)
        free = sum(self.samples[k] for k in right) / correlated(EVERY_S) - len(spreads)
        return float(spreads.sum()) / max(free, 1.0)

    def fed_back(self, flight: int, right: Collection[int]) -> float:
        """The same where a controller answers what is left, as in gusts: all of that goes with one combination."""
        return float(self._spreads(flight, right).max())

    def _spreads(self, flight: int, right: Collection[int]) -> Array:
        """Eigenvalues of G^-1 P over the flight's responses, times all that is left of these in the right flights."""
        lag, first = self.lag(right), self.first
        others, products = np.sum([self.products[lag][k] for k in right], axis=0), self.products[lag][flight]
        left = regression(others, first)[1]
        shown, size = left < 1.0 - SHOWN, np.maximum(np.diag(others)[:first], 1e-300)
        inverse = np.linalg.pinv(others[first:, first:], hermitian=True)
        whole = max(float((np.diag(products)[:first] / size)[shown].sum()), 1e-300)
        return np.asarray(np.linalg.eigvals(inverse @ products[first:, first:]).real * left[shown].sum() / whole)


def by_flight(dataset: Dataset) -> ByFlight | None:
    """The flights one by one; None where there are fewer than three."""
    flights = [flight for flight in islice(dataset, FLIGHTS) if flight.has(*names.RATES, *dataset.controls)]
    streams, forces = _streams(flights, dataset.controls)
    by_lag = {lag: [_products([one], lag) for one in streams] for lag in LAGS}
    whole = {lag: [one for one, _ in some] for lag, some in by_lag.items() if all(samples for _, samples in some)}
    if not whole or len(flights) < 3:
        return None
    samples = [count for _, count in by_lag[min(whole)]]
    return ByFlight(flights, streams, (*names.RATES, *forces), whole, samples)


def _left_by_others(
    each: Sequence[Array], flight: int, places: Sequence[tuple[int, int]], first: int
) -> Iterator[tuple[float, float]]:
    """Shares of a flight's responses that the other flights' effects leave: as recorded, and with a control turned.

    each : products (n, n) by flight. places : row of each response and column of its control; `first` that of the first
    control. A response that the others do not explain leaves all.
    """
    one = each[flight]
    effects, left = regression(sum(each) - one, first)
    for row, column in places:
        sums = np.zeros(len(one))
        sums[row], sums[first:] = 1.0, -effects[:, row]
        other = np.where(np.arange(len(one)) == column, -sums, sums)
        shares = [float(v @ one @ v) / max(one[row, row], 1e-300) for v in (sums, other)]
        yield (shares[0], shares[1]) if left[row] < 1.0 - SHOWN else (1.0, 1.0)


def _streams(
    flights: Sequence[Flight], controls: Sequence[str], motion: bool = True
) -> tuple[list[_Stream], tuple[str, ...]]:
    """Streams of flights with what all of them record, and the forces among the responses."""
    recorded = [c for c in (*names.VELOCITIES, "phi", "theta") if all(flight.has(c) for flight in flights)]
    forces = ("az",) if all(flight.has("az") for flight in flights) else ()
    states = (*names.RATES, *recorded) if motion else ()
    return [_Stream.of(flight, controls, forces, states) for flight in flights], forces


def _moving(products: Array, noise: Array, least: float) -> Array:
    """Combinations (controls, n) of controls that do more than noise of these sums of squares, from their products.

    `least` : share of the power of the first of them that one has.

    A mixer drives six motors by four combinations: what a motor does beside these is not known, and left at nothing.
    """
    floor = np.sqrt(np.maximum(noise, RESTS**2 * max(np.diag(products).max(), np.finfo(float).tiny)))
    power, ways = np.linalg.eigh(products / np.outer(floor, floor))
    return ways[:, power > max(MOVES, least * float(power.max()))] / floor[:, None]


def _mixed(products: Array, ways: Array, first: int) -> Array:
    """Products with these combinations in the place of the controls, which begin at column `first`."""
    from scipy.linalg import block_diag  # slow to import

    whole = block_diag(np.eye(first), ways, np.eye(len(products) - first - len(ways)))
    return whole.T @ products @ whole


@dataclass(frozen=True)
class _Stream:
    """A flight's smoothed controls, responses and motion (T, n); where controls, and where all else, are known (T,)."""

    controls: Array
    responses: Array
    motion: Array
    asked: Array
    answered: Array

    @classmethod
    def of(cls, flight: Flight, controls: Sequence[str], forces: Sequence[str], states: Sequence[str]) -> _Stream:
        """From these channels; responses are the angular accelerations and the forces."""
        moved, _, asked = smoothed(flight, controls)
        _, turning, measured = smoothed(flight, names.RATES)
        others, _, present = smoothed(flight, [*forces, *states])
        count = len(forces)
        responses = np.concatenate([turning, others[:, :count]], axis=1)
        return cls(moved, responses, others[:, count:], asked, measured & present)


def _products(streams: Sequence[_Stream], lag: int) -> tuple[Array, int]:
    """Products of responses, controls and motion (n, n) over flights, the controls so many samples earlier."""
    total, samples = np.zeros((0, 0)), 0
    for one in streams:
        count = len(one.controls) - abs(lag)
        if count < LEAST:
            continue
        later, earlier = (slice(start, start + count) for start in (max(lag, 0), max(-lag, 0)))
        rows = np.concatenate([one.responses[later], one.controls[earlier], one.motion[later]], axis=1)
        whole = one.asked[earlier] & one.answered[later] & np.isfinite(rows).all(axis=1)
        if whole.sum() < LEAST:
            continue
        rows = without_line(rows[whole])
        total = total + rows.T @ rows if samples else rows.T @ rows
        samples += len(rows)
    return total, samples
