"""A network takes what physics leaves over, where something is; where nothing is, it does not stay."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import msgspec
import pytest
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.effects.families.neural import TRUST
from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.learning import network
from rotorid_torch.learning.network import Learnt, turns
from rotorid_torch.learning.trajectories import learn, memory, regressed, turned, with_turned_residual
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import Fitted, Flights, refit
from rotorid_torch.trace.evidence.residual import left_over
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DT = 0.02
HIDDEN = 8.0


def flights(damping: float) -> Dataset:
    """A vehicle whose roll is damped by p |p| as well; no model here knows of that."""
    truth = with_values(rate_vehicle(effects=("forces.quadratic_damping",)), {"forces.quadratic_damping.L": damping})
    moves = {n: 3.0 * m for n, m in manoeuvres(6.0, DT).items()}
    both = {**moves, **{f"{name}_again": -0.8 * move for name, move in moves.items()}}
    lists = {"identify": list(moves), "validate": [f"{name}_again" for name in moves]}
    return flown(truth, both, DT, noise=0.02, seed=3, lists=lists)


@cache
def physics(damping: float) -> Fitted:
    data = flights(damping)
    found = reconstruct(data)
    spec = propose(data, found)
    model = build(spec)
    start = regress_model(model, data, found)
    values = dict(zip(model.parameter_set.names, start.theta.tolist(), strict=True))
    return refit(spec, Flights(data, found), values, start.held)


@cache
def learnt(damping: float) -> Learnt:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network, "TRIALS", 1)
        return learn(physics(damping))


def test_a_network_takes_a_hidden_moment_and_stays():
    found = learnt(HIDDEN)
    told = found.finding()
    assert (told.verdict, told.role) == ("accepted", "learnt")
    assert told.statistic is not None
    assert told.critical_value is not None
    assert told.statistic > 0.15 > 0.05 > told.critical_value


def test_where_nothing_is_hidden_no_network_stays():
    found = learnt(0.0)
    assert found.finding().verdict == "rejected"
    assert found.critical_value is None
    assert "no fit has seen" in found.finding().reason


def test_a_network_that_gains_no_more_than_chance_does_not_stay():
    found = learnt(HIDDEN)
    lucky = Learnt(found.spec, found.values, found.better, (0.0, 2.0 * float(found.better.mean())))
    assert lucky.finding().verdict == "rejected"
    assert "nothing is to be learnt" in lucky.finding().reason


def test_a_turned_residual_keeps_its_size_and_loses_its_meaning():
    fitted = physics(HIDDEN)
    turn = turns(fitted.flights, torch.Generator().manual_seed(1))
    again = refit(fitted.spec, turned(fitted, turn), fitted.values)
    variances = [one.fit.minimum.point.covariance.diagonal() for one in (again, fitted)]
    assert torch.allclose(*variances, rtol=0.3)
    true, shuffled = (f.fit.likelihood.records.outputs for f in (fitted, again))
    assert not torch.equal(true, shuffled)
    assert torch.equal(true.isnan(), shuffled.isnan())


def test_equations_residuals_are_turned_flight_by_flight_whatever_linear_terms_they_have():
    """Where flapping is measured, its tilts are linear terms beside the flights' constants."""
    fitted = physics(HIDDEN)
    data, found = fitted.flights.dataset, fitted.flights.reconstruction
    over = left_over(fitted.model, data, found, data.identify)
    tilted = replace(over, tilts=over.signals[:, :3] ** 2)
    turns = [(0.3, -1.0)] * len(data.identify)
    for f in range(len(data.identify)):
        mine = over.flight == f
        rolled = -over.residual[mine].roll(round(0.3 * int(mine.sum())), dims=0)
        assert torch.equal(with_turned_residual(tilted, turns).residual[mine], rolled)


def test_weights_of_the_equations_repeat_by_seed():
    fitted = physics(HIDDEN)
    data, found = fitted.flights.dataset, fitted.flights.reconstruction
    over = left_over(fitted.model, data, found, data.identify)
    model = build(msgspec.structs.replace(fitted.spec, effects=("neural.forces",)))
    one, two, other = (regressed(model, over, seed) for seed in (5, 5, 6))
    assert one == two
    assert one != other


def test_what_linear_terms_can_take_up_is_left_to_them():
    fitted = physics(0.0)
    data, found = fitted.flights.dataset, fitted.flights.reconstruction
    over = left_over(fitted.model, data, found, data.identify)
    model = build(msgspec.structs.replace(fitted.spec, effects=("neural.forces",)))
    tilted = replace(over, residual=over.residual + 0.5 * over.signals[:, :1])

    def moved(linear: bool) -> float:
        plain, other = (regressed(model, one, linear=linear) for one in (over, tilted))
        return max(abs(other[n] - plain[n]) for n in plain if ".L.h" in n)

    assert moved(linear=False) < 0.01
    assert moved(linear=True) > 0.3


def test_coloured_residuals_are_remembered_and_tighten_the_prior():
    assert memory(physics(0.0)) < 2.0
    remembered = memory(physics(HIDDEN))
    assert remembered > 5.0
    assert learnt(HIDDEN).spec.sizes[TRUST] == pytest.approx(remembered**-0.5)
