"""What becomes of C++: built once, kept whole, found again, and one sentence where that cannot be."""

from __future__ import annotations

import ctypes
import itertools
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rotorid_torch.core.native import build
from rotorid_torch.core.native.build import library
from rotorid_torch.errors import Unsupported
from tests.processes import goes_on, wait_until

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
    build._loaded.clear()


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
    assert not cache.exists()


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
    wait_until(lambda: not goes_on(int(child.read_text())))  # a signal takes its time on a busy machine


def test_a_compiler_behind_another_program(source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "env g++")
    assert build.compiler()[1:] == ("g++",)
    library(source)


def test_a_wrong_number_of_threads_is_told(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setenv("ROTORID_THREADS", "two")
    assert build.threads() >= 1
    assert "'two' is no whole number above zero" in caplog.text


def test_a_cache_that_cannot_be_written_is_done_without(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path / "file"))
    assert library(source).answer() > 0
    (said,) = caplog.messages
    assert said == f"{tmp_path}/file/native: nothing can be kept there (Not a directory); it is made anew each time"


def test_no_room_to_compile(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(Unsupported, match=r"cannot be compiled: .*nowhere: cannot be written to"):
        library(source)


def set_zeros(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[64:512] = bytes(448)
    file.write_bytes(content)


def change_constant(file: Path) -> None:
    content = file.read_bytes()
    assert content.count(CONSTANT) == 1
    file.write_bytes(content.replace(CONSTANT, struct.pack("<d", 0.25)))


def cut(part: float) -> Callable[[Path], None]:
    return lambda file: os.truncate(file, int(part * file.stat().st_size))


def put_foreign(file: Path) -> None:
    """Another library of ours, whole."""
    other = 'extern "C" double constant() { return 8.0; }\n'
    library(other)
    (other_file,) = set(file.parent.glob("*.so")) - {file}
    other_file.replace(file)


def put_link(file: Path) -> None:
    file.rename(file.with_name("elsewhere"))
    file.symlink_to("elsewhere")


def replaced(make: Callable[[Path], None]) -> Callable[[Path], None]:
    def put(file: Path) -> None:
        file.unlink()
        make(file)

    return put


CONSTANT = struct.pack("<d", 0.1372)
DAMAGES: dict[str, Callable[[Path], None]] = {
    "constant": change_constant,
    "zeros": set_zeros,
    "empty": cut(0.0),
    **{f"cut at {part:g}": cut(part) for part in (0.01, 0.3, 0.5, 0.9, 0.999)},
    "longer": lambda file: file.write_bytes(file.read_bytes() + b"more") and None,
    "foreign": put_foreign,
    "link": put_link,
    "folder": replaced(Path.mkdir),
    "pipe": replaced(os.mkfifo),
    "writable by others": lambda file: file.chmod(0o666),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_library_is_built_anew_with_one_line(
    damage: str, cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = f'double two[2] = {{0.1372, {next(NUMBER)}}};\nextern "C" double constant(int i) {{ return two[i]; }}\n'

    def constant() -> float:
        function = library(source).constant
        function.restype = ctypes.c_double
        return function(0)

    assert constant() == 0.1372
    (file,) = cache.iterdir()
    DAMAGES[damage](file)
    forget()
    assert constant() == 0.1372
    (said,) = caplog.messages
    assert said.startswith(f"{cache}: a kept file ")
    forget()
    assert constant() == 0.1372  # found again, and no second line
    assert len(caplog.messages) == 1
    assert file.is_file()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_library_of_another_user_is_not_used(source: str, cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    library(source)
    (file,) = cache.iterdir()
    os.chown(file, 12345, 12345)
    forget()
    library(source)
    assert "belongs to another user" in caplog.text
    assert file.stat().st_uid == 0


def test_a_library_that_changes_while_it_is_used_does_no_harm(source: str, cache: Path) -> None:
    code = f"""
import os, pathlib
from rotorid_torch.core.native.build import library
loaded = library({source!r})
(file,) = pathlib.Path({str(cache)!r}).iterdir()
os.truncate(file, 0)
print(loaded.answer())
"""
    library(source)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(library(source).answer())


def test_libraries_load_where_nothing_runs_from_memory(source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "memfd_create")
    assert library(source).answer() > 0


def test_a_compiler_ends_with_a_killed_process_and_its_folder_goes_with_the_next(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child, place = tmp_path / "child", tmp_path / "temporary"
    place.mkdir()
    program = compiler_that(tmp_path, f"sleep 60 & echo $! > {child}; wait")
    killed = elsewhere(source, {**os.environ, "CXX": program, "TMPDIR": str(place)})
    wait_until(lambda: child.exists() and child.read_text().strip())
    killed.kill()
    killed.communicate()
    wait_until(lambda: not goes_on(int(child.read_text())))
    assert len(list(place.iterdir())) == 1
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    library(source)
    assert not list(place.iterdir())


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
