"""Which control acts on what: accelerations by regression on the controls and the motion, no model but that."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
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
LEAST = 60
"""Samples of a flight that is used."""
SHOWN = 0.4
"""Share of a response that must be explained for its row to count."""
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
    streams, forces = streams_of(flights, controls, motion)
    by_lag = [one for lag in LAGS if (one := products_of(streams, lag))[1]]
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


def streams_of(
    flights: Sequence[Flight], controls: Sequence[str], motion: bool = True
) -> tuple[list[Stream], tuple[str, ...]]:
    """Streams of flights with what all of them record, and the forces among the responses."""
    recorded = [c for c in (*names.VELOCITIES, "phi", "theta") if all(flight.has(c) for flight in flights)]
    forces = ("az",) if all(flight.has("az") for flight in flights) else ()
    states = (*names.RATES, *recorded) if motion else ()
    return [Stream.of(flight, controls, forces, states) for flight in flights], forces


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
class Stream:
    """A flight's smoothed controls, responses and motion (T, n); where controls, and where all else, are known (T,)."""

    controls: Array
    responses: Array
    motion: Array
    asked: Array
    answered: Array

    @classmethod
    def of(cls, flight: Flight, controls: Sequence[str], forces: Sequence[str], states: Sequence[str]) -> Stream:
        """From these channels; responses are the angular accelerations and the forces."""
        moved, _, asked = smoothed(flight, controls)
        _, turning, measured = smoothed(flight, names.RATES)
        others, _, present = smoothed(flight, [*forces, *states])
        count = len(forces)
        responses = np.concatenate([turning, others[:, :count]], axis=1)
        return cls(moved, responses, others[:, count:], asked, measured & present)


def products_of(streams: Sequence[Stream], lag: int) -> tuple[Array, int]:
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
