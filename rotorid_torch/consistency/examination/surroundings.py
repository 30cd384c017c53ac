"""What surrounds the aircraft, from the record alone: local gravity, and wind where there are air data."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.equations import GRAVITY_RANGE
from rotorid_torch.consistency.examination.finding import Finding, Severity, finding
from rotorid_torch.consistency.examination.frames import LEAST_SCALE, unit_of
from rotorid_torch.consistency.imu_place import place_of_imu, placed_pairs
from rotorid_torch.consistency.sensor_pairs import Pair, jackknife_error, minutes
from rotorid_torch.consistency.smoothing import correlated, kernel
from rotorid_torch.core.names import ATTITUDES, VELOCITIES
from rotorid_torch.core.rigid import gravity_in_body, position_rates
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

AIR = ("airspeed", *VELOCITIES, *ATTITUDES)
ITERATIONS = 30
KNOWN = 0.02
"""Standard error of gravity, as a share of it, up to which it is worth telling."""
OTHER = 0.05
"""Share of gravity by which it must be off to doubt forces: rare samples of velocity or attitude lose some percent."""
AIR_SCALE = 0.04
"""Scale error of the airspeed that is worth a word."""
WITHOUT = 0.1
"""Share of gravity below which accelerometers do not read it."""


@dataclass(frozen=True)
class Measured:
    """Values (n,) with their standard errors (n,), from the spread between pieces of flights."""

    values: Array
    errors: Array


def surroundings(dataset: Dataset) -> Iterator[Finding]:
    """Gravity against the declared one."""
    local, declared = gravity(dataset), dataset.vehicle.gravity
    if local is not None and local.errors[0] < KNOWN * declared:
        g, error = float(local.values[0]), float(local.errors[0])
        sentence = f"kinematics with tilt give gravity {g:.3f} m/s² (± {error:.3f}), declared {declared:g}"
        if abs(g) < WITHOUT * declared:
            cause = "ax ay az read acceleration without gravity, not specific force."
            yield finding("error", "ax ay az", f"{sentence}:", cause, "Subtract gravity in body axes.")
        elif abs(g + declared) < OTHER * declared:
            cause = "all channels are in axes forward, left, up; expected forward, right, down."
            advice = "Turn v w q r theta psi ay az, their rates of change, and east."
            yield finding("error", "v w q r theta psi ay az", f"{sentence}:", cause, advice)
        elif abs(g - declared) > max(4.0 * error, GRAVITY_RANGE * declared):
            cause = "a scale or unit error of attitude or accelerometers, or another vehicle.gravity."
            grave: Severity = "warning" if abs(g - declared) > OTHER * declared else "note"
            yield finding(grave, "", f"{sentence}:", cause, "Calibrate before believing forces.")
        else:
            yield finding("good", "", f"{sentence}.")


def air(dataset: Dataset) -> Iterator[Finding]:
    """Wind, and the airspeed's unit, by the velocities."""
    by = wind(dataset)
    if by is not None and (by.errors < 2.0).all():
        (north, east), (north_se, east_se) = by.values[:2], by.errors[:2]
        speed, origin = float(np.hypot(north, east)), float(np.degrees(np.arctan2(-east, -north)) % 360.0)
        sentence = f"airspeed against ground velocity gives wind of {speed:.1f} m/s from {origin:.0f}°"
        more = f"(north {north:+.2f} ± {north_se:.2f}, east {east:+.2f} ± {east_se:.2f} m/s)."
        advice = (
            "Derivatives by u v w are by velocity over ground: let environment.wind be estimated, or fly in calm air."
        )
        windy = speed > max(1.0, 3.0 * float(np.hypot(north_se, east_se)))
        yield finding("warning" if windy else "good", "airspeed", sentence, more, *([advice] if windy else []))
        scale, error = 1.0 + float(by.values[2]), float(by.errors[2])
        if abs(scale - 1.0) > max(AIR_SCALE, 4.0 * error):
            size = f"is {scale:.3g} (± {error:.1g}) times the speed through the air that velocities and this wind give"
            other = not 1.0 / LEAST_SCALE < scale < LEAST_SCALE
            advice = "Correct its unit or calibration."
            yield finding("error" if other else "warning", "airspeed", f"{size}{unit_of('airspeed', scale)}.", advice)


def gravity(dataset: Dataset) -> Measured | None:
    """Gravity in m/s² (1,) from how specific force and velocity change with tilt; None where it cannot be seen.

    A constant on every accelerometer is free in each piece, so that only tilt tells gravity.

    Source: Morelli and Klein, Aircraft System Identification, 2nd ed., eq. 10.11.
    """
    nominal = dataset.vehicle.gravity
    exact = [pair for pair in placed_pairs(dataset) if pair.exact]
    flights = dataset.flights.values()
    sums = np.array([m for f in flights for pair in exact if f.has(*pair.channels) for m in _gravity_moments(f, pair)])
    if len(sums) < 3 or sums[:, 0].sum() <= 0.0:
        return None
    total = sums.sum(axis=0)
    without = [(total[1] - one[1]) / max(total[0] - one[0], np.finfo(float).tiny) for one in sums]
    hidden = nominal * float(_noise_of_tilt(dataset, exact) / total[0])
    off = float(total[1] / total[0])
    left = np.maximum(sums[:, 2] - 2.0 * off * sums[:, 1] + off**2 * sums[:, 0], 0.0)
    spread = max(jackknife_error(without), float(np.sqrt((sums[:, 0] * left / sums[:, 3]).sum())) / float(total[0]))
    spread = max(spread, place_of_imu(dataset).gravity_se)
    error = float(np.hypot(spread, hidden))
    return Measured(np.array([nominal + off]), np.array([error]))


def _noise_of_tilt(dataset: Dataset, pairs: Sequence[Pair]) -> float:
    """Sum over all samples of the squares that noise of the attitude adds to those of tilt: it hides gravity.

    Source: Fuller, Measurement Error Models (1987), sec. 1.1.
    """
    total = 0.0
    for flight in dataset.flights.values():
        bell, _ = kernel(flight.dt)
        read = [angle for angle in ATTITUDES[:2] if any(flight.has(*pair.channels) for pair in pairs)]
        total += flight.samples * float((bell**2).sum()) * sum(dataset.noise(angle) ** 2 for angle in read)
    return total


def _gravity_moments(flight: Flight, pair: Pair) -> Iterator[tuple[float, float, float, float]]:
    """Per piece, sums of squares of tilt, its products with what the equation leaves over, and of that, about means.

    The fourth are the samples that the kernel leaves independent.
    """
    together = correlated(flight.dt)
    bell, slope = kernel(flight.dt)
    if flight.samples < len(bell) + 100:
        return
    falls = gravity_in_body(flight.bridged(ATTITUDES[:2]), 1.0).numpy()
    fall = np.convolve(falls[:, VELOCITIES.index(pair.left_name)], bell, "valid")
    missing = np.isnan(flight.stack(pair.channels).numpy()).any(axis=1).astype(float)
    fall = np.where(np.convolve(missing, np.ones(len(bell)), "valid") > 0.5, np.nan, fall)
    left = np.convolve(pair.left(flight), slope, "valid") - np.convolve(pair.right(flight), bell, "valid")
    for first, last in minutes(len(left), flight.dt, 0):
        x, y = fall[first:last], left[first:last]
        finite = np.isfinite(x) & np.isfinite(y)
        if finite.sum() > 20:
            x, y = x[finite] - x[finite].mean(), y[finite] - y[finite].mean()
            yield float(x @ x), float(x @ y), float(y @ y), len(y) / together


def wind(dataset: Dataset) -> Measured | None:
    """Steady wind over ground (north, east) in m/s, and the airspeed's scale error (3,), from air and ground speed.

    Airspeed (1 + scale) = |velocity over ground - wind| at all samples once a second, by Gauss-Newton; None without
    airspeed, velocity and attitude with heading. Needs headings that differ, else its standard errors are large.

    Source: Morelli and Klein, Aircraft System Identification, 2nd ed., ch. 10 (air data).
    """
    parts = [p for f in dataset.flights.values() if f.has(*AIR) for p in _ground(f)]
    if len(parts) < 3:
        return None
    whole = _solve(parts)
    without = np.array([_solve([*parts[:i], *parts[i + 1 :]]) for i in range(len(parts))])
    return Measured(whole, np.array([jackknife_error(list(column)) for column in without.T]))


def _ground(flight: Flight) -> Iterator[Array]:
    """Per piece, rows of airspeed and velocity north, east, down (n, 4), once a second and where all are there."""
    airspeed, velocity, attitude = flight.stack(AIR)[:: max(1, round(1.0 / flight.dt))].split([1, 3, 3], dim=1)
    rows = np.concatenate([airspeed.numpy(), position_rates(velocity, attitude).numpy() * (1.0, 1.0, -1.0)], axis=1)
    for first, last in minutes(len(rows), 1.0, 0):
        part = rows[first:last]
        part = part[np.isfinite(part).all(axis=1)]
        if len(part) >= 5:
            yield part


def _solve(parts: list[Array]) -> Array:
    airspeed, north, east, down = np.concatenate(parts).T
    guess = np.zeros(3)
    for _ in range(ITERATIONS):
        x, y = north - guess[0], east - guess[1]
        speed = np.maximum(np.sqrt(x**2 + y**2 + down**2), 1e-6)
        scale = 1.0 + guess[2]
        jacobian = np.stack([-scale * x / speed, -scale * y / speed, speed], axis=1)
        step = np.linalg.lstsq(jacobian, airspeed - scale * speed, rcond=1e-6)[0]
        guess = guess + step
        if np.abs(step).max() < 1e-6:
            break
    return guess
