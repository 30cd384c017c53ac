"""What is written is whole or absent: over earlier things, on full disks, and where a process dies at any moment."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rotorid_torch.core.storage import atomic
from rotorid_torch.core.storage.atomic import (
    Unwritable,
    atomic_file,
    atomic_folder,
    restore,
    scratch_folder,
    sweep,
    writing,
)

WRITES = """
import os, sys, time
from pathlib import Path
from rotorid_torch.core.storage import atomic
how, place = sys.argv[1], Path(sys.argv[2])
if how == "between":
    atomic._exchange = lambda one, other: False
    earlier_rename = Path.rename
    def rename(self, other):
        if self.name.endswith(".partial"):
            os.kill(os.getpid(), 9)
        return earlier_rename(self, other)
    Path.rename = rename
with atomic.atomic_folder(place, lambda: None) as folder:
    (folder / "new").touch()
    if how == "while writing":
        print("writing", flush=True)
        time.sleep(60)
"""


def writer(how: str, place: Path) -> subprocess.Popen[str]:
    """A process that writes a folder, and dies between two renames or waits to be killed."""
    return subprocess.Popen([sys.executable, "-c", WRITES, how, str(place)], stdout=subprocess.PIPE, text=True)


def write(place: Path, name: str) -> None:
    with atomic_folder(place, lambda: None) as folder:
        (folder / name).touch()


def below(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


@pytest.mark.parametrize("found_by", ["whoever reads", "whoever writes there", "whoever writes beside it"])
def test_what_a_dead_process_has_hidden_is_put_back(tmp_path: Path, found_by: str):
    place = tmp_path / "data"
    write(place, "old")
    dead = writer("between", place)
    dead.communicate()
    assert dead.returncode == -9
    assert not place.exists()
    if found_by == "whoever reads":
        restore(place)
    elif found_by == "whoever writes there":
        with pytest.raises(ZeroDivisionError), atomic_folder(place, lambda: None):
            _ = 1 / 0
    else:
        write(tmp_path / "other", "thing")
    assert below(place) == ["old"]
    sweep(tmp_path)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_what_the_user_has_made_since_stays(tmp_path: Path):
    place = tmp_path / "data"
    write(place, "old")
    writer("between", place).communicate()
    place.mkdir()
    (place / "mine").touch()
    sweep(tmp_path)
    assert below(place) == ["mine"]
    assert len(list(tmp_path.rglob("old"))) == 1  # and nothing of what was hidden is lost


def test_leftovers_of_the_dead_go_and_those_of_the_living_stay(tmp_path: Path):
    both = [writer("while writing", tmp_path / name) for name in ("one", "two")]
    for process in both:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
    both[0].kill()
    both[0].communicate()
    write(tmp_path / "three", "x")
    left = [path.name.split(".")[1] for path in tmp_path.iterdir() if path.name.startswith(".")]
    both[1].kill()
    both[1].communicate()
    assert left == ["two"]


def test_temporary_folders_of_the_dead_go_with_whatever_is_written_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary" / ".scratch.rotorid-01234567.partial" / "inside").mkdir(parents=True)
    write(tmp_path / "data", "x")
    assert below(tmp_path) == ["data", "data/x", "temporary"]


def test_files_that_are_alike_but_not_ours_stay(tmp_path: Path):
    names = [".x.partial", ".x.rotorid-0123.partial", "x.rotorid-01234567.partial", ".x.rotorid-0123456g.partial"]
    for name in names:
        (tmp_path / name).touch()
    sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_leftovers_of_other_users_stay(tmp_path: Path):
    other = tmp_path / ".x.rotorid-01234567.partial"
    other.touch()
    os.chown(other, 12345, 12345)
    sweep(tmp_path)
    assert other.exists()


def test_a_folder_takes_the_place_that_another_one_took_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for can_exchange in (True, False):
        place = tmp_path / f"data {can_exchange}"
        if not can_exchange:
            monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
        with atomic_folder(place, lambda: None) as first:
            (first / "first").touch()
            write(place, "second")
        assert below(place) == ["first"]
    assert len(list(tmp_path.iterdir())) == 2


def test_a_folder_without_permission_to_be_replaced_stays(tmp_path: Path):
    write(tmp_path / "data", "old")

    def refuse() -> None:
        if any(tmp_path.glob(".data.*")):
            raise ValueError("changed meanwhile")

    with pytest.raises(ValueError, match="changed meanwhile"), atomic_folder(tmp_path / "data", refuse) as folder:
        (folder / "new").touch()
    assert below(tmp_path) == ["data", "data/old"]


def test_scratch_is_private_and_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with scratch_folder() as folder:
        assert folder.stat().st_mode & 0o777 == 0o700
        with atomic_file(folder / "inside") as file:
            file.touch()
        assert below(folder) == ["inside"]
    assert not list(tmp_path.iterdir())


def no_folder(place: Path) -> None:
    """Nothing lies above the place."""


def a_file(place: Path) -> None:
    place.parent.touch()


@pytest.mark.parametrize(("make", "told"), [(no_folder, "does not exist"), (a_file, "is not a folder")])
def test_a_place_without_a_folder_is_refused(tmp_path: Path, make: Callable[[Path], None], told: str):
    place = tmp_path / "above" / "place"
    make(place)
    with pytest.raises(Unwritable, match=f"above/place: its folder .*above {told}"):
        atomic.refuse_unless_writable(place)


def test_a_name_that_is_too_long_is_refused(tmp_path: Path):
    with pytest.raises(Unwritable, match="File name too long"):
        atomic.refuse_unless_writable(tmp_path / ("x" * 250))


def test_folders_that_will_be_made_are_not_missed_but_made_by_nobody(tmp_path: Path):
    atomic.refuse_unless_writable(tmp_path / "deep" / "deeper" / "place", parents=True)
    assert not list(tmp_path.iterdir())
    (tmp_path / "deep").touch()
    with pytest.raises(Unwritable, match="deep is not a folder"):
        atomic.refuse_unless_writable(tmp_path / "deep" / "deeper" / "place", parents=True)


@pytest.mark.skipif(not Path("/sys/kernel").exists(), reason="needs a file system that nobody can write to")
def test_a_read_only_place_is_refused():
    with pytest.raises(Unwritable, match="/sys/kernel/run: its folder /sys/kernel cannot be written to"):
        atomic.refuse_unless_writable(Path("/sys/kernel/run"))


@pytest.mark.parametrize(
    "error",
    [OSError(errno.ENOSPC, "No space left"), OSError("800 requested and 0 written"), OSError(errno.EDQUOT, "Quota")],
)
def test_a_full_disk_is_told_with_the_place(tmp_path: Path, error: OSError):
    with pytest.raises(Unwritable, match=f"{tmp_path}/run: cannot be written to"):
        fail(tmp_path / "run", error)
    assert not list(tmp_path.iterdir())


def fail(place: Path, error: OSError) -> None:
    with atomic_folder(place, lambda: None):
        raise error


@pytest.mark.parametrize("error", [FileNotFoundError(2, "none", "/a/flight.npz"), OSError(errno.ENOMEM, "memory")])
def test_what_is_no_matter_of_the_place_is_told_as_it_is(tmp_path: Path, error: OSError):
    with pytest.raises(type(error)) as told:
        fail(tmp_path / "run", error)
    assert told.value is error


def test_a_reader_that_left_is_no_full_disk():
    with pytest.raises(BrokenPipeError), writing("standard output"):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")


def test_no_temporary_folder_is_told(monkeypatch: pytest.MonkeyPatch):
    def none() -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", none)
    monkeypatch.setenv("TMPDIR", "/full")
    with pytest.raises(Unwritable, match="/full: cannot be written to; expected room for temporary files"):
        scratch_folder().__enter__()
