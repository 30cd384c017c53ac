"""What the seed seeds beside what the package draws by generators of its own."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch

import rotorid_torch as rotorid
from rotorid_torch.report.records import read_report
from rotorid_torch.run import pipeline
from tests.known_models import flown, manoeuvres, rate_vehicle


@pytest.mark.parametrize("command", [rotorid.identify, rotorid.close_loop])
def test_modules_of_users_draw_by_the_seed(command: Callable, monkeypatch: pytest.MonkeyPatch):
    data = flown(rate_vehicle(), manoeuvres(4.0, 0.02), 0.02)
    monkeypatch.setattr(pipeline, "at_one_rate", Mock(side_effect=LookupError))
    torch.manual_seed(1)
    with pytest.raises(LookupError):
        command(data, seed=7)
    assert torch.initial_seed() == 7


@pytest.mark.parametrize("seed", [7, np.int64(7), np.uint8(7), torch.tensor(7)])
def test_every_whole_number_is_a_seed(seed: Any, tmp_path: Path):
    data = flown(rate_vehicle(), manoeuvres(4.0, 0.02), 0.02)
    pipeline.reconstruct(data, tmp_path / "RUN", seed=seed)
    assert read_report(tmp_path / "RUN").seed == 7
