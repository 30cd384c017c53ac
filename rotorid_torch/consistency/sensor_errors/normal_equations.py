"""Normal equations of all pieces together: fits of chosen sensor errors, gains of the others, levels of misfit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rotorid_torch.consistency.equations import null
from rotorid_torch.consistency.sensor_errors.pieces import REACH_S, Piece
from rotorid_torch.consistency.sensor_errors.weighted_fit import (
    BANDS_HZ,
    Errors,
    Levels,
    Setting,
    WhiteRows,
    constant_columns,
    rows,
)
from rotorid_torch.core.names import RATES, VELOCITIES
from rotorid_torch.effects.base import Effect
from rotorid_torch.effects.families.sensors import FILTER_ENDINGS, LeverArm, Misalignment, SensorFilter, SensorScale

Array = np.ndarray

ITERATIONS = 6
"""Gauss-Newton steps of a fit, at most."""
SETTLED = 0.05
"""A fit has converged when every step is below this share of its standard error, or gains less than this."""
SUSPECT = 3.0
"""Standard deviations by which a band's level must exceed the noise before it replaces it."""


@dataclass(frozen=True)
class Normal:
    """One piece's part of the normal equations: N (P, P), gradient (P,), sum of squares, its constants eliminated.

    constants : of each drifting channel, value and standard error, the other errors held.
    """

    flight: str
    matrix: Array
    gradient: Array
    cost: float
    constants: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Point:
    """The normal equations at these errors, piece by piece and summed; columns in the order of `names`."""

    errors: dict[str, float]
    names: tuple[str, ...]
    parts: tuple[Normal, ...]
    matrix: Array
    gradient: Array
    cost: float

    def among(self, errors: Errors, names: Sequence[str]) -> Point:
        """The same point for some of its names; errors that differ by zeros."""
        i = [self.names.index(name) for name in names]
        parts = tuple(replace(p, matrix=p.matrix[np.ix_(i, i)], gradient=p.gradient[i]) for p in self.parts)
        return Point(dict(errors), tuple(names), parts, self.matrix[np.ix_(i, i)], self.gradient[i], self.cost)

    def solve(self, free: Sequence[str]) -> tuple[Array, Array]:
        """Step to the least sum of squares in the errors named, and their covariance."""
        i = [self.names.index(name) for name in free]
        inverse = _inverse(self.matrix[np.ix_(i, i)])
        return -inverse @ self.gradient[i], inverse

    def joining(self, name: str, held: Sequence[str]) -> tuple[float, float]:
        """Step and information of one more error when those held are refitted with it."""
        j, i = self.names.index(name), [self.names.index(n) for n in held if n != name]
        along = _inverse(self.matrix[np.ix_(i, i)]) @ self.matrix[i, j]
        information = self.matrix[j, j] - self.matrix[j, i] @ along
        if information <= 1e-9 * max(self.matrix[j, j], 1e-300):
            return 0.0, 0.0
        return float(-(self.gradient[j] - self.gradient[i] @ along) / information), float(information)

    def by_flight(self, name: str, held: Sequence[str]) -> tuple[Array, Array]:
        """Information (F, F) on an error's steps that differ from flight to flight, and information times steps (F,).

        Those held are refitted, the same in all flights. Of one flight alone the pieces stand for flights.
        """
        j, i = self.names.index(name), [self.names.index(n) for n in held if n != name]
        flights = [part.flight for part in self.parts]
        labels = flights if len(set(flights)) > 1 else range(len(flights))
        groups = np.array([[label == one for label in labels] for one in dict.fromkeys(labels)], dtype=float)
        matrix = groups @ np.stack([part.matrix[j] for part in self.parts])
        slope = groups @ np.array([part.gradient[j] for part in self.parts])
        along = _inverse(self.matrix[np.ix_(i, i)])
        information = np.diag(matrix[:, j]) - matrix[:, i] @ along @ matrix[:, i].T
        return information, matrix[:, i] @ along @ self.gradient[i] - slope


@dataclass
class Search:
    """The pieces of a data set with the level of what is left in each equation and band.

    The columns of the pieces' constants hardly depend on the errors: they are renewed when the levels are. Until then
    the same errors, which many fits begin from or end at, have the same normal equations: these are kept.
    """

    pieces: Sequence[Piece]
    setting: Setting
    levels: dict[str, Array] = field(default_factory=dict)
    constants: list[tuple[tuple[str, ...], Array]] = field(default_factory=list)
    _points: dict[tuple[tuple[str, float], ...], Point] = field(default_factory=dict)

    def at(self, errors: Errors, names: Sequence[str]) -> Point:
        """Normal equations at these errors in the errors named."""
        key = tuple(sorted((name, value) for name, value in errors.items() if value))
        point = self._points.get(key)
        if point is None or not set(names) <= {*point.names}:
            point = self._points[key] = _sum(errors, names, self._rows(errors, names))
        return point.among(errors, names)

    def measure(self, errors: Errors, names: Sequence[str]) -> Point:
        """The same with levels taken from what all of the named errors together cannot explain."""
        self.constants = [constant_columns(piece, self.setting, errors) for piece in self.pieces]
        self._points.clear()
        rows = self._rows(errors, names)
        point = _sum(errors, names, rows)
        step = point.solve(names)[0]
        levels = _levels(rows, step, self.levels)
        if all(np.array_equal(levels[name], self.levels.get(name, np.ones_like(levels[name]))) for name in levels):
            return point
        self.levels = levels
        self._points.clear()
        return self.at(errors, names)

    def raised(self, errors: Errors) -> bool:
        """Raise the levels to what these errors leave over, where that is more; whether anything was raised.

        Errors that shrink both sides of an equation seem to explain any misfit while its level is unknown.
        """
        left = _levels(self._rows(errors, ()), np.zeros(0), self.levels)
        higher = {name: np.maximum(level, self.levels.get(name, 1.0)) for name, level in left.items()}
        if all(np.array_equal(level, self.levels.get(name, np.ones_like(level))) for name, level in higher.items()):
            return False
        self.levels = higher
        self._points.clear()
        return True

    @property
    def misfit(self) -> float:
        """Largest level of what is left over, in powers of the noise."""
        return max((float(level.max()) for level in self.levels.values()), default=1.0)

    def fit(self, errors: Errors, free: Sequence[str]) -> Point:
        """Gauss-Newton over the errors named, the others held where they are."""
        point = self.at({**{name: null(name) for name in free}, **errors}, free)
        for _ in range(ITERATIONS):
            step, covariance = point.solve(free)
            if not np.all(np.isfinite(step)) or np.all(np.abs(step) < SETTLED * np.sqrt(np.diag(covariance))):
                break
            trial = self.at(_stepped(point.errors, free, step), free)
            halvings = 0
            while trial.cost > point.cost + 1.0 and halvings < 4:
                step, halvings = 0.5 * step, halvings + 1
                trial = self.at(_stepped(point.errors, free, step), ())  # its cost is all that is asked for
            if trial.cost > point.cost + 1.0:
                break
            gained, point = point.cost - trial.cost, trial if trial.names else self.at(trial.errors, free)
            if abs(gained) < SETTLED:
                break
        return point

    def _rows(self, errors: Errors, names: Sequence[str]) -> list[WhiteRows]:
        if not self.constants:
            self.constants = [constant_columns(piece, self.setting, errors) for piece in self.pieces]
        return [
            rows(piece, self.setting, errors, names, self.levels, held)
            for piece, held in zip(self.pieces, self.constants, strict=True)
        ]


def _sum(errors: Errors, names: Sequence[str], rows: Sequence[WhiteRows]) -> Point:
    parts = tuple(_eliminated(piece) for piece in rows)
    matrix, gradient = np.sum([p.matrix for p in parts], axis=0), np.sum([p.gradient for p in parts], axis=0)
    return Point(dict(errors), tuple(names), parts, matrix, gradient, sum(p.cost for p in parts))


def _stepped(errors: Errors, free: Sequence[str], step: Array) -> dict[str, float]:
    moved = {name: errors.get(name, null(name)) + by for name, by in zip(free, step, strict=True)}
    return {**errors, **{name: bounded(name, value) for name, value in moved.items()}}


def _bounds(effect: Effect) -> tuple[float, float]:
    return effect.declared[0].bounds


_FILTERS = {p.name.removeprefix("rates"): p.bounds for p in SensorFilter(RATES).declared}
LIMITS = {
    "delay": (-REACH_S, REACH_S),
    "filter": _FILTERS[""],
    "scale": _bounds(SensorScale(VELOCITIES)),
    "misalignment": _bounds(Misalignment(RATES)),
    "lever_arm": _bounds(LeverArm()),
    "bias": (-np.inf, np.inf),
}
"""What a sensor can have, as the effects declare it, and a clock beside what was set right before; a constant has no
limit here, its unit differs by channel."""


def limits(name: str) -> tuple[float, float]:
    """What a sensor can have of the error of this name."""
    return next((_FILTERS[e] for e in FILTER_ENDINGS if name.endswith(e)), LIMITS[name.partition(".")[0]])


def bounded(name: str, value: float) -> float:
    """The value inside what a sensor can have."""
    low, high = limits(name)
    return float(min(max(value, low), high))


def _inverse(matrix: Array) -> Array:
    """Inverse of a normal matrix on unit columns; directions without information get none."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-10, hermitian=True) / np.outer(scale, scale)


def _eliminated(piece: WhiteRows) -> Normal:
    """Normal equations of a piece; its constants are solved for and leave."""
    b = len(piece.biases)
    normal, slope = piece.matrix.T @ piece.matrix, piece.matrix.T @ piece.residual - piece.towards
    inverse = _inverse(normal[:b, :b])
    across = normal[b:, :b] @ inverse
    constants = {
        name.removeprefix("bias."): (-float(inverse[i] @ slope[:b]), float(np.sqrt(inverse[i, i])))
        for i, name in enumerate(piece.biases)
        if name.startswith("bias.")
    }
    cost = float(piece.residual @ piece.residual - slope[:b] @ inverse @ slope[:b])
    return Normal(
        piece.flight, normal[b:, b:] - across @ normal[:b, b:], slope[b:] - across @ slope[:b], cost, constants
    )


def _levels(rows: Sequence[WhiteRows], step: Array, old: Levels) -> dict[str, Array]:
    """Power of what is left over that of the noise, per equation and band, where it is beyond chance; else 1."""
    bands = len(BANDS_HZ) - 1
    power: dict[str, Array] = {}
    for piece in rows:
        b = len(piece.biases)
        remainder = piece.residual + piece.matrix[:, b:] @ step
        remainder = remainder + piece.matrix[:, :b] @ np.linalg.lstsq(piece.matrix[:, :b], -remainder, rcond=1e-10)[0]
        band = np.digitize(piece.frequencies, BANDS_HZ) - 1
        spectrum = np.einsum("kij,kj->ki", piece.factor, _as_spectrum(remainder, piece))
        share = np.einsum("kij,kj->ki", np.abs(piece.factor) ** 2, _as_power(piece.freedom, piece))
        whole = (np.abs(piece.factor) ** 2).sum(-1)
        count = np.where(piece.frequencies > 0.0, 2.0, 1.0)[:, None]
        spectrum, data = count * np.abs(spectrum) ** 2 / whole, count * share / whole
        for i, name in enumerate(piece.equations):
            sums = np.stack([np.bincount(band, column[:, i], bands) for column in (spectrum, data)])
            power[name] = power.get(name, 0.0) + sums
    return {name: _beyond_chance(both[0], both[1], old.get(name, np.ones(bands))) for name, both in power.items()}


def _beyond_chance(power: Array, data: Array, old: Array) -> Array:
    ratio = np.ones_like(power)
    for band in range(len(power) - 1, -1, -1):
        if data[band] >= 8.0:
            ratio[band] = old[band] * power[band] / data[band]
        elif band + 1 < len(power):
            ratio[band] = ratio[band + 1]
    beyond = ratio > 1.0 + SUSPECT * np.sqrt(2.0 / np.maximum(data, 8.0))
    return np.where(beyond, ratio, 1.0)


def _as_spectrum(values: Array, piece: WhiteRows) -> Array:
    """White rows back to (harmonics, equations) complex of unit power."""
    equations, harmonics = len(piece.equations), len(piece.frequencies) - 1
    real, imaginary = values[equations:].reshape(2, harmonics, equations)
    return np.concatenate([values[:equations][None] + 0j, (real + 1j * imaginary) / np.sqrt(2.0)])


def _as_power(values: Array, piece: WhiteRows) -> Array:
    equations, harmonics = len(piece.equations), len(piece.frequencies) - 1
    return np.concatenate([values[:equations][None], values[equations:].reshape(2, harmonics, equations).mean(0)])
