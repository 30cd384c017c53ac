"""What every step needs of a data set: body rates that move, a control that moves, flights that are long enough."""

from collections.abc import Iterator
from dataclasses import dataclass

from rotorid_torch.consistency.examination.finding import Finding, finding
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.errors import InputError

SHORTEST_S = 1.5
"""Least length of a flight to identify from: the regressions need several periods of the slowest motion they hold."""
FEWEST = 30
"""Least samples of a body rate or control in such a flight: a few for each of the parameters of an equation."""


@dataclass(frozen=True)
class Lack:
    """Something that a flight lacks: the channel or key, what is wrong, what was expected."""

    flight: str
    key: str
    wrong: str
    expected: str


def lacks(dataset: Dataset) -> Iterator[Lack]:
    """Whatever keeps the steps from making a model of a data set."""
    for flight, rate, wrong in dataset.lacking_rates():
        yield Lack(flight, rate, wrong, "body rates p q r in rad/s that move, in every flight")
    if dataset.kind == "multirotor" and not any(map(names.is_motor, dataset.controls)):
        text = f"a multirotor whose controls are {', '.join(dataset.controls)}"
        yield Lack(dataset.identify[0], "motor1", text, 'motor commands motor1, motor2, ..., or kind = "helicopter"')
    yield from _of_records(dataset)


def examinable(dataset: Dataset) -> bool:
    """Whether records are long enough, and controls move, so that more can be said of them than that."""
    return next(_of_records(dataset), None) is None


def _of_records(dataset: Dataset) -> Iterator[Lack]:
    spreads = [dataset.facts[flight].spreads[c] for flight in dataset.identify for c in dataset.controls]
    if not any(spread.low < spread.high for spread in spreads):
        text = "no control moves in any identify flight"
        yield Lack(dataset.identify[0], dataset.controls[0], text, "a test input on one")
    for flight in dataset.identify:
        yield from _of_length(dataset, flight)


def _of_length(dataset: Dataset, flight: str) -> Iterator[Lack]:
    facts = dataset.facts[flight]
    if facts.seconds < SHORTEST_S:
        wanted = f"at least {SHORTEST_S:g} s in a flight of the identify list"
        yield Lack(flight, "time", f"the flight lasts {facts.seconds:.3g} s", wanted)
        return
    for channel in (*dataset.controls, *(rate for rate in names.RATES if facts.has(rate))):
        count = facts.spreads[channel].count
        if count < FEWEST:
            yield Lack(flight, channel, f"has {count} samples", f"at least {FEWEST} in a flight of the identify list")
            return


def refuse_lacks(dataset: Dataset) -> None:
    """Raise InputError where the steps cannot make a model of a data set, with the first reason."""
    for lack in lacks(dataset):
        raise InputError(dataset.file(lack.flight), lack.key, lack.wrong, lack.expected)


def needs(dataset: Dataset) -> Iterator[Finding]:
    """The same as errors of `check`; flights that lack the same are one finding, the first one's."""
    alike = dict[tuple[str, str, str], list[Lack]]()
    for lack in lacks(dataset):
        alike.setdefault((lack.key, lack.wrong.split()[0], lack.expected), []).append(lack)
    for first, *others in alike.values():
        more = f" (likewise in {', '.join(lack.flight for lack in others)})" if others else ""
        text = f"{first.wrong}{more}; identify needs {first.expected}."
        yield finding("error", first.key, text, flight=first.flight)
