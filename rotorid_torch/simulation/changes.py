"""How an effect changes a vehicle of any kind: at a factor of its typical size, not at all at zero."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorid_torch.simulation.rigid import three

Change = Callable[[Any, float], Any]
"""A changed copy of a vehicle, at a factor of the typical size."""
Sized = Callable[[Any, Mapping[str, float]], Any]
"""The vehicle with an effect of the size that the library's parameters say, by name, SI."""


@dataclass(frozen=True)
class Hidden:
    """One effect: its change, and the flights it needs.

    `flights`: group of further flights without which it would not show. `brings`: what else the change makes the
    vehicle feel, by id. `sized`: the change where parameters say how large; None where only the typical size is known.
    """

    change: Change
    flights: str = ""
    brings: tuple[str, ...] = ()
    sized: Sized | None = None


def raised(part: str, empty: Any = None, **typical: float) -> Change:
    """Numbers of a part of the vehicle, raised in proportion to the size; `empty`: the part of one that has none."""

    def change(vehicle: Any, size: float) -> Any:
        whole = getattr(vehicle, part) or empty
        more = {name: getattr(whole, name) + value * size for name, value in typical.items()}
        return replace(vehicle, **{part: replace(whole, **more)})

    return change


def more_inertia(share: float) -> Change:
    """More inertia about all axes, by a share of it."""
    return lambda vehicle, size: replace(
        vehicle, inertia=tuple(three((1.0 + share * size) * row) for row in vehicle.inertia_matrix)
    )


def sensor_error(name: str, typical: Mapping[str, float] | tuple[float, ...]) -> Change:
    """An error of the sensors in proportion to the size: values by channel join, vectors add up."""

    def change(vehicle: Any, size: float) -> Any:
        earlier = getattr(vehicle.sensors, name)
        if isinstance(typical, Mapping):
            joined: Any = {**earlier, **{channel: value * size for channel, value in typical.items()}}
        else:
            joined = three(np.asarray(earlier) + np.asarray(typical) * size)
        return replace(vehicle, sensors=replace(vehicle.sensors, **{name: joined}))

    return change
