"""Three grades: ready, limited to axes, not usable because; the command's exit code and its first line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rotorid_torch import cli
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.examination.controls import band
from rotorid_torch.consistency.examination.grade import Graded, graded, head
from rotorid_torch.data import Dataset, load
from rotorid_torch.data.write import write_dataset
from tests.helpers import shared

DT, SECONDS = 0.02, 40.0


def flown(seed: int = 0, **change: object) -> dict[str, np.ndarray]:
    """A helicopter whose rates and az answer their sticks, which are steps of random length from 1 s on."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, DT)
    flight = {"time": time}
    pairs = {"lat": ("p", 6.0, 8.0), "lon": ("q", 3.0, 4.0), "ped": ("r", 2.0, 3.0), "col": ("az", -60.0, 6.0)}
    for stick, (rate, power, damping) in pairs.items():
        switches = np.cumsum(rng.uniform(0.3, 1.5, 60))
        steps = 0.05 * rng.choice([-1.0, 0.0, 1.0], 61)[np.searchsorted(switches, time)] * (time > 1.0)
        flight[stick] = steps + 1e-4 * rng.standard_normal(len(time))
        response = np.zeros(len(time))
        for i in range(1, len(time)):
            response[i] = response[i - 1] + DT * (power * steps[i - 1] - damping * response[i - 1])
        flight[rate] = response - 9.8 * (rate == "az") + 1e-3 * rng.standard_normal(len(time))
    return flight | {name: np.asarray(values) for name, values in change.items()}


def grade(flight: dict[str, np.ndarray], **more: object) -> Graded:
    controls = {stick: {"unit": "rad"} for stick in ("lat", "lon", "col", "ped") if stick in flight}
    dataset = Dataset.from_arrays({"f": flight}, identify=["f"], controls=controls)
    return graded(dataset, check(dataset).findings)


def axes(found: Graded) -> dict[str, str]:
    return {one.axis: one.grade for one in found.axes}


def test_what_was_flown_on_every_axis_is_ready():
    found = grade(flown())
    assert (found.grade, found.because) == ("ready", ())
    assert found.sentence == "ready: a model can be identified on roll, pitch, yaw, vertical"


def test_an_axis_that_follows_nothing_limits():
    noise = 0.05 * np.random.default_rng(9).standard_normal(round(SECONDS / DT))
    found = grade(flown(r=noise))
    assert found.grade == "limited"
    assert axes(found) == {"roll": "ready", "pitch": "ready", "yaw": "not usable", "vertical": "ready"}
    assert found.sentence == "limited to roll, pitch, vertical (yaw not usable: r nowhere follows the controls)"


def test_a_channel_of_no_axis_limits_and_leaves_the_axes_ready():
    """The first two lines of `check` do not contradict each other."""
    found = grade(flown(ay=0.5 * np.random.default_rng(7).standard_normal(round(SECONDS / DT))))
    assert (found.grade, {*axes(found).values()}) == ("limited", {"ready"})
    assert found.sentence.startswith("limited: roll, pitch, yaw, vertical ready, other channels with care (ay: ")


def test_a_control_that_rests_limits():
    found = grade(flown(ped=1e-4 * np.random.default_rng(8).standard_normal(round(SECONDS / DT))))
    assert axes(found)["yaw"] == "not usable"


def test_a_stick_that_follows_the_motion_limits():
    flight = flown()
    flight["lat"] = 0.4 * flight["p"]
    assert grade(flight).grade != "ready"


def test_rates_that_nowhere_follow_are_not_usable():
    rng = np.random.default_rng(7)
    noise = {c: 0.05 * rng.standard_normal(round(SECONDS / DT)) for c in ("p", "q", "r")}
    found = grade({c: v for c, v in flown(**noise).items() if c != "az"} | {"w": 0.3 * noise["p"][::-1].copy()})
    assert found.grade == "not usable"
    assert found.because[0] == "roll, pitch, yaw not usable: p, q, r nowhere follow the controls"
    assert found.sentence.startswith("not usable, because p, q, r nowhere follow the controls (roll, pitch, yaw)")


def test_a_bench_is_not_usable():
    flight = flown()
    still = {c: 1e-3 * flight[c] for c in ("p", "q", "r")}
    found = grade(flight | still | {"az": -9.8 + 1e-3 * (flight["az"] + 9.8)})
    assert found.grade == "not usable"
    assert "hardly moves" in found.sentence


def test_an_error_is_not_usable():
    found = grade(flown(az=-flown()["az"]))
    assert found.grade == "not usable"
    assert found.axes == ()


@pytest.mark.parametrize(("change", "code"), [({}, 0), ({"r": None}, 0), ({"az": None}, 3)])
def test_the_command_says_the_grade_first(change: dict, code: int, tmp_path: Path, capsys):
    flight = flown()
    rng = np.random.default_rng(3)
    worse = {"r": 0.05 * rng.standard_normal(len(flight["time"])), "az": -flight["az"]}
    flight |= {name: worse[name] for name in change}
    controls = {stick: {"unit": "rad"} for stick in ("lat", "lon", "col", "ped")}
    write_dataset(tmp_path / "set", {"f": flight}, identify=["f"], controls=controls)
    wanted = {0: "ready" if not change else "limited", 3: "not usable"}[code]
    assert cli.main(["check", str(tmp_path / "set")]) == code
    assert capsys.readouterr().out.splitlines()[0].startswith(f"set: {wanted}")
    assert cli.main(["check", str(tmp_path / "set"), "--json"]) == code
    answer = json.loads(capsys.readouterr().out)
    assert (answer["grade"], answer["fit"]) == (wanted, code == 0)
    assert bool(answer["because"]) == (wanted != "ready")


@pytest.mark.parametrize("name", ["uh60-hover", "ah1-hover"])
def test_clean_shared_sets_are_ready(name: str):
    dataset = load(shared("flightdata", name))
    assert graded(dataset, check(dataset).findings).grade == "ready"


def test_a_head_is_a_clause():
    assert head("late by 0.05 s (± 0.01) (p (x) 0.1): shift it. More.") == "late by 0.05 s"


def test_a_multirotor_has_no_force_along_x_and_y_to_follow_its_motors():
    rng, time = np.random.default_rng(0), 0.01 * np.arange(2000)
    motors = {f"motor{i}": 0.5 + 0.1 * np.sin((1.0 + 0.3 * i) * time) for i in range(1, 5)}
    rates = {name: np.sin((1.3 + i) * time) for i, name in enumerate("pqr")}
    forces = {name: 0.1 * rng.standard_normal(2000) for name in ("ax", "ay")}
    data = Dataset.from_arrays({"f": {"time": time, **motors, **rates, **forces}}, identify=["f"])
    assert not [f for f in band(data) if {"ax", "ay"} & {*f.channel.split()}]
