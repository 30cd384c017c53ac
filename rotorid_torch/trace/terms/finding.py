"""What tracing says: one finding per effect, the verdict, and what is missing without a name. Plain data."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rotorid_torch.core.names import Verdict

LISTED = 3
"""Parameters of one effect in a sentence, at most: the surest, or the largest."""


@dataclass(frozen=True)
class EffectFinding:
    """One effect: verdict with its reason in words, smallest size these flights show.

    statistic, critical_value : T and the T at which p is the level; for the reader, as p decides.
    p : family-wise adjusted probability that flights with nothing missing show as much evidence; None where no clean
        aircraft were drawn.
    values : parameters by full name with their standard errors, where it was fitted. part : of the model from the
        start that is this effect, where one is. units : of the values, by the same names, where they have any.
    """

    id: str
    role: str
    verdict: Verdict
    reason: str
    statistic: float | None = None
    critical_value: float | None = None
    smallest_visible: tuple[float, str] | None = None
    group: tuple[str, ...] = ()
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    part: str = ""
    p: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Unknown:
    """Something is missing and has no name: equation, band in Hz, what it goes with, since when.

    judged : false where nothing but chance was there to tell that it is more than ordinary.
    """

    where: str
    band_hz: tuple[float, float]
    goes_with: str | None
    since_s: float | None
    sentence: str
    judged: bool = True
