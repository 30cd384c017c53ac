"""Aircraft drawn at random for the studies of the closed loop, and flights of them with something hidden.

A drawn aircraft declares itself truthfully: mass, inertia, hub, rotor, noise. Its augmentation is tuned anew for what
flies, as its makers would have it, and then made weaker or stronger by a factor that nobody declares. Flights are
written as a data set without truth; what was true stays in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from hidden.outside_causes import CAUSES, fly_with
from rotorid_torch.data.write import to_toml, write_dataset
from rotorid_torch.errors import InputError
from rotorid_torch.simulation.flight.augmentation import Augmentation, design
from rotorid_torch.simulation.flight.linear import linearise
from rotorid_torch.simulation.flight.manoeuvres import Condition, chosen, conditioned, groups
from rotorid_torch.simulation.flight.sensors import MEASURED, Channels, measured_channels, true_channels
from rotorid_torch.simulation.flight.simulation import FlightHistory, Programme, fly_batch, with_heading, with_height
from rotorid_torch.simulation.flight.trim import Trim, find_trim
from rotorid_torch.simulation.flight_test import declare
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES, Aircraft
from rotorid_torch.simulation.helicopter.hidden import HIDDEN
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft

HEIGHT = 27.4  # m
SECONDS = 15.0
TRIES = 20
"""Drawn vehicles that cannot be trimmed at all their speeds are drawn again, so often at most."""
UH60_MASS, UH60_RADIUS = 7258.0, 8.178  # kg with blades, m
UH60_INERTIA = np.array([[6316.8, 0.0, -2551.6], [0.0, 52215.3, 0.0], [-2551.6, 0.0, 49888.7]])
UH60_HUB = np.array([0.4546, 0.0, -1.8132])


class Drawn(msgspec.Struct, frozen=True):
    """A drawn aircraft: `vehicle` is the content of its vehicle file; `speed` in m/s.

    `augmentation` : factor of the feedback gains. `noise` : factor of the usual noise; both by draw.
    """

    number: int
    vehicle: dict[str, Any]
    speed: float
    augmentation: float
    noise: float


@dataclass(frozen=True)
class Flown:
    """Flights of a drawn aircraft: a data set's parts in memory.

    `clean` : the aircraft without what is hidden. `right` : the measured flights as faultless sensors with the same
    noise would have read them.
    """

    clean: Aircraft
    declaration: dict[str, Any]
    measured: dict[str, Channels]
    right: dict[str, Channels]

    def write(self, folder: Path, *, right: bool = False) -> Path:
        """Lay the data set down, without truth."""
        keys = ("name", "kind", "description", "vehicle", "controls", "channels", "model")
        tables = {key: self.declaration[key] for key in keys}
        flights = self.right if right else self.measured
        return write_dataset(folder, flights, **self.declaration["flights"], **tables)


def draw(number: int, seed: int, place: Path) -> Drawn:
    """Aircraft of this number; the same one each time. Kept as a file in a folder once it was drawn."""
    file = place / f"{seed}-{number}.json"
    if file.exists():
        return msgspec.json.decode(file.read_bytes(), type=Drawn)
    for attempt in range(TRIES):
        drawn = _drawn(number, np.random.default_rng([seed, number, attempt]))
        if _flyable(drawn, place):
            file.write_bytes(msgspec.json.encode(drawn))
            return drawn
    raise InputError("usage", "seed", f"no aircraft {number} that can be flown in {TRIES} draws", "another seed")


def _drawn(number: int, rng: np.random.Generator) -> Drawn:
    """Size by mass, and everything else around the UH-60 of that size."""
    mass = float(np.exp(rng.uniform(np.log(3000.0), np.log(11000.0))))
    length = (mass / UH60_MASS) ** (1.0 / 3.0)
    radius = UH60_RADIUS * length * rng.uniform(0.95, 1.08)
    spread = np.sqrt(rng.uniform(0.85, 1.15, 3))
    inertia = UH60_INERTIA * (mass / UH60_MASS) * length**2 * np.outer(spread, spread)
    rotor = {
        "blades": int(rng.choice([4, 4, 5])),
        "radius": radius,
        "speed": 221.0 * rng.uniform(0.95, 1.05) / radius,
        "hinge_offset": radius * rng.uniform(0.035, 0.055),
        "lock_number": rng.uniform(6.5, 9.5),
    }
    vehicle = {
        "mass": mass,
        "inertia": inertia.tolist(),
        "mass_excludes": ["blades"],
        "hub": (UH60_HUB * length * rng.uniform(0.85, 1.15, 3)).tolist(),
        "imu": (length * rng.uniform(-0.5, 0.5, 3)).tolist(),
        "rotor": {key: float(value) if key != "blades" else value for key, value in rotor.items()},
    }
    speed = 0.0 if rng.uniform() < 0.6 else float(np.round(rng.uniform(12.0, 35.0)))
    augmentation, noise = float(rng.uniform(0.75, 1.3)), float(np.exp(rng.uniform(np.log(0.7), np.log(1.5))))
    return Drawn(number, {"name": f"drawn-{number}", "vehicle": vehicle}, speed, augmentation, noise)


def _flyable(drawn: Drawn, place: Path) -> bool:
    """Whether a drawn aircraft can be trimmed at all the speeds of its flights."""
    try:
        aircraft = _built(drawn, place)
        fastest = conditioned(groups(drawn.speed)["speeds"][-1], Condition(0.0, HEIGHT, drawn.speed))[1]
        for speed in (drawn.speed, fastest.speed):
            find_trim(aircraft, speed, HEIGHT)
    except InputError:
        return False
    return True


def _built(drawn: Drawn, place: Path) -> Aircraft:
    """The aircraft of a vehicle file that is written beside the draw."""
    place.mkdir(parents=True, exist_ok=True)
    file = place / f"{drawn.vehicle['name']}.toml"
    file.write_text(to_toml(drawn.vehicle), encoding="utf-8")
    return load_aircraft(file)


def groups_of(hidden: Sequence[str]) -> tuple[str, ...]:
    """Groups of flights without which something hidden would not show."""
    wanted = (HIDDEN[e].flights for e in hidden if e in HIDDEN)
    return tuple(dict.fromkeys(("all", *filter(None, wanted))))


def fly_drawn(
    drawn: Drawn,
    hidden: Sequence[str],
    size: float,
    flights: Sequence[str],
    seed: int,
    place: Path,
    seconds: float = SECONDS,
) -> Flown:
    """Fly a drawn aircraft with something hidden: effects of the library, or a cause of `outside_causes`.

    Parameters
    ----------
    size : factor of the typical size. flights : names and groups. seed : of noise and gusts.
    place : folder for the vehicle file. seconds : of each flight.
    """
    clean = _built(drawn, place)
    aircraft = clean
    for effect in hidden:
        aircraft = HIDDEN[effect].change(aircraft, size) if effect in HIDDEN else aircraft
    names = chosen(flights, drawn.speed)
    usual = Condition(0.0, HEIGHT, drawn.speed)
    trims, gains = _prepared(aircraft, [conditioned(n, usual)[1] for n in names], drawn.augmentation)
    outside = [CAUSES[cause] for cause in hidden if cause in CAUSES]
    if outside:
        record = fly_with(aircraft, trims, gains, names, seconds, outside[0].at_blades(drawn.number, aircraft, size))
    else:
        record = fly_batch(aircraft, trims, gains, Programme(names, seconds, seed))
    measured, right = {}, {}
    for k, name in enumerate(names):
        measured[name], right[name] = _sensed(aircraft, record, k, name, seed, drawn.noise)
    declaration = declare(clean, f"{drawn.vehicle['name']}-{seed}", names, MEASURED, drawn.speed, HEIGHT)
    for table in (*declaration["controls"].values(), *declaration["channels"].values()):
        table["noise"] *= drawn.noise
    return Flown(clean, declaration, measured, right)


def _prepared(
    aircraft: Aircraft, conditions: Sequence[Condition], factor: float
) -> tuple[list[Trim], list[Augmentation]]:
    """Trim and augmentation of each flight; another heading or height needs another trim only where it matters."""
    by_condition: dict[tuple[float, float, float], Trim] = {}
    designed: dict[float, Augmentation] = {}
    trims = []
    for one in conditions:
        heading = one.heading if aircraft.knows_directions else 0.0
        key = (one.speed, one.height if aircraft.wake.ground else 0.0, heading)
        if key not in by_condition:
            by_condition[key] = find_trim(aircraft, one.speed, one.height, heading)
        if one.speed not in designed:
            designed[one.speed] = Augmentation(factor * design(linearise(aircraft, by_condition[key])).gains)
        trim = by_condition[key] if aircraft.knows_directions else with_heading(by_condition[key], one.heading)
        trims.append(with_height(trim, one.height))
    return trims, [designed[one.speed] for one in conditions]


def _sensed(
    aircraft: Aircraft, record: FlightHistory, flight: int, name: str, seed: int, factor: float
) -> tuple[Channels, Channels]:
    """A flight as its sensors read it, and as faultless ones would; noise by a factor of the usual."""
    truth = true_channels(aircraft, record, flight)
    usual = measured_channels(truth, MEASURED, name, seed)
    measured: Channels = {"time": truth["time"]}
    right: Channels = {"time": truth["time"]}
    for channel, values in usual.items():
        if channel == "time":
            continue
        fault = f"effect_{channel}"
        read = truth[channel] if channel in CONTROL_NAMES else truth.get(fault, truth[channel])
        noise = factor * (values - read)
        measured[channel], right[channel] = read + noise, truth[channel] + noise
    return measured, right
