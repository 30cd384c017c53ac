"""What a data set is made of: declaration and flights together, where they fit each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import msgspec

from rotorid_torch.arguments import listed
from rotorid_torch.core import names
from rotorid_torch.data import plausible
from rotorid_torch.data.declare import Declaration
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.data.reading.dead import Dead, dead_channels, facts_without, flight_without
from rotorid_torch.data.schema import ChannelSpec, ControlSpec, FlightLists, ModelSettings, Vehicle
from rotorid_torch.errors import InputError, nearest
from rotorid_torch.printable import printable

SHOWN = 30
"""Flights that are listed by name, at most."""


@dataclass(frozen=True, eq=False, repr=False)
class Contents:
    """Vehicle, flights and their lists.

    `flights` of a folder are read when they are asked for, those used last stay in memory; `facts` of all are known.
    `derived` are channels that were made from others, which no score knows; where these are velocities that were
    `dead_reckoned` from specific forces, they drift. `dead` are channels that never change, which flights and facts are
    without.
    """

    name: str
    kind: str
    path: Path | None
    sha256: str
    description: str
    vehicle: Vehicle
    controls: tuple[str, ...]
    control_specs: Mapping[str, ControlSpec]
    channel_specs: Mapping[str, ChannelSpec]
    flights: Mapping[str, Flight]
    facts: Mapping[str, Facts]
    identify: tuple[str, ...]
    validate: tuple[str, ...]
    acid: tuple[str, ...]
    settings: ModelSettings
    warnings: tuple[str, ...]
    derived: frozenset[str] = frozenset()
    dead_reckoned: bool = False
    dead: tuple[Dead, ...] = ()


class Origin(NamedTuple):
    """Where a data set comes from: its folder, its declaration, each flight's file, and the hash of all of it."""

    folder: Path | None
    toml: str | Path
    places: Mapping[str, str | Path]
    sha256: str


def assembled(
    declaration: Declaration,
    flights: Mapping[str, Flight],
    facts: Mapping[str, Facts],
    origin: Origin,
    warnings: list[str],
) -> Contents:
    """Checks that need declaration and flights together, then what the data set is made of."""
    folder, toml, places, sha256 = origin
    flights, facts, spoken = _speeds_as_commands(flights, facts)
    declaration, flights, facts, left = _of_one_kind(declaration, flights, facts)
    controls, remarks = _controls(declaration, facts, places)
    specs = {
        name: declaration.controls.get(name) or ControlSpec(unit="norm" if names.is_motor(name) else "rad")
        for name in controls
    }
    _check_motors(declaration, controls, facts, toml)
    _check_channels(declaration, facts, toml)
    dead = dead_channels(facts, declaration.flights.identify)
    flights, facts = (_living(flights, dead), facts_without(facts, dead)) if dead else (flights, facts)
    return Contents(
        name=declaration.name or (printable(folder.resolve().name, layout=False) if folder else "arrays"),
        kind=declaration.kind,
        path=folder,
        sha256=sha256,
        description=declaration.description,
        vehicle=declaration.vehicle,
        controls=controls,
        control_specs=MappingProxyType(specs),
        channel_specs=MappingProxyType(dict(declaration.channels)),
        flights=MappingProxyType(flights),
        facts=MappingProxyType(facts),
        identify=declaration.flights.identify,
        validate=declaration.flights.validate,
        acid=declaration.flights.acid,
        settings=declaration.model,
        warnings=(*declaration.warnings, *warnings, *spoken, *left, *remarks, *_other_names(facts)),
        dead=dead,
    )


def _speeds_as_commands(
    flights: Mapping[str, Flight], facts: Mapping[str, Facts]
) -> tuple[Mapping[str, Flight], Mapping[str, Facts], list[str]]:
    """Flights with motor commands, 0 to 1, in proportion to the rotor speeds where no control is recorded; a remark.

    One is the largest speed of all rotors and flights. The speeds stay beside them, and carry the thrust.
    """
    recorded = {channel for one in facts.values() for channel in one.channels}
    speeds = sorted(name for name in recorded if names.is_rotor_speed(name))
    if not speeds or any(map(names.is_control, recorded)) or not all(one.has(*speeds) for one in facts.values()):
        return flights, facts, []
    largest = max(max(abs(s.low), abs(s.high)) for one in facts.values() for s in (one.spreads[n] for n in speeds))
    if largest <= 0.0:
        return flights, facts, []

    def commanded(name: str) -> Flight:
        flight = flights[name]
        commands = {f"motor{n.removeprefix('omega')}": flight.channels[n].abs() / largest for n in speeds}
        return Flight(flight.name, flight.dt, MappingProxyType({**flight.channels, **commands}))

    whole = OnDemand(flights, commanded)
    said = f"no commands are recorded: the rotor speeds are the controls, 1 is {largest:.4g} rad/s"
    return whole, {name: Facts.of(whole[name]) for name in whole}, [said]


def _check_motors(
    declaration: Declaration, controls: Sequence[str], facts: Mapping[str, Facts], toml: str | Path
) -> None:
    """Refuse motors that are not as many as their commands, and thrusts that no vehicle has."""
    motors = declaration.vehicle.motors
    commands = [name for name in controls if names.is_motor(name)]
    if motors and commands and len(motors) != len(commands):
        raise InputError(
            toml, "vehicle.motors", f"declares {len(motors)} motors", f"{len(commands)}, one per motor command"
        )
    plausible.check_thrust(declaration.vehicle, _largest_inputs(commands, facts), toml)


def _check_channels(declaration: Declaration, facts: Mapping[str, Facts], toml: str | Path) -> None:
    """Refuse a declared channel that is neither in the table nor in any flight."""
    present = {channel for flight_facts in facts.values() for channel in flight_facts.channels}
    for channel in declaration.channels:
        if names.channel(channel) is None and channel not in present:
            hint = nearest(channel, names.CHANNELS)
            raise InputError(
                toml, f"channels.{channel}", f"no flight has this channel{hint}", "a channel of the data set"
            )


def _other_names(facts: Mapping[str, Facts]) -> list[str]:
    """Sentences on channels of other names, which nothing uses, that may stand for a known one that is not recorded."""
    recorded = {channel: None for flight_facts in facts.values() for channel in flight_facts.channels}
    meant = {name: names.meant(name) for name in recorded if names.channel(name) is None}
    return [
        f"channel '{name}' is kept and not used (did you mean '{near}'?)"
        for name, near in meant.items()
        if near and near not in recorded
    ]


def _of_one_kind(
    declaration: Declaration, flights: Mapping[str, Flight], facts: Mapping[str, Facts]
) -> tuple[Declaration, Mapping[str, Flight], Mapping[str, Facts], list[str]]:
    """A multirotor's flights that tell of commands and rates, where others are logs of another kind; and a remark."""
    commands = {c for one in facts.values() for c in one.channels if names.is_motor(c)}
    whole = {name for name, one in facts.items() if one.has(*names.RATES, *commands)}
    chosen = {
        w: tuple(n for n in getattr(declaration.flights, w) if n in whole) for w in ("identify", "validate", "acid")
    }
    if declaration.kind != "multirotor" or len(whole) == len(facts) or not chosen["identify"]:
        return declaration, flights, facts, []
    left = [name for name in facts if name not in whole]
    said = f"{listed(left, SHOWN)} left out: logs of another kind, without body rates or motor commands, beside flights"
    reduced = msgspec.structs.replace(declaration, flights=FlightLists(**chosen))
    return (
        reduced,
        OnDemand([name for name in flights if name in whole], lambda name: flights[name]),
        {name: one for name, one in facts.items() if name in whole},
        [f"{said} that have both"],
    )


def _living(flights: Mapping[str, Flight], dead: Sequence[Dead]) -> Mapping[str, Flight]:
    """The flights without their dead channels, each when it is asked for."""
    return OnDemand(flights, lambda name: flight_without(flights[name], dead))


def _largest_inputs(commands: Sequence[str], facts: Mapping[str, Facts]) -> list[float]:
    """What the declared thrusts are of: 1 of a motor command, or the largest rotor speeds where all are recorded."""
    speeds = [f"omega{command.removeprefix('motor')}" for command in commands]
    if not all(flight_facts.has(*speeds) for flight_facts in facts.values()):
        return [1.0] * len(commands)
    spreads = ([flight_facts.spreads[speed] for flight_facts in facts.values()] for speed in speeds)
    return [max(max(abs(s.low), abs(s.high)) for s in every) for every in spreads]


def _controls(
    declaration: Declaration, facts: Mapping[str, Facts], places: Mapping[str, str | Path]
) -> tuple[tuple[str, ...], list[str]]:
    """Controls: the declared ones and those of the vehicle's kind that are recorded; every flight must have them."""
    recorded = {
        channel for flight_facts in facts.values() for channel in flight_facts.channels if names.is_control(channel)
    }
    motors = declaration.kind == "multirotor"
    of_kind = {name for name in recorded if names.is_motor(name) == motors}
    chosen = names.ordered_controls(set(declaration.controls) | of_kind or recorded)
    if not chosen:
        file = places[declaration.flights.identify[0]]
        raise InputError(file, "controls", "there is no control", "at least one of lon, lat, col, ped, motor1, ...")
    for name, flight_facts in facts.items():
        for control in chosen:
            if not flight_facts.has(control):
                expected = "every control of the data set in every flight"
                raise InputError(places[name], control, flight_facts.lack(control), expected)
    undeclared = [name for name in chosen if name not in declaration.controls]
    remarks = [
        f"{' '.join(alike)}: no [controls.{alike[0]}] says the unit, taken as {unit}"
        for unit, motor in (("rad", False), ("norm", True))
        if (alike := [name for name in undeclared if names.is_motor(name) == motor])
    ]
    unused = sorted(recorded - set(chosen))
    remarks += [f"channel {name} is recorded, not declared as a control and not used" for name in unused]
    return chosen, [*remarks, *_of_motors(declaration.kind, chosen)]


def _of_motors(kind: str, controls: Sequence[str]) -> list[str]:
    """Sentences on motors that are missing between others, and on a helicopter that has nothing but motors."""
    numbers = {int(name.removeprefix("motor")) for name in controls if names.is_motor(name)}
    missing = [f"motor{number}" for number in range(1, max(numbers, default=0)) if number not in numbers]
    remarks = [f"{' '.join(missing)}: not recorded beside {' '.join(controls)}, so that nothing explains what it does"]
    only = kind == "helicopter" and len(numbers) == len(controls)
    said = 'kind is helicopter, but every control is a motor command: kind = "multirotor" has its physics'
    return [*(remarks if missing else []), *([said] if only else [])]
