"""The cases of the golden study: flights with something hidden in them, and what a right verdict names.

Drawn aircraft come in two halves with seeds of their own. The tuning half may be looked at to set something; the
judging half is run at milestones and never looked at to set anything. Sets of other people are in neither half.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import combinations
from pathlib import Path

import numpy as np
from hidden import in_records
from hidden.drawn_aircraft import draw, fly_drawn, groups_of
from hidden.outside_causes import CAUSES
from hidden.true_parameters import true_parameters

import rotorid_torch as rotorid
from rotorid_torch.simulation.helicopter.hidden import HIDDEN


class Kind(StrEnum):
    """What is asked of the closed loop."""

    SHARED = "shared"
    """A set of other people, as it is."""
    RECORDS = "records"
    """A set of other people that hides nothing, with a cause put into its records."""
    CLEAN = "clean"
    EFFECT = "effect"
    PAIR = "pair"
    GUSTS = "gusts"
    """Turbulence at its typical size: with nothing else, with a delay, with a slung load."""
    OUTSIDE = "outside"
    """A cause that no library has."""
    REMOVED = "removed"
    """An effect whose own entry is taken out of the library: every name is a wrong one. Errors of sensors stay in: the
    search that finds them is over the sensors' equations, and has no entries to take out."""
    QUICK = "quick"
    """A clean aircraft, few short flights of it, and a library of one effect."""


class Half(StrEnum):
    """Which part of the study."""

    SHARED = "shared"
    TUNING = "tuning"
    JUDGING = "judging"


SEEDS = {Half.TUNING: 101, Half.JUDGING: 202}
SIZES = (1.0, 0.5)
PAIRS, OUTSIDE_AIRCRAFT = 14, 3
ABSORBED = frozenset(
    (
        "rotor.wake_distortion",
        "rotor.stall",
        "forces.drag",
        "forces.quadratic_damping",
        "forces.translational_lift",
        "forces.tail_interference",
        "mass.payload",
        "mass.cg",
        "mass.inertia",
    )
)
"""Effects of which free derivatives, trims and initial states of a helicopter in hover explain all, or nearly all."""
IN_GUSTS = (
    ("environment.turbulence",),
    ("environment.turbulence", "control.delay"),
    ("environment.turbulence", "mass.slung_load"),
)
"""Pairs of a round, and aircraft on each of which each outside cause acts in a round."""
TINY = ("f321_lon", "f321_lat", "f321_col", "f321_ped", "dbl_lat_n")
TINY_SECONDS = 4.0


@dataclass(frozen=True)
class Answer:
    """What a right verdict on a set of other people names; `hidden` is None where the description does not state it.

    `also` : names that the description backs as well, which are neither asked for nor wrong. `true` : sizes by name.
    """

    hidden: tuple[str, ...] | None = None
    also: tuple[str, ...] = ()
    true: Mapping[str, float] = field(default_factory=dict)


MOTORS = ("propulsion.voltage", "propulsion.motor_lag")
ANSWERS = {
    "uh60-hover": Answer(()),
    "uh60-60kt": Answer(()),
    "ah1-hover": Answer(()),
    "uh60b-hover": Answer(()),
    "uh60-delay": Answer(("control.delay",), true={"control.delay.common": 0.06}),
    "uh60-x1": Answer(),
    "uh60-x2": Answer(),
    "uh60-x3": Answer(),
    "ah1-x1": Answer(),
    "crazyflie-motors": Answer(
        ("propulsion.motor_lag", "control.delay", "propulsion.rotor_inertia"), also=("mass.inertia",)
    ),
    "crazypad-normal": Answer(("propulsion.motor_lag",), also=("control.delay",)),
    "crazypad-x1": Answer(),
    "crazypad-x2": Answer(),
    "trex550-rates": Answer(),
    "trex550-translation": Answer(("sensors.delay",), also=("forces.drag", "sensors.bias", "environment.vibration")),
    "nanodrone": Answer(
        ("propulsion.rotor_drag", *MOTORS),
        also=("control.delay", "propulsion.axial_inflow", "propulsion.rotor_inertia"),
    ),
    "sag": Answer(("propulsion.rotor_drag", *MOTORS), also=("control.delay", "sensors.misalignment")),
    "ground-67g": Answer(("environment.ground", *MOTORS), also=("control.delay", "sensors.scale")),
}
"""Sets of other people by name, those that take longest last; answers as the sets' descriptions back them."""
CLEAN_SETS = tuple(name for name, answer in ANSWERS.items() if answer.hidden == ())


@dataclass(frozen=True)
class Case:
    """One closed loop.

    `hidden` : effects and causes, none for a clean aircraft; None where the description does not state them.
    `size` : factor of the typical size. `aircraft` : number of the drawn aircraft. `dataset` : name of the set of other
    people. `repeat` : of noise.
    """

    half: Half
    kind: Kind
    hidden: tuple[str, ...] | None = ()
    size: float = 0.0
    aircraft: int = 0
    dataset: str = ""
    repeat: int = 0

    @property
    def key(self) -> str:
        """What makes the case another one."""
        hidden = "not stated" if self.hidden is None else "+".join(self.hidden) or "nothing"
        vehicle = self.dataset or f"aircraft {self.aircraft}"
        return f"{self.half} {self.kind} {vehicle} {hidden} x{self.size:g} #{self.repeat}"

    @property
    def also(self) -> tuple[str, ...]:
        """Names that are not wrong, beside what is hidden."""
        return ANSWERS[self.dataset].also if self.kind is Kind.SHARED else ()

    @property
    def seed(self) -> int:
        """Of noise and gusts: another one where something else is hidden."""
        words = zlib.crc32("+".join(self.hidden or ()).encode())
        return int(np.random.default_rng([SEEDS[self.half], words, self.repeat]).integers(1_000_000))


@dataclass(frozen=True)
class Flown:
    """Flights of a case as a data set, and true sizes by full name of the parameter."""

    dataset: rotorid.Dataset
    true: Mapping[str, float]


def shared_cases() -> Iterator[Case]:
    """Sets of other people as they are; with causes in their records; with the entry of what they hide removed."""
    late = ("uh60-delay", ANSWERS["uh60-delay"].hidden)
    causes = [(name, (cause,)) for cause in in_records.CAUSES for name in CLEAN_SETS]
    removed = [late, *(pair for pair in causes if pair[1][0] in HIDDEN)]
    for name, answer in ANSWERS.items():
        yield Case(Half.SHARED, Kind.SHARED, answer.hidden, float(answer.hidden != ()), dataset=name)
    for kind, pairs in ((Kind.RECORDS, causes), (Kind.REMOVED, removed)):
        yield from (Case(Half.SHARED, kind, hidden, 1.0, dataset=name) for name, hidden in pairs)


def drawn_cases(half: Half, aircraft: int, clean: int, rounds: int) -> Iterator[Case]:
    """Cases of drawn aircraft of one half: in whatever order they are cut short, all aircraft have had their turn.

    Parameters
    ----------
    aircraft : drawn in this half. clean : cases in which nothing is hidden. rounds : over all that can be hidden.
    """
    for k in range(clean):
        yield Case(half, Kind.CLEAN, aircraft=k % aircraft, repeat=k // aircraft)
    for n in range(rounds):
        hidden = [(Kind.EFFECT, (effect,), size, n) for size in SIZES for effect in HIDDEN]
        hidden += [(Kind.REMOVED, (effect,), 1.0, n) for effect in HIDDEN if not effect.startswith("sensors.")]
        hidden += [(Kind.PAIR, pair, 1.0, n) for pair in _pairs(half, n)]
        repeats = range(n * OUTSIDE_AIRCRAFT, (n + 1) * OUTSIDE_AIRCRAFT)
        hidden += [(Kind.OUTSIDE, (cause,), 1.0, repeat) for repeat in repeats for cause in CAUSES]
        order = np.random.default_rng([SEEDS[half], n]).permutation(len(hidden))
        for turn, (kind, effects, size, repeat) in enumerate(hidden[k] for k in order):
            yield Case(half, kind, effects, size, (turn + n) % aircraft, repeat=repeat)
    for k in range(clean):
        yield from (Case(half, Kind.GUSTS, hidden, 1.0, k % aircraft, repeat=k // aircraft) for hidden in IN_GUSTS)


def _pairs(half: Half, repeat: int) -> list[tuple[str, str]]:
    """Two identifiable effects each, drawn."""
    pairs = list(combinations((effect for effect in HIDDEN if effect not in ABSORBED), 2))
    rng = np.random.default_rng([SEEDS[half], repeat, PAIRS])
    return [pairs[k] for k in rng.choice(len(pairs), PAIRS, replace=False)]


def flights_of(case: Case, shared: Path, aircraft: Path, folder: Path) -> Flown:
    """Flights of a case.

    Parameters
    ----------
    shared : folder of the sets of other people. aircraft : folder of the drawn aircraft. folder : for flights.
    """
    if not case.dataset:
        return _flown(case, aircraft, folder)
    dataset = rotorid.load(shared / case.dataset)
    true = dict(ANSWERS[case.dataset].true)
    if case.kind is Kind.SHARED or case.hidden == ANSWERS[case.dataset].hidden:
        return Flown(dataset, true)
    altered = in_records.CAUSES[(case.hidden or ("",))[0]](dataset)
    return Flown(altered.dataset, altered.true)


def _flown(case: Case, aircraft: Path, folder: Path) -> Flown:
    """Flights of a drawn aircraft: all of the usual ones, and those without which what is hidden would not show."""
    hidden, tiny = case.hidden or (), case.kind is Kind.QUICK
    drawn = draw(case.aircraft, SEEDS[case.half], aircraft)
    flights, seconds = (TINY, {"seconds": TINY_SECONDS}) if tiny else (groups_of(hidden), {})
    flown = fly_drawn(drawn, hidden, case.size, flights, case.seed, folder, **seconds)
    if tiny:  # a vehicle of which nothing is declared has few parameters, and no clean aircraft is flown for it
        flown.declaration["vehicle"] = {}
    return Flown(rotorid.load(flown.write(folder / "flights")), true_parameters(flown.clean, hidden, case.size))
