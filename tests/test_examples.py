"""Examples of docstrings run: each public function has one, with a data set DATASET and its RUN at hand."""

from __future__ import annotations

import doctest
import inspect
from pathlib import Path
from typing import Any

import pytest

import rotorid_torch as rotorid

FUNCTIONS = [name for name in rotorid.__all__ if inspect.isfunction(getattr(rotorid, name))]
THINGS = {name: getattr(rotorid, name) for name in FUNCTIONS} | {
    "from_arrays": rotorid.Dataset.from_arrays,
    "windows": rotorid.Dataset.windows,
}
OF_LOGS = {"import_log", "reconstruct", "register", "export"}
"""Without an example: they take files of a user's own, or are told in docs/."""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("examples")
    rotorid.fly(folder / "DATASET", flights=["f321_lon", "f321_lat", "dbl_ped_p"], seconds=8.0)
    rotorid.identify(rotorid.load(folder / "DATASET"), out=folder / "RUN")
    return folder


@pytest.mark.parametrize("name", [name for name in THINGS if name not in OF_LOGS])
def test_the_example_of(name: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)
    found: list[doctest.DocTest] = doctest.DocTestFinder(recurse=False).find(THINGS[name], name, globs={})
    assert found
    assert found[0].examples, f"{name} has no example"
    told: list[Any] = []
    result = doctest.DocTestRunner(verbose=False).run(found[0], out=told.append)
    assert result.failed == 0, "".join(told)


@pytest.mark.parametrize("name", list(THINGS))
def test_the_docstring_says_what_is_refused_of(name: str) -> None:
    text = THINGS[name].__doc__ or ""
    assert len(text.splitlines()) > 1, name
    assert "InputError" in text or name in ("register", "reconstruct", "export"), name
