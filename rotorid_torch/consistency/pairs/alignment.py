"""Large errors first: an IMU turned by any angle, and clocks that are off by any time, from the whole record.

Body rates and the rates of change of the attitude are one vector in two sensors' axes. Their covariance (3, 3) at
every lag has a nuclear norm that no rotation changes: its peak is the lag, and the rotation follows there.

Source: Kabsch, Acta Crystallographica A 32 (1976), 922; Wahba, SIAM Review 7 (1965), 409, problem 65-1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations, product

import numpy as np
import torch

from rotorid_torch.consistency.correction import without_errors_of_flight
from rotorid_torch.consistency.equations import OF_GYROS
from rotorid_torch.consistency.pairs.far_lags import FarLag, lag_of_velocities
from rotorid_torch.consistency.smoothing import EVERY_S, centred, correlated, kernel, smoothed
from rotorid_torch.core import names
from rotorid_torch.core.rigid import gravity_in_body
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

REACH_S, LONGEST_S = 0.2, 30.0
"""Lags that other examinations look for, and the longest that is looked for here."""
FLIGHTS = 16
"""Flights that are looked at, at most."""
LEAST = 50
"""Samples of a flight that is used, at least."""
NEAR = 3
"""Samples to either side of a lag's peak within which it is where least is left."""
AGREES, HALVED = 0.7, 0.5
"""Correlation from which on a lag is known, and the share of what lags within `REACH_S` leave that it may leave."""
TRIED = (0.4, 0.7)
"""The same of a stream that is tried: rotation times velocity is wrong until it is moved, and then it must agree."""
SETTLED = 0.8
"""Correlation of force with velocity and attitude from which on no further stream is moved."""
REACHED = 0.65
"""Largest lag as a share of the longest flight."""
MET = np.array([0.1, 0.1, 0.35])
"""Shares of the power of left and right and of their samples that must meet at a lag."""
CHANCE = 5.0
"""Standard errors of a correlation (Fisher's z) that no chance gives: a nuclear norm of three rows has 2.5 +- 0.7."""
LEAST_TURN = np.radians(3.0)
"""Smallest turn that is looked for here: smaller ones are found jointly with the other sensor errors."""
SURE = 5.0
"""Standard errors of a turn."""
BETTER = 0.7
"""Share of the disagreement that a turn must leave at most."""
MOVES = 25.0
"""Power of a smoothed signal over that of its noise from which on it moves far above that."""
STEEP = 1.3
"""Pitch angle beyond which Euler angles say little of rates."""
ALIKE_S = 0.06
"""Lags of two streams that differ by less have one cause."""


@dataclass(frozen=True)
class Alignment:
    """What large errors the streams have against each other.

    turn : rotation vector e (3,) in rad, zeros for none: the IMU reads R(e)' times the vector in body axes; turn_se its
    standard error. gyros_alone : whether the accelerometers are not turned with the gyros. clocks : by unit, time in s
    by which it is late (early where negative). mirror : what each rate reads, as `+p -q +r`, where no rotation but a
    sign or an exchange of axes explains the rates; else empty. before,
    after : share of the rates' variance that the attitude does not explain, as recorded and with all of this taken out.
    strength : power of rates and attitude over that of their noise, the smaller.
    """

    turn: Array = field(default_factory=lambda: np.zeros(3))
    turn_se: float = 0.0
    gyros_alone: bool = False
    clocks: Mapping[str, float] = field(default_factory=dict)
    mirror: str = ""
    before: float = 0.0
    after: float = 0.0
    strength: float = 0.0

    @property
    def angle(self) -> float:
        """Angle of the turn, rad."""
        return float(np.linalg.norm(self.turn))

    @property
    def delays(self) -> dict[str, float]:
        """Clocks as errors of sensors by name."""
        return {f"delay.{unit}": seconds for unit, seconds in self.clocks.items()}

    @property
    def misalignment(self) -> dict[str, float]:
        """The turn as errors by name, the largest component first; empty for none."""
        parts = sorted(zip("xyz", self.turn.tolist(), strict=True), key=lambda part: -abs(part[1]))
        kind = OF_GYROS if self.gyros_alone else "misalignment"
        return {f"{kind}.{axis}": value for axis, value in parts} if self.angle > 0.0 else {}

    @property
    def errors(self) -> dict[str, float]:
        """All of it as errors by name, as `without_errors` takes them out; empty for none."""
        return {**self.delays, **self.misalignment}


@once
def alignment(dataset: Dataset) -> Alignment:
    """Large turns and clock errors of a data set's identify flights; none where rates or attitude are missing."""
    flights = [dataset.flights[name] for name in dataset.some(FLIGHTS)]
    flights = [f for f in flights if f.has(*names.RATES, *names.ATTITUDES)]
    if not flights:
        return Alignment()
    sides = [s for s in (rates_by_attitude(f) for f in flights) if s.pairs > LEAST]
    if not sides:
        return Alignment()
    late = _lag(sides)
    turn = turned(dataset, [s.moved(late).met for s in sides])
    before = share_left([s.met for s in sides])
    turn = replace(turn, before=before, gyros_alone=turn.angle > 0.0 and _gyros_alone(dataset, flights, turn))
    if turn.gyros_alone:
        turn = _or_mirrored(turn, [s.moved(late).met for s in sides])
    return replace(turn, clocks=_clocks(dataset, flights, turn, _fine(sides, late, rotation(turn.turn).T)))


def _gyros_alone(dataset: Dataset, flights: Sequence[Flight], turn: Alignment) -> bool:
    """Whether specific force agrees with attitude and velocity as recorded, and turned back with the gyros does not.

    Where no velocity is recorded, gravity alone is compared: what pushes the vehicle besides has no mean.
    """
    left = np.zeros(2)
    for flight in (f for f in flights if f.has(*names.SPECIFIC_FORCES)):
        still = torch.zeros(flight.samples, dtype=torch.float64)
        moving = Flight(flight.name, flight.dt, {**dict.fromkeys(names.VELOCITIES, still), **flight.channels})
        for k, one in enumerate((turn, replace(turn, gyros_alone=True))):
            by = forces_of(without_errors_of_flight(moving, one.errors), dataset.vehicle.gravity)
            left[k] += float(((by.felt - by.pushed - by.fallen)[by.present] ** 2).sum())
    return bool(left[1] < BETTER * left[0])


def rotation(vector: Array) -> Array:
    """Matrix (3, 3) of a rotation vector (3,) in rad."""
    from scipy.spatial.transform import Rotation  # slow to import

    return Rotation.from_rotvec(vector).as_matrix()


def rotation_vector(matrix: Array) -> Array:
    """Rotation vector (3,) in rad of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation  # slow to import

    return Rotation.from_matrix(matrix).as_rotvec()


def angle_of(matrix: Array) -> float:
    """Angle in rad, 0 to pi, of a rotation matrix (3, 3): its sine is half of what the matrix is skew by."""
    skew = matrix - matrix.T
    return float(np.arctan2(np.hypot.reduce(skew[np.triu_indices(3, 1)]), np.trace(matrix) - 1.0))


def right_angles() -> list[Array]:
    """The 24 rotations (3, 3) that take axes to axes."""
    signed = [
        np.eye(3)[[*p]] * np.array([*s])[:, None]
        for p in permutations(range(3))
        for s in product((1.0, -1.0), repeat=3)
    ]
    return [matrix for matrix in signed if np.linalg.det(matrix) > 0.0]


@dataclass(frozen=True)
class Sides:
    """Two vectors (T, 3) every `EVERY_S`, zero where unknown."""

    left: Array
    right: Array

    @property
    def power(self) -> Array:
        """Squares (2, T) of left and right."""
        return np.stack([(self.left**2).sum(axis=1), (self.right**2).sum(axis=1)])

    @property
    def present(self) -> Array:
        """Where left and right are not missing (2, T), 1 or 0."""
        return (self.power > 0.0).astype(float)

    @property
    def pairs(self) -> int:
        """Samples at which neither is missing."""
        return int(self.present.prod(axis=0).sum())

    @property
    def met(self) -> Sides:
        """The samples at which neither is missing, both about their means."""
        both = self.present.prod(axis=0) > 0.0
        always = np.ones(int(both.sum()), bool)
        return Sides(centred(self.left[both], always), centred(self.right[both], always))

    def moved(self, lag: int) -> Sides:
        """With the left side taken so many samples later."""
        count = len(self.left) - abs(lag)
        if lag >= 0:
            return Sides(self.left[lag:], self.right[:count])
        return Sides(self.left[:count], self.right[-lag:])


def rates_by_attitude(flight: Flight) -> Sides:
    """Body rates by the attitude's rates of change, and as recorded."""
    values, changes, present = smoothed(flight, names.ATTITUDES)
    rates, _, rates_present = smoothed(flight, names.RATES)
    if not len(values):
        return Sides(values, rates)
    by_attitude = centred(body_rates(values, changes), present & (np.abs(values[:, 1]) < STEEP))
    return Sides(by_attitude, centred(rates, rates_present))


def body_rates(angles: Array, changes: Array, order: str = "ZYX") -> Array:
    """Body rates (T, 3) by angles about x, y and z (T, 3) and their rates of change, of turns in this order.

    Source: Diebel, Representing Attitude (Stanford, 2006), section 8; Morelli and Klein, eq. 3.21, for the usual order.
    """
    rates = np.zeros_like(angles)
    for axis in ("XYZ".index(letter) for letter in order):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        c, s, turning = np.cos(angles[:, axis]), np.sin(angles[:, axis]), rates.copy()
        rates[:, first] = c * turning[:, first] + s * turning[:, second]
        rates[:, second] = c * turning[:, second] - s * turning[:, first]
        rates[:, axis] += changes[:, axis]
    return rates


def _correlations(sides: Sequence[Sides], size: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Size of the covariance of left, so many samples later, with right over the power that meets (lags,), to 1.

    And whether it is known there (lags,): enough meets, and no chance gives it. Sums over flights; size : of matrices
    (lags, 3, 3), for example the trace. Streams that change slowly have fewer independent samples.

    Source: Bartlett, Journal of the Royal Statistical Society 98 (1935), 536; Fisher, Metron 1 (1921), 3.
    """
    most = _most(sides)
    total, met, alike = (np.zeros((2 * most + 1, *shape)) for shape in ((3, 3), (3,), (2,)))
    whole = np.zeros_like(met)
    for side in sides:
        reach = min(most, int(REACHED * len(side.left)))
        here = slice(most - reach, most + 1 + reach)
        (left, right), (power, power_right) = side.present, side.power
        total[here] += _sums(side.left[:, :, None], side.right[:, None, :], reach)
        pairs = [(power, right), (left, power_right), (left, right)]
        met[here] += np.concatenate([_sums(a[:, None], b[:, None], reach) for a, b in pairs], axis=1)
        alike[here] += np.stack([_sums(x, x, reach).sum(axis=1) for x in (side.left, side.right)], axis=1)
        least = min(left.sum(), right.sum())
        shares = least / max(left.sum(), 1.0), least / max(right.sum(), 1.0)
        whole[here] += [power.sum() * shares[0], power_right.sum() * shares[1], least]
    tiny = np.finfo(float).tiny
    scores = size(total) / np.sqrt(np.maximum(met[:, 0] * met[:, 1], tiny))
    together = max(float((alike / np.maximum(alike[most], tiny)).prod(axis=1).sum()), 1.0)
    independent = np.maximum(met[:, 2] / together - 3.0, 0.0)
    sure = np.arctanh(np.clip(scores, 0.0, 1.0 - 1e-9)) * np.sqrt(independent) > CHANCE
    return scores, sure & (met >= MET * whole).all(axis=1)


def _sums(left: Array, right: Array, reach: int) -> Array:
    """Sums (lags, ...) of left (T, ...), so many samples later, times right, at lags from -reach to reach."""
    size = 1 << int(np.ceil(np.log2(2 * len(left))))
    both = np.fft.irfft(np.fft.rfft(left, size, axis=0) * np.fft.rfft(right, size, axis=0).conj(), size, axis=0)
    return np.concatenate([both[size - reach :], both[: reach + 1]])


def _best(scores: Array, sure: Array, agrees: float = AGREES, halved: float = HALVED) -> int:
    """Lag, in samples, of the highest score (lags,) that is sure; 0 where none is beyond what lies within `REACH_S`."""
    middle, near = len(scores) // 2, round(REACH_S / EVERY_S)
    best = int(np.argmax(np.where(sure, scores, 0.0)))
    inside, top = float(scores[max(middle - near, 0) : middle + near + 1].max()), float(scores[best])
    far = sure[best] and abs(best - middle) > near and scores[middle] != 0.0  # at none, streams never meet
    peak = 0 < best < len(scores) - 1 and top >= max(scores[best - 1], scores[best + 1])
    return best - middle if far and peak and top > agrees and 1.0 - top < halved * (1.0 - inside) else 0


def _most(sides: Sequence[Sides]) -> int:
    return min(round(LONGEST_S / EVERY_S), int(REACHED * max(len(s.left) for s in sides)))


def _lag(sides: Sequence[Sides]) -> int:
    """Samples by which the attitude comes after the rates, whatever turns the one against the other."""
    return _best(*_correlations(sides, lambda c: np.linalg.svd(c, compute_uv=False).sum(axis=1)))


def _fine(sides: Sequence[Sides], lag: int, matrix: Array | None = None) -> float:
    """A lag of whole samples in s, moved to where least is left; 0 for none: with ends that differ its peak is off."""
    if not lag:
        return 0.0
    around = range(-NEAR, NEAR + 1)
    near = [s.moved(lag) for s in sides]
    right = [s.right[NEAR:-NEAR] for s in near]  # the same samples for all of them
    moved = [[s.left[NEAR + k : len(s.left) - NEAR + k] for s in near] for k in around]
    left = [share_left([Sides(*both).met for both in zip(one, right, strict=True)], matrix) for one in moved]
    best = min(max(int(np.argmin(left)), 1), len(left) - 2)
    below, at, above = left[best - 1 : best + 2]
    bend = below - 2.0 * at + above
    part = float(np.clip(0.5 * (below - above) / bend, -1.0, 1.0)) if bend > 0.0 else 0.0
    return EVERY_S * (lag + around[best] + part)


def share_left(sides: Sequence[Sides], matrix: Array | None = None) -> float:
    """Share of the rates' variance that the attitude, turned by a matrix (3, 3), does not explain."""
    turn = np.eye(3) if matrix is None else matrix
    left = sum(float(((s.right - s.left @ turn.T) ** 2).sum()) for s in sides)
    return left / max(sum(float((s.right**2).sum()) for s in sides), np.finfo(float).tiny)


def turned(dataset: Dataset, sides: Sequence[Sides]) -> Alignment:
    """The turn of the rates against the attitude, or a mirror, where one is beyond doubt."""
    covariance = sum((s.right.T @ s.left for s in sides), np.zeros((3, 3)))
    u, sizes, vt = np.linalg.svd(covariance)
    sign = np.linalg.det(u @ vt)
    turn, free = u @ np.diag([1.0, 1.0, sign]) @ vt, u @ vt
    straight, after = share_left(sides), share_left(sides, turn)
    strength = _strength(dataset, sides)
    moved = strength > MOVES
    if sign < 0.0 and moved and share_left(sides, free) < 0.5 * min(after, straight) and share_left(sides, free) < 0.3:
        return Alignment(mirror=axes_of(free), before=straight, after=share_left(sides, free), strength=strength)
    together = correlated(EVERY_S)
    left = after * sum(float((s.right**2).sum()) for s in sides) / max(sum(len(s.right) for s in sides) * 3 - 3, 1)
    weak = max(float(sizes[1] + sign * sizes[2]), np.finfo(float).tiny)
    error = float(np.sqrt(left * together / weak))
    angle = angle_of(turn)
    sure = moved and angle > max(LEAST_TURN, SURE * error) and after < BETTER * straight
    if not sure:
        return Alignment(before=straight, after=straight, strength=strength)
    return Alignment(rotation_vector(turn.T), error, before=straight, after=after, strength=strength)


def _or_mirrored(turn: Alignment, sides: Sequence[Sides]) -> Alignment:
    """The turn of gyros alone, or a mirror where an axis that hardly moves does not tell the two apart.

    Wires are exchanged more easily than a sensor is turned without the one beside it.
    """
    u, _, vt = np.linalg.svd(sum((s.right.T @ s.left for s in sides), np.zeros((3, 3))))
    mirror = u @ np.diag([1.0, 1.0, -np.linalg.det(u @ vt)]) @ vt
    after = share_left(sides, mirror)
    if BETTER * after > turn.after:
        return turn
    return Alignment(mirror=axes_of(mirror), before=turn.before, after=after, strength=turn.strength)


def _strength(dataset: Dataset, sides: Sequence[Sides]) -> float:
    """Power of rates and of the attitude's rates over that of their noise, the smaller."""
    dt = float(np.median([dataset.facts[name].dt for name in dataset.identify]))
    bell, slope = kernel(dt)
    count = max(sum(len(s.left) for s in sides), 1)
    taps = (("left", names.ATTITUDES, slope), ("right", names.RATES, bell))
    ratios = []
    for side, channels, weights in taps:
        noise = sum(dataset.noise(c) ** 2 for c in channels) * float((weights**2).sum())
        power = sum(float((getattr(s, side) ** 2).sum()) for s in sides) / count
        ratios.append(power / max(noise, np.finfo(float).tiny))
    return min(ratios)


def axes_of(matrix: Array) -> str:
    """What each rate reads by the nearest matrix that takes axes to axes."""
    nearest = [(names.RATES[int(np.argmax(np.abs(row)))], row[int(np.argmax(np.abs(row)))]) for row in matrix]
    return " ".join(f"{'+' if size > 0.0 else '-'}{name}" for name, size in nearest)


def _clocks(dataset: Dataset, flights: Sequence[Flight], turn: Alignment, seconds: float) -> dict[str, float]:
    """Which streams are late, in s: attitude or rates, then velocities or accelerometers against what they are with."""
    shifts = {"attitude": seconds} if seconds else {}
    felt, gravity = [f for f in flights if f.has(*names.VELOCITIES, *names.SPECIFIC_FORCES)], dataset.vehicle.gravity
    if not felt:
        return _without_forces(dataset, flights, turn, seconds)
    if climbs(felt, gravity):
        return shifts
    tried = [shifts, {"rates": -seconds}, {"rates": -seconds, "accelerations": -seconds}] if seconds else [{}]
    scored = [(_motion(felt, turn, clocks, gravity), clocks) for clocks in tried]
    best, clocks = max(scored, key=lambda one: one[0].agreed)
    if best.agreed > SETTLED:
        late = best.forces + clocks.get("accelerations", 0.0)
        return clocks | ({"accelerations": late} if best.forces else {})
    best, clocks = max(scored, key=lambda one: one[0].moved)
    if not best.unit:
        return clocks
    further = {**clocks, best.unit: clocks.get(best.unit, 0.0) + best.seconds}
    if _motion(felt, turn, further, gravity).agreed < AGREES:
        return clocks
    return {name: value for name, value in further.items() if abs(value) > ALIKE_S}


def _without_forces(dataset: Dataset, flights: Sequence[Flight], turn: Alignment, seconds: float) -> dict[str, float]:
    """The same where no accelerometer says what pushed the aircraft: gravity by the attitude does.

    Of attitude and rates that one is moved with which the velocities are on time, or nearly so.
    """
    tried = [{"attitude": seconds}, {"rates": -seconds}] if seconds else [dict[str, float]()]
    lags = list[tuple[float, FarLag, dict[str, float]]]()
    for clocks in tried:
        errors = replace(turn, clocks=clocks).errors
        righted = [without_errors_of_flight(flight, errors) for flight in flights]
        lag = lag_of_velocities(righted, dataset.vehicle.gravity)
        lags += [(abs(lag.seconds), lag, clocks)] if lag else []
    if not lags:
        return tried[0]
    off, lag, clocks = min(lags, key=lambda one: one[0])
    far = off > REACH_S and lag.left < HALVED * lag.left_near
    return {**clocks, "velocities": lag.seconds} if far else clocks


@dataclass(frozen=True)
class _Motion:
    """How well velocity, attitude and force agree (a correlation) as they are, and with one stream moved.

    unit, seconds : that stream and the time by which it comes after the others; empty where none clearly does.
    forces : the same time of the accelerometers where it is beyond doubt; level motion agrees without them.
    """

    agreed: float = 0.0
    moved: float = 0.0
    unit: str = ""
    seconds: float = 0.0
    forces: float = 0.0


def _motion(flights: Sequence[Flight], turn: Alignment, clocks: Mapping[str, float], gravity: float) -> _Motion:
    errors = replace(turn, clocks=clocks).errors
    every = [forces_of(without_errors_of_flight(f, errors), gravity) for f in flights]
    every = [e for e in every if len(e.present)]
    if not every:
        return _Motion()
    velocities = [Sides(centred(e.pushed, e.present), centred(e.felt - e.fallen, e.present)) for e in every]
    forces = [Sides(centred(e.felt, e.present), centred(e.pushed + e.fallen, e.present)) for e in every]
    agreed, sure, shifts = 0.0, 0, list[tuple[float, str, float]]()
    for unit, sides in (("velocities", velocities), ("accelerations", forces)):
        scores, beyond = _correlations(sides, lambda c: np.trace(c, axis1=1, axis2=2))
        middle, lag = len(scores) // 2, _best(scores, beyond, *TRIED)
        agreed = max(agreed, float(scores[middle]))
        if lag:
            shifts.append((float(scores[middle + lag]), unit, _fine(sides, lag)))
        sure = _best(scores, beyond)
    score, unit, seconds = max(shifts, default=(agreed, "", 0.0))
    return _Motion(agreed, score, unit, seconds, _fine(forces, sure))


def climbs(flights: Sequence[Flight], gravity: float) -> bool:
    """Whether w is positive up: so taken, velocity agrees with force and attitude, and else it does not."""
    flights = [f for f in flights if f.has(*names.VELOCITIES, *names.RATES, *names.ATTITUDES, *names.SPECIFIC_FORCES)]
    left, power = np.zeros(2), 0.0
    for flight in flights:
        down = forces_of(flight, gravity)
        up = replace(down, pushed=down.pushed - 2.0 * down.by_w)
        if down.present.any():
            left += [float((centred(e.pushed - e.felt + e.fallen, e.present) ** 2).sum()) for e in (down, up)]
            power += float((centred(down.felt - down.fallen, down.present) ** 2).sum())
    return bool(left[1] < CLIMBS * min(left[0], power))


CLIMBS = 0.2
"""Share of what velocities leave, and of the forces, that velocities with w turned leave at most."""
MIRRORED = 0.5
"""Mean square that mirrored axes must leave, over that of the best turn, to be told: less than half."""


@dataclass(frozen=True)
class ForceTurn:
    """How the accelerometers alone are turned, or mirrored, against velocity and attitude.

    matrix : orthogonal (3, 3), what they read of a vector in body axes. left, by_bias : mean square in (m/s²)² of what
    the turn leaves, and of what a constant on each axis of each flight leaves instead.
    """

    matrix: Array
    left: float
    by_bias: float


def force_turn(flights: Iterable[Flight], gravity: float) -> ForceTurn | None:
    """The turn that makes specific force that of velocity and attitude (Wahba's problem); None without these."""
    every = [
        forces_of(f, gravity) for f in flights if f.has(*names.VELOCITIES, *names.SPECIFIC_FORCES, *names.ATTITUDES)
    ]
    pairs = [np.stack([e.felt, e.pushed + e.fallen])[:, e.present] for e in every]
    pairs = [pair[:, np.isfinite(pair).all(axis=(0, 2))] for pair in pairs]
    felt, true = np.concatenate([np.zeros((2, 0, 3)), *pairs], axis=1)
    if len(felt) < LEAST:
        return None
    u, _, vt = np.linalg.svd(felt.T @ true)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt  # along an axis that does not move any sign will do
    left, mirrored = (float(((felt - true @ matrix.T) ** 2).mean()) for matrix in (turn, u @ vt))
    best, left = (u @ vt, mirrored) if mirrored < MIRRORED * left else (turn, left)
    spread = sum(float((felt - true).var(axis=0).sum()) * len(felt) for felt, true in pairs if len(felt))
    return ForceTurn(best, left, spread / felt.size)


@dataclass(frozen=True)
class Forces:
    """What velocity says (T, 3), what gravity says, what is felt, smoothed; and where all is known (T,).

    pushed : rate of change of velocity over ground in body axes, rotation included; by_w : what of it is due to w;
    fallen : minus gravity.
    """

    pushed: Array
    by_w: Array
    fallen: Array
    felt: Array
    present: Array


def forces_of(flight: Flight, gravity: float) -> Forces:
    """Source: Morelli and Klein, Aircraft System Identification, 2nd ed., eq. 3.35."""
    velocity, change, present = smoothed(flight, names.VELOCITIES)
    rates, _, whole = smoothed(flight, names.RATES)
    angles, _, turned = smoothed(flight, names.ATTITUDES)
    felt, _, measured = smoothed(flight, names.SPECIFIC_FORCES)
    if not len(velocity):
        return Forces(velocity, velocity, velocity, velocity, present)
    fallen = -gravity_in_body(torch.from_numpy(angles), gravity).numpy()
    w = np.array([0.0, 0.0, 1.0])
    pushed, by_w = (x + np.cross(rates, v) for x, v in ((change, velocity), (w * change, w * velocity)))
    return Forces(pushed, by_w, fallen, felt, present & whole & turned & measured)
