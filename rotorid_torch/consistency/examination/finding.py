"""What an examination of a data set finds."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["good", "note", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """One finding: how grave, of which flight and channel (empty: of all), and a sentence that also says what to do."""

    severity: Severity
    flight: str
    channel: str
    sentence: str


def finding(severity: Severity, channel: str, *parts: str, flight: str = "") -> Finding:
    """Finding whose sentence is the parts, joined by blanks."""
    return Finding(severity, flight, channel, " ".join(parts))
