"""The flight test: aircraft, trim, augmentation, manoeuvres and sensors make a data set."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.data import Dataset
from rotorid_torch.data.write import declarations, refuse_unless_free, write_dataset
from rotorid_torch.errors import InputError, nearest
from rotorid_torch.simulation.changes import Hidden
from rotorid_torch.simulation.flight.augmentation import Augmentation, design
from rotorid_torch.simulation.flight.linear import linearise
from rotorid_torch.simulation.flight.manoeuvres import Condition, chosen, conditioned, lists
from rotorid_torch.simulation.flight.sensors import MEASURED, NOISE, Channels, measured_channels, true_channels
from rotorid_torch.simulation.flight.simulation import Programme, Progress, fly_batch, with_heading, with_height
from rotorid_torch.simulation.flight.trim import Trim, find_trim
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES, Aircraft
from rotorid_torch.simulation.helicopter.hidden import EVERY_FORM, FORMS, HIDDEN, differences
from rotorid_torch.simulation.helicopter.rotor import LOCK_SLOPE
from rotorid_torch.simulation.multirotor import channels, manoeuvres
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.multirotor.flight import Fleet, Task, fly_fleet
from rotorid_torch.simulation.multirotor.hidden import HIDDEN as MULTIROTOR
from rotorid_torch.simulation.multirotor.vehicles import is_multirotor, multirotor
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft

FLOWN = "Built-in flight-test aircraft"
"""What the description of a flown data set begins with."""
HEIGHT = 27.4
"""Height of a helicopter's flights, m: more than three rotor radii of the UH-60, out of the ground's reach."""
SECONDS, MULTIROTOR_SECONDS, LONGEST_S = 15.0, 20.0, 3600.0
"""Length of each flight: a manoeuvre and its decay; several figures."""


@dataclass(frozen=True, repr=False)
class FlownSet:
    """A flown data set: `declaration` is its dataset.toml; `flights` are measured, `truth` is without noise.

    `hidden` are the effects with their sizes and what they changed, as truth/effects.json has them.
    """

    name: str
    declaration: dict[str, Any]
    flights: dict[str, Channels]
    truth: dict[str, Channels]
    hidden: tuple[dict[str, Any], ...]

    def __repr__(self) -> str:
        return f"{type(self).__name__} {self.name}: {len(self.flights)} flights: {arguments.listed(self.flights)}"

    def tables(self) -> dict[str, Any]:
        """The declaration as keywords of `Dataset.from_arrays`, without the name."""
        keys = ("kind", "description", "vehicle", "controls", "channels", "model")
        return {**self.declaration["flights"], **{k: self.declaration[k] for k in keys if k in self.declaration}}

    def dataset(self) -> Dataset:
        """Return the measured flights as a data set in memory."""
        return Dataset.from_arrays(self.flights, name=self.name, **self.tables())


@dataclass(frozen=True, repr=False)
class FlightTest(FlownSet):
    """Flights of a helicopter: what flew, with `trim` and `augmentation` of the data set's own condition."""

    aircraft: Aircraft
    trim: Trim
    augmentation: Augmentation


@dataclass(frozen=True, repr=False)
class MultirotorTest(FlownSet):
    """Flights of a multirotor: `craft` is what flew, `clean` what its maker knows."""

    craft: Multirotor
    clean: Multirotor


def fly(
    out: Path | None,
    *,
    speed: float | None = None,
    heading: float = 0.0,
    height: float | None = None,
    vehicle: Path | str | None = None,
    flights: Sequence[str] | None = None,
    seed: int = 0,
    effects: Sequence[tuple[str, float | None]] = (),
    progress: Progress | None = None,
    seconds: float | None = None,
) -> FlownSet:
    """Fly the built-in flight-test aircraft and write the data set.

    Parameters
    ----------
    out : folder to write, or None to keep the result in memory only.
    speed, heading, height : of the trimmed flight: m/s (hover), rad, m (27.4). Of a multirotor: speed of its figures
        and height of its hover, which go with its size.
    vehicle : a vehicle file (see `vehicle`), without one the UH-60; or the name of a multirotor, "quad", or
        "multirotor-N": the Nth one drawn at random.
    flights : names of flights (see `manoeuvres`); without them all of them, and those that an effect needs to show.
    seed : of sensor noise and gusts.
    effects : pairs of id and factor of the typical size (None: one), or ids alone; see `effects`.
    progress : called with samples done and in all.
    seconds : length of each flight (15; 20 of a multirotor).

    Raises
    ------
    InputError : an unknown flight or effect, a bad vehicle file, no trim, something in the way of `out`.

    Examples
    --------
    >>> import rotorid_torch as rotorid
    >>> test = rotorid.fly(None, flights=["f321_lon"], seconds=2.0)
    >>> test.dataset()
    Dataset uh60-0, helicopter: controls lon, lat, col, ped; 1 identify, 0 validate, 0 acid: f321_lon
    """
    order = _Order(out, vehicle, speed, heading, height, seconds, flights, effects, seed).checked()
    return _multirotor_test(order, progress) if is_multirotor(vehicle) else _helicopter_test(order, progress)


@dataclass(frozen=True)
class _Order:
    """What is asked for, as the arguments of `fly`."""

    out: Path | None
    vehicle: Path | str | None
    speed: float | None
    heading: float
    height: float | None
    seconds: float | None
    flights: Sequence[str] | None
    effects: Sequence[tuple[str, float | None]]
    seed: int

    def checked(self) -> _Order:
        """The same with numbers as numbers and lists as lists; InputError where an argument is neither."""
        of, optional = "fly", arguments.optional(arguments.number)
        arguments.optional(arguments.place)(Argument(of, "vehicle"), self.vehicle)
        named = 'a list of names of flights: ["f321_lon"]'
        flights = self.flights
        return replace(
            self,
            out=arguments.optional(arguments.place)(Argument(of, "out"), self.out),
            seed=arguments.seed(Argument(of, "seed"), self.seed),
            heading=arguments.number(Argument(of, "heading"), self.heading, "rad"),
            speed=optional(Argument(of, "speed"), self.speed),
            height=optional(Argument(of, "height"), self.height),
            seconds=optional(Argument(of, "seconds"), self.seconds),
            flights=None if flights is None else arguments.sequence(Argument(of, "flights"), flights, named),
            effects=_pairs(self.effects),
        )

    def names(self, hidden: Sequence[dict[str, Any]], library: Mapping[str, Hidden]) -> list[str]:
        """Flights that are asked for; without them all, and the groups that show what is hidden."""
        if self.flights is not None:
            return list(self.flights)
        return ["all", *(library[one["id"]].flights or "all" for one in hidden)]


def _helicopter_test(order: _Order, progress: Progress | None) -> FlightTest:
    """Fly a helicopter and write the data set."""
    out, vehicle = order.out, None if order.vehicle is None else Path(order.vehicle)
    if out is not None:
        refuse_unless_free(out, FLOWN, [] if vehicle is None else [vehicle])
    seconds = SECONDS if order.seconds is None else order.seconds
    height = HEIGHT if order.height is None else order.height
    usual = Condition(order.heading, height, order.speed or 0.0)
    _check_condition(usual, seconds)
    clean = load_aircraft(vehicle)
    aircraft, hidden = _altered(clean, order.effects, EVERY_FORM)
    names = chosen(order.names(hidden, HIDDEN), usual.speed)
    conditions = [conditioned(name, usual)[1] for name in names]
    for one in conditions:
        _check_condition(one, seconds)
    trims, augmentations = _trims(aircraft, {*conditions, usual})
    gains = [augmentations[one.speed] for one in conditions]
    common = gains[0] if all(one is gains[0] for one in gains) else gains
    programme = Programme(names, seconds, order.seed)
    history = fly_batch(aircraft, [trims[one] for one in conditions], common, programme, progress)
    truth = {name: true_channels(aircraft, history, k) for k, name in enumerate(names)}
    measured = {name: measured_channels(truth[name], MEASURED, name, order.seed) for name in names}
    label = out.name if out is not None else f"{aircraft.name}-{usual.speed:g}"
    declaration = declare(clean, label, names, MEASURED, usual.speed, height)
    flown = aircraft, trims[usual], augmentations[usual.speed]
    return _written(FlightTest(label, declaration, measured, truth, hidden, *flown), out)


def _multirotor_test(order: _Order, progress: Progress | None) -> MultirotorTest:
    """Fly a multirotor, whose controller knows the clean one, and write the data set."""
    clean = _of_size(multirotor(str(order.vehicle)), order.speed, order.height)
    seconds, seed = MULTIROTOR_SECONDS if order.seconds is None else order.seconds, order.seed
    if order.out is not None:
        refuse_unless_free(order.out, FLOWN, [])
    _check_condition(Condition(order.heading, clean.height, 0.0), seconds)
    craft, hidden = _altered(clean, order.effects, {name: one.change for name, one in MULTIROTOR.items()})
    names = manoeuvres.chosen(order.names(hidden, MULTIROTOR))
    fleet = Fleet.of([craft] * len(names), [clean] * len(names))
    samples = round(seconds * craft.rate) + 1
    time = fleet.step * np.arange(samples * fleet.every + 1, dtype=np.float64)
    targets = [manoeuvres.targets_of(name, clean, time, order.heading) for name in names]
    rows = np.stack(targets, axis=-1).swapaxes(0, 1)
    record = fly_fleet(fleet, Task(names, samples, lambda step: rows[step]), seed, progress)
    truth = {name: channels.true_channels(craft, record, k) for k, name in enumerate(names)}
    measured = {name: channels.measured_channels(craft, truth[name], name, seed) for name in names}
    label = order.out.name if order.out is not None else clean.name
    what = f"{FLOWN} ({clean.name}), a multirotor flown by its position controller; hover at {clean.height:.3g} m."
    declaration = channels.declare(clean, label, names, what)
    hidden = tuple({**one, "brings": list(MULTIROTOR[one["id"]].brings) if one["size"] else []} for one in hidden)
    return _written(MultirotorTest(label, declaration, measured, truth, hidden, craft, clean), order.out)


def _of_size(craft: Multirotor, speed: float | None, height: float | None) -> Multirotor:
    """A multirotor whose figures are flown at a speed and whose hover is at a height, where they are asked for."""
    speed = craft.speed if speed is None else speed
    height = craft.height if height is None else height
    _check_condition(Condition(0.0, height, speed), 1.0)
    if not 0.1 <= speed <= 30.0:
        raise InputError("usage", "speed", f"is {speed}", "a speed of figures of 0.1 to 30 m/s")
    return replace(craft, speed=speed, height=height)


def _pairs(effects: Any) -> list[tuple[str, float | None]]:
    """Ids of effects with factors of their typical sizes; an id alone has none."""
    argument, expected = Argument("fly", "effects"), 'a list of pairs of id and factor: [("control.delay", 1.0)]'
    pairs: list[tuple[str, float | None]] = []
    for one in arguments.sequence(argument, effects, expected):
        pair = (one, None) if isinstance(one, str) else one
        if not isinstance(pair, tuple | list) or len(pair) != 2 or not isinstance(pair[0], str):
            raise argument.wrong(f"holds {arguments.described(one)}", expected)
        pairs.append((pair[0], None if pair[1] is None else arguments.number(argument, pair[1], "a factor")))
    return pairs


def _trims(aircraft: Aircraft, conditions: set[Condition]) -> tuple[dict[Condition, Trim], dict[float, Augmentation]]:
    """Trim of each condition, and the augmentation that is designed for each speed.

    Another heading or height needs another trim only where wind, load or ground make a difference.
    """
    sense = -1.0 if aircraft.clockwise else 1.0
    trims: dict[Condition, Trim] = {}
    equilibria: dict[tuple[float, float, float], Trim] = {}
    gains: dict[float, Augmentation] = {}
    for one in sorted(conditions, key=lambda one: (one.speed, one.height, one.heading)):
        heading = sense * one.heading if aircraft.knows_directions else 0.0
        key = (one.speed, one.height if aircraft.wake.ground else 0.0, heading)
        if key not in equilibria:
            equilibria[key] = find_trim(aircraft, one.speed, one.height, heading)
        trim = equilibria[key] if aircraft.knows_directions else with_heading(equilibria[key], sense * one.heading)
        trims[one] = with_height(trim, one.height)
        if one.speed not in gains:
            gains[one.speed] = design(linearise(aircraft, equilibria[key]))
    return trims, gains


Test = TypeVar("Test", bound=FlownSet)


def _written(test: Test, out: Path | None) -> Test:
    """The flown set, written as a data set with its truth and effects; an earlier data set there is replaced."""
    if out is not None:
        declared = json.dumps({"effects": list(test.hidden)}, indent=1) + "\n"
        texts = {"truth/effects.json": declared, **declarations(out)}
        write_dataset(out, test.flights, truth=test.truth, texts=texts, name=test.name, **test.tables())
    return test


def _check_condition(condition: Condition, seconds: float) -> None:
    """Refuse a flight that nobody can fly."""
    speed, heading, height = condition.speed, condition.heading, condition.height
    if not (np.isfinite(speed) and 0.0 <= speed <= 150.0):
        raise InputError("usage", "speed", f"is {speed}", "a speed of 0 to 150 m/s")
    if not np.isfinite(heading):
        raise InputError("usage", "heading", f"is {heading}", "an angle in rad")
    if not (np.isfinite(height) and height > 0.0):
        raise InputError("usage", "height", f"is {height}", "a height above ground in m")
    if not 0.0 < seconds <= LONGEST_S:
        raise InputError("usage", "seconds", f"is {seconds:g}", f"a time above 0, {LONGEST_S:g} s at most")


Vehicle = TypeVar("Vehicle", Aircraft, Multirotor)


def _altered(
    aircraft: Vehicle, effects: Sequence[tuple[str, float | None]], library: Mapping[str, Callable[..., Vehicle]]
) -> tuple[Vehicle, tuple[dict[str, Any], ...]]:
    """The aircraft with all effects switched on, and a list of what each one changed."""
    changes = []
    for effect, factor in effects:
        size = 1.0 if factor is None else factor
        _check_effect(effect, size, library)
        family, change = FORMS.get(effect, effect), library[effect]
        if family in (one["id"] for one in changes):
            raise InputError("usage", "effect", f"'{family}' is there twice", "each effect once")
        changed = change(aircraft, size)
        changes.append({"id": family, "size": size, "changes": differences(aircraft, changed)})
        aircraft = changed
    return aircraft, tuple(changes)


def _check_effect(effect: str, size: float, library: Mapping[str, object]) -> None:
    """Refuse an effect that an aircraft of this kind cannot have, and a size that none has."""
    if effect not in library:
        elsewhere = {**EVERY_FORM, **MULTIROTOR}
        kind = "helicopter" if library is EVERY_FORM else "multirotor"
        why = f"it is a {kind}" if effect in elsewhere else f"there is none of that name{nearest(effect, library)}"
        wrong = f"the flight-test aircraft has no effect '{effect}': {why}"
        raise InputError("usage", "effect", wrong, f"one of: {arguments.listed(library)}")
    if not (np.isfinite(size) and 0.0 <= size <= 10.0):
        raise InputError("usage", "size", f"is {size} for {effect}", "a factor of its typical size, 0 to 10")


def declare(
    aircraft: Aircraft, name: str, flights: Sequence[str], channels: Sequence[str], speed: float, height: float
) -> dict[str, Any]:
    """The data set's dataset.toml."""
    rotor, sense = aircraft.rotor, -1.0 if aircraft.clockwise else 1.0
    mirror = np.array([1.0, sense, 1.0])
    side, nose = ("right", "right") if aircraft.clockwise else ("left", "left")
    positive = {"lon": "nose up", "lat": f"{side} side down", "col": "climb", "ped": f"nose {nose}"}
    state = f"flight at {speed:g} m/s" if speed else "hover"
    lock = aircraft.air_density * LOCK_SLOPE * rotor.chord * rotor.radius**4 / rotor.flap_inertia
    return {
        "format": 1,
        "name": name,
        "kind": "helicopter",
        "description": f"{FLOWN} ({aircraft.name}), {state} at {height:g} m, rate and attitude augmentation active.",
        "vehicle": {
            "mass": aircraft.mass,
            "inertia": (aircraft.inertia_matrix * np.outer(mirror, mirror)).tolist(),
            "mass_excludes": ["blades"],
            "gravity": aircraft.gravity,
            "air_density": aircraft.air_density,
            "hub": (np.asarray(rotor.hub) * mirror).tolist(),
            "imu": (np.asarray(aircraft.imu) * mirror).tolist(),
            "rotor": {
                "blades": rotor.blades,
                "radius": rotor.radius,
                "chord": rotor.chord,
                "speed": rotor.speed,
                "direction": "cw" if aircraft.clockwise else "ccw",
                "hinge_offset": rotor.hinge_offset,
                "lock_number": round(lock, 3),
            },
        },
        "controls": {
            control: {"unit": "rad", "limits": list(limits), "noise": NOISE[control], "positive": positive[control]}
            for control, limits in zip(CONTROL_NAMES, aircraft.limits, strict=True)
        },
        "channels": {c: {"noise": NOISE[c]} for c in channels if c != "time" and c not in CONTROL_NAMES},
        "flights": lists(flights),
        "model": {"reference": f"{speed:g} m/s" if speed else "hover"},
    }
