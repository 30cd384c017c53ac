"""A multirotor's scores over a list of flights: responses at measured states, and predictions over parts of a second.

A flight counts for what it moves, and a model for what it describes at all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rotorid_torch.model.model import ANGULAR_ACCELERATIONS
from rotorid_torch.validate.judged import Judgement, Response

TURNING = ("rates", "attitude")
"""Quantities that only flights tell which turn the vehicle."""


@dataclass(frozen=True)
class Ahead:
    """Mean error of a quantity after so many seconds, of the model and of holding it, over the flights of a list."""

    quantity: str
    seconds: float
    unit: str
    error: float
    held: float


@dataclass(frozen=True)
class ShortHorizon:
    """One list of flights: R2 of each response, all its flights together, and predictions.

    measured : R2 as measured. responses : with one constant of each flight and response taken out, which is what the
    model is judged by; as measured where that is not recorded. still : responses that no flight of the list moves.
    silent : responses that nothing of the model moves.
    """

    name: str
    flights: int
    measured: Mapping[str, float]
    responses: Mapping[str, float]
    predictions: tuple[Ahead, ...]
    still: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()

    @classmethod
    def of(cls, name: str, flights: Sequence[Judgement]) -> ShortHorizon:
        """Of a list of flights that have responses."""
        each: dict[str, list[Response]] = {}
        for flight in flights:
            for row, response in flight.responses.items():
                each.setdefault(row, []).append(response)
        moved = {row: [r for r in of if r.moved] for row, of in each.items()}
        measured, without = ({row: _pooled(moved[row] or of, on) for row, of in each.items()} for on in (False, True))
        still = tuple(row for row, of in moved.items() if not of)
        silent = tuple(row for row, of in each.items() if not any(r.described for r in moved[row] or of))
        return cls(name, len(flights), measured, without, tuple(_means(flights)), still, silent)

    @property
    def counted(self) -> dict[str, float]:
        """R2 of the responses that flights of the list move and the model describes."""
        left = {*self.still, *self.silent}
        return {row: r2 for row, r2 in self.responses.items() if row not in left and math.isfinite(r2)}

    @property
    def accelerations(self) -> dict[str, float]:
        """Those of the body among these."""
        return {row: r2 for row, r2 in self.counted.items() if not row.startswith("omega")}

    @property
    def worse(self) -> dict[str, float]:
        """Quantities that the model predicts worse than holding them does, and after how many seconds it does first."""
        first: dict[str, float] = {}
        for p in self.predictions:
            if p.error > p.held:
                first[p.quantity] = min(p.seconds, first.get(p.quantity, math.inf))
        return first

    @property
    def soonest(self) -> float:
        """Seconds of the shortest prediction; none: infinite."""
        return min((p.seconds for p in self.predictions), default=math.inf)


def described(horizon: ShortHorizon, after: ShortHorizon) -> float:
    """Mean R2, none below zero, of the accelerations that a model describes `after`; before, others may be silent."""
    shares = [max(horizon.responses.get(row, 0.0), 0.0) for row in after.accelerations]
    return sum(shares) / len(shares) if shares else 0.0


def _pooled(responses: Sequence[Response], about: bool) -> float:
    """R2 over all flights, as if they were one record: their errors over their deviations, each over its length.

    about : with each flight's constant taken out.
    """
    error, spread = 0.0, 0.0
    for r in responses:
        if r.rmse is not None and r.r2 is not None and math.isfinite(r.r2) and r.r2 < 1.0:
            deviation = r.rmse**2 / (1.0 - r.r2)
            without = r.r2 if r.r2_without_constant is None or not about else r.r2_without_constant
            error += r.seconds * deviation * (1.0 - without)
            spread += r.seconds * deviation
    return 1.0 - error / spread if spread else math.nan


def _means(flights: Sequence[Judgement]) -> Iterator[Ahead]:
    turned = [f for f in flights if any(r.moved for row, r in f.responses.items() if row in ANGULAR_ACCELERATIONS)]
    for p in {(p.quantity, p.seconds): p for flight in flights for p in flight.predictions}.values():
        both = [
            (q.error, q.held)
            for flight in (turned or flights if p.quantity in TURNING else flights)
            for q in flight.predictions
            if (q.quantity, q.seconds) == (p.quantity, p.seconds) and q.error is not None and q.held is not None
        ]
        if both:
            error, held = (sum(values) / len(both) for values in zip(*both, strict=True))
            yield Ahead(p.quantity, p.seconds, p.unit, error, held)
