"""What is to be said of an estimate on anybody's model: whole flights, feedback, initial states that are believed."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rotorid_torch.arguments import listed
from rotorid_torch.core.gauss_newton import InfiniteCost
from rotorid_torch.errors import InputError
from rotorid_torch.identification.estimate.own_models.steps import Stepped
from rotorid_torch.identification.estimate.progressive_fit import ROUGH, Fit, Settings, Start, fit
from rotorid_torch.identification.estimate.segments import Records, cut
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.regress.feedback import Follower, followers

WORSE = 1.5
"""Residuals of whole flights over those of the segments, above which it is said."""
HIGHEST = 5.0
"""Hz: what is faster, no pilot answers."""
LISTED = 4
"""Parameters that a sentence names."""


@dataclass(frozen=True, repr=False)
class WholeFlights:
    """Free runs over whole flights.

    residuals : per flight (T, ny) measured minus model, NaN = missing. rms : [ny] their root mean square, infinite
    where a run diverges. ratio : [ny] over that of the segments that the fit took.
    """

    residuals: list[Tensor]
    rms: Tensor
    ratio: Tensor

    def __repr__(self) -> str:
        each = ", ".join(f"{rms:.4g}" for rms in self.rms.tolist())
        return f"WholeFlights: {len(self.residuals)} flights, residuals of {each} (rms by output)"

    @property
    def remark(self) -> str:
        """What to say where whole flights leave much more than the segments; else nothing."""
        worst = float(self.ratio.nan_to_num(0.0).max())
        if worst < WORSE:
            return ""
        much = "diverge" if math.isinf(worst) else f"leave up to {worst:.2g} times the residuals"
        return f"flown free from the first sample, whole flights {much}"


def counted_twice(records: Records) -> str:
    """What to say of flights, and of outputs, that are copies of others; nothing where none is."""
    flights = zip(records.measured(records.controls), records.measured(records.outputs), strict=True)
    named = {"flight": [torch.cat(pair, dim=-1) for pair in flights], "output": records.outputs.unbind(-1)}
    said = [f"{noun} {k} is a copy of {noun} {j}" for noun, some in named.items() for j, k in _copies(some)]
    return f"{listed(said, LISTED)}: counted twice, standard errors are too small" if said else ""


def _copies(records: Sequence[Tensor]) -> Iterator[tuple[int, int]]:
    """Places of records that are the same to the last digit, the first of them and another."""
    first: dict[tuple[torch.Size, bytes], int] = {}
    for k, record in enumerate(records):
        j = first.setdefault((record.shape, record.contiguous().numpy().tobytes()), k)
        if j != k:
            yield j, k


def whole_flights(records: Records, fitted: Fit) -> WholeFlights:
    """Free runs of the fitted model from the initial states that the fit found."""
    problem, place = fitted.likelihood, fitted.minimum.point
    segments = cut(records, records.samples)
    x0 = place.x0[(problem.segments.place[:, 0] == 0).nonzero()[:, 0]]
    near = x0[:, None].expand(-1, segments.samples, -1)
    run = problem.engine.run(place.theta, records, segments, x0, near, None)
    residuals = records.measured(segments.outputs - run.outputs)
    rms = _rms(residuals, [~one.isnan() for one in records.measured(records.outputs)])
    assert place.moments is not None
    return WholeFlights(residuals, rms, rms / place.moments.mean_square.sqrt().clamp_min(1e-300))


def _rms(residuals: list[Tensor], present: list[Tensor]) -> Tensor:
    """Root mean square [ny] where something was measured; infinite where a run has none that is finite there."""
    flat, measured = torch.cat(residuals), torch.cat(present)
    squares = torch.where(measured, flat.nan_to_num(math.inf).square(), 0.0)
    return (squares.sum(dim=0) / measured.sum(dim=0)).sqrt()


def acting_back(residuals: list[Tensor], records: Records) -> str:
    """What to say of controls that follow residuals, per flight (T, ny); nothing where none does."""
    followings: list[tuple[int, Follower]] = []
    controls = records.measured(records.controls)
    intervals = (records.dt * records.spacing()).tolist()
    for output in range(residuals[0].shape[-1]):
        parts = [
            _spectra(torch.cat([one[:, output, None], u], dim=-1), dt)
            for one, u, dt in zip(residuals, controls, intervals, strict=True)
        ]
        spectra, frequencies = (torch.cat([part[k] for part in parts]) for k in (0, 1))
        followings += [(output, one) for one in followers(spectra[:, 0], spectra[:, 1:], frequencies)]
    if not followings:
        return ""
    output, one = max(followings, key=lambda pair: abs(pair[1].correlation))
    more = f", and {len(followings) - 1} more" if len(followings) > 1 else ""
    return (
        f"control {one.place} follows the residual of output {output} (correlation {one.correlation:.2f} after"
        f" {one.seconds:.2g} s{more}): feedback of what the model does not explain; parameters may be biased"
    )


def _spectra(columns: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Transforms (M, n) of records (T, n) about their means up to `HIGHEST`, and the frequencies (M,), Hz."""
    present = torch.where(columns.isfinite(), columns, torch.nan)
    centred = (present - present.nanmean(dim=0)).nan_to_num(0.0)
    frequencies = torch.fft.rfftfreq(len(columns), dt, dtype=torch.float64)
    inside = (frequencies > 0.0) & (frequencies <= HIGHEST)
    return torch.fft.rfft(centred, dim=0)[inside], frequencies[inside]


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
    except (InfiniteCost, InputError):  # runs from the first samples diverge
        return ""
    rows = zip(system.entries, fitted.theta.tolist(), theta, errors, strict=True)
    moved = [f"{entry.name} {held:.4g}" for entry, free, held, se in rows if abs(held - free) > se]
    return f'initial states held (x0="fixed") would give {listed(moved, LISTED)}' if moved else ""
