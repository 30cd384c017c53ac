"""Scores of free runs as records: a known error gives known numbers."""

from __future__ import annotations

import math

import pytest
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.run.judge import Runs, flight_record, list_scores
from rotorid_torch.validate import scores
from tests.helpers import small_arrays

OUTPUTS = ("v", "p", "phi", "az", "a1")


@pytest.fixture(scope="module")
def data() -> Dataset:
    vehicle = {"mass": 1000.0}
    channels = {name: {"noise": 0.001} for name in ("v", "p", "phi", "az")}
    return Dataset.from_arrays(
        small_arrays(), identify=["one"], validate=["two"], acid=["three"], vehicle=vehicle, channels=channels
    )


def runs(data: Dataset, flight: str, error: float) -> Runs:
    """Two windows with this error, in units of each channel's scale, in every channel."""
    record = data.flights[flight]
    measured = record.stack(OUTPUTS)[: scores.horizon_samples(record.dt)]
    scale = torch.tensor([data.scales().get(name, 1.0) for name in OUTPUTS], dtype=torch.float64)
    windows = torch.stack([measured, measured])
    simulated = torch.stack([measured + error * scale, measured + 2.0 * error * scale])
    return Runs(flight, record.dt, windows, simulated)


def test_a_known_error_gives_the_same_J_and_windows(data: Dataset):
    record = flight_record(runs(data, "three", 0.2), OUTPUTS, data)
    assert record.list == "acid"
    assert record.J == pytest.approx(0.2)
    assert record.windows.median == pytest.approx(0.3)
    assert (record.windows.p10, record.windows.p90) == (pytest.approx(0.22), pytest.approx(0.38))
    assert record.J_noise is not None
    assert record.J_trim is not None
    assert 0 < record.J_noise < record.J_trim


def test_channels_are_those_of_the_flight_scored_or_not(data: Dataset):
    record = flight_record(runs(data, "one", 0.1), OUTPUTS, data)
    assert set(record.channels) == {"v", "p", "phi", "az"}
    assert record.channels["p"].rmse == pytest.approx(0.1 * data.scales()["p"])
    assert record.channels["p"].theil_parts[0] == pytest.approx(1.0)


def test_a_perfect_model_scores_nothing(data: Dataset):
    record = flight_record(runs(data, "two", 0.0), OUTPUTS, data)
    assert record.J == 0.0
    assert record.channels["v"].r2 == 1.0
    assert record.channels["v"].theil_parts == (None, None, None)


def test_lists_are_scored_by_the_rms_of_their_flights(data: Dataset):
    errors = {"one": 0.1, "two": 0.2, "three": 0.3}
    flights = {name: flight_record(runs(data, name, error), OUTPUTS, data) for name, error in errors.items()}
    score = list_scores(flights)
    assert (score.identify, score.validate, score.acid) == tuple(pytest.approx(x) for x in (0.1, 0.2, 0.3))
    pooled = list_scores({str(error): flight_record(runs(data, "one", error), OUTPUTS, data) for error in (0.3, 0.4)})
    assert pooled.identify == pytest.approx(math.sqrt(0.125))
    assert pooled.acid is None
