"""Fits that travelled between ranks are those that were made, to the last digit, in all that tracing asks of them."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import pytest
import torch

from rotorid_torch.core.names import RATES
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import CAREFUL, Flights, refit
from rotorid_torch.trace.evidence.parallel_fits import Wanted, fits
from rotorid_torch.trace.evidence.screen import screen
from rotorid_torch.trace.measured.accelerations import MeasuredAccelerations, _message
from rotorid_torch.trace.measured.fitted import FittedAtStates
from tests.known_models import body_spec, flown, manoeuvres, rate_vehicle, scattered, with_values

DT = 0.04
LISTS = {"identify": ["f_lon", "f_lat", "f_col"], "validate": ["f_ped"]}


class Others(Ranks):
    """A rank for which the others make everything."""

    def carry(
        self,
        items: Sequence[Any],
        make: Callable[[Any], Any],
        told: Callable[[Any], Any],
        again: Callable[[Any, Any], Any],
    ) -> list[Any]:
        return [again(item, pickle.loads(pickle.dumps(told(make(item))))) for item in items]


@pytest.mark.parametrize("kept", [True, False])
def test_a_fit_of_another_rank_is_the_same_fit(kept: bool, monkeypatch: pytest.MonkeyPatch):
    if not kept:
        monkeypatch.setattr("rotorid_torch.identification.estimate.likelihood.KEPT_NUMBERS", 0)
    truth = with_values(rate_vehicle(effects=("control.delay",)), {"control.delay.common": 0.08})
    data = flown(truth, manoeuvres(6.0, DT), DT, noise=0.02, lists=LISTS)
    flights = Flights(data, reconstruct(data))
    null = refit(propose(data, flights.reconstruction), flights, {})
    names = ("control.delay", "control.lag")
    specs = [msgspec.structs.replace(null.spec, effects=(name,)) for name in names]
    wanted = [Wanted(spec, {**null.values, "control.delay.common": 0.05}, null) for spec in specs]
    made, told = (fits(wanted, ("forces.L.q",), CAREFUL, ranks) for ranks in (ALONE, Others()))
    for one, other in zip(made, told, strict=True):
        assert other.spec == one.spec
        assert other.values == one.values
        assert "forces.L.q" not in other.names
        assert (other.cost, other.per_sample) == (one.cost, one.per_sample)
        assert torch.equal(other.fit.errors, one.fit.errors)
        assert torch.equal(other.identified.size(), one.identified.size())
        assert torch.equal(other.unseen.size(), one.unseen.size())
        assert (other.fit.minimum.point.parts is not None) == kept
    seen, again = (screen(one, ["control.lag"], shuffles=3) for one in (made[0], told[0]))
    assert torch.equal(again.equations.total, seen.equations.total)


def test_what_was_fitted_at_measured_states_travels_whole():
    spec = body_spec(states=RATES, outputs=RATES, patterns={}, imu=(0.0, 0.0, 0.0), effects=("control.delay",))
    unused: Any = None
    model = scattered(build(spec))
    made = FittedAtStates(spec, model, unused, {"control.delay.common": 0.25}, {"one": model.theta.detach() + 1.0})
    shared = MeasuredAccelerations(unused)
    found = Others().carry([spec], lambda _: made, _message, shared._again)[0]
    assert (found.spec, found.values, found.errors) == (made.spec, made.values, made.errors)
    assert torch.equal(found.without["one"], made.without["one"])
