"""Several processes on one data set: the numbers of one, a lost one told, an interrupted run taken up again."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from rotorid_torch.commands.console import PlainConsole
from rotorid_torch.core.processes.ranks import Ranks
from rotorid_torch.data import load
from rotorid_torch.errors import InputError
from rotorid_torch.report.records import Report, read_report
from rotorid_torch.run import pipeline
from rotorid_torch.run.output import checkpoint as checkpointing
from rotorid_torch.run.output.checkpoint import Checkpoint, Steps, checkpoint
from rotorid_torch.run.output.monitor import Monitor
from tests.known_models import flown, manoeuvres, rate_vehicle, written
from tests.processes import ended, of_ranks, wait_until, write_earlier

DT = 0.04
LISTS = {"identify": ["f_lon", "f_lat", "f_col"], "validate": ["f_ped"]}
PROGRAM = [sys.executable, "-m", "rotorid_torch"]
STOPPED_AFTER_STEP_1 = """
import os, signal, sys
from rotorid_torch import cli
from rotorid_torch.run import pipeline
pipeline.propose = lambda *told: os.kill(os.getpid(), int(sys.argv[1]))
sys.exit(cli.main(sys.argv[2:]))
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = flown(rate_vehicle(), manoeuvres(9.0, DT), DT, noise=0.02, lists=LISTS)
    return written(made, tmp_path_factory.mktemp("sets") / "rates")


@pytest.fixture(scope="module")
def straight(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Report:
    out = tmp_path_factory.mktemp("straight") / "run"
    pipeline.identify(load(data), out=out)
    return read_report(out)


def test_two_ranks_come_to_the_numbers_of_one(data: Path, straight: Report, tmp_path: Path):
    codes, told, errors = ended(of_ranks(2, [*PROGRAM, "identify", str(data), "--out", str(tmp_path / "run")]))
    assert codes == [0, 0], errors
    assert errors == ["", ""]
    assert "report:" in told[0]
    assert told[1] == ""
    got = read_report(tmp_path / "run")
    assert got.before is not None
    assert straight.before is not None
    for one, other in zip(straight.before.parameters, got.before.parameters, strict=True):
        assert other.value == pytest.approx(one.value, rel=1e-9, abs=1e-9 * (one.se or 0.0))
        assert other.se == pytest.approx(one.se, rel=1e-9)
        assert (other.status, other.at_bound) == (one.status, one.at_bound)
    assert set(got.before.flights) == set(straight.before.flights)
    for name, flight in straight.before.flights.items():
        assert got.before.flights[name].J == pytest.approx(flight.J, rel=1e-9)
    assert got.before.scores.validate == pytest.approx(straight.before.scores.validate, rel=1e-9)
    assert got.warnings == straight.warnings
    assert {p.stem for p in (tmp_path / "run" / "reconstruct").iterdir()} == {"f_lon", "f_lat", "f_col", "f_ped"}
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_more_ranks_than_flights_are_refused(data: Path):
    with pytest.raises(InputError, match="started 4 processes; expected 3 at most for 3 flights"):
        pipeline.identify(load(data), ranks=Ranks(0, 4))


@pytest.mark.slow
def test_what_all_ranks_refuse_is_told_once(tmp_path: Path):
    codes, _, errors = ended(
        of_ranks(2, [*PROGRAM, "identify", str(tmp_path / "none"), "--out", str(tmp_path / "run")])
    )
    assert codes == [2, 2]
    assert "".join(errors).count("\n") == 1
    assert "there is no such folder" in "".join(errors)
    assert not list(tmp_path.iterdir())


def test_usage_is_refused_once_for_all_ranks():
    codes, _, errors = ended(of_ranks(2, [*PROGRAM, "identify"]))
    assert codes == [2, 2]
    assert errors[1] == ""
    assert errors[0].count("\n") == 1


@pytest.mark.parametrize("lost", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_lost_rank_ends_the_run_with_one_line(data: Path, tmp_path: Path, lost: int):
    out = tmp_path / "run"
    write_earlier(out)
    before = (out / "report.json").read_bytes()
    processes = of_ranks(2, [*PROGRAM, "identify", str(data), "--out", str(out), "--quiet"])
    wait_until((tmp_path / ".run.checkpoint" / "reconstruct-f_lon.pt").exists)
    processes[lost].kill()
    begin = time.monotonic()
    codes, _, errors = ended(processes)
    assert time.monotonic() - begin < 60.0
    assert codes[1 - lost] == 1
    assert errors[1 - lost].count("\n") == 1
    assert "a process of this run is lost" in errors[1 - lost]
    assert (out / "report.json").read_bytes() == before


@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_resume_gives_what_a_straight_run_gives(data: Path, straight: Report, tmp_path: Path, how: signal.Signals):
    out = tmp_path / "run"
    arguments = ["identify", str(data), "--out", str(out), "--quiet", "--resume"]
    stopped = subprocess.run([sys.executable, "-c", STOPPED_AFTER_STEP_1, str(int(how)), *arguments], check=False)
    assert stopped.returncode == (-9 if how == signal.SIGKILL else 130)
    assert not out.exists()
    assert (tmp_path / ".run.checkpoint" / "reconstruct.pt").exists()
    subprocess.run([*PROGRAM, *arguments], check=True)
    got, log = read_report(out), (out / "log.txt").read_text(encoding="utf-8")
    assert got.before == straight.before
    assert got.warnings == straight.warnings
    assert "reconstruct: taken from the interrupted run" in log
    assert "ml: taken" not in log
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_every_step_taken_up_gives_the_same(
    data: Path, straight: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "judge", stopped)
        with pytest.raises(KeyboardInterrupt):
            pipeline.identify(load(data), out=out, resume=True)
    run = pipeline.identify(load(data), out=out, resume=True)
    log = (out / "log.txt").read_text(encoding="utf-8")
    for step in ("reconstruct", "structure", "ftr", "ml"):
        assert f"{step}: taken from the interrupted run" in log
    assert read_report(out).before == straight.before
    assert read_report(out).warnings == straight.warnings
    assert run.reconstruction.flights["f_lat"].innovations.keys() == {"p", "q", "r"}


def stopped(*told: object) -> None:
    raise KeyboardInterrupt


def test_without_resume_an_interrupted_run_leaves_nothing(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pipeline, "propose", stopped)
    with pytest.raises(KeyboardInterrupt):
        pipeline.identify(load(data), out=tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_a_run_that_is_interrupted_while_it_begins_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(checkpointing.json, "dumps", stopped)
    with pytest.raises(KeyboardInterrupt), checkpoint(tmp_path / "run", {"seed": "0"}, resume=False, keep=False):
        pytest.fail("the work began")
    assert not list(tmp_path.iterdir())


def interrupted(out: Path, key: dict[str, str], **results: object) -> None:
    """Leave the checkpoint of a run that did not end."""
    with suppress(KeyboardInterrupt), checkpoint(out, key, resume=True, keep=True) as kept:
        for name, result in results.items():
            kept.write(name, result, pytest.fail)
        raise KeyboardInterrupt


def test_another_run_is_not_taken_up(tmp_path: Path):
    out = tmp_path / "run"
    interrupted(out, {"data set": "one", "seed": "0"}, first=1.0)
    with (
        pytest.raises(InputError) as refusal,
        checkpoint(out, {"data set": "two", "seed": "0"}, resume=True, keep=True),
    ):
        pass
    assert refusal.value.key == "--resume"
    assert "another data set (one)" in refusal.value.wrong
    with checkpoint(out, {"data set": "one", "seed": "0"}, resume=True, keep=True) as kept:
        assert kept.read("first") == 1.0
        with (
            pytest.raises(InputError, match="another run is writing"),
            checkpoint(out, {"data set": "one", "seed": "0"}, resume=True, keep=True),
        ):
            pass
    assert not list(tmp_path.iterdir())


def test_a_run_from_the_beginning_forgets_the_interrupted_one(tmp_path: Path):
    interrupted(tmp_path / "run", {"seed": "0"}, first=1.0)
    with checkpoint(tmp_path / "run", {"seed": "0"}, resume=False, keep=False) as kept:
        assert kept.read("first") is None


def test_a_file_cut_short_is_a_step_not_finished(tmp_path: Path):
    kept = Checkpoint(tmp_path)
    kept.write("step", {"values": np.arange(1000.0)}, pytest.fail)
    np.testing.assert_array_equal(kept.read("step")["values"], np.arange(1000.0))
    whole = (tmp_path / "step.pt").read_bytes()
    one = np.array([1.0, 2.0, 3.0]).tobytes()
    for damaged in (whole[: len(whole) // 2], whole.replace(one, one[::-1])):
        (tmp_path / "step.pt").write_bytes(damaged)
        assert kept.read("step") is None
    (tmp_path / "step.pt").write_bytes(whole)
    assert kept.read("step") is not None


def test_a_full_disk_ends_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rotorid_torch.run.output.checkpoint.write_sealed", full)
    steps = Steps(Monitor(PlainConsole()), Ranks(), Checkpoint(tmp_path))
    assert steps.do("structure", "structure", lambda: "made") == "made"
    said = capsys.readouterr()
    assert "No space left on device" in said.out
    assert said.err == ""
    assert Checkpoint(tmp_path).read("structure") is None
