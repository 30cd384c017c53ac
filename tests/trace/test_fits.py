"""Fits that are compared: one that begins near another loses nothing of it."""

from __future__ import annotations

import msgspec
import pytest

from rotorid_torch.identification.reconstruct import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.trace.fits import Flights, refit
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DT = 0.02


def test_a_fit_near_another_begins_at_its_cost_whatever_effect_joins_at_nothing():
    truth = with_values(rate_vehicle(effects=("control.lag",)), {"control.lag.common": 0.1})
    lists = {"identify": list(manoeuvres(6.0, DT)), "validate": []}
    data = flown(truth, manoeuvres(6.0, DT), DT, noise=0.02, lists=lists)
    flights = Flights(data, reconstruct(data))
    null = refit(propose(data, flights.reconstruction), flights, {})
    for effects in ((), ("control.delay",)):
        spec = msgspec.structs.replace(null.spec, effects=effects)
        begun = refit(spec, flights, null.values, near=null).fit.minimum.history[0]
        assert begun == pytest.approx(null.cost, rel=1e-9)
    assert refit(null.spec, flights, null.values).fit.minimum.history[0] > null.cost + 1.0
