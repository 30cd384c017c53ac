"""The script to copy: its effect promises what an effect has to, and it trains."""

import json
import math
from importlib import import_module
from pathlib import Path

import pytest

from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.model.own_effects import refuse_faulty
from tests.experiments.test_experiments import quick

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")
pytest.importorskip("torch.utils.tensorboard")


def test_its_network_is_sound() -> None:
    module = import_module("hybrid")
    refuse_faulty([module.NetworkForces.id], HELICOPTER)


@pytest.mark.slow
def test_it_trains_and_leaves_a_model(tmp_path: Path) -> None:
    result = quick("hybrid", tmp_path, "--out", str(tmp_path / "net"))
    assert len(result["unseen"]) == 3
    assert all(map(math.isfinite, result["unseen"]))
    assert (tmp_path / "net" / "model.pt").exists()
    assert list((tmp_path / "net" / "tensorboard").iterdir())
    assert json.dumps(result)
