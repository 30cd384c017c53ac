"""What identify refuses before any work: one line, and no folder left behind."""

import numpy as np
import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.errors import InputError
from rotorid_torch.run import pipeline
from tests.helpers import small_flight


def no_work(*given, **named):
    raise AssertionError("step 1 was begun")


@pytest.fixture(autouse=True)
def _step_1_must_not_begin(monkeypatch):
    monkeypatch.setattr("rotorid_torch.run.pipeline.motion_and_forces", no_work)


def test_a_flight_too_short_to_identify_from_is_named(tmp_path):
    short = small_flight(samples=26)
    flights = {"long": small_flight(), "short": short}
    dataset = Dataset.from_arrays(flights, identify=["long", "short"])
    with pytest.raises(InputError, match=r"flight short: time: the flight lasts 0\.5 s; expected at least"):
        pipeline.identify(dataset, out=tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_a_short_flight_to_judge_by_is_no_reason_to_refuse(tmp_path):
    flights = {"long": small_flight(), "short": small_flight(samples=26)}
    dataset = Dataset.from_arrays(flights, identify=["long"], validate=["short"])
    with pytest.raises(AssertionError, match="step 1 was begun"):
        pipeline.identify(dataset, out=tmp_path / "run")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("effects", "told"),
    [(["no.such"], "no.such: there is no such effect"), (["control.delay", "control.delay"], "is named twice")],
)
def test_effects_that_make_no_model(effects, told, tmp_path):
    dataset = Dataset.from_arrays({"f": small_flight()}, identify=["f"])
    with pytest.raises(InputError, match=told):
        pipeline.identify(dataset, effects=effects, out=tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_controls_that_never_move_identify_nothing(tmp_path):
    still = {name: np.zeros(400) if name in ("lat", "lon") else values for name, values in small_flight().items()}
    dataset = Dataset.from_arrays({"f": still}, identify=["f"])
    with pytest.raises(InputError, match=r"flight f: lon: no control moves in any identify flight; expected"):
        pipeline.identify(dataset, out=tmp_path / "run")
