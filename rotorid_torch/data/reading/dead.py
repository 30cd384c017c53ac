"""Channels that stand still while the aircraft flies measure nothing: left out as if they were not recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from rotorid_torch.core import names
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.flight import Flight

STEADY = (*names.POSITIONS, "psi", "omega", "torque", "voltage")
"""Channels that may be steady in a flight and differ from one to the next, as height and rotor speed in a simulator."""


@dataclass(frozen=True)
class Dead:
    """A channel without a change, in these flights; `everywhere` where it changes in no identify flight."""

    channel: str
    flights: tuple[str, ...]
    everywhere: bool
    value: float

    @property
    def sentence(self) -> str:
        """What is wrong and what was done, without the channel's name."""
        at = f"{self.value:.4g} {names.unit(self.channel)}".rstrip()
        done = "left out as if it were not recorded. Check the sensor and its connection."
        if self.everywhere:
            return f"never changes in the identify flights ({at} in all samples): dead, or not connected; {done}"
        where = f"never changes in {', '.join(self.flights)} ({at} in all samples), and moves in other flights"
        return f"{where}: {done}"


def dead_channels(facts: Mapping[str, Facts], identify: Sequence[str]) -> tuple[Dead, ...]:
    """Measured channels without a change in all identify flights, and those that lack one in some flights.

    A record without noise rests at trim, and may rest for a whole flight that moves other axes: a channel that rests
    where most of its other flights begin is no dead one. Controls may rest, and channels of other names are not judged.
    """
    channels = dict.fromkeys(channel for each in facts.values() for channel in each.spreads)
    judged = (c for c in channels if c != "time" and names.channel(c) is not None and not names.is_control(c))
    unchanging = (_dead(channel, facts, set(identify)) for channel in judged)
    return tuple(one for one in unchanging if one is not None)


def _dead(channel: str, facts: Mapping[str, Facts], identify: set[str]) -> Dead | None:
    spreads = {flight: each.spreads[channel] for flight, each in facts.items() if channel in each.spreads}
    rounding = {flight: 1e-12 * max(abs(spread.low), abs(spread.high)) for flight, spread in spreads.items()}
    still = {flight: spread for flight, spread in spreads.items() if spread.high - spread.low <= rounding[flight]}
    moving = {flight: spread for flight, spread in spreads.items() if flight not in still}
    if not still:
        return None
    value = next(iter(still.values())).low
    if not identify & {*moving} and (identify & {*still} or not moving):
        steady = channel in STEADY or channel.startswith("omega")
        differ = any(abs(spread.low - value) > 1e-9 * abs(value) for spread in still.values())
        return None if steady and differ else Dead(channel, tuple(spreads), True, value)
    if 2 * sum(spread.rests for spread in moving.values()) >= len(moving):
        return None
    return Dead(channel, tuple(still), False, value)


def facts_without(facts: Mapping[str, Facts], dead: Sequence[Dead]) -> dict[str, Facts]:
    """Facts of all flights, without the dead channels of each."""
    return {flight: _facts_without(each, _gone(flight, dead)) for flight, each in facts.items()}


def flight_without(flight: Flight, dead: Sequence[Dead]) -> Flight:
    """A flight without its dead channels."""
    gone = _gone(flight.name, dead)
    remaining = {channel: values for channel, values in flight.channels.items() if channel not in gone}
    return replace(flight, channels=MappingProxyType(remaining))


def _gone(flight: str, dead: Sequence[Dead]) -> set[str]:
    return {one.channel for one in dead if flight in one.flights}


def _facts_without(facts: Facts, gone: set[str]) -> Facts:
    spreads = {channel: spread for channel, spread in facts.spreads.items() if channel not in gone}
    return replace(facts, channels=tuple(c for c in facts.channels if c not in gone), spreads=spreads)
