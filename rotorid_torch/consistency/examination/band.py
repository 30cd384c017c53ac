"""In which band each response belongs to the controls."""

from __future__ import annotations

from collections.abc import Iterator

from rotorid_torch.consistency.examination.finding import Finding, finding
from rotorid_torch.consistency.records.coherence import Coherence, coherences
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset

RESPONSES = (*names.RATES, *names.SPECIFIC_FORCES, *names.VELOCITIES)


def band(dataset: Dataset) -> Iterator[Finding]:
    """Rates and specific forces (else velocities) that follow the controls, and those that nowhere do."""
    measured = coherences(dataset, RESPONSES)
    good = [c for c in measured if c.band is not None]
    forces = set(names.SPECIFIC_FORCES) <= {c.channel for c in measured}
    lost = [c for c in measured if c.band is None and not (forces and c.channel in names.VELOCITIES)]
    if good:
        sentence = f"follow the controls with coherence above 0.6: {', '.join(map(_stretch, good))}."
        yield finding(
            "good", " ".join(c.channel for c in good), sentence, "Outside that fits and scores see other causes."
        )
    if lost:
        sentence = "nowhere follow the controls with coherence above 0.6: noise, air or a controller moves them."
        advice = "Models of them rest on little: fly larger inputs, in calm air, on one control at a time."
        yield finding("warning", " ".join(c.channel for c in lost), sentence, advice)


def _stretch(c: Coherence) -> str:
    low, high = c.band or (0.0, 0.0)
    return f"{c.channel} {low:.1g} to {high:.2g} Hz"
