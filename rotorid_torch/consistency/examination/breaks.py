"""What no flight does: channels that jump, and stretches that are there twice."""

from __future__ import annotations

from collections.abc import Iterator

from rotorid_torch.consistency.examination.finding import Finding, finding
from rotorid_torch.consistency.records.copies import Copy, copies
from rotorid_torch.consistency.records.steps import Step, steps
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset

TOLD = 6
"""Steps that one sentence names."""


def jumps(dataset: Dataset) -> Iterator[Finding]:
    """Steps of attitude, velocity and position that no motion makes, with their times."""
    by_flight: dict[str, list[Step]] = {}
    for step in steps(dataset):
        by_flight.setdefault(step.flight, []).append(step)
    for flight, jumped in by_flight.items():
        listed = ", ".join(f"{s.channel} {s.size:+.3g} {names.unit(s.channel)} at {s.at:.2f} s" for s in jumped[:TOLD])
        more = f" and {len(jumped) - TOLD} more" if len(jumped) > TOLD else ""
        channels = " ".join(dict.fromkeys(s.channel for s in jumped))
        sentence = f"steps from one sample to the next ({listed}{more}), which no motion makes:"
        cause = "an estimator was reset. Cut the flight there, or undo the step; no bias is told from it."
        yield finding("warning", channels, sentence, cause, flight=flight)


def twice(dataset: Dataset) -> Iterator[Finding]:
    """Flights and stretches that are there twice; an error where a list is judged by what another one was fitted to."""
    lists = {name: word for word in ("identify", "validate", "acid") for name in getattr(dataset, word)}
    for one in copies(dataset):
        across = lists.get(one.flight) != lists.get(one.of)
        where = _where(one, dataset)
        if across:
            sentence = f"{where}: {lists.get(one.flight)} is then judged by what {lists.get(one.of)} holds."
            yield finding("error", "", sentence, "Leave one of the two out.", flight=one.flight)
        else:
            sentence = f"{where}: it counts twice."
            yield finding("warning", "", sentence, "Leave one of the two out.", flight=one.flight)


def _where(one: Copy, dataset: Dataset) -> str:
    whole = one.seconds > 0.98 * dataset.facts[one.flight].seconds
    if whole and one.flight != one.of:
        return f"is a copy of {one.of}, sample by sample"
    here = "itself" if one.flight == one.of else one.of
    stretch = f"{one.seconds:.1f} s from {one.at:.1f} s on"
    return f"{stretch} repeat {here} from {one.of_at:.1f} s on, sample by sample"
