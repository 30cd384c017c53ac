"""Flights of a small known model with something hidden, and the loop on them; made once, and left as they are."""

from __future__ import annotations

from functools import cache

from rotorid_torch.data import Dataset
from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.critical_values import Null
from rotorid_torch.trace.evidence.fits import Fitted, Flights, refit
from rotorid_torch.trace.loop import Tracing, trace
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DT = 0.02
SUSPECTS = ("control.delay", "control.lag", "forces.quadratic_damping")


@cache
def flights(*effects: str, seed: int = 3, noise: float = 0.02, **values: float) -> Dataset:
    """Values of the effects' parameters by their full names, dots written as two underscores."""
    names = {f"{e.replace('__', '.')}": v for e, v in values.items()}
    truth = with_values(rate_vehicle(effects=effects), names)
    moves = manoeuvres(8.0, DT)
    both = {**moves, **{f"{name}_again": -0.8 * move for name, move in moves.items()}}
    lists = {"identify": list(moves), "validate": [f"{name}_again" for name in moves]}
    return flown(truth, both, DT, noise=noise, seed=seed, lists=lists)


@cache
def started(data: Dataset) -> tuple[Flights, Fitted]:
    found = reconstruct(data)
    spec = propose(data, found)
    model = build(spec)
    start = regress_model(model, data, found)
    known = Flights(data, found)
    values = dict(zip(model.parameter_set.names, start.theta.tolist(), strict=True))
    return known, refit(spec, known, values, start.held)


def traced(data: Dataset) -> Tracing:
    known, null = started(data)
    return trace(Null(null.spec, null.values), known, lambda null, effects, observed: "none drawn")
