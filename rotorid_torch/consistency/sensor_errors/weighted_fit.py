"""Sensor errors from kinematics by weighted least squares on finite Fourier transforms, all channels noisy.

Every equation d(left)/dt = right is compared at the harmonics of a piece: j w left + (change over the piece) - right,
where the change, a trend, and a constant of every gyro and accelerometer are free in each piece. The noise of all
channels, known per sample, gives the covariance between the equations at each frequency; that the same noise is in
what the errors multiply is taken out of the normal equations.

Source: Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., ch. 12 (errors in
variables); Morelli and Klein, Aircraft System Identification, 2nd ed., ch. 7 and 10.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.equations import null, sides, undoing, unit_of, without_static_errors
from rotorid_torch.consistency.sensor_errors.pieces import HIGHEST_HZ, Piece
from rotorid_torch.core.names import POSITIONS, RATES, SPECIFIC_FORCES
from rotorid_torch.effects.families.sensors import DAMPED, PERIOD, SMOOTHED

Array = np.ndarray
Errors = Mapping[str, float]
Several = Mapping[str, Array | float]
"""Errors of several sets at once: arrays (sets) where the sets differ, numbers where they agree."""

DRIFTING = (*RATES, *SPECIFIC_FORCES, "pdot", "qdot", "rdot")
"""Channels whose constant is free in every piece."""
BANDS_HZ = (0.0, 0.15, 0.3, 0.6, 1.0, 1.6, 2.5, 3.6, HIGHEST_HZ + 1.0)
"""Edges of the bands in which the level of what is left is measured."""
FILTER_STEPS = {PERIOD: 1e-4, DAMPED: 1e-3, SMOOTHED: 1e-6}
"""The same for what a filter has besides a time constant: s, 1, s²."""
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

    def arm(self, errors: Several) -> list[Array | float]:
        """Place of the IMU (3), lever-arm error included."""
        return [
            declared + errors.get(f"lever_arm.{axis}", 0.0)
            for declared, axis in zip(self.imu.tolist(), "xyz", strict=True)
        ]


@dataclass(frozen=True)
class WhiteRows:
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
    return names, _linearised(piece, setting, errors, names, _frequencies(piece))[1]


def _linearised(
    piece: Piece, setting: Setting, errors: Errors, names: Sequence[str], frequencies: Array
) -> tuple[Array, Array]:
    """The residual (harmonics, equations), and its columns by differences (harmonics, equations, names)."""
    reference = residual(piece, setting, _moved(errors, names), frequencies)
    reference = np.broadcast_to(reference, (1 + len(names), *reference.shape[-2:]))
    return reference[0], np.moveaxis((reference[1:] - reference[0]) / _steps(names)[:, None, None], 0, -1)


def _steps(names: Sequence[str]) -> Array:
    return np.array([step_of(name) for name in names])


def step_of(name: str) -> float:
    """Difference by which the column of an error is taken."""
    return next((s for ending, s in FILTER_STEPS.items() if name.endswith(ending)), STEPS[name.partition(".")[0]])


def _moved(errors: Errors, names: Sequence[str]) -> Several:
    """The errors as they are, and with each of the names one step further."""
    sets = [np.full(1 + len(names), errors.get(name, null(name))) for name in names]
    for i, (values, step) in enumerate(zip(sets, _steps(names), strict=True), 1):
        values[i] += step
    return {**errors, **dict(zip(names, sets, strict=True))}


def _before(errors: Several, dimensions: int) -> Several:
    """The errors with the sets before further dimensions."""
    shape = (-1, *[1] * dimensions)
    return {name: value if np.ndim(value) == 0 else np.reshape(value, shape) for name, value in errors.items()}


def rows(
    piece: Piece,
    setting: Setting,
    errors: Errors,
    names: Sequence[str],
    levels: Levels,
    constants: tuple[tuple[str, ...], Array],
) -> WhiteRows:
    """Linearise a piece's residual about `errors` in its own constants and in the errors of these names."""
    biases, held = constants
    frequencies = _frequencies(piece)
    raise_by = _raise(piece, frequencies, levels)
    noisy = [name for name in names if name.startswith(NOISY)]
    covariance = _covariance(piece, setting, _moved(errors, noisy), frequencies)
    covariance = np.broadcast_to(covariance, (1 + len(noisy), *covariance.shape[-3:]))
    factor = raise_by[:, :, None] * np.linalg.cholesky(covariance[0])
    white = np.linalg.inv(factor)
    drawn = dict(zip(noisy, _drawn(covariance, white, _steps(noisy)), strict=True))
    towards = np.array([*np.zeros(len(biases)), *(drawn.get(name, 0.0) for name in names)])
    base, columns = _linearised(piece, setting, errors, names, frequencies)
    stack = np.concatenate([held, columns, base[..., None]], axis=-1)
    real = _as_rows(white @ stack)
    nuisance = np.linalg.qr(_as_rows(white @ _nuisance(len(piece.equations), frequencies, piece)))[0]
    real -= nuisance @ (nuisance.T @ real)
    constant = np.linalg.qr(real[:, : len(biases)])[0]
    freedom = 1.0 - (nuisance**2).sum(1) - (constant**2).sum(1)
    matrix, left = real[:, :-1], real[:, -1]
    return WhiteRows(piece.flight, biases, matrix, left, towards, freedom, piece.equations, frequencies, factor)


def residual(piece: Piece, setting: Setting, errors: Several, frequencies: Array) -> Array:
    """Left's rate less right at the harmonics, (..., harmonics, equations) complex, per square root of a sample."""
    sets = _before(errors, 1)
    x = without_static_errors(piece.on_time(errors), sets)
    both = zip(*sides(x, piece.equations, setting.gravity, setting.arm(sets)), strict=True)
    rate = 2j * np.pi * frequencies
    parts = [rate * _spectrum(a, len(rate)) - _spectrum(b, len(rate)) for a, b in both]
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def _spectrum(record: Array, count: int) -> Array:
    """Transform (..., count) of one period: the last sample joins the first, which is the trapezoidal rule."""
    period = record[..., :-1].copy()
    period[..., 0] = 0.5 * (record[..., 0] + record[..., -1])
    return np.fft.rfft(period)[..., :count] / np.sqrt(period.shape[-1])


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
    mean, harmonics = white[0].real, np.sqrt(2.0) * white[1:].reshape(-1, white.shape[-1])
    return np.concatenate([mean, harmonics.real, harmonics.imag])


def _covariance(piece: Piece, setting: Setting, errors: Several, frequencies: Array) -> Array:
    """Covariance (..., harmonics, equations, equations) that the channels' noise gives the residual."""
    places = np.linspace(0, piece.samples - 1, POINTS).astype(int)
    values = piece.readings[:, piece.margin + places]
    nudge = np.maximum(piece.noise, 1e-9)
    bent = np.repeat(values[:, None], len(piece.channels) + 1, axis=1)
    for i, by in enumerate(nudge):
        bent[i, i + 1] += by
    sets = _before(errors, 2)
    x = without_static_errors(dict(zip(piece.channels, bent, strict=True)), sets)
    left, right = sides(x, piece.equations, setting.gravity, setting.arm(sets))
    both = np.stack(np.broadcast_arrays(*left, *right), axis=-2)
    # (..., channels, equations, instants) of either side, per standard deviation of each channel's noise
    slope = (both[..., 1:, :, :] - both[..., :1, :, :]) * (piece.noise / nudge)[:, None, None] / np.sqrt(len(places))
    left, right = np.split(slope, 2, axis=-2)
    omega = 2.0 * np.pi * frequencies
    first, second = zip(*(undoing(errors, unit_of(channel)) for channel in piece.channels), strict=True)
    first, second = (np.stack(np.broadcast_arrays(*values), axis=-1)[..., None, :] for values in (first, second))
    power = (1.0 - omega[:, None] ** 2 * second) ** 2 + (omega[:, None] * first) ** 2

    def summed(a: Array, b: Array) -> Array:
        products = a @ b.swapaxes(-1, -2)
        size = products.shape[-2:]
        over = power @ products.reshape(*products.shape[:-2], -1)
        return over.reshape(*over.shape[:-1], *size)

    mixed = summed(right, left)
    out = (omega**2)[:, None, None] * summed(left, left) + summed(right, right)
    return out + 1j * omega[:, None, None] * (mixed - mixed.swapaxes(-1, -2))


def _drawn(covariance: Array, white: Array, steps: Array) -> Array:
    """Gradient that noise alone has along errors: half the trace of covariance^-1 times its change, a datum.

    covariance : at the errors, and with each of them one step further.
    """
    inverse = white.conj().swapaxes(-1, -2) @ white
    change = covariance[1:] - covariance[0]
    inside = (change * inverse.swapaxes(-1, -2)).sum((-2, -1)).real / steps[:, None]
    return 0.5 * inside[:, 0] + inside[:, 1:].sum(-1)


def _raise(piece: Piece, frequencies: Array, levels: Levels) -> Array:
    band = np.digitize(frequencies, BANDS_HZ) - 1
    flat = np.ones(len(BANDS_HZ) - 1)
    return np.stack([np.sqrt(levels.get(name, flat))[band] for name in piece.equations], axis=-1)
