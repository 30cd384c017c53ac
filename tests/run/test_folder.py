"""A run is whole or absent: renamed when complete, refused before the work, safe when its process dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from rotorid_torch.errors import InputError
from rotorid_torch.run import folder

OURS = '{"format": 1, "rotorid": "0.1.0", "command": "identify"}'
WRITES_SLOWLY = """
import sys, time
from pathlib import Path
from rotorid_torch.run.folder import run_folder
with run_folder(sys.argv[1]) as partial:
    (partial / "report.json").write_text('{"format": 1, "rotorid": "half"}')
    print("writing", flush=True)
    time.sleep(60)
"""


def write(out: Path, text: str = OURS) -> None:
    with folder.run_folder(out) as partial:
        (partial / "report.json").write_text(text)
        (partial / "figures").mkdir()


def test_run_takes_its_place_when_complete(tmp_path: Path):
    out = tmp_path / "run"
    with folder.run_folder(out) as partial:
        assert not out.exists()
        (partial / "report.json").write_text(OURS)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]
    assert (out / "report.json").read_text() == OURS
    assert out.stat().st_mode & 0o777 == 0o777 & ~current_umask()


def current_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("can_exchange", [True, False])
def test_earlier_run_is_replaced_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, can_exchange: bool):
    if not can_exchange:
        monkeypatch.setattr(folder, "_exchange", lambda one, other: False)
    out = tmp_path / "run"
    write(out)
    (out / "of the earlier run").touch()
    write(out, '{"format": 1, "rotorid": "new"}')
    assert sorted(p.name for p in out.iterdir()) == ["figures", "report.json"]
    assert "new" in (out / "report.json").read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_exception_leaves_the_earlier_run(tmp_path: Path, error: type[BaseException]):
    out = tmp_path / "run"
    write(out)
    with pytest.raises(error):
        break_off(out, error())
    assert (out / "report.json").read_text() == OURS
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]


def break_off(out: Path, error: BaseException) -> None:
    with folder.run_folder(out) as partial:
        (partial / "report.json").write_text("{}")
        raise error


def test_exception_leaves_none_where_none_was(tmp_path: Path):
    with pytest.raises(ValueError, match="x"):
        break_off(tmp_path / "run", ValueError("x"))
    assert list(tmp_path.iterdir()) == []


def test_killed_run_leaves_the_earlier_and_its_leftover_is_cleaned(tmp_path: Path):
    out = tmp_path / "run"
    write(out)
    process = subprocess.Popen([sys.executable, "-c", WRITES_SLOWLY, str(out)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == "writing\n"
    write(out, '{"format": 1, "rotorid": "second"}')
    assert len(list(tmp_path.iterdir())) == 2, "a living run's folder was taken for a leftover"
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert "second" in (out / "report.json").read_text()
    write(out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]


def make_file(place: Path) -> None:
    place.write_text("a letter")


def make_folder(place: Path) -> None:
    place.mkdir()
    (place / "thesis.txt").write_text("ten years of work")


def make_other_report(place: Path) -> None:
    place.mkdir()
    (place / "report.json").write_text("[1, 2]")


def make_dangling_link(place: Path) -> None:
    place.symlink_to(place.parent / "nowhere")


@pytest.mark.parametrize("make", [make_file, make_folder, make_other_report, make_dangling_link, Path.mkdir])
def test_what_is_not_a_run_is_refused_and_kept(tmp_path: Path, make):
    out = tmp_path / "run"
    make(out)
    before = sorted(p.name for p in tmp_path.rglob("*"))
    with pytest.raises(InputError, match="not a run"), folder.run_folder(out):
        pytest.fail("the work began")
    assert sorted(p.name for p in tmp_path.rglob("*")) == before


def test_missing_parent_and_a_file_as_parent_are_refused(tmp_path: Path):
    (tmp_path / "file").touch()
    for parent in ("missing", "file"):
        with pytest.raises(InputError, match="does not exist"), folder.run_folder(tmp_path / parent / "run"):
            pytest.fail("the work began")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_parent_without_write_permission_is_refused(tmp_path: Path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot be written"), folder.run_folder(tmp_path / "run"):
        pytest.fail("the work began")


def test_two_runs_to_one_place_at_once_leave_one_whole(tmp_path: Path):
    out = tmp_path / "run"
    barrier = threading.Barrier(4)

    def work(text: str) -> None:
        barrier.wait()
        with folder.run_folder(out) as partial:
            (partial / "report.json").write_text(text)
            (partial / "copy").write_text(text)

    threads = [threading.Thread(target=work, args=(f'{{"format": 1, "rotorid": "{k}"}}',)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (out / "report.json").read_text() == (out / "copy").read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]


def test_whole_file_appears_complete_or_not_at_all(tmp_path: Path):
    out = tmp_path / "free.npz"
    with pytest.raises(ZeroDivisionError), folder.whole_file(out) as partial:
        partial.write_text(str(1 / 0))
    assert list(tmp_path.iterdir()) == []
    with folder.whole_file(out) as partial:
        assert partial.suffix == ".npz"
        partial.write_text("whole")
    assert [p.name for p in tmp_path.iterdir()] == ["free.npz"]
    with pytest.raises(InputError, match="is a folder"), folder.whole_file(tmp_path):
        pytest.fail("the work began")
