"""What believing the flights' own initial states would change, where an estimate leaves them free."""

from collections.abc import Sequence
from dataclasses import replace

from rotorid_torch.arguments import listed
from rotorid_torch.core.gauss_newton import InfiniteCost
from rotorid_torch.identification.estimate.own_models.steps import Stepped
from rotorid_torch.identification.estimate.progressive_fit import ROUGH, Fit, Settings, Start, fit
from rotorid_torch.identification.estimate.system import System

LISTED = 4
"""Parameters that the sentence names."""


def with_starts_held(system: System, stepped: Stepped[Fit], settings: Settings, errors: Sequence[float]) -> str:
    """Which parameters initial states that are believed would move by more than a standard error (`errors`)."""
    records, fitted = stepped.records, stepped.fit
    partly = settings.x0_held is not None or settings.x0_bounds is not None or settings.optimiser != "gauss-newton"
    if settings.x0 != "free" or partly or bool(records.states[:, 0].isnan().any()):
        return ""
    lengths = (fitted.likelihood.longest * records.dt,)
    believing = replace(settings, x0="fixed", lengths=lengths, options=ROUGH)
    try:
        theta = fit(system, records, Start(fitted.theta), believing).theta.tolist()
    except InfiniteCost:
        return ""
    rows = zip(system.entries, fitted.theta.tolist(), theta, errors, strict=True)
    moved = [f"{entry.name} {held:.4g}" for entry, free, held, se in rows if abs(held - free) > se]
    return f'initial states held (x0="fixed") would give {listed(moved, LISTED)}' if moved else ""
