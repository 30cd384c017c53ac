"""Rows of a regression in the frequency domain: one flight transformed, nuisance projected out, noise accounted for."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor

import torch
from torch import Tensor

from rotorid_torch.errors import InputError
from rotorid_torch.identification.regress import fourier

KINDS = ("derivative", "value")
NOISES = ("estimated", "none")
BELIEVED_RELIABILITY = 0.5
"""Below this, an estimated noise floor cannot be told from a broad-band signal and is not taken out."""
MISSING_LIMIT = 0.25
"""Share of missing samples above which a record is refused."""
ROUNDING = 1e-12
"""Share of a regressor below which its content in the band is nothing but rounding."""


@dataclass(frozen=True)
class Rows:
    """One flight's regression rows: real over imaginary parts, nuisance columns projected out, per square root of T.

    response : (..., 2 M). regressors : (..., 2 M, n).
    noise : (..., n) power that noise of the regressors adds, summed over the rows.
    noise_scatter : relative standard deviation of `noise`; zero where the noise was declared.
    response_noise : (..., 2 M) variance of each row from noise of the response.
    leverage : (2 M) share of each row taken by the nuisance columns.
    information : independent real data, two per 1/T of band less the nuisance columns.
    frequencies : (M,) Hz. oversample : points per 1/T.
    """

    response: Tensor
    regressors: Tensor
    noise: Tensor
    noise_scatter: float
    response_noise: Tensor
    leverage: Tensor
    information: float
    frequencies: Tensor
    oversample: int


@dataclass(frozen=True)
class Transform:
    """How records become rows, as in `regress`.

    response_noise : standard deviation of a sample of the response; None: estimated.
    """

    band: tuple[float, float]
    kind: str = "derivative"
    noise: str | Tensor | Sequence[float] = "estimated"
    response_noise: float | None = None
    trend: bool = True
    oversample: int = 1


def flight_rows(response: Tensor, regressors: Tensor, dt: float, transform: Transform, notes: list[str]) -> Rows:
    """Transform one flight and project its nuisance columns out; notes collects sentences."""
    band, derivative, oversample = transform.band, transform.kind == "derivative", transform.oversample
    if band[1] >= 0.5 / dt:
        wrong = f"{band[1]:g} Hz with samples {dt:g} s apart"
        raise InputError("arrays", "band", wrong, f"less than {0.5 / dt:.4g} Hz; dt is the time between samples, s")
    y, x = _without_gaps(response, "response", notes), _without_gaps(regressors.mT, "regressors", notes)
    duration = (y.shape[-1] - 1) * dt
    first, count = _harmonics(duration, band, oversample)
    frequencies = torch.arange(first, first + count, dtype=torch.float64, device=y.device) / (duration * oversample)
    floor, response_floor = fourier.noise_floor(x), fourier.noise_floor(y)
    # values go together at the samples: any sums of them do; a derivative goes with what lies between samples
    bent, bent_x = (fourier.kinks(y, response_floor), fourier.kinks(x, floor)) if derivative else (None, None)
    spectrum = fourier.finite_transform(y, dt, first, count, oversample, bent)
    rates = torch.ones_like(frequencies)
    if derivative:
        spectrum = fourier.derivative_transform(y, spectrum, frequencies, duration)
        rates = (2.0 * torch.pi * frequencies).square()
    basis = fourier.nuisance_basis(frequencies, duration, ends=derivative, trend=transform.trend)
    project = torch.eye(2 * count, dtype=torch.float64, device=y.device) - basis @ basis.T
    scale = (duration * oversample) ** -0.5
    z = project @ fourier.as_rows(fourier.finite_transform(x, dt, first, count, oversample, bent_x)).mT * scale
    still = torch.linalg.vector_norm(z, dim=-2) <= ROUNDING * x.abs().amax(-1) * duration**0.5
    z = torch.where(still.unsqueeze(-2), 0.0, z)
    declared = transform.response_noise
    response_sd = response_floor if declared is None else y.new_full(y.shape[:-1], declared)
    information = 2.0 * count / oversample - basis.shape[-1]
    weight, size = dt * information / 2.0, z.square().sum(-2)
    power, scatter = _noise_power(floor, x.shape[-1], transform.noise, weight, size, notes)
    return Rows(
        response=(project @ fourier.as_rows(spectrum).unsqueeze(-1)).squeeze(-1) * scale,
        regressors=z,
        noise=power,
        noise_scatter=scatter,
        response_noise=response_sd.square().unsqueeze(-1) * rates.repeat(2) * (dt / 2.0 / oversample),
        leverage=basis.square().sum(-1),
        information=information,
        frequencies=frequencies,
        oversample=oversample,
    )


def total_noise(flights: Sequence[Rows]) -> Tensor:
    """Noise power (..., n) of the regressors over the rows of all flights."""
    return torch.stack(torch.broadcast_tensors(*[f.noise for f in flights])).sum(0)


def _without_gaps(record: Tensor, key: str, notes: list[str]) -> Tensor:
    """Fill missing samples along the last dimension and say so, or refuse what is mostly missing."""
    share = float(torch.isnan(record).to(torch.float64).mean(-1).max())
    if share > MISSING_LIMIT:
        limit = f"at most {MISSING_LIMIT:.0%}, which straight lines fill"
        raise InputError("arrays", key, f"{share:.0%} of the samples of a record are missing", limit)
    filled, count, longest = fourier.fill_gaps(record)
    if count:
        notes.append(f"{key}: {count} missing samples filled by straight lines, the longest gap {longest} samples")
    return filled


def _harmonics(duration: float, band: tuple[float, float], oversample: int) -> tuple[int, int]:
    """First multiple of 1 / (oversample T) in the band, not below 1/T, and how many there are."""
    grid = duration * oversample
    first = max(oversample, ceil(band[0] * grid - 1e-9))
    count = floor(band[1] * grid + 1e-9) - first + 1
    if count < 2 * oversample:
        wrong = f"{band[0]:.3g} to {band[1]:.3g} Hz holds fewer than two harmonics of a record of {duration:.3g} s"
        raise InputError("arrays", "band", wrong, "a wider band or a longer record")
    return first, count


def _noise_power(
    floor: Tensor, samples: int, noise: str | Tensor | Sequence[float], weight: float, power: Tensor, notes: list[str]
) -> tuple[Tensor, float]:
    """Noise power (..., n) of the regressors over the rows, given or estimated, and its relative scatter."""
    if not isinstance(noise, str):
        sd = torch.as_tensor(noise, dtype=torch.float64, device=power.device)
        return (sd.square() * weight).expand(power.shape), 0.0
    if noise == "none":
        return torch.zeros_like(power), 0.0
    estimate = floor.square() * weight
    doubtful = estimate > (1.0 - BELIEVED_RELIABILITY) * power
    if bool(doubtful.any()):
        columns = sorted({int(i) for i in doubtful.nonzero()[:, -1]})
        notes.append(f"regressors {columns}: broad-band, noise not told from signal and not taken out")
    return torch.where(doubtful, 0.0, estimate), fourier.noise_floor_scatter(samples)
