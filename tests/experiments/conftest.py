"""Experiments are on the path for a test; what they import and register is forgotten after it."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rotorid_torch.effects.registry import EFFECTS, registered
from tests.helpers import ROOT

EXPERIMENTS = ROOT / "experiments"


@pytest.fixture(autouse=True)
def _on_the_path(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    monkeypatch.syspath_prepend(str(EXPERIMENTS / "studies"))
    library = dict(registered())
    yield
    EFFECTS.clear()
    EFFECTS.update(library)
    for name in [n for n, m in sys.modules.items() if _is_experiment(m)]:
        del sys.modules[name]


def _is_experiment(module: object) -> bool:
    file = getattr(module, "__file__", None)
    return file is not None and EXPERIMENTS in Path(file).parents
