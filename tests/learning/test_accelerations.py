"""A network at measured states takes a force that the model lacks, and does not stay where nothing is hidden."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.effects.families.neural import NeuralForces
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.learning import network
from rotorid_torch.learning.accelerations import learn_at_states
from rotorid_torch.learning.network import Learnt
from rotorid_torch.model.nominal import build
from rotorid_torch.simulation import fly
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.measured.fitted import FittedAtStates

DRAG = "propulsion.rotor_drag"


@cache
def fitted(*effects: str) -> FittedAtStates:
    """The nominal model of a drawn quadrotor's flights."""
    flights = ["translate_p", "eight_p", "random_a", "mixed_n"]
    flown = fly(None, vehicle="multirotor-2", flights=flights, effects=[(e, 1.0) for e in effects], seconds=10.0)
    data = at_one_rate(flown.dataset())
    seen = Flights(data, reconstruct(data))
    return FittedAtStates.of(propose(data, seen.reconstruction, ()), seen)


@cache
def learnt(*effects: str) -> Learnt:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network, "TRIALS", 1)
        return learn_at_states(fitted(*effects))


def test_a_drag_that_no_effect_was_asked_for_is_learnt():
    drag = learnt(DRAG)
    assert drag.finding().verdict == "accepted"
    null = fitted(DRAG)
    with_it = FittedAtStates(drag.spec, build(drag.spec, drag.values), null.flights, {}, {})
    before, after = (one.sigma for one in (null, with_it))
    assert after["ax"] < 0.95 * before["ax"]  # twenty seconds of flight, and a prior that lets little go
    assert after["pdot"] == pytest.approx(before["pdot"])


def test_where_nothing_is_hidden_no_network_stays():
    assert learnt().finding().verdict == "rejected"


def test_its_weights_stand_still_and_it_sees_neither_rates_nor_moments():
    spec = learnt(DRAG).spec
    assert not any(name.startswith(f"{NeuralForces.id}.") for name in build(spec).parameter_set.free)
    effect = NeuralForces.from_spec(spec)
    assert effect.rows == ("X", "Y", "Z")
    assert set(effect.inputs) == {"u", "v", "w", *spec.driven}


def test_without_validate_flights_nothing_judges_it():
    null = fitted()
    alone = Flights(replace(null.flights.dataset, validate=()), null.flights.reconstruction)
    network = learn_at_states(FittedAtStates(null.spec, null.model, alone, null.errors, null.without))
    assert network.finding().verdict == "not testable"
    assert "validate" in network.finding().reason
