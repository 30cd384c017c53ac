"""The whole check: joint sensor errors, a verdict per channel, check.json and pictures; and a long flight in time."""

import json
import re
import time
from importlib.util import module_from_spec, spec_from_file_location
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import rotorid_torch as rotorid
from rotorid_torch.consistency.examination.grade import head
from rotorid_torch.consistency.sensor_errors.sensor_finding import KinematicFinding, SensorParameter
from rotorid_torch.data import Dataset, load
from rotorid_torch.data.write import write_dataset
from rotorid_torch.run.check import check, check_table, sensor_words, write_check
from rotorid_torch.run.output.monitor import Monitor
from rotorid_torch.simulation import fly
from tests.helpers import ROOT, shared, small_flight

CLEAN = (
    "uh60-hover",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("uh60-60kt", "ah1-hover", "uh60b-hover")),
)


def verdicts(found):
    return {one.channel: one.verdict for one in found.channels}


def test_sizes_that_no_sensor_has_are_not_said_to_be_visible():
    """A bias of seven turns and a scale of twice the motion."""
    names = {"sensors.bias.phi": (0.1, "rad"), "sensors.bias.theta": (44.0, "rad"), "sensors.scale.psi": (1.28, "1")}
    parameters = [SensorParameter(name, 0.0, 1.0, unit, False, 0.0, size) for name, (size, unit) in names.items()]
    bias, scale = (
        KinematicFinding(f"sensors.{kind}", "below floor", "", 0.0, 1.0, several, None, ())
        for kind, several in (("bias", tuple(parameters[:2])), ("scale", tuple(parameters[2:])))
    )
    (said,) = sensor_words([bias, scale])
    assert said.sentence.endswith("Such sizes would show: a bias of a sensor, 5.73° (phi).")


@pytest.mark.parametrize("name", CLEAN)
def test_clean_sets_are_good_in_every_channel(name):
    found = check(load(shared("flightdata", name)))
    assert set(verdicts(found).values()) == {"good"}
    (clean,) = (one.sentence for one in found.findings if "no constant sensor error" in one.sentence)
    assert re.search(r"a bias of a sensor, .*rad/s \([pqr]\)( to .*rad/s \([pqr]\))?, .*m/s² \(a[xyz]\)", clean)
    assert "s²)" not in clean.split("a filter of a sensor")[-1]
    assert not any(p.accepted for sensor in found.sensors for p in sensor.parameters)
    assert not [one for one in found.findings if one.severity in ("error", "warning")]


def test_a_late_stream_has_its_delay_and_standard_error():
    found = check(load(shared("flightdata", "uh60-x2")))
    (delay,) = (p for sensor in found.sensors for p in sensor.parameters if p.accepted)
    assert delay.se < 0.001
    assert verdicts(found)["phi"] == "with care"
    (told,) = (one.sentence for one in found.findings if "(all channels together)." in one.sentence)
    assert told.startswith("attitude")
    assert any("attitude" in why and "together" not in why for why in found.because)  # what it is, not how it was seen


def test_measured_defects_are_told_with_what_to_do():
    pad = check(load(shared("flightdata", "crazypad-normal")))
    assert verdicts(pad)["p"] == verdicts(pad)["q"] == "with care"
    assert verdicts(pad)["az"] == "good"
    assert any(s.sentence.startswith("no test input on roll, pitch") for s in pad.findings)
    jitter = [f for f in check(load(shared("flightdata", "crazyflie-motors"))).findings if f.channel == "time"]
    assert "intervals of 0.522 to 7 ms, median 0.989" in jitter[0].sentence
    nano = check(load(shared("flightdata", "nanodrone")))
    assert verdicts(nano)["omega1"] == "with care"
    told = " ".join(f.sentence for f in nano.findings)
    assert "3.04 to 3.99 V" in told
    assert "square_2 27%" in told


def test_a_head_is_the_first_clause_without_brackets():
    assert head("late by 0.05 s (± 0.01) (p (x) 0.1): shift it. More.") == "late by 0.05 s"


def test_a_run_holds_check_json_and_pictures(tmp_path: Path):
    flights = {name: small_flight(seed=k, samples=900) for k, name in enumerate(("one", "two"))}
    controls = {"lat": {"unit": "rad"}, "lon": {"unit": "rad"}}
    write_dataset(tmp_path / "set", flights, identify=["one"], validate=["two"], controls=controls)
    dataset = rotorid.load(tmp_path / "set")
    found = rotorid.check(dataset)
    for _ in range(2):  # the second replaces the first
        write_check(tmp_path / "run", dataset, found, 0, Monitor())
    whole = json.loads((tmp_path / "run" / "check.json").read_text())
    assert {"format", "rotorid", "sha256", "dataset", "fit", "findings", "channels", "sensors"} <= whole.keys()
    assert [one["channel"] for one in whole["channels"]][:2] == ["lon", "lat"]
    names = {path.stem for path in (tmp_path / "run" / "figures").iterdir()}
    assert {"sampling", "spectra", "coherence", "controls", "correlation", "kinematics"} <= names
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in (tmp_path / "run" / "figures").iterdir())
    console = Console(width=150, record=True, file=StringIO())
    console.print(check_table(found))
    text = console.export_text()
    assert "Channel by channel" in text
    assert text.startswith(f"set: {found.grade}")
    assert f"\nset: {found.grade}" in text.partition("Channel by channel")[2]
    assert "\nNext: " in text


def test_data_in_memory_with_gaps_and_a_dead_channel_are_checked():
    flight = small_flight(samples=900)
    flight["r"][:], flight["u"][:] = 0.0, 3.0
    flight["theta"][100:160] = np.nan
    found = check(Dataset.from_arrays({"f": flight}, identify=["f"]))
    assert [verdicts(found)[name] for name in ("p", "r", "u")] == ["good", "not fit", "not fit"]
    assert [one.severity for one in found.findings if "never changes" in one.sentence and one.channel == "u"] == [
        "warning"
    ]
    assert not found.fit


@pytest.mark.slow
def test_ten_minutes_at_200_hz_are_checked_in_their_share_of_a_minute(tmp_path: Path):
    spec = spec_from_file_location("hour_flight", ROOT / "experiments" / "studies" / "hour_flight.py")
    assert spec is not None
    assert spec.loader is not None
    hour_flight = module_from_spec(spec)
    spec.loader.exec_module(hour_flight)
    fly(tmp_path / "flown", seed=1, flights=hour_flight.PIECES[:4])
    hour_flight.write_hour(tmp_path / "flown", tmp_path / "hour", 600.0, 200.0)
    begin = time.process_time()
    found = check(load(tmp_path / "hour"))
    assert time.process_time() - begin < 15.0
    assert not [one for one in found.findings if one.severity == "warning" and "against" in one.sentence]
