"""Compiles C++ once and keeps it: libraries are found again by a hash of all that they are made of."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import signal
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path

from rotorid_torch.core.native.fallback import Unsupported, say_once

LOOPS = Path(__file__).parent / "loops"
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-std=c++17", "-fPIC", "-shared", "-pthread", "-Wno-psabi")
LIMIT_S = 300.0
"""s: a compiler that takes longer than this is given up."""
_refused: dict[str, str] = {}
"""What could not be compiled in this process, by key, and why: not tried twice."""
NO_COMPILER = "no C++ compiler was found (g++ on PATH, or CXX=...)"


def compiler() -> tuple[str, ...]:
    """The command that compiles C++: path of its program, and what stands behind it in CXX ("ccache g++").

    Raises
    ------
    Unsupported : there is none.
    """
    wanted = os.environ.get("CXX", "g++")
    program, *options = [wanted] if shutil.which(wanted) else shlex.split(wanted) or [wanted]
    found = shutil.which(program)
    if found is None:
        raise Unsupported(NO_COMPILER)
    return (found, *options)


def threads() -> int:
    """Threads of a native loop: ROTORID_THREADS, else OMP_NUM_THREADS, else the processors that this process may use.

    An empty ROTORID_THREADS asks for all processors, whatever OMP_NUM_THREADS says.

    Torch's own threads are another matter: its operations here are small, and wait for each other on shared cores.
    """
    wanted = os.environ.get("ROTORID_THREADS", os.environ.get("OMP_NUM_THREADS", ""))
    if wanted.isdecimal() and int(wanted) > 0:
        return int(wanted)
    if wanted:
        say_once(f"threads: '{wanted}' is no whole number above zero; all processors are used")
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cache_folder() -> Path:
    """Where libraries are kept: ROTORID_CACHE, or the user's cache folder."""
    chosen = os.environ.get("ROTORID_CACHE")
    base = (
        Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rotorid-torch"
    )
    return base / "native"


@functools.lru_cache
def _target(program: tuple[str, ...]) -> str:
    """All of the compiler's macros: its version and this machine's instruction set."""
    command = [*program, *FLAGS, "-dM", "-E", "-x", "c++", os.devnull]
    try:
        asked = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise Unsupported(f"{shlex.join(program)} does not work: {error.strerror}") from error
    if asked.returncode:
        raise Unsupported(f"{shlex.join(program)} does not work: {_first_error(asked.stderr)}")
    return asked.stdout


def lanes() -> int:
    """Doubles in the widest vector register, as `loops/lanes.h` has it."""
    macros = _target(compiler())
    return 8 if "__AVX512F__" in macros else 4 if "__AVX2__" in macros else 2


@functools.lru_cache
def _loops() -> str:
    return "\n".join(path.read_text() for path in sorted(LOOPS.glob("*.h")))


@functools.lru_cache(maxsize=64)
def library(source: str) -> ctypes.CDLL:
    """The compiled source, from the cache where it was built before; safe for processes that build at once.

    Raises
    ------
    Unsupported : there is no compiler, it refuses the source, or the cache cannot be written.
    """
    program = compiler()
    key = hashlib.sha256("\n".join([source, _loops(), _target(program), *FLAGS]).encode()).hexdigest()[:24]
    file = cache_folder() / f"{key}.so"
    if key in _refused:
        raise Unsupported(_refused[key])
    if not file.exists():
        _compile(program, source, file)
    try:
        return ctypes.CDLL(str(file))
    except OSError as error:
        file.unlink(missing_ok=True)  # cut short by a full disk or a crash: built anew next time
        raise Unsupported(f"the compiled model cannot be loaded: {error}") from error


def _compile(program: tuple[str, ...], source: str, file: Path) -> None:
    """Build beside the place and rename: nobody ever sees half a library."""
    vector_functions = ["-lmvec"] if platform.machine() == "x86_64" and platform.libc_ver()[0] == "glibc" else []
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=file.parent) as folder:
            text, made = Path(folder) / "model.cpp", Path(folder) / "model.so"
            text.write_text(source)
            command = [*program, *FLAGS, f"-I{LOOPS}", str(text), "-o", str(made), *vector_functions, "-lm"]
            code, said = _run(command)
            if code:
                raise _remembered(file.stem, f"{shlex.join(program)} refuses the model: {_first_error(said)}")
            made.replace(file)
    except OSError as error:
        raise Unsupported(f"the compiled model cannot be kept in {file.parent}: {error.strerror}") from error
    except subprocess.TimeoutExpired as error:
        raise _remembered(file.stem, f"{shlex.join(program)} took longer than {LIMIT_S:g} s") from error


def _remembered(key: str, why: str) -> Unsupported:
    _refused[key] = why
    return Unsupported(why)


def _run(command: list[str]) -> tuple[int, str]:
    """Exit code and error stream; whoever is late or interrupted ends with all that it has started."""
    quiet, told = subprocess.DEVNULL, subprocess.PIPE
    with subprocess.Popen(command, stdout=quiet, stderr=told, text=True, start_new_session=True) as running:
        try:
            said = running.communicate(timeout=LIMIT_S)[1]
        except BaseException:
            with suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGKILL)
            raise
    return running.returncode, said


def _first_error(output: str) -> str:
    return next((line for line in output.splitlines() if "error" in line), output.strip()[:200])
