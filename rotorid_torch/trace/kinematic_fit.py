"""Sensor errors from kinematics by weighted least squares on finite Fourier transforms, all channels noisy.

Every equation d(left)/dt = right is compared at the harmonics of a piece: j w left + (change over the piece) - right,
where the change, a trend, and a constant of every gyro and accelerometer are free in each piece. The noise of all
channels, known per sample, gives the covariance between the equations at each frequency; that the same noise is in
what the errors multiply is taken out of the normal equations.

Source: Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., ch. 12 (errors in
variables); Morelli and Klein, Aircraft System Identification, 2nd ed., ch. 7 and 10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.core.names import POSITIONS, RATES, SPECIFIC_FORCES
from rotorid_torch.trace.kinematic_equations import sides, unit_of, without_static_errors
from rotorid_torch.trace.kinematic_records import HIGHEST_HZ, Piece

Array = np.ndarray
Errors = Mapping[str, float]

DRIFTING = (*RATES, *SPECIFIC_FORCES, "pdot", "qdot", "rdot")
"""Channels whose constant is free in every piece."""
BANDS_HZ = (0.0, 0.15, 0.3, 0.6, 1.0, 1.6, 2.5, 3.6, HIGHEST_HZ + 1.0)
"""Edges of the bands in which the level of what is left is measured."""
STEPS = {"delay": 1e-4, "filter": 1e-4, "scale": 1e-4, "misalignment": 1e-4, "lever_arm": 1e-3, "bias": 1e-4}
"""Differences by which the columns are taken: s, s, 1, rad, m, the channel's unit."""
NOISY = ("scale", "misalignment", "lever_arm", "filter")
"""Errors that multiply noise: a clock and a constant do not."""
POINTS = 40
"""Instants of a piece at which its equations are linearised for the noise."""

Levels = Mapping[str, Array]
"""Per equation, by which factor what is left exceeds the noise in each of the bands."""


@dataclass(frozen=True)
class Setting:
    """What is declared of gravity (m/s2) and of the IMU's place (3) m."""

    gravity: float
    imu: Array

    def arm(self, errors: Errors) -> Array:
        """Place of the IMU, lever-arm error included."""
        return self.imu + np.array([errors.get(f"lever_arm.{axis}", 0.0) for axis in "xyz"])


@dataclass(frozen=True)
class Rows:
    """Whitened rows of one piece at given errors, nuisance of the equations projected out.

    matrix : (n, biases + names), residual : (n,), towards : (biases + names,) what noise alone adds to the gradient,
    freedom : (n,) share of a row's variance that nuisance and constants leave, factor : (harmonics, equations,
    equations) that made the rows white.
    """

    flight: str
    biases: tuple[str, ...]
    matrix: Array
    residual: Array
    towards: Array
    freedom: Array
    equations: tuple[str, ...]
    frequencies: Array
    factor: Array


def constant_columns(piece: Piece, setting: Setting, errors: Errors) -> tuple[tuple[str, ...], Array]:
    """Names of the constants that are free in a piece, and their columns (harmonics, equations, constants).

    A receiver's delay is among them: it is no effect of its own, but would pull at the velocities' clock.
    """
    names = tuple(f"bias.{channel}" for channel in piece.channels if channel in DRIFTING)
    names += ("delay.positions",) if set(POSITIONS) & set(piece.channels) else ()
    frequencies = _frequencies(piece)
    base = residual(piece, setting, errors, frequencies)
    columns = [_column(piece, setting, errors, name, base) for name in names]
    return names, np.stack(columns, axis=-1) if columns else np.zeros((*base.shape, 0))


def _column(piece: Piece, setting: Setting, errors: Errors, name: str, base: Array) -> Array:
    step = STEPS[name.partition(".")[0]]
    moved = {**errors, name: errors.get(name, 0.0) + step}
    return (residual(piece, setting, moved, _frequencies(piece)) - base) / step


def rows(
    piece: Piece,
    setting: Setting,
    errors: Errors,
    names: Sequence[str],
    levels: Levels,
    constants: tuple[tuple[str, ...], Array],
) -> Rows:
    """Linearise a piece's residual about `errors` in its own constants and in the errors of these names."""
    biases, held = constants
    frequencies = _frequencies(piece)
    raise_by = _raise(piece, frequencies, levels)
    covariance = _covariance(piece, setting, errors, frequencies)
    factor = raise_by[:, :, None] * np.linalg.cholesky(covariance)
    white = np.linalg.inv(factor)
    base = residual(piece, setting, errors, frequencies)
    towards = np.zeros(len(biases) + len(names))
    for i, name in enumerate(names, len(biases)):
        if name.startswith(NOISY):
            towards[i] = _drawn(piece, setting, errors, name, covariance, white)
    columns = [_column(piece, setting, errors, name, base) for name in names]
    stack = np.concatenate([held, *(c[..., None] for c in columns), base[..., None]], axis=-1)
    real = _as_rows(white @ stack)
    nuisance = np.linalg.qr(_as_rows(white @ _nuisance(len(piece.equations), frequencies, piece)))[0]
    real -= nuisance @ (nuisance.T @ real)
    own = np.linalg.qr(real[:, : len(biases)])[0]
    freedom = 1.0 - (nuisance**2).sum(1) - (own**2).sum(1)
    matrix, left = real[:, :-1], real[:, -1]
    return Rows(piece.flight, biases, matrix, left, towards, freedom, piece.equations, frequencies, factor)


def residual(piece: Piece, setting: Setting, errors: Errors, frequencies: Array) -> Array:
    """Left's rate less right at the harmonics, (harmonics, equations) complex, per square root of a sample."""
    x = dict(zip(piece.channels, piece.on_time(errors), strict=True))
    left, right = sides(without_static_errors(x, errors), piece.equations, setting.gravity, setting.arm(errors))
    both = np.stack([left, right])
    # one period: the last sample joins the first, which is the trapezoidal rule
    period = both[..., :-1].copy()
    period[..., 0] = 0.5 * (both[..., 0] + both[..., -1])
    spectrum = np.fft.rfft(period)[..., : len(frequencies)] / np.sqrt(period.shape[-1])
    return (2j * np.pi * frequencies * spectrum[0] - spectrum[1]).T


def _frequencies(piece: Piece) -> Array:
    duration = (piece.samples - 1) * piece.dt
    most = min(int(HIGHEST_HZ * duration), (piece.samples - 1) // 4)
    return np.arange(most + 1) / duration


def _nuisance(equations: int, frequencies: Array, piece: Piece) -> Array:
    """Columns (harmonics, equations, 2 equations): the change over the piece, and a trend."""
    count = piece.samples - 1
    ramp = np.linspace(-1.0, 1.0, count, endpoint=False) + 1.0 / count
    change = np.full(len(frequencies), 1.0 + 0j)
    trend = np.fft.rfft(ramp)[: len(frequencies)] / np.sqrt(count)
    trend[0] = 0.0
    eye = np.eye(equations)
    return np.concatenate([part[:, None, None] * eye for part in (change, trend)], axis=-1)


def _as_rows(white: Array) -> Array:
    """Whitened (harmonics, equations, columns) complex as real rows of unit variance; the mean is real."""
    mean, rest = white[0].real, np.sqrt(2.0) * white[1:].reshape(-1, white.shape[-1])
    return np.concatenate([mean, rest.real, rest.imag])


def _covariance(piece: Piece, setting: Setting, errors: Errors, frequencies: Array) -> Array:
    """Covariance (harmonics, equations, equations) that the channels' noise gives the residual."""
    places = np.linspace(0, piece.samples - 1, POINTS).astype(int)
    values = piece.readings[:, piece.margin + places]
    nudge = np.maximum(piece.noise, 1e-9)
    bent = np.repeat(values[:, None], len(piece.channels) + 1, axis=1)
    for i, by in enumerate(nudge):
        bent[i, i + 1] += by
    x = without_static_errors(dict(zip(piece.channels, bent, strict=True)), errors)
    both = np.stack(sides(x, piece.equations, setting.gravity, setting.arm(errors)))
    # (2, channels, equations, instants), per standard deviation of each channel's noise
    slope = np.moveaxis((both[:, :, 1:] - both[:, :, :1]) * (piece.noise / nudge)[:, None], 2, 1)
    left, right = slope / np.sqrt(len(places))
    omega = 2.0 * np.pi * frequencies
    lag = np.array([errors.get(f"filter.{unit_of(channel)}", 0.0) for channel in piece.channels])
    power = 1.0 + (omega[:, None] * lag) ** 2

    def summed(a: Array, b: Array) -> Array:
        return np.tensordot(power, a @ b.swapaxes(-1, -2), axes=1)

    mixed = summed(right, left)
    out = (omega**2)[:, None, None] * summed(left, left) + summed(right, right)
    return out + 1j * omega[:, None, None] * (mixed - mixed.swapaxes(-1, -2))


def _drawn(piece: Piece, setting: Setting, errors: Errors, name: str, covariance: Array, white: Array) -> float:
    """Gradient that noise alone has along one error: half the trace of covariance^-1 times its change, a datum."""
    step = STEPS[name.partition(".")[0]]
    moved = {**errors, name: errors.get(name, 0.0) + step}
    change = (_covariance(piece, setting, moved, _frequencies(piece)) - covariance) / step
    inside = np.einsum("kij,kjl,kil->k", white, change, white.conj()).real
    return float(0.5 * inside[0] + inside[1:].sum())


def _raise(piece: Piece, frequencies: Array, levels: Levels) -> Array:
    band = np.digitize(frequencies, BANDS_HZ) - 1
    flat = np.ones(len(BANDS_HZ) - 1)
    return np.stack([np.sqrt(levels.get(name, flat))[band] for name in piece.equations], axis=-1)
