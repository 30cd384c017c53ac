"""Experiments import each other by bare names: their folder is on the path for a test, and forgotten after it."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers import ROOT


@pytest.fixture(autouse=True)
def _beside_the_experiments(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(ROOT / "experiments"))
    yield
    for name in [n for n, m in sys.modules.items() if _is_experiment(m)]:
        del sys.modules[name]


def _is_experiment(module: object) -> bool:
    file = getattr(module, "__file__", None)
    return file is not None and Path(file).parent == ROOT / "experiments"
