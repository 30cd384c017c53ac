"""What the seed seeds beside what the package draws by generators of its own."""

from collections.abc import Callable
from unittest.mock import Mock

import pytest
import torch

import rotorid_torch as rotorid
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
