"""scripts/bench.py in its quick form: the table is told, JSON holds the rows, what cannot be measured says why."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import ROOT, shared

KEYS = ["name", "value", "unit", "against", "ratio", "bar", "met"]


def bench(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "scripts" / "bench.py"), "--quick", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_rows_without_anchors_or_data_are_told_and_the_others_measured(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    done = bench("--only", "A-1", "reconstruct", "help", "--data", str(tmp_path), "--json", str(file))
    assert done.returncode == 0, done.stderr
    assert "not measured: no anchors" in done.stdout
    assert "not measured: no data set" in done.stdout
    rows = {row["name"]: row for row in json.loads(file.read_text())}
    assert all(list(row) == KEYS for row in rows.values())
    assert rows["A-1"]["value"] is None
    assert rows["A-1"]["met"] is None
    assert rows["A-1"]["bar"] == 1.5
    assert 0.0 < rows["help"]["value"]
    assert rows["help"]["met"] == (rows["help"]["value"] <= 3.0)


def test_help_is_told_to_import_no_torch() -> None:
    done = bench("--only", "help-torch")
    assert done.returncode == 0, done.stderr
    assert "0 times" in done.stdout


@pytest.mark.parametrize("wrong", [("--only", "C-1"), ("--repeats", "0"), ("--json", "no-such-folder/rows.json")])
def test_bad_usage_is_one_line_before_anything_is_measured(wrong: tuple[str, str]) -> None:
    done = bench(*wrong)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert wrong[1] in done.stderr


@pytest.mark.slow
def test_the_filter_agrees_with_the_anchors_and_is_held_against_them(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    anchors = str(shared("perf"))
    bench("--only", "A-10", "accuracy-A-cpp", "--anchors", anchors, "--json", str(file), "--profile")
    rows = {row["name"]: row for row in json.loads(file.read_text())}
    assert rows["accuracy-A-cpp"]["met"]
    assert 0.1 < rows["A-10"]["ratio"] < 50.0
    assert rows["A-10"]["met"] == (rows["A-10"]["ratio"] <= 1.3)
