"""The words of the closed loop: one template for each reason. Nothing reads a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rotorid_torch.trace.evidence.fits import FittedT
from rotorid_torch.trace.search.decide import NO_SCATTER, Reason, size_of

REASONS = {
    Reason.BELOW_LEVEL: "it explains no more than it does where nothing is missing",
    Reason.ABSORBED: "at its usual size these flights would not show it: {imitators}; {flights} would tell",
    Reason.BETTER_EXPLAINED: "what it would explain, {explained_by} better",
    Reason.NO_BETTER_FIT: "fitted in full, it explains nothing",
    Reason.ACTIVE_BOUND: "{parameter} = {value:.3g} lies at the edge of its range",
    Reason.WITHIN_ERROR: "{parameter} = {value:.3g} ± {error:.1g}: the interval holds the size of nothing",
    Reason.UNSEEN_WORSE: "it does not help on flights that no fit has seen ({better} of {count} better)",
    Reason.FREE_RUNS_WORSE: "free runs of flights that no fit has seen are worse with it ({worse} of {count})",
    Reason.NOT_ADEQUATE: "it explains {share:.0f} % of what is missing; the larger part stays without a name",
    Reason.GROUP: "something of this kind acts, but these flights cannot tell it from {others}",
    Reason.NAMED: "no other effect explains it, and flights that no fit has seen are better described",
    Reason.HELPS: "flights that no fit has seen are better described with it ({better} of {count} better)",
    Reason.OTHER_NAMED: "these flights cannot tell it from {others}",
}


def reason(which: Reason, **details: object) -> str:
    """A reason in words."""
    return REASONS[which].format(**details)


def explained_by(names: Sequence[str]) -> str:
    """What explains something, with its verb."""
    return f"{' and '.join(names) or 'another effect'} {'explain' if len(names) > 1 else 'explains'}"


def size_details(
    null: FittedT, fitted: FittedT, effect: str, drawn: Mapping[str, float] = NO_SCATTER
) -> dict[str, object]:
    """What the reasons about a full fit say of it; drawn: scatter of sizes over clean aircraft, by full name."""
    size, unseen = size_of(fitted, effect, drawn=drawn), null.unseen_log_ratios(fitted)
    return {
        "parameter": size.parameter,
        "value": size.value,
        "error": size.error,
        "better": int((unseen > 0).sum()),
        "count": len(unseen),
    }


@dataclass(frozen=True)
class UnknownWords:
    """What has no name.

    where : the equation. size : rms, in its unit. band : Hz. shape : how it goes with a signal. since_s : onset.
    """

    where: str
    size: float
    unit: str
    band: tuple[float, float]
    goes_with: str
    shape: str
    since_s: float | None

    def __str__(self) -> str:
        how = self.shape if self.shape.startswith(" ") else f" ({self.shape})" if self.shape else ""
        began = "" if self.since_s is None else f", since {self.since_s:.1f} s into the flights"
        return (
            f"Something is missing in {self.where}: {self.size:.2g} {self.unit} rms at {self.band[0]:.2g} to"
            f" {self.band[1]:.2g} Hz go with {self.goes_with}{how}{began}; no effect of the library explains it."
        )


def path_words(band: tuple[float, float]) -> str:
    """Something acts on the controls, in a band in Hz."""
    return (
        f"Something is missing between the recorded controls and the rotor, at {band[0]:.2g} to {band[1]:.2g} Hz;"
        " no effect of the library explains it."
    )
