"""A helicopter with an IMU alone: identified with dead-reckoned velocities where these serve, and without elsewhere."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import pytest

import rotorid_torch as rotorid
from rotorid_torch.core.names import FLAPPING, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.run.pipeline import UNUSED

FLIGHTS = ("dbl_lon_p", "dbl_lat_p", "dbl_col_p", "dbl_ped_p", "f321_lon", "f321_lat", "dbl_ped_n", "dbl_lat_n")


def by_an_imu(speed: float) -> Dataset:
    """The built-in aircraft about a speed, m/s, without velocities, height and flapping."""
    flown = rotorid.fly(None, flights=FLIGHTS, speed=speed, seed=3).dataset()
    left = {*VELOCITIES, "height", *FLAPPING}
    return flown.changed(
        lambda flight: replace(
            flight, channels=MappingProxyType({c: v for c, v in flight.channels.items() if c not in left})
        )
    )


@pytest.fixture(scope="module")
def inertial() -> Dataset:
    return by_an_imu(0.0)


def test_speeds_are_states_and_the_model_flies_better(inertial: Dataset):
    run = rotorid.identify(inertial)
    unknown = rotorid.identify(replace(inertial, settings=type(inertial.settings)()))
    assert "u" in run.model.body.states
    assert "u" not in unknown.model.body.states
    for flights in ("identify", "validate"):
        assert run.scores[flights] < 0.5 * unknown.scores[flights]
    channels = run.record.before.flights["dbl_ped_n"].channels
    assert set(channels).isdisjoint(VELOCITIES)
    assert run.estimate.method == "output-error"


def test_an_effect_of_the_air_finds_its_velocities(inertial: Dataset):
    run = rotorid.identify(inertial, effects=["environment.wind"])
    assert "environment.wind" in run.spec.effects


def test_they_are_left_out_where_they_serve_badly():
    wrong = by_an_imu(30.0)
    run = rotorid.identify(replace(wrong, settings=type(wrong.settings)(reference="hover")))
    assert "u" not in run.model.body.states
    assert UNUSED in run.record.warnings


def test_no_gusts_are_sought_in_what_drifts(inertial: Dataset):
    with pytest.raises(rotorid.InputError, match="no velocities are measured"):
        rotorid.identify(inertial, method="filter-error")
