"""Gusts as inputs of the models that are compared."""

from __future__ import annotations

import torch

from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.identification.gusts import Weather
from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.gusts import DRIFT, GUSTS, without_gust_inputs
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.air import in_moving_air
from rotorid_torch.trace.evidence.fits import Flights, refit
from rotorid_torch.trace.evidence.residual import left_over
from tests.gusty_flights import INTENSITY, LENGTH, turbulent


def test_gusts_that_are_fed_in_leave_little_over():
    """Residuals of velocities over 5 s are gusts alone here, and the smoother finds most of these."""
    data, gusts = turbulent()
    step1 = reconstruct(data)
    spec, flights = propose(data, step1, ()), Flights(data, step1)
    model = build(spec)
    theta = regress_model(model, data, step1).theta.tolist()
    values = dict(zip(model.parameter_set.names, theta, strict=True))
    weather = Weather((INTENSITY,) * 3, (LENGTH,) * 3, DRIFT, {}, {})
    moving, in_air = in_moving_air(spec, values, flights, weather)
    assert in_air.weather is weather
    assert without_gust_inputs(moving).inputs == spec.inputs
    for k, name in enumerate(GUSTS):
        smoothed = torch.stack([in_air.dataset.flights[n].channels[name] for n in data.identify])
        assert float(torch.corrcoef(torch.stack([smoothed.flatten(), gusts[..., k].flatten()]))[0, 1]) > 0.8
    still, fed = refit(spec, flights, values), refit(moving, in_air, values)
    places = [spec.outputs.index(n) for n in VELOCITIES]
    with_gusts, without = (one.fit.minimum.point.covariance.diagonal()[places] for one in (fed, still))
    assert bool((with_gusts < 0.36 * without).all())
    again = regress_model(fed.model, in_air.dataset, step1)  # beside gusts that are inputs
    assert set(again.own_share) == set(spec.controls)
    assert torch.isfinite(again.theta).all()
    left = left_over(fed.model, in_air.dataset, step1, data.identify)
    assert not set(GUSTS) & set(left.names)  # nothing is said to go with a gust
    assert fed.in_still_air.spec.inputs == spec.inputs
    assert fed.in_still_air.values == fed.values
    assert still.in_still_air is still
