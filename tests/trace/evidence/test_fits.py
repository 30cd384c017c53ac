"""Fits that are compared: one that begins near another loses nothing of it."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import pytest
import torch

from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.trace.evidence.fits import Fitted, Flights, refit
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DT = 0.02


@pytest.fixture(scope="module")
def null() -> Fitted:
    truth = with_values(rate_vehicle(effects=("control.lag",)), {"control.lag.common": 0.1})
    lists = {"identify": list(manoeuvres(6.0, DT)), "validate": []}
    data = flown(truth, manoeuvres(6.0, DT), DT, noise=0.02, lists=lists)
    flights = Flights(data, reconstruct(data))
    return refit(propose(data, flights.reconstruction), flights, {})


@pytest.mark.parametrize("effects", [(), ("control.delay",)])
def test_a_fit_near_another_begins_at_its_cost_whatever_effect_joins_at_nothing(null: Fitted, effects: tuple[str, ...]):
    spec = msgspec.structs.replace(null.spec, effects=effects)
    assert refit(spec, null.flights, null.values, near=null).fit.minimum.history[0] == pytest.approx(
        null.cost, rel=1e-9
    )
    assert refit(spec, null.flights, null.values).fit.minimum.history[0] > null.cost + 1.0


def test_trajectories_from_which_runs_diverge_are_not_begun_from(null: Fitted, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        "rotorid_torch.trace.evidence.fits._followed", lambda near, model, states: torch.full_like(states, 1e300)
    )
    again, afresh = (refit(null.spec, null.flights, null.values, near=near) for near in (null, None))
    assert again.fit.minimum.history == afresh.fit.minimum.history


def test_the_scatter_of_an_effect_is_that_of_fits_without_one_flight_each(null: Fitted):
    spec = msgspec.structs.replace(null.spec, effects=("control.lag",))
    whole = refit(spec, null.flights, null.values, near=null)
    listed, found = null.flights.dataset.identify, []
    for name in listed:
        rest = replace(null.flights.dataset, identify=tuple(n for n in listed if n != name))
        found.append(refit(spec, replace(null.flights, dataset=rest), whole.values).values)
    scatter = whole.scatter("control.lag")
    assert set(scatter) >= {"control.lag.common"}
    for name, error in scatter.items():
        each = torch.tensor([values[name] for values in found], dtype=torch.float64)
        exact = ((len(each) - 1) * each.var(correction=0)).sqrt()
        assert error == pytest.approx(float(exact), rel=0.3)


def test_a_parameter_that_cannot_be_told_has_no_finite_error(null: Fitted):
    twice = refit(null.spec, null.flights, null.values, held=[n for n in null.names if n != "forces.L.p"])
    assert 0.0 < twice.error("forces.L.p") < math.inf
    assert twice.error("forces.L.lat") == math.inf
    blind = replace(
        twice, fit=replace(twice.fit, minimum=replace(twice.fit.minimum, not_identifiable=torch.ones(1) > 0))
    )
    assert blind.error("forces.L.p") == math.inf


def test_errors_of_an_effect_alone_are_those_of_the_whole_covariance(null: Fitted):
    spec = msgspec.structs.replace(null.spec, effects=("control.lag",))
    fitted = refit(spec, null.flights, null.values, near=null)
    alone = {name: fitted.error(name) for name in fitted.names}
    scatter = fitted.scatter("control.lag")
    whole = dict(zip(fitted.names, fitted.fit.errors.tolist(), strict=True))
    assert alone == pytest.approx(whole, rel=1e-10)
    assert fitted.error("control.lag.nothing") == math.inf
    assert refit(spec, null.flights, null.values, near=null).scatter("control.lag") == scatter
