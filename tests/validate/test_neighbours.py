"""Bands of free runs: what the errors of a model's parameters make of its trajectories."""

import pytest
import torch

from rotorid_torch.validate.neighbours import free_run_bands
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DELAY, ERROR = "control.delay.common", 0.01


def test_the_error_of_a_delay_is_in_the_band() -> None:
    """A trajectory that comes late by t +- s is uncertain by s times its slope."""
    model = with_values(rate_vehicle(effects=("control.delay",)), {DELAY: 0.05})
    data = flown(model, manoeuvres(6.0, 0.02), 0.02)
    covariance = torch.tensor([[ERROR**2]], dtype=torch.float64)
    band = free_run_bands(model, data, ["f_lat"], [DELAY], covariance)["f_lat"]["p"]
    slope = torch.gradient(data["f_lat"].stack(["p"])[: len(band), 0], spacing=0.02)[0].abs()
    assert float(band.max()) == pytest.approx(ERROR * float(slope.max()), rel=0.6)
    assert float((band / ERROR)[slope < 1e-3].max()) < 0.2 * float(slope.max())
