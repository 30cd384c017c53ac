"""Finite Fourier transforms of sampled records: end weights, chirp-z, nuisance columns, noise, smoothing, gaps."""

from functools import lru_cache
from math import comb

import torch
from torch import Tensor

from rotorid_torch.data.flight import bridged

END_ORDER = 8
"""Degree of the polynomial at each end of the quadrature; more than 8 would amplify the noise of the end samples."""
NOISE_ORDER = 8
"""Order of the differences that leave the noise."""
SPECTRUM = 4
"""Spectral lines to each side over which a record's own spectrum is averaged."""
KINK_SIGMA = 5.0
"""Standard deviations of noise above which a jump in slope is a kink."""


def end_weights(theta: Tensor, order: int = END_ORDER) -> Tensor:
    """Weights of the first samples that turn the sum of x[n] exp(-j theta n), n >= 0, into its integral.

    Inside a smooth record the sum equals the integral to machine precision; all error comes from the ends. There the
    record is taken for a polynomial through its first order + 1 samples, times the exact exponential, so that only x
    must be smooth on the sample grid and not its product with a high frequency. At theta = 0 this is Gregory's
    rule, whose first weight is the familiar 1/2. The last samples take the conjugate weights in reverse order.

    theta : (M,) rad per sample.

    Returns (M, order + 1) complex, in sample intervals.

    Source: Gregory (1670) as in Hamming, Numerical Methods for Scientists and Engineers, ch. 18, with the operator
    E = 1 + Delta replaced by exp(-j theta) E; Morelli and Klein, Aircraft System Identification, ch. 7 (Filon).
    """
    # coefficients of Delta^m in integral minus sum, by Cauchy's formula on a circle (the poles at theta cancel)
    points, radius = 128, 0.7
    turn = (torch.arange(points, dtype=torch.float64, device=theta.device) + 0.5) * (2.0 * torch.pi / points)
    delta = radius * torch.exp(1j * turn)
    phase = 1j * theta.unsqueeze(-1)
    gap = 1.0 / (phase - torch.log(1.0 + delta)) - 1.0 / (1.0 - torch.exp(-phase) * (1.0 + delta))
    powers = delta ** -torch.arange(order + 1, device=theta.device).unsqueeze(-1)
    coefficients = gap @ powers.T / points
    binomials = [[(-1.0) ** (m - i) * comb(m, i) for i in range(order + 1)] for m in range(order + 1)]
    return coefficients @ torch.tensor(binomials, dtype=torch.complex128, device=theta.device)


def kinks(x: Tensor, floor: Tensor) -> Tensor:
    """Second differences (..., T) of a record at its kinks, zero elsewhere.

    A kink is a sample where the fourth difference is no longer small against the second ones around it, as it is in
    all that is smooth on the sample grid, and stands out of the noise. floor : (...) see `noise_floor`.
    """
    second, fourth = torch.zeros_like(x), torch.zeros_like(x)
    second[..., 1:-1] = torch.diff(x, n=2, dim=-1)
    fourth[..., 2:-2] = torch.diff(x, n=4, dim=-1).abs()
    noise = KINK_SIGMA * comb(8, 4) ** 0.5 * floor.unsqueeze(-1)
    around = torch.nn.functional.max_pool1d(second.abs().reshape(-1, 1, x.shape[-1]), 5, 1, 2).reshape(x.shape)
    return torch.where((fourth > 1.5 * around) & (fourth > noise), second, 0.0)


def chirp_z(x: Tensor, start: float, step: float, count: int) -> Tensor:
    """Sum of x[n] exp(-2j pi (start + k step) n) for k = 0 ... count - 1, by Bluestein's three FFTs.

    x : (..., T) samples.
    start, step : cycles per sample.
    count : number of frequencies.

    Returns (..., count) complex.

    Source: Rabiner, Schafer, Rader, The chirp z-transform algorithm, IEEE Trans. Audio 17 (1969).
    """
    samples = x.shape[-1]
    n = torch.arange(max(samples, count), dtype=torch.float64, device=x.device)
    chirp = torch.exp(-1j * torch.pi * step * n.square())
    size = samples + count - 1
    tilted = x * torch.exp(-2j * torch.pi * start * n[:samples]) * chirp[:samples]
    kernel = torch.zeros(size, dtype=torch.complex128, device=x.device)
    kernel[:count] = chirp[:count].conj()
    kernel[size - samples + 1 :] = chirp[1:samples].conj().flip(0)
    product = torch.fft.fft(tilted, n=size) * torch.fft.fft(kernel)
    return torch.fft.ifft(product)[..., :count] * chirp[:count]


def finite_transform(
    x: Tensor, dt: float, first: int, count: int, oversample: int = 1, kink: Tensor | None = None
) -> Tensor:
    """Finite Fourier transform, the integral of x exp(-j w t) over the record, at frequencies k / (oversample T).

    x : (..., T) samples, the first at t = 0; the record lasts T = (samples - 1) dt.
    dt : sample interval, s.
    first, count : the first k and how many.
    oversample : points per 1/T; 1 gives the harmonics of the record by one FFT, more a finer grid by chirp-z.
    kink : (..., T) second differences where the record is straight lines and not smooth (edges of a manoeuvre), zero
        elsewhere; see `kinks`.

    Returns (..., count) complex, in units of x times s.

    Source: Morelli and Klein, Aircraft System Identification, 2nd ed., ch. 7 (finite transform, chirp-z).
    """
    intervals = x.shape[-1] - 1
    grid = intervals * oversample
    order = min(END_ORDER, intervals // 8)
    turn, ends, corner = (part.to(x.device) for part in _weights(intervals, grid, first, count, order))
    total = _sum(x, grid, first, count)
    if kink is not None and bool(kink.any()):
        total = total + corner * _sum(kink, grid, first, count)
    total = total + x[..., : order + 1].to(ends.dtype) @ ends.T
    return (total + turn * (x[..., -order - 1 :].flip(-1).to(ends.dtype) @ ends.conj().T)) * dt


def _sum(x: Tensor, grid: int, first: int, count: int) -> Tensor:
    """Sum of x[n] exp(-2j pi k n / grid) for count values of k."""
    if grid > x.shape[-1] - 1:
        return chirp_z(x, first / grid, 1.0 / grid, count)
    # at the harmonics exp(-j w T) = 1: the last sample joins the first
    return torch.fft.rfft(x[..., :-1])[..., first : first + count] + x[..., -1:]


@lru_cache(maxsize=64)
def _weights(intervals: int, grid: int, first: int, count: int, order: int) -> tuple[Tensor, Tensor, Tensor]:
    """exp(-j w T), weights of the end samples and of kinks at k / grid cycles per sample; flights are alike: kept.

    Straight lines between samples have the factor sinc^2 where smooth records have 1. Second differences have the
    factor -4 sin^2(theta / 2), so the share (1 - sinc^2) / (4 sin^2(theta / 2)) of them, 1/12 at low frequency, joins.
    """
    turns = torch.arange(first, first + count, dtype=torch.float64) / grid
    theta = 2.0 * torch.pi * turns
    corner = (1.0 - torch.sinc(turns).square()) / (4.0 * torch.sin(theta / 2.0).square())
    return torch.exp(-1j * theta * intervals), end_weights(theta, order), corner


def derivative_transform(x: Tensor, transform: Tensor, frequencies: Tensor, duration: float) -> Tensor:
    """Transform of dx/dt from that of x: j w x(w) + x(T) exp(-j w T) - x(0).

    x : (..., T) samples, transform : (..., M) their finite transform.
    frequencies : (M,) Hz. duration : T, s.

    Source: integration by parts; Morelli and Klein, eq. 7.21.
    """
    omega = 2.0 * torch.pi * frequencies
    return 1j * omega * transform + x[..., -1:] * torch.exp(-1j * omega * duration) - x[..., :1]


def nuisance_basis(frequencies: Tensor, duration: float, ends: bool, trend: bool) -> Tensor:
    """Orthonormal real columns (2 M, k) that a constant, a trend and the end terms of a record span in its rows.

    At the harmonics the constant vanishes and both end terms are one column; such columns drop out.

    frequencies : (M,) Hz. duration : T, s.
    ends : whether x(0) and x(T) exp(-j w T) of a derivative are left free, as their samples are noisy.
    trend : whether a trend in time joins the constant.
    """
    phase = 2.0 * torch.pi * frequencies * duration
    turn = torch.exp(-1j * phase)
    columns = [(1.0 - turn) / (1j * phase)]
    if trend:
        columns.append(turn * (1j * phase + 1.0) / phase.square() - 1.0 / phase.square())
    if ends:
        columns += [torch.ones_like(turn), turn]
    rows = as_rows(torch.stack(columns)).T
    norms = torch.linalg.vector_norm(rows, dim=0)
    u, s, _ = torch.linalg.svd(rows[:, norms > 1e-9] / norms[norms > 1e-9], full_matrices=False)
    return u[:, s > 1e-6]


def as_rows(spectrum: Tensor) -> Tensor:
    """Stack real over imaginary parts along the last dimension: (..., M) complex to (..., 2 M) real."""
    return torch.cat((spectrum.real, spectrum.imag), dim=-1)


def noise_floor(x: Tensor, order: int = NOISE_ORDER) -> Tensor:
    """Estimate the standard deviation of the white noise in a record from its high differences.

    Differences of high order n leave the noise and remove what is smooth: sd^2 = mean (D^n x)^2 / C(2 n, n). What jumps
    (edges of a manoeuvre) touches few samples and is cut at four robust deviations, 1.4826 median |D^n x|.

    x : (..., T) samples without gaps.

    Returns (...) standard deviation of a sample, in units of x; zero where the record is too short to tell.

    Source: Hall, Kay and Titterington, Biometrika 77 (1990), 521 (variance from differences).
    """
    if x.shape[-1] < 4 * order:
        return torch.zeros(x.shape[:-1], dtype=x.dtype, device=x.device)
    difference = torch.diff(x, n=order, dim=-1)
    robust = 1.4826 * difference.abs().median(dim=-1).values
    inside = difference.abs() <= 4.0 * robust.unsqueeze(-1)
    power = (difference.square() * inside).sum(-1) / inside.sum(-1).clamp(min=1)
    return torch.sqrt(power / comb(2 * order, order))


def noise_floor_scatter(samples: int, order: int = NOISE_ORDER) -> float:
    """Relative standard deviation of the square of `noise_floor` on a record of white noise.

    sqrt(2 / N'), N' = N C(2 n, n)^2 / C(4 n, 2 n) the independent of N differences of order n: N over the sum of their
    squared autocorrelations.
    """
    independent = samples * comb(2 * order, order) ** 2 / comb(4 * order, 2 * order)
    return (2.0 / independent) ** 0.5


def smoothed(x: Tensor, noise: Tensor) -> Tensor:
    """Records less the white noise in them: a Wiener filter without phase, made of each record's own spectrum.

    The record goes on beyond its ends as its own mirror image, so that its ends are kept.

    x : (..., T) samples without gaps. noise : (...) standard deviation of a sample's noise, in units of x.

    Source: Morelli (1995), Journal of Aircraft 32(4), 689 (optimal Fourier smoothing).
    """
    mean, samples = x.mean(dim=-1, keepdim=True), x.shape[-1]
    lines = torch.fft.rfft(torch.cat([x - mean, (x - mean).flip(-1)], dim=-1))
    power, reach = lines.abs().square(), min(SPECTRUM, lines.shape[-1] - 1)
    wide = torch.cat([power[..., 1 : reach + 1].flip(-1), power, power[..., -reach - 1 : -1].flip(-1)], dim=-1)
    averaged = wide.unfold(-1, 2 * reach + 1, 1).mean(dim=-1)
    level = 2.0 * samples * noise.square().unsqueeze(-1)  # each sample is there twice, in phase
    share = (1.0 - level / averaged.clamp_min(1e-300)).clamp_min(0.0)
    return mean + torch.fft.irfft(share * lines, n=2 * samples)[..., :samples]


def fill_gaps(x: Tensor) -> tuple[Tensor, int, int]:
    """Fill missing samples (NaN) by straight lines, beyond the first and last good sample by holding them.

    x : (..., T).

    Returns the filled record, the number of samples filled and the longest gap in samples.
    """
    missing = torch.isnan(x)
    if not bool(missing.any()):
        return x, 0, 0
    gaps = torch.nn.functional.pad(missing, (1, 1)).to(torch.int8).diff(dim=-1)  # 1 where one begins, -1 behind it
    begins, ends = (gaps == 1).nonzero()[:, -1], (gaps == -1).nonzero()[:, -1]
    filled = bridged(x.reshape(-1, x.shape[-1]).mT.cpu()).mT.to(x).reshape(x.shape)
    return filled, int(missing.sum()), int((ends - begins).max())
