"""Vehicles with equations of their own: flown by `rotorid fly`, or drawn like the vehicle of a data set.

Read `flight_test` (what `rotorid fly` does, from an aircraft to a data set), `changes` (how an effect is hidden) and
`rigid` (kinematics that all share), then the chapters: `vehicles/` (the file that describes an aircraft), `helicopter/`
(its parts, and what it can hide), `flight/` (how it moves, is trimmed, steered and measured), `multiblade/` (many
different helicopters at once, in multi-blade coordinates), `multirotor/` (multirotors, whole, and what they can hide),
`drawn/` (clean aircraft like that of a data set). No equation is shared with `model` or `effects`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rotorid_torch.simulation.flight_test import FlightTest as FlightTest
    from rotorid_torch.simulation.flight_test import FlownSet as FlownSet
    from rotorid_torch.simulation.flight_test import MultirotorTest as MultirotorTest
    from rotorid_torch.simulation.flight_test import fly as fly


def __getattr__(name: str) -> Any:
    # loaded when first used: who draws clean aircraft needs no flight test
    place = vars(import_module(f"{__name__}.flight_test"))
    if name in place:
        return place[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
