"""A library of C sources, by the C compiler of this machine, for any machine of its kind."""

import os
import platform
import shlex
import shutil
import subprocess
from pathlib import Path

from rotorid_torch.core.native.build import LIMIT_S
from rotorid_torch.errors import InputError

FLAGS = ("-O2", "-std=c99", "-fPIC", "-shared", "-fvisibility=hidden")


def c_compiler() -> list[str]:
    """The command that compiles C: CC, else cc or gcc on PATH.

    Raises InputError: there is none.
    """
    for wanted in filter(None, (os.environ.get("CC"), "cc", "gcc", "clang")):
        program, *options = shlex.split(wanted)
        path = shutil.which(program)
        if path is not None:
            return [path, *options]
    raise InputError("export", "--fmu", "no C compiler was found", "cc or gcc on PATH, or CC=...")


def library(sources: list[Path], out: Path) -> None:
    """Compile sources into a shared library.

    Raises InputError: there is no compiler, or it refuses them.
    """
    command = [*c_compiler(), *FLAGS, *map(str, sources), "-o", str(out), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=LIMIT_S, check=False)
    if done.returncode:
        said = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip()[:200])
        raise InputError("export", "--fmu", f"{command[0]} refuses the model: {said}", "a compiler of C99")


def suffix() -> str:
    """How the system's shared libraries end."""
    return {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")
