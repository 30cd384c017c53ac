"""Controls: limits, excitation, feedback, and how quietly the flights begin."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.excitation import BAND_HZ, Excitation, excitation
from rotorid_torch.data.finding import Finding, finding

FEEDBACK = 0.1
"""Share of a control's own motion below which only a combination of derivatives can be found."""


def controls(dataset: Dataset) -> Iterator[Finding]:
    """Saturation, declared limits, excitation and its share that is not feedback."""
    every = [excitation(dataset, control) for control in dataset.controls]
    yield from _limits(dataset, every)
    still = [e.control for e in every if not e.moved]
    if still:
        told = "hardly moves in any identify flight: its derivatives cannot be found. Fly a 3-2-1-1 or doublet on it."
        yield finding("warning", " ".join(still), told)
    moving = [e for e in every if e.moved]
    bound = [e for e in moving if e.independent < FEEDBACK]
    if bound:
        told = ", ".join(f"{e.independent:.0%} of {e.control}" for e in bound)
        yield finding(
            "warning",
            " ".join(e.control for e in bound),
            f"only {told} from {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz is the control's own motion,",
            "the rest follows",
            "the aircraft and the other controls (feedback): only combinations of derivatives can be found.",
            "Fly test inputs on top of the controller, one control at a time.",
        )
    for e in moving:
        if e.independent >= FEEDBACK:
            yield finding("good", e.control, _moves(dataset, e))


def _moves(dataset: Dataset, e: Excitation) -> str:
    unit = dataset.control_specs[e.control].unit
    where = f"in {len(e.moved)} of {len(dataset.identify)} identify flights"
    own = f"{e.independent:.0%} of its motion from {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz is its own, not feedback"
    return f"moves up to {e.travel:.3g} ({unit}) {where}; {own}."


def _limits(dataset: Dataset, every: Sequence[Excitation]) -> Iterator[Finding]:
    full = [e for e in every if e.at_limit > 0.01]
    if full:
        told = ", ".join(f"{e.control} up to {e.at_limit:.0%} of a flight" for e in full)
        reason = "what was asked beyond the limit is not in the record. Use smaller inputs."
        yield finding("warning", " ".join(e.control for e in full), f"on a limit: {told};", reason)
    for e in every:
        limits = dataset.control_specs[e.control].limits
        if limits and e.outside > 0.02 * (limits[1] - limits[0]):
            told = f"goes {e.outside:.3g} beyond its declared limits {list(limits)}. Check limits and unit."
            yield finding("warning", e.control, told)


def trim(dataset: Dataset) -> Iterator[Finding]:
    """Whether the identify flights begin quietly enough to know the trim."""
    moving = [name for name in dataset.identify if dataset.quiet(name) * dataset.facts[name].dt < 0.8]
    if not moving:
        yield finding("good", "", "every identify flight begins with a quiet second: the trim is well known.")
        return
    whole = "every identify flight" if len(moving) == len(dataset.identify) else ", ".join(moving)
    told = f"controls move within the first second of {whole}: the trim is only the mean of 0.5 s there."
    yield finding("note", "", told, "Begin records a second before the input.")
