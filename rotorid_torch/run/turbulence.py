"""What step 3 found of moving air, as the loop tells it; and the verdict where no model came of the flights."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from rotorid_torch.consistency.pairs.velocity_clock import velocity_clock
from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.core.processes.ranks import Ranks
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.gusts import Air, Histories, follow, histories, of_all
from rotorid_torch.identification.model_estimation import ModelEstimate, records
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.model.model import Model
from rotorid_torch.report.records import FitRecord
from rotorid_torch.report.summary import failing, worse_than_trim
from rotorid_torch.trace.loop import Tracing
from rotorid_torch.trace.search.decide import VERDICTS, Reason
from rotorid_torch.trace.stochastic import TURBULENCE, quiet_moments
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.verdict import Statement

ALIKE = "fitted by output error: the air is calm, for before the pilot acts all flights are alike"
"""How the method was chosen where quiet moments of the flights show no gusts."""
DRIFTING = "fitted by output error: u v w are dead reckoned, and a drift looks like gusts"
"""How it was chosen where velocities were made from specific forces."""
UNSEEN_BETTER = "fitted by output error: flights that no fit has seen are better described than by filter error"
"""How it was chosen where coloured residuals might have been of gusts."""
LATE = "fitted by output error: u and v are {seconds:.2g} s {way} against attitude and rates, which looks like gusts"
"""How it was chosen where residuals of velocities are coloured by their clock."""


@dataclass(frozen=True)
class Choice:
    """The method that step 3 is asked for, and why.

    sure : whether nothing else need be asked; else flights that no fit has seen decide between both methods.
    """

    method: str
    why: str = ""
    sure: bool = True


def method_by_quiet_moments(asked: str, dataset: Dataset, spec: ModelSpec) -> Choice:
    """The method that step 3 is asked for after a look at the flights' quiet moments.

    Where flights differ there, the air moves; where they are all alike, coloured residuals are of the model. Where
    there are no such moments, or flights differ by slow drifts alone, coloured residuals may be of gusts or of the
    model; where the velocities have another clock than attitude and rates, they are of the clock. Not asked where no
    velocities are measured, for gusts have nothing to act through.

    asked : of `METHODS`.
    """
    if asked != "auto" or not set(VELOCITIES) & set(spec.outputs):
        return Choice(asked)
    if dataset.dead_reckoned:
        return Choice("output-error", DRIFTING)
    quiet = quiet_moments(dataset, spec)
    if quiet.shaken:
        return Choice("auto")
    if quiet.alike:
        return Choice("output-error", ALIKE)
    clock = velocity_clock(dataset)
    if clock is None:
        return Choice("auto", sure=False)
    way = "late" if clock.seconds > 0.0 else "early"
    return Choice("output-error", LATE.format(seconds=abs(clock.seconds), way=way))


def in_turbulence(finding: EffectFinding, air: Air | None, why: str) -> EffectFinding:
    """The finding that names turbulence with the size that the filter error method gives it, if that was the method.

    Intensity is the rms over the three axes, length the mean of the logarithms, each axis by its relative error.
    Turbulence that no quiet moments show is only suspected: what sways by itself colours residuals too.

    why : how the method was chosen.
    """
    if air is None:
        return finding
    if finding.verdict != "accepted":
        finding = replace(finding, verdict=VERDICTS[Reason.NOT_ADEQUATE])
    intensity, length = _size(air)
    size = {f"{TURBULENCE}.intensity": intensity}
    if length is not None:
        size[f"{TURBULENCE}.length"] = length
    said = f"{why}; gusts are in the model's rates as the filter found them"
    return replace(finding, reason=said, values=size)


def without_what_gusts_leave(tracing: Tracing, shaken: Sequence[EffectFinding]) -> Tracing:
    """The tracing without what has no name where gusts are left over too: clean aircraft fly in none."""
    rough = any(f.id == TURBULENCE and f.verdict == "accepted" for f in shaken)
    return replace(tracing, unknown=None) if rough else tracing


def _size(air: Air) -> tuple[tuple[float, float], tuple[float, float] | None]:
    """Intensity and length with standard errors; no length where each axis has it at the end of its range."""
    count = len(air.axes)
    intensity = (sum(a.intensity**2 for a in air.axes) / count) ** 0.5
    slopes = [a.intensity / (count * max(intensity, 1e-12)) * a.intensity_se for a in air.axes]
    lengths = [(a.length, a.length_se / a.length) for a in air.axes if a.length_se < a.length]
    both = intensity, sum(s * s for s in slopes) ** 0.5
    if not lengths:
        return both, None
    weights = [1.0 / max(relative, 1e-3) ** 2 for _, relative in lengths]
    length = 1.0
    for (one, _), weight in zip(lengths, weights, strict=True):
        length *= one ** (weight / sum(weights))
    return both, (length, length / sum(weights) ** 0.5)


def smoothed_gusts(
    follower: Model, step3: ModelEstimate, dataset: Dataset, reconstruction: Reconstruction, ranks: Ranks
) -> Histories:
    """Gusts of all flights by the filter that came to the air; none where output error was the method.

    follower : model of the flights as the steps saw them.
    """
    if step3.air is None:
        return {}
    whole = replace(dataset, identify=tuple(dataset.flights))
    names = [n for part in ranks.gather(ranks.mine(whole.identify)) for n in part]
    batch = of_all(records(follower, whole, reconstruction, ranks), ranks)
    gusts = batch.outputs.new_zeros(*batch.outputs.shape[:2], len(VELOCITIES))
    gusts[[names.index(n) for n in step3.flights], : step3.air.velocities.shape[1]] = step3.air.velocities
    others = torch.tensor([k for k, n in enumerate(names) if n not in step3.flights], dtype=torch.int64)
    if len(others):
        gusts[others] = follow(follower, step3.names, step3.air, batch.pick(others))
    return histories(names, batch, gusts)


def without_clean_bill(verdict: Statement, fit: FitRecord) -> Statement:
    """The statement; where no effect is named and the model is worse than holding trim, that there is no model."""
    if verdict.kind != "nothing undeclared" or not worse_than_trim(fit):
        return verdict
    sentence = f"No model could be identified from these flights: {failing(fit)}."
    return replace(verdict, kind="unknown", sentence=sentence)
