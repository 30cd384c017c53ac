"""What this installation can do: versions, threads, devices, and what is missing for the optional parts."""

import os
import platform
import re
import shlex
from importlib.metadata import PackageNotFoundError, requires, version

import msgspec
import torch
from rich.table import Table

from rotorid_torch.core.native.build import NO_COMPILER, compiler
from rotorid_torch.core.storage.cache import Usage, usage
from rotorid_torch.errors import Unsupported
from rotorid_torch.version import __version__

PACKAGE = "rotorid-torch"
NEEDED = ("torch", "torchdiffeq", "numpy", "matplotlib", "tensorboard", "msgspec", "rich", "jinja2")
ADVICE = "ROTORID_CACHE names another place, --empty-cache empties it"
REQUIRED = re.compile(r"([\w.-]+).*; extra == .(\w+).")
"""A package and the extra that brings it, as the installed package says."""


class Installation(msgspec.Struct, frozen=True, kw_only=True):
    """What `rotorid doctor` found; a version is None where the package is missing.

    extras : by name their packages. cache : what is kept between runs now. removed : what was, where the cache has been
    emptied.
    """

    rotorid: str
    python: str
    system: str
    cores: int
    threads: int
    compiler: str | None
    cuda: str | None
    packages: dict[str, str | None]
    extras: dict[str, dict[str, str | None]]
    cache: Usage
    removed: Usage | None


def findings(removed: Usage | None = None) -> Installation:
    """Look at this installation."""
    return Installation(
        rotorid=__version__,
        python=platform.python_version(),
        system=f"{platform.system()} {platform.machine()}",
        cores=os.cpu_count() or 1,
        threads=torch.get_num_threads(),
        compiler=_compiler(),
        cuda=torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        packages={name: _version(name) for name in NEEDED},
        extras=_extras(),
        cache=usage(),
        removed=removed,
    )


def table(installation: Installation) -> Table:
    """The findings for people."""
    rows = Table(show_header=False)
    rows.add_row("rotorid", installation.rotorid)
    rows.add_row("Python", f"{installation.python}, {installation.system}")
    rows.add_row("cores, threads used", f"{installation.cores}, {installation.threads} (set OMP_NUM_THREADS to change)")
    rows.add_row("C++ compiler", installation.compiler or f"{NO_COMPILER}: torch does its work, 30 to 200 times slower")
    rows.add_row("CUDA device", installation.cuda or "none")
    rows.add_row("cache", f"{installation.cache.folder}: {_size(installation.cache)} ({ADVICE})")
    if installation.removed:
        rows.add_row("", f"removed: {_size(installation.removed)}")
    for name, installed in installation.packages.items():
        rows.add_row(name, installed or f"missing: pip install {name}")
    for name, packages in installation.extras.items():
        missing = [package for package, installed in packages.items() if installed is None]
        versions = ", ".join(f"{package} {installed}" for package, installed in packages.items())
        rows.add_row(f"extra {name}", f"not installed: pip install {' '.join(missing)}" if missing else versions)
    return rows


def _size(cache: Usage) -> str:
    return f"{cache.files} files, {cache.bytes / 2**20:.1f} MiB"


def _compiler() -> str | None:
    try:
        return shlex.join(compiler())
    except Unsupported:
        return None


def _extras() -> dict[str, dict[str, str | None]]:
    """The packages of every extra that users install, with their versions."""
    extras: dict[str, dict[str, str | None]] = {}
    try:
        required = requires(PACKAGE) or []
    except PackageNotFoundError:  # a folder on the path, not installed
        required = []
    for match in filter(None, map(REQUIRED.match, required)):
        if match[2] != "dev":
            extras.setdefault(match[2], {})[match[1]] = _version(match[1])
    return extras


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
