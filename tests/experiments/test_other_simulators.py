"""Other people's simulators: what is missing is skipped with a reason, what has a line is not run again; the table."""

import dataclasses
import json
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.run.folder import run_folder
from tests.experiments.test_experiments import quick
from tests.helpers import shared

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")
pytest.importorskip("torch.utils.tensorboard")


def line(name: str, **said: object) -> dict:
    scores = {"validate": 0.25, "acid": None}
    told = {"J": dict.fromkeys(("before", "after", "noise"), scores), "verdict": "structure", "sentence": "Inflow."}
    told |= {"parameters": {}}
    return {"case": name, "hidden": None, "seconds": 61.2} | told | said


def test_missing_sets_are_skipped_and_finished_ones_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, calls = import_module("other_simulators"), []

    def run(place: Path, out: Path, seed: int, hide: str) -> dict:
        calls.append(place.name)
        return line(place.name) if len(calls) > 1 else {"case": place.name, "hidden": None, "failed": "no fit"}

    monkeypatch.setattr(module, "run_set", run)
    for name in ("uh60-hover", "ah1-hover"):
        (tmp_path / "data" / name).mkdir(parents=True)
        (tmp_path / "data" / name / "dataset.toml").touch()
    args = module.Args(data=tmp_path / "data", sets=("uh60-hover", "ah1-hover", "uh60-x9"), out=tmp_path / "out")
    for _ in range(2):
        module.main(dataclasses.replace(args))
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert list(first["skipped"]) == ["uh60-x9"]
    assert (first["runs"], second["runs"]) == (2, 1)
    assert calls == ["uh60-hover", "ah1-hover", "uh60-hover"]
    assert second["verdicts"] == {"uh60-hover": "structure", "ah1-hover": "structure"}


def test_a_set_is_closed_into_a_run_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = import_module("other_simulators")

    def close_loop(data: object, out: Path, seed: int) -> None:
        with run_folder(out, "close-loop") as folder:
            (folder / "report.json").touch()
        raise ValueError(f"{data} {seed}")

    monkeypatch.setattr(module.rotorid, "close_loop", close_loop)
    monkeypatch.setattr(module.rotorid, "load", lambda place: place.name)
    found = module.run_set(tmp_path / "uh60-x1", tmp_path / "out" / "runs", 5)
    assert found["failed"] == "ValueError: uh60-x1 5"
    assert (tmp_path / "out" / "runs" / "uh60-x1" / "report.json").exists()


def test_a_cause_is_put_into_the_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module, seen = import_module("other_simulators"), []
    time = np.arange(0.0, 4.0, 0.01)
    channels = {"time": time, "lat": np.sin(time), "p": np.cos(time)}
    data = Dataset.from_arrays({"f": channels}, identify=["f"], controls={"lat": {"unit": "rad"}})

    def close_loop(dataset: Dataset, out: Path, seed: int) -> None:
        seen.append(dataset.flights["f"])
        raise ValueError("seen")

    monkeypatch.setattr(module.rotorid, "close_loop", close_loop)
    monkeypatch.setattr(module.rotorid, "load", lambda place: data)
    found = module.run_set(tmp_path / "uh60-hover", tmp_path / "out", 5, "control.delay")
    assert found["case"] == "uh60-hover control.delay"
    assert found["hidden"] == ("control.delay",)
    assert found["failed"] == "ValueError: seen"
    early, held = seen[0].channels["lat"].numpy(), seen[0].channels["p"].numpy()
    assert np.nanmax(np.abs(early - np.sin(time + 0.06))) < 1e-4
    assert np.isnan(early).sum() < 12
    assert np.array_equal(held, np.cos(time))


def test_table_has_a_row_for_each_set_in_their_order(tmp_path: Path) -> None:
    module = import_module("other_simulators")
    text = module.table(
        [line("uh60-x1"), line("uh60-hover", hidden=[]), {"case": "x", "hidden": None, "failed": "why"}]
    )
    rows = text.splitlines()[2:]
    assert rows[0] == "| uh60-hover | nothing | Inflow. | 0.250 | 0.250 | 0.250 |  |  |  | 61 |"
    assert rows[1].startswith("| uh60-x1 | not told |")
    assert rows[2].startswith("| x | not told | why |")
    assert len({row.count("|") for row in text.splitlines()}) == 1


@pytest.mark.slow
def test_the_first_set_is_closed(tmp_path: Path) -> None:
    data = shared("flightdata")
    result = quick("other_simulators", tmp_path, "--data", str(data), "--out", str(tmp_path / "study"))
    assert result["runs"] == 1
    assert result["verdicts"]["uh60-hover"] in ("nothing undeclared", "structure")
    assert (tmp_path / "study" / "runs" / "uh60-hover" / "report.json").exists()
