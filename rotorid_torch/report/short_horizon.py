"""A multirotor's scores in few words: what the model gives at measured states, and how far it predicts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from rotorid_torch.report.records import LISTS, FitRecord, FlightRecord

NAMES = {"pdot": "roll acceleration", "qdot": "pitch acceleration", "rdot": "yaw acceleration"}

BRACKETS = (
    "R² at measured states with one constant per flight taken out, in brackets as measured; mean errors of predictions,"
    " in brackets of holding what was measured"
)


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
    model is judged by; as measured where that is not recorded.
    """

    name: str
    flights: int
    measured: dict[str, float]
    responses: dict[str, float]
    predictions: tuple[Ahead, ...]

    @property
    def worse(self) -> list[str]:
        """Quantities that the model predicts worse than holding them does, after the longest time."""
        last = max((p.seconds for p in self.predictions), default=0.0)
        return [p.quantity for p in self.predictions if p.seconds == last and p.error > p.held]


def short_horizon(fit: FitRecord) -> list[ShortHorizon]:
    """One for each list whose flights have responses; none for a vehicle that a free run tells of."""
    horizons = []
    for name in LISTS:
        flights = [f for f in fit.flights.values() if f.list == name and f.responses]
        if flights:
            measured, responses = (_pooled(flights, about) for about in (False, True))
            horizons.append(ShortHorizon(name, len(flights), measured, responses, tuple(_means(flights))))
    return horizons


def explained(horizon: ShortHorizon) -> str:
    """What the model explains and predicts on a list of flights, as a sentence; first where holding is better."""
    unseen = "" if horizon.name == "identify" else ", which it has not seen"
    where = f"On the {horizon.name} flights{unseen}, the model"
    parts = [
        f"{name} {_text(r2)} ({_text(measured)})"
        for (name, r2), measured in zip(
            _named(horizon.responses).items(), _named(horizon.measured).values(), strict=True
        )
    ]
    how = "R² at measured states, one constant per flight taken out; in brackets as measured"
    said = f"explains {', '.join(parts)} ({how})"
    ahead = [
        f"{p.quantity} {p.error:.3g} {p.unit} ({p.held:.3g} if held)"
        for p in horizon.predictions
        if p.seconds == horizon.predictions[-1].seconds
    ]
    errors = f"; errors after {horizon.predictions[-1].seconds:g} s: {', '.join(ahead)}" if ahead else ""
    if horizon.worse:
        first = f"predicts {' and '.join(horizon.worse)} worse than holding what was measured"
        return f"{where} {first}; it {said}{errors}."
    return f"{where} {said}{errors}."


def _named(responses: dict[str, float]) -> dict[str, float]:
    """R2 of the responses in plain words; the rotors' speeds together."""
    values = {NAMES.get(name, name): r2 for name, r2 in responses.items() if not name.startswith("omega")}
    speeds = [r2 for name, r2 in responses.items() if name.startswith("omega")]
    return values | ({"rotor speeds": sum(speeds) / len(speeds)} if speeds else {})


def _text(r2: float) -> str:
    return f"{r2:z.2f}"


def _pooled(flights: list[FlightRecord], about: bool) -> dict[str, float]:
    """R2 over all flights: their errors over their deviations, so that an axis left alone counts for little.

    about : with each flight's constant taken out.
    """
    names = dict.fromkeys(name for flight in flights for name in flight.responses)
    pooled = {}
    for name in names:
        error, spread = 0.0, 0.0
        for r in (flight.responses[name] for flight in flights if name in flight.responses):
            if r.rmse is not None and r.r2 is not None and r.r2 < 1.0:
                deviation = r.rmse**2 / (1.0 - r.r2)
                without = r.r2 if r.r2_without_constant is None or not about else r.r2_without_constant
                error += deviation * (1.0 - without)
                spread += deviation
        pooled[name] = 1.0 - error / spread if spread else math.nan
    return pooled


def _means(flights: list[FlightRecord]) -> Iterator[Ahead]:
    for p in flights[0].predictions:
        both = [
            (q.error, q.held)
            for flight in flights
            for q in flight.predictions
            if (q.quantity, q.seconds) == (p.quantity, p.seconds) and q.error is not None and q.held is not None
        ]
        if both:
            error, held = (sum(values) / len(both) for values in zip(*both, strict=True))
            yield Ahead(p.quantity, p.seconds, p.unit, error, held)
