"""What becomes of C++: built once, kept whole, found again, and one sentence where that cannot be."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rotorid_torch.core.native import build
from rotorid_torch.core.native.build import library
from rotorid_torch.core.native.fallback import Unsupported

NUMBER = itertools.count(7)


@pytest.fixture
def source() -> str:
    """Nobody has built it before in this process."""
    return f'extern "C" int answer() {{ return {next(NUMBER)}; }}\n'


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "native"


def compiler_that(folder: Path, does: str) -> str:
    """A compiler that tells its macros and then does something else; it writes a line in `calls` before."""
    program = folder / "compiler"
    program.write_text(f'#!/bin/sh\ncase "$*" in *-dM*) exec g++ "$@";; esac\necho called >> {folder}/calls\n{does}\n')
    program.chmod(0o755)
    return str(program)


def elsewhere(source: str, env: dict[str, str]) -> subprocess.Popen[str]:
    """Another process that builds, loads and answers."""
    code = f"from rotorid_torch.core.native.build import library; print(library({source!r}).answer())"
    return subprocess.Popen([sys.executable, "-c", code], env=env, stdout=subprocess.PIPE, text=True)


def forget() -> None:
    """As a new process would."""
    library.cache_clear()


def test_what_was_built_is_found_again_without_compiling(
    source: str, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CXX", compiler_that(tmp_path, 'exec g++ "$@"'))
    first = library(source).answer()
    assert library(source).answer() == first
    forget()
    assert library(source).answer() == first
    assert (tmp_path / "calls").read_text() == "called\n"
    assert [p.suffix for p in cache.iterdir()] == [".so"]
    library(source + "// another model\n")
    assert len(list(cache.iterdir())) == 2


def test_the_loops_and_the_machine_are_part_of_what_it_is_found_by(
    source: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library(source)
    for name, changed in (("_loops", lambda: "other loops"), ("_target", lambda program: "other machine")):
        forget()
        monkeypatch.setattr(build, name, changed)
        library(source)
    assert len(list(cache.iterdir())) == 3
    forget()


def test_two_processes_that_build_at_once_leave_one_whole_library(source: str, cache: Path, tmp_path: Path) -> None:
    env = {**os.environ, "CXX": compiler_that(tmp_path, 'sleep 1; exec g++ "$@"')}
    both = [elsewhere(source, env) for _ in range(2)]
    told = [process.communicate(timeout=120)[0].strip() for process in both]
    assert told == [str(library(source).answer())] * 2
    assert len(list(cache.iterdir())) == 1
    assert (tmp_path / "calls").read_text().count("called") == 2


def test_no_compiler(source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(Unsupported, match=r"no C\+\+ compiler was found \(g\+\+ on PATH, or CXX=\.\.\.\)"):
        library(source)


def test_a_compiler_that_does_not_work(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "broken"
    program.write_text("#!/bin/sh\necho 'fatal error: no libraries' >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("CXX", str(program))
    with pytest.raises(Unsupported, match="broken does not work: fatal error: no libraries"):
        library(source)


def test_a_compiler_that_refuses_the_source(cache: Path) -> None:
    with pytest.raises(Unsupported, match=r"refuses the model: .*error.*nonsense"):
        library('extern "C" int answer() { return nonsense; }\n')
    assert list(cache.iterdir()) == []


def test_a_compiler_that_never_ends(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", compiler_that(tmp_path, "exec sleep 60"))
    monkeypatch.setattr(build, "LIMIT_S", 0.2)
    with pytest.raises(Unsupported, match=r"took longer than 0\.2 s"):
        library(source)


def test_a_refusal_is_not_asked_for_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = tmp_path / "asked"
    monkeypatch.setenv("CXX", compiler_that(tmp_path, f'echo >> {asked}; exec g++ "$@"'))
    for _ in range(2):
        with pytest.raises(Unsupported, match="refuses the model"):
            library('extern "C" int answer() { return no_such_name; }\n')
    assert (tmp_path / "calls").read_text().splitlines() == ["called"]


def test_a_late_compiler_ends_with_what_it_started(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = tmp_path / "child"
    monkeypatch.setenv("CXX", compiler_that(tmp_path, f"sleep 60 & echo $! > {child}; wait"))
    monkeypatch.setattr(build, "LIMIT_S", 2.0)
    with pytest.raises(Unsupported, match="took longer"):
        library(source + "// late\n")
    state = Path(f"/proc/{int(child.read_text())}/stat")

    def goes_on() -> bool:
        return state.exists() and state.read_text().split()[2] != "Z"

    asked = time.monotonic()  # a signal takes its time on a busy machine, less than what was started would have
    while goes_on() and time.monotonic() < asked + 20.0:
        time.sleep(0.05)
    assert not goes_on()


def test_a_compiler_behind_another_program(source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "env g++")
    assert build.compiler()[1:] == ("g++",)
    library(source)


def test_a_wrong_number_of_threads_is_told(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("ROTORID_THREADS", "two")
    assert build.threads() >= 1
    assert "'two' is no whole number above zero" in caplog.text


def test_a_cache_that_cannot_be_written(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path / "file"))
    with pytest.raises(Unsupported, match=r"cannot be kept in .*file/native: Not a directory"):
        library(source)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_cache(source: str, cache: Path) -> None:
    cache.mkdir(parents=True)
    cache.chmod(0o555)
    with pytest.raises(Unsupported, match=r"cannot be kept in .*: Permission denied"):
        library(source)


def test_a_library_cut_short_is_built_anew(source: str, cache: Path) -> None:
    told = elsewhere(source, dict(os.environ)).communicate(timeout=120)[0].strip()
    (file,) = cache.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(Unsupported, match="cannot be loaded"):
        library(source)
    assert str(library(source).answer()) == told


@pytest.mark.parametrize(
    ("ours", "torchs", "wanted"), [("3", "1", 3), (None, "2", 2), ("", "1", None), (None, None, None)]
)
def test_threads(ours: str | None, torchs: str | None, wanted: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("ROTORID_THREADS", ours), ("OMP_NUM_THREADS", torchs)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1, 2, 3, 4}, raising=False)
    assert build.threads() == (wanted or 5)


@pytest.mark.parametrize(("given", "wanted"), [({}, 5), ({"OMP_NUM_THREADS": "2"}, 2), ({"ROTORID_THREADS": "3"}, 3)])
def test_commands_leave_the_processors_to_native_loops(given: dict[str, str], wanted: int) -> None:
    code = """
import contextlib, os
from rotorid_torch import cli
with contextlib.suppress(SystemExit):
    cli.main(["--help"])
from rotorid_torch.core.native import build
os.sched_getaffinity = lambda process: range(5)
print(build.threads())
"""
    env = {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")} | given
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == str(wanted)


def test_a_compiler_that_cannot_be_started(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "no-program"
    program.write_bytes(b"\0")
    program.chmod(0o755)
    monkeypatch.setenv("CXX", str(program))
    with pytest.raises(Unsupported, match="no-program does not work: Exec format error"):
        library(source)
