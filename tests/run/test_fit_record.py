"""Scores of free runs as records: a known error gives known numbers. The model here replays the measurement."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from rotorid_torch.data import Dataset
from rotorid_torch.report.records import FlightRecord
from rotorid_torch.run import fit_record
from rotorid_torch.validate import windows
from rotorid_torch.validate.free_run import Windows
from tests.helpers import small_arrays

OUTPUTS = ("v", "p", "phi", "az", "a1")


@pytest.fixture(scope="module")
def data() -> Dataset:
    channels = {name: {"noise": 0.001} for name in ("v", "p", "phi", "az")}
    return Dataset.from_arrays(
        small_arrays(), identify=["one"], validate=["two"], acid=["three"], vehicle={"mass": 1000.0}, channels=channels
    )


def judgement(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> fit_record.Judged:
    """Judgement of a model that is off by 0.1 of every channel's scale on the first flight, 0.2 and 0.3 on the next."""
    off = {name: 0.1 * (k + 1) for k, name in enumerate(data.flights)}

    def replayed(model: object, pieces: Windows, run: object) -> tuple[Tensor, Tensor]:
        scale = torch.tensor([data.scales().get(name, 1.0) for name in OUTPUTS], dtype=torch.float64)
        size = torch.tensor([off[name] for name in pieces.names], dtype=torch.float64)
        return torch.zeros(0), pieces.measured + size[:, None, None] * scale

    monkeypatch.setattr(windows, "free_run", replayed)
    monkeypatch.setattr(fit_record.Runs, "of", lambda model: None)
    body = SimpleNamespace(outputs=OUTPUTS, controls=("lat",))
    model = SimpleNamespace(body=body, own_states=(), tape=lambda controls, dt: controls)
    return fit_record.judge(model, data)


@pytest.fixture
def judged(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> fit_record.Judged:
    return judgement(data, monkeypatch)


def test_a_known_error_gives_the_same_J_and_windows(judged: fit_record.Judged):
    record: FlightRecord = judged.flights["three"]
    assert record.list == "acid"
    assert record.J == pytest.approx(0.3)
    assert record.windows.median == pytest.approx(0.3)
    assert record.J_noise is not None
    assert record.J_trim is not None
    assert 0 < record.J_noise < record.J_trim


def test_channels_are_those_of_the_flight_scored_or_not(judged: fit_record.Judged, data: Dataset):
    record = judged.flights["one"]
    assert set(record.channels) == {"v", "p", "phi", "az"}
    assert record.channels["p"].rmse == pytest.approx(0.1 * data.scales()["p"])
    assert record.channels["p"].theil_parts[0] == pytest.approx(1.0)


def test_lists_are_scored_by_their_own_flights(judged: fit_record.Judged):
    score = judged.scores
    assert (score.identify, score.validate, score.acid) == tuple(pytest.approx(x) for x in (0.1, 0.2, 0.3))


def test_overlays_show_every_flight_from_its_start(judged: fit_record.Judged):
    shown = [(overlay.flight, overlay.list) for overlay in judged.overlays]
    assert shown == [("one", "identify"), ("two", "validate"), ("three", "acid")]
    assert judged.overlays[0].time[0] == 0.0
    assert judged.overlays[0].common(OUTPUTS) == ["v", "p", "phi", "az"]


def test_flights_judged_in_groups_come_out_the_same(
    judged: fit_record.Judged, data: Dataset, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(windows, "TOGETHER", 1)
    apart = judgement(data, monkeypatch)
    assert apart.flights == judged.flights
    assert list(apart.flights) == list(data.flights)
    assert apart.scores == judged.scores


def test_of_many_flights_the_first_of_each_list_are_shown(data: Dataset, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fit_record, "SHOWN", 1)
    two = dataclasses.replace(data, identify=("one", "two"), validate=())
    judged = judgement(two, monkeypatch)
    assert [overlay.flight for overlay in judged.overlays] == ["one", "three"]
    assert list(judged.flights) == ["one", "two", "three"]
