"""Flights of a multirotor that have rotor speeds and no commands: the speeds are the controls."""

from collections.abc import Mapping
from types import MappingProxyType

from rotorid_torch.core import names
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.on_demand import OnDemand

Flights = Mapping[str, Flight]


def speeds_as_commands(flights: Flights, facts: Mapping[str, Facts]) -> tuple[Flights, Mapping[str, Facts], list[str]]:
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
