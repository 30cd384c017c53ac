"""The flight-test aircraft: a simulator of its own that flies manoeuvres and writes data sets."""

from rotorid_torch.fly.effects import EFFECT_CLASSES as EFFECT_CLASSES
from rotorid_torch.fly.effects import EFFECTS as EFFECTS
from rotorid_torch.fly.flight_test import FlightTest as FlightTest
from rotorid_torch.fly.flight_test import fly as fly
