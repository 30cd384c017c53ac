"""A small run of a drawn helicopter, identified once."""

from __future__ import annotations

from pathlib import Path

import pytest

import rotorid_torch as rotorid
from rotorid_torch.data import Dataset
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import save
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DT, DELAY = 0.04, 0.07


@pytest.fixture(scope="session")
def flights() -> Dataset:
    lists = {"identify": ["f_lon", "f_lat", "f_col"], "validate": ["f_ped"]}
    return flown(rate_vehicle(), manoeuvres(9.0, DT), DT, noise=0.02, lists=lists)


@pytest.fixture(scope="session")
def run(flights: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A RUN on disk, with a delay put into the way of its controls."""
    out = tmp_path_factory.mktemp("runs") / "run"
    identified = rotorid.identify(flights, out=out)
    spec = identified.spec.with_effects("control.delay")
    late = with_values(build(spec), identified.model.named_values | {"control.delay.common": DELAY})
    save(late, spec, out / "model.pt")
    return out
