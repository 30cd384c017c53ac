"""Scores of free runs as records: a linear vehicle whose controls do a tenth too much gives known numbers."""

from __future__ import annotations

import dataclasses

import pytest

from rotorid_torch.core.names import STICKS
from rotorid_torch.data import Dataset
from rotorid_torch.model.model import Model
from rotorid_torch.run import fit_record
from rotorid_torch.validate import windows
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Flights of a linear vehicle: the same controls once, twice and three times as large; one lacks a channel."""
    moves = manoeuvres(6.0, 0.02)["f_lat"]
    sizes = {"one": 1.0, "two": 2.0, "three": 3.0}
    lists = {"identify": ["one"], "validate": ["two"], "acid": ["three"]}
    whole = flown(rate_vehicle(), {name: size * moves for name, size in sizes.items()}, lists=lists)
    flights = {
        name: {c: v.numpy() for c, v in flight.channels.items() if (name, c) != ("two", "r")}
        for name, flight in whole.flights.items()
    }
    return Dataset.from_arrays(flights, **lists, controls={c: {"unit": "rad"} for c in STICKS})


@pytest.fixture(scope="module")
def model() -> Model:
    """The same vehicle, its controls a tenth stronger: what it answers is a tenth too large, at every instant."""
    true = rate_vehicle()
    stronger = {n: 1.1 * value for n, value in true.named_values.items() if n.rpartition(".")[2] in STICKS}
    return with_values(true, stronger)


@pytest.fixture(scope="module")
def judged(model: Model, data: Dataset) -> fit_record.Judged:
    return fit_record.judge(model, data)


def test_a_known_error_gives_its_J_and_windows(judged: fit_record.Judged):
    record = judged.flights["three"]
    assert record.list == "acid"
    assert record.J == pytest.approx(0.3, rel=1e-6)
    assert record.windows.median == pytest.approx(0.3, rel=1e-6)
    assert record.J_trim == pytest.approx(3.0, rel=1e-6)
    assert record.J_noise is not None
    assert 0.0 < record.J_noise < 0.01


def test_channels_are_those_of_the_flight(judged: fit_record.Judged, data: Dataset):
    assert set(judged.flights["one"].channels) == {"p", "q", "r"}
    assert set(judged.flights["two"].channels) == {"p", "q"}
    p = judged.flights["one"].channels["p"]
    assert p.rmse == pytest.approx(0.1 * data.scales()["p"], rel=1e-6)
    bias, variance, covariance = p.theil_parts
    assert bias + variance == pytest.approx(1.0)  # what is in proportion is no lack of correlation
    assert covariance == pytest.approx(0.0, abs=1e-6)


def test_lists_are_scored_by_their_own_flights(judged: fit_record.Judged):
    score = judged.scores
    assert (score.identify, score.validate, score.acid) == tuple(pytest.approx(x, rel=1e-6) for x in (0.1, 0.2, 0.3))


def test_overlays_show_every_flight_from_its_start(judged: fit_record.Judged):
    shown = [(overlay.flight, overlay.list) for overlay in judged.overlays]
    assert shown == [("one", "identify"), ("two", "validate"), ("three", "acid")]
    assert judged.overlays[0].time[0] == 0.0
    assert judged.overlays[1].common(("p", "q", "r")) == ["p", "q"]


def test_flights_judged_in_groups_come_out_the_same(
    judged: fit_record.Judged, model: Model, data: Dataset, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(windows, "TOGETHER", 1)
    apart = fit_record.judge(model, data)
    assert apart.scores == judged.scores
    assert list(apart.flights) == list(data.flights)
    assert apart.flights == judged.flights


def test_of_many_flights_the_first_of_each_list_are_shown(model: Model, data: Dataset, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fit_record, "SHOWN", 1)
    two = dataclasses.replace(data, identify=("one", "two"), validate=())
    judged = fit_record.judge(model, two)
    assert [overlay.flight for overlay in judged.overlays] == ["one", "three"]
    assert list(judged.flights) == ["one", "two", "three"]
