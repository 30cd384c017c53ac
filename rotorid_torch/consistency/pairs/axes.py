"""In which axes and units velocities and positions are: complex least squares over the whole record.

A horizontal vector is one complex number, so that one complex factor is a unit and a turn about the vertical at once.
Velocities are held against gravity and specific force, which attitude and IMU measure; positions against the path
that velocity and attitude say, for a position that is differentiated is mostly noise.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from rotorid_torch.consistency.smoothing import EVERY_S, smoothed
from rotorid_torch.core import names
from rotorid_torch.core.rigid import gravity_in_body, position_rates
from rotorid_torch.core.statistics import jackknife_variance, regression, without_line
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray
Form = Literal["plain", "mirrored", "earth"]
"""What a record is besides scaled and turned: nothing, with the second axis the other way, along north and east."""

PIECE_S = 20.0
"""Parts of flights from whose spread errors are known: about as long, two at least."""
LEAST = 50
"""Samples of a part that is used."""
CLEAR, AS_WELL = 0.5, 1.1
"""What another form may leave of the plain form's misfit: to be the right one, or where it needs no turn."""
EXPLAINED = 0.5
"""Share of what the nuisances leave that the factor must explain, to be known."""
LEAST_TURN = np.radians(5.0)
"""Smallest turn that is told, rad."""
LEAST_MOTION = 0.2
"""m/s² rms, from which on velocities are compared: an estimator's that hardly move are what it makes of noise."""
SURE_SHARE = 0.1
"""Largest standard error of a factor, as a share of it, that is worth telling."""


@dataclass(frozen=True)
class Frame:
    """A record is `factor` times what it should be; a factor of exp(i a) is a turn by a, clockwise seen from above.

    errors : standard errors of size and angle of the factor. misfit, explained : mean square that is left, and share
    of what the nuisances leave that the factor explains. motion : rms of the record, per s for velocities.
    """

    factor: complex
    errors: tuple[float, float]
    misfit: float
    explained: float
    motion: float
    form: Form = "plain"

    @property
    def scale(self) -> float:
        """Size of the factor."""
        return abs(self.factor)

    @property
    def turn(self) -> float:
        """Angle of the factor, rad."""
        return float(np.angle(self.factor))

    @property
    def clear(self) -> bool:
        """Whether the factor is worth telling."""
        return self.explained > EXPLAINED and max(self.errors) < SURE_SHARE


def feels(dataset: Dataset) -> bool:
    """Whether horizontal accelerometers are recorded in every flight."""
    return all(facts.has(*names.SPECIFIC_FORCES[:2]) for facts in dataset.facts.values())


def velocity_frame(dataset: Dataset, felt: bool) -> Frame | None:
    """Frame of u and v by gravity and, where `felt`, the accelerometers; None where it cannot be known.

    d(u + iv)/dt + ir(u + iv) is the factor times the horizontal specific force and gravity, and iw(p + iq) by a factor
    of its own, for w may have another unit; so has what an IMU feels that is away from the centre of gravity. Without
    accelerometers what gravity does is estimated beside linear terms in velocities, rates and controls.

    Source: Morelli and Klein, Aircraft System Identification, 2nd ed., eq. 3.35.
    """
    flights = _with(dataset, *names.RATES)
    headed = all(flight.has("psi") for flight in flights)

    def rows(flight: Flight, form: Form) -> Array:
        return _motion(flight, names.SPECIFIC_FORCES[:2] if felt else dataset.controls, dataset.vehicle.gravity, form)

    frame = _best(flights, rows, ("plain", "mirrored", "earth") if headed else ("plain", "mirrored"))
    return frame if frame is not None and frame.motion > LEAST_MOTION else None


def _motion(flight: Flight, extra: Sequence[str], gravity: float, form: Form) -> Array:
    """Change of the horizontal velocity, force, nuisances, in columns (T, n), complex; only where all are known.

    extra : horizontal specific forces, or else the controls.
    """
    velocity, change, present = smoothed(flight, names.VELOCITIES)
    rates, turning, rates_present = smoothed(flight, names.RATES)
    tilt, _, tilt_present = smoothed(flight, names.ATTITUDES[:2])
    others, _, others_present = smoothed(flight, extra)
    if not len(velocity):
        return np.zeros((0, 2), complex)
    heading = np.exp(1j * smoothed(flight, ("psi",))[0][:, 0]) if form == "earth" else np.ones(len(velocity))
    mirror, (p, q, r) = -1j if form == "mirrored" else 1j, rates.T
    z, slope = (x[:, 0] + mirror * x[:, 1] for x in (velocity, change))
    fall = gravity_in_body(torch.from_numpy(tilt), gravity).numpy()
    force, across = fall[:, 0] + 1j * fall[:, 1], 1j * velocity[:, 2] * (p + 1j * q)
    if tuple(extra) == names.SPECIFIC_FORCES[:2]:
        columns = [force + others[:, 0] + 1j * others[:, 1], across, *_felt_on_arms(rates, turning)]
    else:
        in_body = z * heading.conj()
        columns = [force, across, in_body, in_body.conj(), velocity[:, 2], *rates.T, *others.T]
    changed = slope if form == "earth" else slope + 1j * r * z
    whole = present & rates_present & tilt_present & others_present
    return np.stack([changed, *(column * heading for column in columns)], axis=1)[whole]


def _felt_on_arms(rates: Array, turning: Array) -> Iterator[Array]:
    """Horizontal specific force (T,), complex, that an IMU feels 1 m from the reference point, along each axis."""
    for arm in np.eye(3):
        felt = np.cross(turning, arm) + np.cross(rates, np.cross(rates, arm))
        yield felt[:, 0] + 1j * felt[:, 1]


def path_frame(dataset: Dataset) -> Frame | None:
    """Frame of north and east against the path by velocity and attitude; None where it cannot be known."""

    def rows(flight: Flight, form: Form) -> Array:
        place, path = _places(flight, names.POSITIONS[:2])
        mirror = -1j if form == "mirrored" else 1j
        return np.stack([place[:, 0] + mirror * place[:, 1], path[:, 0] + 1j * path[:, 1]], axis=1)

    return _best(_with(dataset, "psi", *names.POSITIONS[:2]), rows, ("plain", "mirrored"))


def height_frame(dataset: Dataset) -> Frame | None:
    """Frame of the height against the climb by velocity and attitude, its factor negative where it is positive down."""

    def rows(flight: Flight, _: Form) -> Array:
        place, path = _places(flight, ("height",))
        return np.stack([place[:, 0], path[:, 2]], axis=1).astype(complex)

    return _best(_with(dataset, "height"), rows, ("plain",))


def _with(dataset: Dataset, *needs: str) -> list[Flight]:
    channels = (*names.VELOCITIES, *names.ATTITUDES[:2], *needs)
    return [dataset.flights[name] for name, facts in dataset.facts.items() if facts.has(*channels)]


def _places(flight: Flight, channels: Sequence[str]) -> tuple[Array, Array]:
    """Positions (T, n), and north, east and height (T, 3) that velocity and attitude say, every `EVERY_S`, in m.

    Straight lines are taken out of both: a path's beginning, and what a constant error of velocity becomes.
    """
    heading = flight.bridged(["psi"]) if flight.has("psi") else torch.zeros(flight.samples, 1, dtype=torch.float64)
    attitude = torch.cat([flight.bridged(names.ATTITUDES[:2]), heading], dim=1)
    rates = position_rates(flight.bridged(names.VELOCITIES), attitude).numpy()
    every = max(1, round(EVERY_S / flight.dt))
    path = (np.cumsum(rates, axis=0) * flight.dt)[::every]
    place = flight.stack(channels).numpy()[::every]
    present = np.isfinite(place).all(axis=1) & np.isfinite(path).all(axis=1)
    return place[present], path[present]


def _best(flights: Sequence[Flight], rows: Callable[[Flight, Form], Array], forms: Sequence[Form]) -> Frame | None:
    """The plain form, or another one that leaves far less, or no more without any turn; None where neither is known."""
    fits = [fit for form in forms if (fit := _fit([p for f in flights for p in _parts(rows(f, form), f)], form))]
    if not fits or fits[0].form != "plain":
        return None
    plain, best = fits[0], fits[0]
    for other in fits[1:]:
        straight = other.form == "earth" and abs(other.turn) < LEAST_TURN < abs(plain.turn)
        if other.misfit < (AS_WELL if straight else CLEAR) * plain.misfit and other.misfit < AS_WELL * best.misfit:
            best = other
    return best if best.clear else None


def _parts(columns: Array, flight: Flight) -> Iterator[tuple[Array, int]]:
    """Products (n, n) of the columns (T, n) of each part of a flight, without their lines, and its samples."""
    count = max(2, round(flight.samples * flight.dt / PIECE_S))
    for part in np.array_split(columns, count):
        if len(part) >= LEAST:
            left = without_line(part)
            yield left.conj().T @ left, len(part)


def _fit(parts: Sequence[tuple[Array, int]], form: Form) -> Frame | None:
    """Factor of the second column in the first beside the others, its errors by the jackknife over the parts."""
    if len(parts) < 2:
        return None
    total = np.sum([part for part, _ in parts], axis=0)
    factor, misfit, without = _solved(total)
    if not (np.isfinite(factor) and abs(factor) > 0.0 and without > 0.0):
        return None
    relative = np.array([_solved(total - part)[0] / factor for part, _ in parts])
    errors = np.sqrt([float(jackknife_variance(x)) for x in (np.abs(relative), np.angle(relative))])
    samples = sum(count for _, count in parts)
    motion = float(np.sqrt(total[0, 0].real / samples))
    return Frame(factor, (float(errors[0]), float(errors[1])), misfit / samples, 1.0 - misfit / without, motion, form)


def _solved(products: Array) -> tuple[complex, float, float]:
    """Factor of the second column, squares that are left with it, and without it, from products (n, n)."""
    nuisances = np.delete(np.delete(products, 1, 0), 1, 1)
    (factor, *_), shares = regression(products)
    power = float(products[0, 0].real)
    return complex(factor[0]), power * max(float(shares[0]), 0.0), power * float(regression(nuisances)[1][0])
