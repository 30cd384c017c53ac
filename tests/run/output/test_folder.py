"""A run is whole or absent: renamed when complete, refused before the work, safe when its process dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from rotorid_torch.core.storage import atomic
from rotorid_torch.errors import InputError
from rotorid_torch.run.output import folder
from tests.helpers import small_folder

OURS = '{"format": 1, "rotorid": "0.1.0", "command": "identify"}'
WRITES_SLOWLY = """
import sys, time
from pathlib import Path
from rotorid_torch.run.output.folder import run_folder
with run_folder(sys.argv[1], "identify") as partial:
    (partial / "report.json").write_text('{"format": 1, "rotorid": "half", "command": "identify"}')
    print("writing", flush=True)
    time.sleep(60)
"""


def write(out: Path, text: str = OURS) -> None:
    with folder.run_folder(out, "identify") as partial:
        (partial / "report.json").write_text(text)
        (partial / "figures").mkdir()


def test_run_takes_its_place_when_complete(tmp_path: Path):
    out = tmp_path / "run"
    with folder.run_folder(out, "identify") as partial:
        assert not out.exists()
        (partial / "report.json").write_text(OURS)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]
    assert (out / "report.json").read_text() == OURS
    assert out.stat().st_mode & 0o777 == 0o777 & ~current_umask()


def current_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("name", ["report.html", "report.DOCX", "run.pdf", "run.json", "model.pt"])
def test_a_run_does_not_take_the_name_of_a_file(tmp_path: Path, name: str):
    with pytest.raises(InputError, match=f"{name}: ends with .*, and a run is a folder"):
        write(tmp_path / name)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("name", ["run.2", "uh60-0.5", "run.v2", "gusts.auto", ".run", "earlier.html"])
def test_a_folder_with_a_dot_in_its_name_is_none_of_a_file(tmp_path: Path, name: str):
    if name == "earlier.html":
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.json").write_text(OURS)
    write(tmp_path / name)
    assert (tmp_path / name / "report.json").is_file()


@pytest.mark.parametrize("can_exchange", [True, False])
def test_earlier_run_is_replaced_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, can_exchange: bool):
    if not can_exchange:
        monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
    out = tmp_path / "run"
    write(out)
    (out / "figures" / "of the earlier run.png").touch()
    write(out, '{"format": 1, "rotorid": "new", "command": "close-loop"}')
    assert sorted(p.name for p in out.rglob("*")) == ["figures", "report.json"]
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
    with folder.run_folder(out, "identify") as partial:
        (partial / "report.json").write_text("{}")
        raise error


@pytest.mark.parametrize("moment", [1, 2, 3])
def test_an_interrupt_while_something_is_removed_leaves_nothing(tmp_path: Path, monkeypatch, moment: int):
    out, removals, rmdir = tmp_path / "run", [], os.rmdir
    write(out)

    def interrupted(*place, **more) -> None:
        removals.append(place)
        if len(removals) == moment:
            raise KeyboardInterrupt
        rmdir(*place, **more)

    monkeypatch.setattr(os, "rmdir", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(out, OURS.replace("0.1.0", "new"))
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    assert (out / "figures").is_dir()


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
    write(out, '{"format": 1, "rotorid": "second", "command": "identify"}')
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
    with pytest.raises(InputError, match="not a run"), folder.run_folder(out, "identify"):
        pytest.fail("the work began")
    assert sorted(p.name for p in tmp_path.rglob("*")) == before


def test_missing_parent_and_a_file_as_parent_are_refused(tmp_path: Path):
    (tmp_path / "file").touch()
    for parent, told in (("missing", "does not exist"), ("file", "is not a folder")):
        with pytest.raises(InputError, match=told):
            folder.refuse_unless_free(tmp_path / parent / "run", "identify")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_parent_without_write_permission_is_refused(tmp_path: Path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot be written"), folder.run_folder(tmp_path / "run", "identify"):
        pytest.fail("the work began")


def test_two_runs_to_one_place_at_once_leave_one_whole(tmp_path: Path):
    out = tmp_path / "run"
    barrier = threading.Barrier(4)

    def work(text: str) -> None:
        barrier.wait()
        with folder.run_folder(out, "identify") as partial:
            (partial / "report.json").write_text(text)
            (partial / "log.txt").write_text(text)

    threads = [threading.Thread(target=work, args=(OURS.replace("0.1.0", str(k)),)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (out / "report.json").read_text() == (out / "log.txt").read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]


def test_dots_at_the_end_of_a_path_are_no_name(tmp_path: Path):
    write(tmp_path / "run")
    write(tmp_path / "run" / "figures" / "..", '{"format": 1, "rotorid": "new", "command": "identify"}')
    assert "new" in (tmp_path / "run" / "report.json").read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]


@pytest.mark.parametrize("earlier", ["check", "reconstruct", "identify", "close-loop"])
@pytest.mark.parametrize("command", ["check", "reconstruct", "identify", "close-loop"])
def test_a_command_replaces_runs_of_its_kind_alone(tmp_path: Path, earlier: str, command: str):
    out = tmp_path / "run"
    text = OURS.replace("identify", earlier)
    with folder.run_folder(out, earlier) as partial:
        (partial / "report.json").write_text(text)
    if earlier == command or {earlier, command} == {"identify", "close-loop"}:
        folder.refuse_unless_free(out, command)
        return
    with pytest.raises(InputError, match=f"is in the way and is a run of {earlier}"):
        folder.refuse_unless_free(out, command)
    assert (out / "report.json").read_text() == text


@pytest.mark.parametrize("name", ["notes.txt", "figures/mine.svg", "data/flights/one.npz", ".hidden"])
def test_a_run_that_holds_files_of_others_is_kept(tmp_path: Path, name: str):
    out = tmp_path / "run"
    write(out)
    (out / name).parent.mkdir(parents=True, exist_ok=True)
    (out / name).write_text("mine")
    with pytest.raises(InputError, match=f"{name}: would be deleted, and is no part of a run"):
        write(out)
    assert (out / name).read_text() == "mine"


def write_free_run(out: Path, value: float, **more) -> None:
    with folder.free_run_file(out, **more) as partial, partial.open("wb") as file:
        np.savez(file, time=[value])  # pyright: ignore[reportArgumentType]


def test_a_free_run_appears_complete_or_not_at_all_and_replaces_an_earlier_one(tmp_path: Path):
    out = tmp_path / "free.npz"
    with pytest.raises(ZeroDivisionError):
        write_free_run(out, 1 / 0)
    assert list(tmp_path.iterdir()) == []
    for value in (1.0, 2.0):
        write_free_run(out, value)
        assert dict(np.load(out)) == {"time": [value]}
    assert [p.name for p in tmp_path.iterdir()] == ["free.npz"]


def make_npz(place: Path) -> None:
    with place.open("wb") as file:
        np.savez(file, time=[0.0])  # pyright: ignore[reportArgumentType]


def make_link_to_free_run(place: Path) -> None:
    write_free_run(place.with_name("other.npz"), 1.0)
    place.symlink_to("other.npz")


OTHERS = [make_file, make_npz, make_folder, make_dangling_link, make_link_to_free_run, Path.touch, os.mkfifo]


@pytest.mark.parametrize("make", OTHERS)
def test_what_is_no_free_run_is_refused_and_kept(tmp_path: Path, make):
    out = tmp_path / "free.npz"
    make(out)
    before = out.lstat()
    with pytest.raises(InputError, match=r"is in the way and is not a free run|is a folder|is not a file"):
        write_free_run(out, 1.0)
    assert (out.lstat().st_ino, out.lstat().st_size) == (before.st_ino, before.st_size)


@pytest.mark.parametrize("make", [make_file, make_npz, make_dangling_link, make_link_to_free_run])
def test_a_file_is_replaced_where_the_user_insists(tmp_path: Path, make):
    out = tmp_path / "free.npz"
    make(out)
    write_free_run(out, 3.0, overwrite=True)
    assert not out.is_symlink()
    assert dict(np.load(out)) == {"time": [3.0]}


@pytest.mark.parametrize("make", [make_folder, os.mkfifo])
def test_what_is_no_file_is_not_replaced_where_the_user_insists(tmp_path: Path, make):
    out = tmp_path / "free.npz"
    make(out)
    with pytest.raises(InputError, match=r"is a folder|is not a file"):
        write_free_run(out, 3.0, overwrite=True)


def same(out: Path) -> Path:
    return out


def linked(out: Path) -> Path:
    out.with_name("link.npz").symlink_to(out)
    return out.with_name("link.npz")


def hard_linked(out: Path) -> Path:
    out.with_name("hard.npz").hardlink_to(out)
    return out.with_name("hard.npz")


def around(out: Path) -> Path:
    (out.parent / "folder").mkdir()
    return out.parent / "folder" / ".." / out.name


@pytest.mark.parametrize("name", [same, linked, hard_linked, around])
@pytest.mark.parametrize("free_run", [True, False])
def test_a_file_that_is_read_is_replaced_by_nothing(tmp_path: Path, name, free_run: bool):
    flight = tmp_path / "flight.npz"
    (write_free_run(flight, 1.0) if free_run else make_npz(flight))
    before = flight.read_bytes()
    out = name(flight)
    with pytest.raises(InputError, match="which is read"):
        write_free_run(out, 3.0, overwrite=True, inputs=[flight])
    assert flight.read_bytes() == out.read_bytes() == before


@pytest.mark.parametrize("part", ["flights", "truth"])
@pytest.mark.parametrize("command", ["check", "reconstruct", "identify", "close-loop"])
def test_no_run_is_written_among_the_flights_of_a_data_set(tmp_path: Path, part: str, command: str):
    small_folder(tmp_path / "set")
    (tmp_path / "set" / part).mkdir(exist_ok=True)
    with pytest.raises(InputError, match=f"lies in {part} of the data set"):
        folder.refuse_unless_free(tmp_path / "set" / part / "run", command)
    folder.refuse_unless_free(tmp_path / "set" / "run", command)


@pytest.mark.parametrize("name", ["run/report.json", "run/model.pt", "run/reconstruct/new.npz", "set/flights/new.npz"])
@pytest.mark.parametrize("linked_folder", [True, False])
def test_no_free_run_becomes_a_part_of_a_run_or_a_data_set(tmp_path: Path, name: str, linked_folder: bool):
    small_folder(tmp_path / "set")
    write(tmp_path / "run")
    out = tmp_path / name
    out.parent.mkdir(exist_ok=True)
    if linked_folder:
        (tmp_path / "link").symlink_to(out.parent)
        out = tmp_path / "link" / out.name
    with pytest.raises(InputError, match="has the name of a file of"):
        write_free_run(out, 1.0, overwrite=True)
    write_free_run(tmp_path / "set" / "free.npz", 1.0)
    write_free_run(tmp_path / "run" / "free.npz", 1.0)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everywhere")
def test_an_input_that_cannot_be_reached_is_told_by_its_reader(tmp_path: Path):
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "model.pt").touch()
    (tmp_path / "model").chmod(0)
    folder.refuse_unless_free_run(tmp_path / "free.npz", inputs=[tmp_path / "model" / "model.pt"])
