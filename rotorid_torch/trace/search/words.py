"""The words of the closed loop: one template for each reason. Nothing reads a sentence."""

from collections.abc import Mapping, Sequence

from rotorid_torch.effects.registry import registered
from rotorid_torch.printable import significant
from rotorid_torch.trace.evidence.fits import FittedT
from rotorid_torch.trace.evidence.residual import Largest
from rotorid_torch.trace.search.decide import NO_SCATTER, Reason, Row, decide, size_of
from rotorid_torch.trace.terms.finding import EffectFinding, Unknown

REASONS = {
    Reason.PART: "the nominal model has it from the start, as its part '{part}'",
    Reason.NOT_TESTABLE: "{lacking}",
    Reason.TAKEN_UP: "{part} stand for it in these flights; weigh the vehicle, or swing it, to tell",
    Reason.BELOW_LEVEL: "it explains no more than it does where nothing is missing",
    Reason.ABSORBED: "at its usual size these flights would not show it: {imitators}; {flights} would tell",
    Reason.BETTER_EXPLAINED: "what it would explain, {explained_by} better",
    Reason.NO_BETTER_FIT: "fitted in full, it explains nothing",
    Reason.ACTIVE_BOUND: "{parameter} = {value:.3g} lies at the edge of its range",
    Reason.WITHIN_ERROR: "{parameter} = {value:.3g} ± {error}: the interval holds the size of nothing",
    Reason.UNSEEN_WORSE: "it does not help on flights that no fit has seen ({better} of {count} better)",
    Reason.FREE_RUNS_WORSE: "free runs of flights that no fit has seen are worse with it ({worse} of {count})",
    Reason.NO_MODEL: "the model with it is worse than holding trim on flights that no fit has seen",
    Reason.NOT_ADEQUATE: "it explains {share:.0f} % of what is missing; half is asked of a name",
    Reason.GROUP: "something of this kind acts, but these flights cannot tell it from {others}",
    Reason.NAMED: "no other effect explains it, and flights that no fit has seen are better described",
    Reason.HELPS: "flights that no fit has seen are better described with it ({better} of {count} better)",
    Reason.OTHER_NAMED: "these flights cannot tell it from {others}",
}


def reason(which: Reason, **details: object) -> str:
    """A reason in words."""
    if isinstance(error := details.get("error"), float):
        details["error"] = significant(error)
    return REASONS[which].format(**details)


def finding(effect: str, row: Row, said: str = "", **details: object) -> EffectFinding:
    """What is said of an effect of which this was observed; said : in place of the words of the reason."""
    verdict, why = decide(row)
    return EffectFinding(effect, registered()[effect].role.value, verdict, said or reason(why, **details))


def explained_by(names: Sequence[str]) -> str:
    """What explains something, with its verb."""
    return f"{' and '.join(names) or 'another effect'} {'explain' if len(names) > 1 else 'explains'}"


def size_details(
    null: FittedT, fitted: FittedT, effect: str, drawn: Mapping[str, float] = NO_SCATTER
) -> dict[str, object]:
    """What the reasons about a full fit say of it; drawn: errors of sizes on clean aircraft, by full name."""
    size, unseen = size_of(fitted, effect, drawn=drawn), null.unseen_log_ratios(fitted)
    return {
        "parameter": size.parameter,
        "value": size.value,
        "error": size.error,
        "better": int((unseen > 0).sum()),
        "count": len(unseen),
    }


NAMELESS = "no effect of the library explains it"


def unknown_words(missing: Unknown, rms: str, unit: str, shape: str, largest: Largest | None) -> str:
    """What has no name. rms : of what goes with a signal. shape : how. largest : residual of the equation."""
    how = shape if shape.startswith(" ") else f" ({shape})" if shape else ""
    began = "" if missing.since_s is None else f", since {missing.since_s:.1f} s into the flights"
    most = (
        "" if largest is None else f" Most, {largest.size:.2g} {unit}, is at {largest.time:.1f} s of {largest.flight}."
    )
    return (
        f"Something is missing in {missing.where}: {rms} {unit} rms at {missing.band_hz[0]:.2g} to"
        f" {missing.band_hz[1]:.2g} Hz go with {missing.goes_with}{how}{began}; {NAMELESS}.{most}"
    )


def path_words(band: tuple[float, float]) -> str:
    """Something acts on the controls, in a band in Hz."""
    return (
        f"Something is missing between the recorded controls and the rotor, at {band[0]:.2g} to {band[1]:.2g} Hz;"
        f" {NAMELESS}."
    )
