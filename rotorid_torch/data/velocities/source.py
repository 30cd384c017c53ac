"""Where velocities come from that a data set does not hold: position and attitude, or forces and attitude."""

import re
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from rotorid_torch.core.names import ATTITUDES, POSITIONS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.schema import ChannelSpec
from rotorid_torch.data.velocities.dead_reckoning import DeadReckoning, first_stretch
from rotorid_torch.data.velocities.positions import differentiated, held, noise_of

REFERENCE_SPEED = re.compile(r"(hover)|(\d+(?:\.\d*)?) ?(m/s|kt|kn|knots)", re.IGNORECASE)
"""What a declared reference may say of the speed at which flights start."""
DECLARED_SPEED = 'the speed at which flights start, as reference = "hover" or "30 m/s" under [model]'
"""What to declare where velocities could be dead reckoned."""
KNOT = 0.514444
"""m/s of a nautical mile in an hour."""


def with_velocities(dataset: Dataset) -> Dataset:
    """The data set with u v w in every flight, where none has any of them and all have what they can be made from.

    From position and attitude, or of a helicopter from specific forces, rates and attitude. `derived` tells that no
    score is to know these channels. Where they cannot be had although position is recorded, a warning says so.
    """
    flights_facts = dataset.facts.values()
    if any(facts.has(c) for facts in flights_facts for c in VELOCITIES):
        return dataset
    if all(facts.has(*POSITIONS, *ATTITUDES) for facts in flights_facts):
        return _from_position(dataset)
    reckoned = dataset.kind == "helicopter" and inertial(dataset) and starts_at_speed(dataset)
    return _from_forces(dataset) if reckoned else dataset


def inertial(dataset: Dataset) -> bool:
    """Whether all flights have what velocities are dead reckoned from."""
    return all(facts.has(*SPECIFIC_FORCES, *RATES, *ATTITUDES[:2]) for facts in dataset.facts.values())


def starts_at_speed(dataset: Dataset) -> bool:
    """Whether the speed at which flights start is declared or recorded."""
    return reference_speed(dataset) is not None or all(facts.has("airspeed") for facts in dataset.facts.values())


def reference_speed(dataset: Dataset) -> float | None:
    """Speed at which flights start by the declared reference ("hover", "30 m/s", "60 kt"), m/s; None where none is."""
    declared = REFERENCE_SPEED.fullmatch(dataset.settings.reference.strip())
    if declared is None:
        return None
    hover, number, unit = declared.groups()
    return 0.0 if hover else float(number) * (1.0 if unit.lower() == "m/s" else KNOT)


def _from_position(dataset: Dataset) -> Dataset:
    moving = dataset.changed(differentiated)
    stays = any(held(flight) for flight in dataset.flights.values())
    if stays or not all(one.has(*VELOCITIES) for one in moving.facts.values()):
        remark = "u v w are not measured, nor can they be had from position: it is held or missing for too long"
        return replace(dataset, warnings=tuple(dict.fromkeys((*dataset.warnings, remark))))
    noise = noise_of(dataset, moving.flights)
    size = f"{noise['u']:.2g}, w to {noise['w']:.2g} m/s"
    return _completed(moving, noise, f"made from position and attitude, to about {size}")


def _from_forces(dataset: Dataset) -> Dataset:
    speed = reference_speed(dataset)
    start = "the airspeed" if speed is None else f"{speed:.3g} m/s"
    how = f"dead reckoned from specific forces and attitude, from {start} at the start of each flight"
    short = [flight.name for flight in dataset.flights.values() if first_stretch(flight) < flight.samples]
    how += f" (up to the first gap in {', '.join(short)})" if short else ""
    reckoning = DeadReckoning.of(dataset, speed)
    noise = dict.fromkeys(VELOCITIES, reckoning.noise)
    return replace(_completed(dataset.changed(reckoning.flight), noise, how), dead_reckoned=True)


def _completed(moving: Dataset, noise: Mapping[str, float], how: str) -> Dataset:
    """The data set that says how its u v w were made; noise : standard deviation of a sample, m/s."""
    specs = {c: ChannelSpec(noise=sd) for c, sd in noise.items()}
    return replace(
        moving,
        channel_specs=MappingProxyType({**moving.channel_specs, **specs}),
        warnings=(*moving.warnings, f"u v w are not measured: {how}, and not scored"),
        derived=frozenset(VELOCITIES),
    )
