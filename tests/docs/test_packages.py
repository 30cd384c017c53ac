"""Wheel and source distribution are built and installed clean; what the package needs beside Python code is in them."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from rotorid_torch.version import __version__
from tests.docs.validated import ROOT


def test_the_version_is_one_everywhere():
    assert f"version: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    latest = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert latest is not None
    assert latest[1] == __version__


@pytest.mark.slow
def test_packages_build_and_install_clean(tmp_path: Path):
    build = [sys.executable, "-m", "build", "--outdir", str(tmp_path / "dist"), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,), (source,) = ([*(tmp_path / "dist").glob(ending)] for ending in ("*.whl", "*.tar.gz"))
    needed = {path.relative_to(ROOT).as_posix() for path in (ROOT / "rotorid_torch").rglob("*") if path.is_file()}
    needed = {name for name in needed if "__pycache__" not in name}
    assert needed <= set(zipfile.ZipFile(wheel).namelist())
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert needed | {"CITATION.cff", "mkdocs.yml", "docs/index.md"} <= names
    venv.create(tmp_path / "clean", with_pip=True)
    python = tmp_path / "clean" / "bin" / "python"
    for package in (wheel, source):
        install = [python, "-m", "pip", "install", "--quiet", "--no-deps", "--force-reinstall", str(package)]
        subprocess.run(install, check=True, capture_output=True)
        said = subprocess.run([python, "-m", "rotorid_torch", "--help"], check=True, capture_output=True, text=True)
        assert "export" in said.stdout
    shown = subprocess.run([python, "-m", "pip", "show", "rotorid-torch"], check=True, capture_output=True, text=True)
    assert f"Version: {__version__}" in shown.stdout
