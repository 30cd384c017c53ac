"""Whether residuals of output error act back on the controls, as they do where a pilot or autopilot answers gusts."""

import torch
from torch import Tensor

from rotorid_torch.identification.estimate.segments import Records
from rotorid_torch.identification.regress.feedback import Follower, followers

HIGHEST = 5.0
"""Hz: what is faster, no pilot answers."""


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
