"""The study of kills, damage and full disks: what it calls whole, and its quick form."""

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.helpers import ROOT

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")


def test_numbers_leave_out_times_and_nothing_else(tmp_path: Path) -> None:
    trials = import_module("torture_study.trials")
    for name, seconds, value in (("one", 1.0, 2.0), ("late", 9.0, 2.0), ("other", 1.0, 3.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.json").write_text(json.dumps({"time_s": seconds, "before": value}))
        (tmp_path / name / "log.txt").write_text(str(seconds))
        (tmp_path / name / "model.pt").write_bytes(b"model")
    one, late, other = (trials.numbers(tmp_path / name) for name in ("one", "late", "other"))
    assert trials.differences(one, late) == ""
    assert trials.differences(one, other) == "report.json"
    (tmp_path / "late" / "model.pt").write_bytes(b"mode")
    assert trials.differences(one, trials.numbers(tmp_path / "late")) == "model.pt"


def test_processes_and_files_that_a_command_leaves_are_seen(tmp_path: Path) -> None:
    study, trials = import_module("torture"), import_module("torture_study.trials")
    place = trials.Place(tmp_path / "place")
    for folder in (place.work, place.tmp, place.cache):
        folder.mkdir(exist_ok=True)
        (folder / "left").touch()
    assert len(study.leftovers(place, [])) == 3
    assert place.lingering_s() < 1.0
    waiting = ["sh", "-c", "echo ready; read line"]  # no exec after its word: during one, no environment can be read
    with subprocess.Popen(waiting, env=place.environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        assert list(place.alive()) == [process.pid]
        process.kill()


@pytest.mark.parametrize("damage", ["LIBRARY_DAMAGES", "FLOOR_DAMAGES"])
def test_every_damage_changes_the_file(tmp_path: Path, damage: str) -> None:
    study, damages = import_module("torture_study.trials"), getattr(import_module("torture_study.damages"), damage)
    rng = import_module("numpy").random.default_rng(0)
    kept = json.dumps({"gains": {"a": 1.0}, "alike": True, "constants": "?" * 9000}).encode()
    constants = import_module("struct").pack("<3d", 0.125, 0.5, 2.0)
    for name, change in damages.items():
        file = tmp_path / name / "0.so"
        file.parent.mkdir()
        file.write_bytes(kept if damage == "FLOOR_DAMAGES" else kept + constants)
        (file.parent / "1.so").write_bytes(b"another")
        (file.parent / "9.json").write_bytes(b"another")
        before = study.content(file), file.lstat()
        try:
            change(file, rng)
        except (PermissionError, StopIteration):  # not root, or another system
            continue
        after = file.lstat()
        same = study.content(file) == before[0] and file.is_file()
        assert not same or (after.st_mode, after.st_uid) != (before[1].st_mode, before[1].st_uid), name


def test_quick_study_finds_no_fault_and_continues_where_it_stopped(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "experiments" / "studies" / "torture.py"), "--quick", "--out", str(tmp_path)]
    for _ in range(2):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        assert json.loads(done.stdout.splitlines()[-1]) == {"trials": 2, "faulty": {}}
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 2
