"""Values that stand for a missing sample are missing samples on reading; motion, limits and rests stay."""

import numpy as np
import pytest

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.data import Dataset
from rotorid_torch.data.reading.marks import without_marks
from tests.consistency.examination.test_check import rolling

TIME = 0.01 * np.arange(2000)
LOST = np.repeat(np.random.default_rng(0).random(200) < 0.1, 10)


def motion(seed=1):
    return 0.3 * np.sin(3.0 * TIME) + 0.002 * np.random.default_rng(seed).standard_normal(2000)


MARKED = {
    "theta": (motion(), -1.0),
    "phi": (np.round(motion(), 2), -1.0),
    "height": (20.0 + 10.0 * motion(), -9999.0),
    "q": (motion(), 0.0),
    "airspeed": (4.0 + 10.0 * motion(), -1.0),
    "p": (8.0 * motion(), -1.0),
    "motor1": (0.5 + motion(), 65.5),
}


@pytest.mark.parametrize(("channel", "values", "mark"), [(channel, *one) for channel, one in MARKED.items()])
def test_a_mark_is_a_missing_sample_with_its_number(channel, values, mark):
    cleaned, told = without_marks({"time": TIME, channel: np.where(LOST, mark, values)})
    assert np.array_equal(np.isnan(cleaned[channel]), LOST)
    assert len(told) == 1
    assert f"{channel}: {mark:g} " in told[0]
    assert f"{LOST.sum()} samples" in told[0]


def test_a_channel_that_is_missing_in_every_second_row():
    lost = np.random.default_rng(5).random(2000) < 0.5
    cleaned = without_marks({"time": TIME, "voltage": np.where(lost, -1.0, 16.0 + 0.01 * motion())})[0]
    assert np.array_equal(np.isnan(cleaned["voltage"]), lost)


def test_two_marks_and_one_long_stretch_that_may_be_a_broken_sensor():
    height = np.where(TIME < 8.0, -9999.0, 20.0 + motion())
    assert without_marks({"time": TIME, "height": height})[1] == []
    both = np.where(LOST, np.where(TIME < 10.0, -9999.0, -1.0), 20.0 + motion())
    assert np.array_equal(np.isnan(without_marks({"time": TIME, "height": both})[0]["height"]), LOST)


def test_motion_limits_rests_and_turns_are_no_marks():
    rng = np.random.default_rng(2)
    pulses = np.where(np.sin(2.0 * TIME) > 0.9, 0.05, 0.0)
    speed = np.where((TIME > 3.0) & (TIME < 15.0), 500.0 + 10.0 * motion(), 0.0)
    heading = np.radians(np.round(np.degrees(np.mod(0.05 * np.sin(2.0 * TIME), 2.0 * np.pi))))
    whole = np.round(np.degrees(motion()))
    records = {"p": (pulses, np.clip(motion(), -0.1, 0.1), rng.standard_t(2, 2000), np.round(motion(), 1))}
    records |= {"omega1": (speed,), "psi": (heading,), "theta": (whole,), "lat": (np.where(LOST, 0.02, 0.0),)}
    for channel, some in records.items():
        for values in some:
            assert without_marks({"time": TIME, channel: values})[1] == []


def test_no_sensor_is_blamed_for_marks():
    flight = rolling()
    lost = np.repeat(np.random.default_rng(3).random(len(flight["time"]) // 10 + 1) < 0.08, 10)[: len(flight["time"])]
    flight["theta"] = np.where(lost, -1.0, flight["theta"])
    plain, marked = (check(Dataset.from_arrays({"f": one}, identify=["f"])) for one in (rolling(), flight))
    told = [f for f in marked.findings if "stands for a missing sample" in f.sentence]
    assert [(f.severity, f.channel) for f in told] == [("warning", "theta")]
    blamed = [{f.channel for f in one.findings if f.severity == "error"} for one in (plain, marked)]
    assert blamed[0] == blamed[1]
