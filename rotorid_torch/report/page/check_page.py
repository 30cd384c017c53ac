"""The page of a check: the grade first, what to mend, what to fly, then every channel, finding and picture."""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from rotorid_torch.consistency.examination.finding import Finding
from rotorid_torch.report.page.document import LONG_HEADLINE, rendered
from rotorid_torch.report.records import Report

FLY = re.compile(r"\b([Ff]l(y|own)|[Ii]nputs?|manoeuvre|quiet second|Begin records)\b")
"""What a sentence says that asks for other flights rather than for other sensors."""
MOST = 6
"""Findings that the first screen names."""
CAPTIONS = {
    "sampling": "Stamps as recorded: a line is a good clock, a cloud jitters, a lone point is a gap.",
    "spectra": "Where motion ends and noise begins; vibration stands out as a line.",
    "coherence": "In the grey band a response belongs to the controls; fit and judge there.",
    "controls": "What was flown: each control should move by itself in some flight.",
    "correlation": "Controls that go together, or with the motion, are told apart only where they do not.",
    "kinematics": "Rate of each channel less what the others say: recorded (red), without lag, scale and bias (blue)."
    " Red that blue repairs is a clock, a scale or a bias.",
}
FIRST = ("kinematics", "coherence", "controls")
"""Pictures for the first screen: where a sensor errs the first, else the second."""


class Examined(Protocol):
    """What a check has come to."""

    @property
    def sentence(self) -> str:
        """The grade in words."""
        ...

    @property
    def findings(self) -> Sequence[Finding]:
        """Gravest first."""
        ...


@dataclass(frozen=True)
class Image:
    """A picture as PNG in base64, with its caption and its words for who cannot see it."""

    data: str
    caption: str
    alt: str


def render_check(check: Examined, report: Report, pictures: Mapping[str, bytes]) -> str:
    """Return the page; `pictures` are PNG bytes by name."""
    grave = [one for one in check.findings if one.severity in ("error", "warning")]
    notes = [one for one in check.findings if one.severity == "note"]
    images = {name: _image(name, png) for name, png in pictures.items()}
    main = images.pop(next((n for n in FIRST[not grave :] if n in images), ""), None)
    return rendered(
        "check.html.j2",
        check=check,
        report=report,
        headline=headline(check.sentence),
        long=len(headline(check.sentence)) > LONG_HEADLINE,
        mend=[one for one in grave if not FLY.search(one.sentence)][:MOST],
        fly=[one for one in (*grave, *notes) if FLY.search(one.sentence)][:MOST],
        main=main,
        pictures=list(images.values()),
    )


def headline(sentence: str) -> str:
    """The grade in words, of many reasons in brackets without these: axes and lists below have them."""
    short = sentence if len(sentence) <= LONG_HEADLINE else sentence.partition(" (")[0]
    return f"{short[:1].upper()}{short[1:]}."


def _image(name: str, png: bytes) -> Image:
    caption = CAPTIONS.get(name, name)
    return Image(base64.b64encode(png).decode(), caption, f"{name}: {caption[0].lower()}{caption[1:]}")
