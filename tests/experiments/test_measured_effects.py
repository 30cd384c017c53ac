"""Effects on measured flights: what is missing is skipped, the table tells who named the effects; one set for real."""

import dataclasses
import json
from importlib import import_module
from pathlib import Path

import pytest

from tests.experiments.test_experiments import quick
from tests.helpers import shared

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")
pytest.importorskip("torch.utils.tensorboard")


def line(name: str, **said: object) -> dict:
    scores = {"before": {"R² of p'": [0.03, 0.0449]}, "after": {"R² of p'": [0.91, 0.74]}}
    return {"case": name, "effects": ["propulsion.motor_lag"], "source": "closed loop (undeclared)"} | scores | said


def test_missing_sets_are_skipped_and_the_table_tells_who_named_the_effects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, given = import_module("measured_effects"), []

    def run(place: Path, effects: object, fallback: object, seed: int) -> dict:
        given.append((place.name, effects, fallback))
        return line(place.name) if place.name == "nanodrone" else {"case": place.name, "failed": "no fit"}

    monkeypatch.setattr(module, "run_set", run)
    for name in ("nanodrone", "trex550-rates"):
        (tmp_path / "data" / name).mkdir(parents=True)
        (tmp_path / "data" / name / "dataset.toml").touch()
    page = tmp_path / "page.md"
    page.write_text("<!-- measured effects: begin -->\n<!-- measured effects: end -->", encoding="utf-8")
    args = module.Args(
        data=tmp_path / "data", sets=("trex550-rates", "nanodrone", "other"), out=tmp_path / "out", page=page
    )
    module.main(args)
    module.main(dataclasses.replace(args, report=True))
    first, _ = map(json.loads, capsys.readouterr().out.splitlines())
    assert list(first["skipped"]) == ["other"]
    assert [g[:2] for g in given] == [("trex550-rates", None), ("nanodrone", None)]  # the loop is asked
    assert given[1][2] == module.GIVEN["nanodrone"]
    told = page.read_text(encoding="utf-8")
    wanted = "| nanodrone | propulsion.motor_lag (closed loop (undeclared)) | R² of p' | 0.030; 0.045 | 0.91; 0.74 |"
    assert wanted in told
    assert "| trex550-rates | no fit |" in told


def test_a_loop_that_fails_leaves_the_given_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    module = import_module("measured_effects")

    def fails(data: object, seed: int) -> None:
        raise ValueError("not here")

    monkeypatch.setattr(module.rotorid, "close_loop", fails)
    effects, source, run = module._effects(None, None, ("control.delay",), 0)
    assert effects == ("control.delay",)
    assert run is None
    assert "ValueError" in source
    assert module._effects(None, (), ("control.delay",), 0) == ((), "given", None)


@pytest.mark.slow
def test_crazyflies_motors_lag(tmp_path: Path) -> None:
    found = quick(
        "studies/measured_effects", tmp_path, "--data", str(shared("flightdata")), "--out", str(tmp_path / "out")
    )
    after = found["sets"]["crazyflie-motors"]
    assert min(after["R² of p'"][0], after["R² of q'"][1], after["R² of az"][0]) > 0.9
    assert after["R² of r'"][0] > 0.87
