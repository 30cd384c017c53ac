"""Flights of one multirotor, each by its name, as sensors read them and as they were."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.multirotor.channels import Channels, measured_channels, true_channels
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.multirotor.flight import Fleet, Progress, Task, fly_fleet
from rotorid_torch.simulation.multirotor.manoeuvres import targets_of


@dataclass(frozen=True)
class FlightPlan:
    """How flights are flown: seconds of each, heading, rad, and seed of everything random."""

    seconds: float
    heading: float = 0.0
    seed: int = 0


def fly_craft(
    craft: Multirotor, clean: Multirotor, names: Sequence[str], plan: FlightPlan, progress: Progress | None = None
) -> tuple[dict[str, Channels], dict[str, Channels]]:
    """True and measured channels by flight of a vehicle, whose controller knows the clean one.

    names : of flights, see `manoeuvres`. progress : called with samples done and in all.
    """
    fleet = Fleet.of([craft] * len(names), [clean] * len(names))
    samples = round(plan.seconds * craft.rate) + 1
    time = fleet.step * np.arange(samples * fleet.every + 1, dtype=np.float64)
    rows = np.stack([targets_of(name, clean, time, plan.heading) for name in names], axis=-1).swapaxes(0, 1)
    record = fly_fleet(fleet, Task(names, samples, lambda step: rows[step]), plan.seed, progress)
    truth = {name: true_channels(craft, record, k) for k, name in enumerate(names)}
    measured = {name: measured_channels(craft, truth[name], name, plan.seed) for name in names}
    return truth, measured
