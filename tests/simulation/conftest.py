"""The hovering UH-60 that several tests of the flight-test aircraft look at, trimmed once."""

from dataclasses import dataclass

import pytest

from rotorid_torch.simulation.flight.linear import LinearAircraft, linearise
from rotorid_torch.simulation.flight.trim import Trim, find_trim
from rotorid_torch.simulation.helicopter.aircraft import Aircraft
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft


@dataclass(frozen=True)
class Hover:
    """Aircraft, trim and linear model."""

    aircraft: Aircraft
    trim: Trim
    linear: LinearAircraft


@pytest.fixture(scope="session")
def hover() -> Hover:
    """The UH-60 in hover."""
    aircraft = load_aircraft()
    trim = find_trim(aircraft, 0.0)
    return Hover(aircraft, trim, linearise(aircraft, trim))
