"""Compiles C++ once and keeps it: libraries are found again by a hash of all that they are made of.

What comes from the cache is checked, and loaded from the bytes that were checked.
"""

import ctypes
import functools
import hashlib
import itertools
import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor

from rotorid_torch.core.processes.children import child
from rotorid_torch.core.storage import cache
from rotorid_torch.core.storage.atomic import scratch_folder
from rotorid_torch.errors import InputError, Unsupported, say_once

Made = TypeVar("Made")
LOOPS = Path(__file__).parent / "loops"
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-std=c++17", "-fPIC", "-shared", "-pthread", "-Wno-psabi")
LIMIT_S = 1800.0
"""s: a compiler that takes longer than this is given up. A filter takes a minute of a processor that others share."""
_refused: dict[str, str] = {}
"""What could not be compiled in this process, by key, and why: not tried twice."""
_loaded: dict[str, ctypes.CDLL] = {}
"""What this process has loaded, by key."""
_serial = itertools.count()
NO_COMPILER = "no C++ compiler was found (g++ on PATH, or CXX=...)"


def compiler() -> tuple[str, ...]:
    """The command that compiles C++: path of its program, and what stands behind it in CXX ("ccache g++").

    Raises Unsupported: there is none.
    """
    wanted = os.environ.get("CXX", "g++")
    program, *options = [wanted] if shutil.which(wanted) else shlex.split(wanted) or [wanted]
    program_path = shutil.which(program)
    if program_path is None:
        raise Unsupported(NO_COMPILER)
    return (program_path, *options)


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

    Raises Unsupported: there is no compiler, it refuses the source, or the system loads nothing that it has compiled.
    """
    program = compiler()
    key = hashlib.sha256("\n".join([source, _loops(), _target(program), *FLAGS]).encode()).hexdigest()[:24]
    if key in _refused:
        raise Unsupported(_refused[key])
    if key not in _loaded:
        name = f"{key}.so"
        content = cache.read(name)
        if content is None:
            content = _compiled(program, source, key)
            cache.keep(name, content)
        _loaded[key] = _load(content)
    return _loaded[key]


def _load(content: bytes) -> ctypes.CDLL:
    """Load these very bytes, from memory where the system can: a file may change while a process runs in it."""
    try:
        with open(os.memfd_create("rotorid"), "wb") as memory:
            memory.write(content)
            memory.flush()
            unseen = "./" * next(_serial)  # the loader takes a name that it has seen for the library that had it
            return ctypes.CDLL(f"/proc/self/fd/{unseen}{memory.fileno()}")
    except (AttributeError, OSError):  # another system than Linux, or one that runs nothing from memory
        pass
    try:
        with scratch_folder() as folder:
            file = folder / "model.so"
            file.write_bytes(content)
            return ctypes.CDLL(str(file))
    except (InputError, OSError) as error:
        raise Unsupported(f"the compiled model cannot be loaded: {error}") from error


def _compiled(program: tuple[str, ...], source: str, key: str) -> bytes:
    vector_functions = ["-lmvec"] if platform.machine() == "x86_64" and platform.libc_ver()[0] == "glibc" else []
    try:
        with scratch_folder() as folder:
            text, binary = folder / "model.cpp", folder / "model.so"
            text.write_text(source)
            command = [*program, *FLAGS, f"-I{LOOPS}", str(text), "-o", str(binary), *vector_functions, "-lm"]
            code, said = _run(command, folder)
            if code:
                raise _remembered(key, f"{shlex.join(program)} refuses the model: {_first_error(said)}")
            return binary.read_bytes()
    except (InputError, OSError) as error:
        raise Unsupported(f"the model cannot be compiled: {error}") from error
    except subprocess.TimeoutExpired as error:
        raise _remembered(key, f"{shlex.join(program)} took longer than {LIMIT_S:g} s") from error


def _remembered(key: str, why: str) -> Unsupported:
    _refused[key] = why
    return Unsupported(why)


def _run(command: list[str], folder: Path) -> tuple[int, str]:
    """Exit code and error stream; its temporary files lie in the folder, which goes with them."""
    quiet, pipe = subprocess.DEVNULL, subprocess.PIPE
    around = {**os.environ, "TMPDIR": str(folder)}
    with child(command, stdout=quiet, stderr=pipe, errors="replace", env=around) as running:
        said = running.communicate(timeout=LIMIT_S)[1]
    return running.returncode, said


def ready(values: Tensor, dtype: torch.dtype = torch.float64) -> Tensor:
    """Values as a library takes them: of this type, in one piece."""
    return values.detach().to(dtype).contiguous()


def compiled_or_none(make: Callable[[], Made], without: str, *tensors: Tensor) -> Made | None:
    """What is made of native code; None where tensors are not in float64 on the processor, or there is no such code.

    without : what it means to go on without it, for the line that says why it is not to be had.
    """
    if any(one.dtype != torch.float64 or one.device.type != "cpu" for one in tensors):
        return None
    try:
        return make()
    except Unsupported as error:
        say_once(f"{without}: {error}")
        return None


def address(values: Tensor | None) -> ctypes.c_void_p:
    """Where values lie, null for none."""
    return ctypes.c_void_p(None if values is None else values.data_ptr())


def _first_error(output: str) -> str:
    return next((line for line in output.splitlines() if "error" in line), output.strip()[:200])
