"""A multirotor's scores in few words: what the model gives at measured states, and how far it predicts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from rotorid_torch.report.records import LISTS, FitRecord, FlightRecord

NAMES = {"pdot": "roll acceleration", "qdot": "pitch acceleration", "rdot": "yaw acceleration"}
FREE_RUN = (
    "J and the pictures of free runs mean nothing here: these flights were flown in closed loop, and a multirotor is a"
    " chain of integrators in which a torque error of one percent grows without bound over 8 s; judge the model by what"
    " it explains at measured states and by its predictions over parts of a second"
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
    """One list of flights: R2 of each response, all its flights together, and predictions."""

    name: str
    flights: int
    responses: dict[str, float]
    predictions: tuple[Ahead, ...]


def short_horizon(fit: FitRecord) -> list[ShortHorizon]:
    """One for each list whose flights have responses; none for a vehicle that a free run tells of."""
    horizons = []
    for name in LISTS:
        flights = [f for f in fit.flights.values() if f.list == name and f.responses]
        if flights:
            horizons.append(ShortHorizon(name, len(flights), _pooled(flights), tuple(_means(flights))))
    return horizons


def explained(horizon: ShortHorizon) -> str:
    """What the model explains and predicts on a list of flights, as a sentence."""
    values = {NAMES.get(name, name): r2 for name, r2 in horizon.responses.items() if not name.startswith("omega")}
    speeds = [r2 for name, r2 in horizon.responses.items() if name.startswith("omega")]
    if speeds:
        values["rotor speeds"] = sum(speeds) / len(speeds)
    parts = [f"{name} {round(r2, 2) + 0.0:.2f}" for name, r2 in values.items()]  # no minus before a zero
    unseen = "" if horizon.name == "identify" else ", which it has not seen"
    ahead = [
        f"{p.quantity} {p.error:.3g} {p.unit} ({p.held:.3g} if held)"
        for p in horizon.predictions
        if p.seconds == horizon.predictions[-1].seconds
    ]
    errors = f"; errors after {horizon.predictions[-1].seconds:g} s: {', '.join(ahead)}" if ahead else ""
    return (
        f"On the {horizon.name} flights{unseen}, the model explains (R² at measured states) {', '.join(parts)}{errors}."
    )


def _pooled(flights: list[FlightRecord]) -> dict[str, float]:
    """R2 over all flights: their errors over their deviations, so that an axis left alone counts for little."""
    names = dict.fromkeys(name for flight in flights for name in flight.responses)
    pooled = {}
    for name in names:
        error, spread = 0.0, 0.0
        for r in (flight.responses[name] for flight in flights if name in flight.responses):
            if r.rmse is not None and r.r2 is not None and r.r2 < 1.0:
                error += r.rmse**2
                spread += r.rmse**2 / (1.0 - r.r2)
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
