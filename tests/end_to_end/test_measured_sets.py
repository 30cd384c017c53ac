"""Real vehicles, measured by others: the chain goes through, and explains on unseen flights what nominal models can."""

from functools import cache

import pytest

from rotorid_torch.data import load
from rotorid_torch.run.pipeline import identify
from rotorid_torch.run.result import Run
from rotorid_torch.validate.responses import responses
from tests.helpers import shared


@cache
def identified(name: str) -> Run:
    return identify(load(shared("flightdata", name)))


@pytest.mark.parametrize(
    ("name", "flight", "response", "least"),
    [
        ("crazyflie-motors", "thrust_unseen", "az", 0.7),
        ("nanodrone", "melon_1", "az", 0.9),
        ("nanodrone", "melon_1", "omega1", 0.5),
        ("crazypad-normal", "f3_out", "az", 0.6),
    ],
)
def test_multirotors_accelerate_as_their_motors_say(name: str, flight: str, response: str, least: float):
    data = load(shared("flightdata", name))
    assert responses(identified(name).model, data.flights[flight], 0.0)[response].r2 > least


@pytest.mark.parametrize(
    ("name", "flight"), [("trex550-rates", "pitch_unseen"), ("trex550-translation", "fast_unseen_1")]
)
def test_a_model_helicopter_of_which_few_channels_are_known_is_better_than_its_trim(name: str, flight: str):
    scored = identified(name).fit.flights[flight]
    assert scored.J < 0.8 * scored.J_trim
