"""Trims that differ with heading: the wind is found, still air is not called a wind, and the loop names it first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.critical_values import Draws, Null
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.evidence.residual import left_over
from rotorid_torch.trace.evidence.trim_differences import explained_trims
from rotorid_torch.trace.loop import trace
from tests.known_models import BODY, body_spec, flown, linear_vehicle, manoeuvres, with_values

DT = 0.02
HEADINGS = {"north": 0.0, "east": 0.5 * math.pi, "south": math.pi, "west": 1.5 * math.pi}
NORTH, EAST = -3.0, 2.0
NOISE = 0.01


def at_headings(north: float, east: float) -> Dataset:
    """The linear vehicle at four headings, let go at rest over ground; other signs are held back."""
    moves, flights = manoeuvres(8.0, DT), {}
    for place, heading in HEADINGS.items():
        reference = {**body_spec().reference, "psi": 0.0, "environment.wind.psi": heading}
        vehicle = linear_vehicle(effects=("environment.wind",), reference=reference, imu=(0.0, 0.0, 0.0))
        vehicle = with_values(vehicle, {"environment.wind.north": north, "environment.wind.east": east})
        both = {f"{n}_{place}": m for n, m in moves.items()} | {f"{n}_{place}_again": -m for n, m in moves.items()}
        for name, record in arrays(flown(vehicle, both, DT, noise=NOISE, seed=len(flights))).items():
            q, r, phi, theta = (record[c] for c in ("q", "r", "phi", "theta"))
            turn = (q * np.sin(phi) + r * np.cos(phi)) / np.cos(theta)
            flights[name] = {**record, "psi": heading + DT * np.cumsum(turn)}
    return recorded(flights)


def arrays(dataset: Dataset) -> dict[str, dict[str, np.ndarray]]:
    """Flights as they are recorded."""
    return {name: {c: v.numpy() for c, v in flight.channels.items()} for name, flight in dataset.flights.items()}


def recorded(flights: Mapping[str, Mapping[str, np.ndarray]]) -> Dataset:
    """A data set of these flights."""
    known = {c: {"noise": NOISE, "bias": "none"} for c in (*BODY, "ax", "ay", "az")}
    return Dataset.from_arrays(
        flights,
        identify=[n for n in flights if not n.endswith("again")],
        validate=[n for n in flights if n.endswith("again")],
        channels={**known, "psi": {"noise": 1e-3, "bias": "none"}},
        controls={c: {"unit": "rad", "noise": 1e-7} for c in ("lon", "lat", "col", "ped")},
        vehicle={"imu": [0.0, 0.0, 0.0]},
    )


@pytest.fixture(scope="module")
def windy() -> Flights:
    data = at_headings(NORTH, EAST)
    return Flights(data, reconstruct(data))


def test_a_wind_explains_the_trims_and_no_delay_is_asked(windy: Flights):
    spec = propose(windy.dataset, windy.reconstruction)
    found = explained_trims(spec, {}, windy, ("control.delay", "environment.wind"))
    assert list(found) == ["environment.wind"]
    assert found["environment.wind"].share > 0.9
    assert found["environment.wind"].start["environment.wind.north"] == pytest.approx(NORTH, abs=0.3)
    assert found["environment.wind"].start["environment.wind.east"] == pytest.approx(EAST, abs=0.3)
    assert found["environment.wind"].start["forces.L.lat"] == pytest.approx(30.0, rel=0.05)


def test_flights_on_one_heading_are_not_asked(windy: Flights):
    names = tuple(n for n in windy.dataset.identify if "north" in n)
    one = Flights(replace(windy.dataset, identify=names), windy.reconstruction)
    assert explained_trims(propose(one.dataset, one.reconstruction), {}, one, ("environment.wind",)) == {}


def test_without_flights_to_decide_each_is_told_by_the_others(windy: Flights):
    alone = Flights(replace(windy.dataset, validate=()), windy.reconstruction)
    found = explained_trims(propose(alone.dataset, alone.reconstruction), {}, alone, ("environment.wind",))
    assert found["environment.wind"].share > 0.9
    assert found["environment.wind"].start["environment.wind.north"] == pytest.approx(NORTH, abs=0.3)
    assert all(0.0 < error < 0.5 for error in found["environment.wind"].scatter.values())


def test_a_flight_without_heading_decides_nothing(windy: Flights):
    flights = arrays(windy.dataset)
    del flights[windy.dataset.validate[0]]["psi"]
    other = Flights(recorded(flights), windy.reconstruction)
    found = explained_trims(propose(other.dataset, other.reconstruction), {}, other, ("environment.wind",))
    assert found["environment.wind"].share > 0.9


def test_headings_on_either_side_of_south_are_one(windy: Flights):
    flights = arrays(windy.dataset)
    for k, record in enumerate(flights.values()):
        record["psi"] = record["psi"] - record["psi"][0] + math.pi * (1.0 if k % 2 else -1.0)
    one = Flights(recorded(flights), windy.reconstruction)
    assert explained_trims(propose(one.dataset, one.reconstruction), {}, one, ("environment.wind",)) == {}


def test_still_air_is_no_wind():
    data = at_headings(0.0, 0.0)
    calm = Flights(data, reconstruct(data))
    alone = replace(calm, dataset=replace(data, validate=()))
    assert explained_trims(propose(data, calm.reconstruction), {}, alone, ("environment.wind",)) == {}
    assert explained_trims(propose(data, calm.reconstruction), {}, calm, ("environment.wind",)) == {}


def test_the_loop_names_the_wind_before_anything_else(windy: Flights):
    spec = propose(windy.dataset, windy.reconstruction)
    model = build(spec)
    start = regress_model(model, windy.dataset, windy.reconstruction)
    values = dict(zip(model.parameter_set.names, start.theta.tolist(), strict=True))

    def drawn(null: Null, effects: Sequence[str], observed: Family) -> Draws:
        assert null.spec.effects == spec.effects  # clean aircraft know no wind
        assert null.values["environment.wind.north"] == pytest.approx(NORTH, abs=0.3)
        assert "environment.wind" not in observed.statistics  # the model has it already
        few = {name: torch.full((19,), 1e-3, dtype=torch.float64) for name in observed.statistics}
        return Draws(few, "drawn", clean=True, least=observed.least)

    said: list[str] = []
    found = trace(Null(spec, values, start.held), windy, drawn, said.append)
    assert found.accepted == ("environment.wind",)
    assert "environment.wind" not in found.null.spec.effects
    assert found.final.values["environment.wind.north"] == pytest.approx(NORTH, abs=0.2)
    assert found.final.values["environment.wind.east"] == pytest.approx(EAST, abs=0.2)
    told = next(f for f in found.findings if f.id == "environment.wind")
    assert told.verdict == "accepted"
    assert found.notes[0].startswith("drawn; they fly in still air")
    assert found.unknown is None  # what stays without a name is not compared with aircraft that fly in still air
    assert torch.tensor([v for v, _ in told.values.values()]).isfinite().all()


def test_a_wind_in_the_model_blows_once_on_what_is_left_over(windy: Flights):
    known = {"reference": {**body_spec().reference, "psi": 0.0}, "imu": (0.0, 0.0, 0.0)}
    told = linear_vehicle(effects=("environment.wind",), **known)
    with_values(told, {"environment.wind.north": NORTH, "environment.wind.east": EAST})
    names = windy.dataset.identify
    over, still = (left_over(m, windy.dataset, windy.reconstruction, names) for m in (told, linear_vehicle(**known)))
    x = list(over.rows).index("X")
    assert float(over.residual[:, x].square().mean()) < 0.1 * float(still.residual[:, x].square().mean())
