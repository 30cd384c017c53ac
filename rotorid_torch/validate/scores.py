"""Numbers that say how well a free run follows the measurement: pure functions of tensors.

Shapes: time is dimension -2 and channels are dimension -1, so a trajectory is [..., T, n]. A NaN is a missing sample
and is skipped. Scales and noises are given, one per channel, in the channel's unit.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from rotorid_torch.validate.judged import WindowsRecord

HORIZON_S = 8.0
QUIET_S = 0.5
WINDOW_STEP_S = 1.0


class Theil(NamedTuple):
    """Theil's inequality coefficient per channel, and the shares of the squared error.

    `coefficient` [..., n]: 0 is a perfect model, 1 none at all. `parts` [..., n, 3] add up to one: bias (the means
    differ), variance (the amplitudes differ), covariance (the shapes differ).
    """

    coefficient: Tensor
    parts: Tensor


def horizon_samples(dt: float, seconds: float = HORIZON_S) -> int:
    """Count of samples that cover `seconds` at the step `dt` (s); at least one."""
    return max(1, round(seconds / dt))


def flight_J(error: Tensor, scale: Tensor) -> Tensor:
    """Score J: root mean square over channels and samples of error / scale.

    error : [..., T, n], free run minus measured, already cut to the horizon.
    scale : [n], the data set's scale of each channel, in the channel's unit.

    Returns [...], without unit; NaN where no sample is valid.
    """
    return torch.nanmean((error / scale).square(), dim=(-2, -1)).sqrt()


def noise_J(measured: Tensor, noise: Tensor, scale: Tensor) -> Tensor:
    """J of the sensor noise alone: what a perfect model would still score.

    `measured` [..., T, n] only says which samples exist; `noise` [n] is the standard deviation of a sample.
    """
    return flight_J(noise + 0.0 * measured, scale)


def trim_J(measured: Tensor, scale: Tensor, dt: float) -> Tensor:
    """J of the model that holds trim (the mean over the first half second); the yardstick. `measured` [..., T, n]."""
    return flight_J(deviation(measured, measured, dt), scale)


def list_score(flight_scores: Tensor) -> Tensor:
    """Score of a list of flights: root mean square of their J, over the last dimension; NaN flights are left out."""
    return torch.nanmean(flight_scores.square(), dim=-1).sqrt()


def deviation(signal: Tensor, measured: Tensor, dt: float) -> Tensor:
    """Subtract the mean of the first half second of `measured` from `signal`; both [..., T, n]."""
    quiet = measured[..., : horizon_samples(dt, QUIET_S), :]
    return signal - torch.nanmean(quiet, dim=-2, keepdim=True)


def rmse(error: Tensor) -> Tensor:
    """Root mean square of the error per channel, in the channel's unit: [..., T, n] -> [..., n]."""
    return torch.nanmean(error.square(), dim=-2).sqrt()


def r2(error: Tensor, measured: Tensor) -> Tensor:
    """R² of each channel: 1 - sum(error²) / sum((measured - mean)²).

    `error` and `measured` [..., T, n] -> [..., n]. Not finite where the measured channel does not move.
    """
    present = torch.where(error.isnan(), torch.nan, measured)
    spread = present - torch.nanmean(present, dim=-2, keepdim=True)
    return 1.0 - torch.nansum(error.square(), dim=-2) / torch.nansum(spread.square(), dim=-2)


def theil(model: Tensor, measured: Tensor, dt: float) -> Theil:
    """Theil's inequality coefficient and its bias, variance and covariance shares.

    `model` and `measured` [..., T, n]; both are taken as deviations from the measured first half second's mean. The
    shares are NaN where there is no error at all.

    Source: Jategaonkar, Flight Vehicle System Identification, 2nd ed., section 11.4 (Theil's inequality coefficient).
    """
    missing = measured.isnan() | model.isnan()
    reference = deviation(measured, measured, dt).masked_fill(missing, torch.nan)
    simulated = deviation(model, measured, dt).masked_fill(missing, torch.nan)
    coefficient = rmse(simulated - reference) / (rmse(reference) + rmse(simulated))
    mean_gap = torch.nanmean(simulated, dim=-2) - torch.nanmean(reference, dim=-2)
    centred = [y - torch.nanmean(y, dim=-2, keepdim=True) for y in (simulated, reference)]
    sigma_simulated, sigma_reference = (rmse(y) for y in centred)
    product = torch.nanmean(centred[0] * centred[1], dim=-2)
    spread = (sigma_simulated - sigma_reference).square()
    unlike = (2.0 * (sigma_simulated * sigma_reference - product)).clamp(min=0.0)
    parts = torch.stack((mean_gap.square(), spread, unlike), dim=-1)
    return Theil(coefficient, parts / parts.sum(dim=-1, keepdim=True))


def window_starts(samples: int, dt: float) -> list[int]:
    """First sample of every whole window of `HORIZON_S`, one each `WINDOW_STEP_S`; one at 0 for a shorter flight."""
    length, hop = horizon_samples(dt), WINDOW_STEP_S / dt
    count = max(0, int((samples - length) / hop + 1e-9)) + 1
    return [round(k * hop) for k in range(count)]


def window_statistics(J: Tensor) -> WindowsRecord:
    """Median, 10th and 90th percentile of the windows' J [W]; NaN where no window has a score."""
    levels = torch.tensor([0.5, 0.1, 0.9], dtype=J.dtype, device=J.device)
    median, p10, p90 = torch.nanquantile(J, levels).tolist()
    return WindowsRecord(median=median, p10=p10, p90=p90)
