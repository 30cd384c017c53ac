"""Draws helicopters like the one of a data set: numbers at random, corrected until trim and derivatives resemble it.

Randomised maximum likelihood: the prior's draw and a perturbed copy of the evidence are fitted together, so that the
aircraft kept are spread about the data's trim and derivatives as widely as two helicopters of one kind differ.

Source: Oliver, He, Reynolds, Conditioning permeability fields to pressure data, ECMOR V (1996); Bardsley and others,
SIAM J. Sci. Comput. 36(4) (2014) (randomise, then optimise).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from rotorid_torch.data import Dataset
from rotorid_torch.data.schema import Vehicle
from rotorid_torch.simulation.drawn.resemblance import Evidence, mirrored, rotor_moves
from rotorid_torch.simulation.drawn.resemblance import reference as trim_of
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES
from rotorid_torch.simulation.multiblade.craft import Craft
from rotorid_torch.simulation.multiblade.priors import Kinds, Number, build, numbers, reference
from rotorid_torch.simulation.multiblade.trim import Trims, find_trims, linearise
from rotorid_torch.simulation.rigid import Array

ROUNDS, WORTH = 6, 0.95  # Gauss-Newton steps, while each of them takes the cost below this share
LOST = 1e3  # what every entry is off, in tolerances, where there is no trim
SETTLING = -0.15  # 1/s: the slowest that rotor, inflow and governor may settle; some governors would swing for ever
ROUGH = 1e-5  # m/s^2, rad/s^2: residual of a trim that only a difference is made of
BUMP, LEAP = 0.05, 1.5  # of a number's spread: difference for its derivative; largest step
ALIKE = 1.2  # rms of trim and derivatives over their tolerances, up to which an aircraft is kept
ON_AXIS = {"lon": (4, 6), "lat": (3, 7), "col": (2, 8), "ped": (5, 9)}
ON_AXIS_SIGN = {"lon": 1.0, "lat": -1.0, "col": -1.0, "ped": -1.0}  # of M lon, L lat, Z col, N ped by our blade angles


@dataclass(frozen=True)
class Prior:
    """What to draw from: numbers of the aircraft (gearing of the controls too) and where it is trimmed."""

    vehicle: Vehicle
    numbers: dict[str, Number]
    velocity: Array
    held: bool
    relaxation: float

    def values(self, normal: Array) -> dict[str, Array]:
        """Numbers [aircraft] for standard normal deviates [aircraft, number]."""
        return {name: number.at(normal[:, k]) for k, (name, number) in enumerate(self.numbers.items())}

    def craft(self, normal: Array, kind: Kinds) -> Craft:
        """The batch of aircraft."""
        return build(self.values(normal), kind, self.vehicle, self.held, self.relaxation)

    def gearing(self, normal: Array) -> Array:
        """Blade angle per unit of the recorded controls, [aircraft, 4]."""
        values = self.values(normal)
        return np.stack([values[f"gearing_{name}"] for name in CONTROL_NAMES], axis=1)


def prior(dataset: Dataset, evidence: Evidence) -> Prior:
    """Prior of helicopters that the data set could be about; needs what `data_sets.undrawable` asks for."""
    trim, vehicle = trim_of(dataset), dataset.vehicle
    if mirrored(dataset):
        vehicle = _mirror(vehicle)
    velocity = level_velocity(trim)
    drawn = numbers(vehicle, float(np.hypot(velocity[0], velocity[1])))
    for k, name in enumerate(CONTROL_NAMES):
        drawn[f"gearing_{name}"] = _gearing(dataset, name, k, float(evidence.table[ON_AXIS[name]]))
    first = dataset.flights[dataset.identify[0]]
    return Prior(vehicle, drawn, velocity, not rotor_moves(dataset), first.dt)


def _gearing(dataset: Dataset, name: str, place: int, on_axis: float) -> Number:
    """Blade angle per unit of a control; a stick's travel is taken for the UH-60's range."""
    sign = -1.0 if on_axis * ON_AXIS_SIGN[name] < 0.0 else 1.0
    spec, low_high = dataset.control_specs[name], reference().limits[place]
    if spec.unit == "rad":
        return Number(sign, 0.02)
    low, high = spec.limits or (-1.0, 1.0)
    return Number(sign * (low_high[1] - low_high[0]) / (high - low), 0.5)


def _mirror(vehicle: Vehicle) -> Vehicle:
    """The vehicle seen in the mirror, its rotor turning counter-clockwise."""
    flip = np.array([1.0, -1.0, 1.0])

    def point(place: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        return None if place is None else (place[0], -place[1], place[2])

    if vehicle.inertia is None:
        inertia = None
    else:
        tensor = np.asarray(vehicle.inertia) * np.outer(flip, flip)
        inertia = tuple((float(row[0]), float(row[1]), float(row[2])) for row in tensor)
    return msgspec.structs.replace(vehicle, inertia=inertia, hub=point(vehicle.hub), imu=point(vehicle.imu))


def level_velocity(trim: Mapping[str, float]) -> Array:
    """Body velocity of a trim as level ahead, to the side, down, m/s [3]."""
    u, v, w, phi, theta = (trim.get(name, 0.0) for name in ("u", "v", "w", "phi", "theta"))
    cp, sp, ct, st = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta)
    below = v * sp + w * cp
    return np.array([u * ct + below * st, v * cp - w * sp, -u * st + below * ct])


@dataclass(frozen=True)
class DrawnAircraft:
    """Drawn aircraft: standard normal deviates [aircraft, number], rotors, trims, and how far they are from the data.

    `misfit` [aircraft]: rms of trim and derivatives from the data's over tolerances.
    """

    normal: Array
    kind: Kinds
    craft: Craft
    trims: Trims
    misfit: Array
    gearing: Array


def draw(prior: Prior, evidence: Evidence, kind: Kinds, streams: list[np.random.Generator]) -> DrawnAircraft:
    """One aircraft per rotor and random stream, corrected towards the evidence."""
    size = len(prior.numbers)
    start = np.stack([stream.standard_normal(size) for stream in streams])
    noise = np.stack([stream.standard_normal(evidence.table.size + evidence.trim.size) for stream in streams])
    asked = np.isfinite(_tolerances(evidence))
    normal, closest, trims = start.copy(), start.copy(), None
    best, going = np.full(len(streams), np.inf), np.ones(len(streams), dtype=bool)
    for _ in range(ROUNDS + 1):
        trims = find_trims(prior.craft(normal, kind), prior.velocity, trims)
        deviation = _compare(evidence, prior.craft(normal, kind), trims, prior.gearing(normal))
        left = np.where(trims.converged[:, None], deviation + noise * asked, LOST)
        cost = (left * left).sum(1) + ((normal - start) ** 2).sum(1)
        closest = np.where((cost < best)[:, None], normal, closest)
        going &= cost < WORTH * best
        best = np.minimum(cost, best)
        for k in np.flatnonzero(going):
            one = slice(k, k + 1)
            iterate = Iterate(normal[k], kind[one], trims.pick(one), deviation[k], left[k], start[k])
            step = _step(prior, evidence, iterate)
            normal[k] += step if trims.converged[k] else -0.5 * normal[k]
    return finish(prior, evidence, closest, kind)


def finish(prior: Prior, evidence: Evidence, normal: Array, kind: Kinds) -> DrawnAircraft:
    """Trim and derivatives of given aircraft."""
    craft = prior.craft(normal, kind)
    trims, gearing = find_trims(craft, prior.velocity), prior.gearing(normal)
    left = _compare(evidence, craft, trims, gearing)
    asked = np.isfinite(_tolerances(evidence))
    misfit = np.sqrt((left[:, asked] ** 2).mean(1)) if asked.any() else np.zeros(len(normal))
    steady = np.linalg.eigvals(linearise(craft, trims).inner).real.max(1) < SETTLING
    return DrawnAircraft(normal, kind, craft, trims, np.where(trims.converged & steady, misfit, np.inf), gearing)


def _tolerances(evidence: Evidence) -> Array:
    """Of all that is compared."""
    return np.concatenate([evidence.tolerance.ravel(), evidence.trim_tolerance])


def _compare(evidence: Evidence, craft: Craft, trims: Trims, gearing: Array) -> Array:
    """Differences from the evidence over their tolerances, [aircraft, 76]."""
    units = np.concatenate([np.ones((craft.count, 6)), gearing], axis=1)
    table = evidence.tabulate(linearise(craft, trims).loads(evidence.frequency, evidence.motion * units[:, None]))
    level = np.concatenate([trims.state[6:8, :, 0].T, trims.controls[..., 0].T / gearing], axis=1)
    measured = np.concatenate([(table - evidence.table).reshape(craft.count, -1), level - evidence.trim], axis=1)
    left = measured / _tolerances(evidence)
    return np.where(np.isfinite(left), left, 0.0)


class Iterate(NamedTuple):
    """One aircraft on its way to the evidence: deviates, rotor, trim, deviation, what is left of it, where it began."""

    normal: Array
    kind: Kinds
    trims: Trims
    deviation: Array
    left: Array
    start: Array


def _step(prior: Prior, evidence: Evidence, iterate: Iterate) -> Array:
    """One Gauss-Newton step of one aircraft's deviates, [number]."""
    normal, kind, trims, deviation, left, start = iterate
    size = len(normal)
    bumped = normal + BUMP * np.eye(size)
    craft = prior.craft(bumped, np.repeat(kind, size, axis=0))
    moved = find_trims(craft, prior.velocity, trims.pick(np.zeros(size, dtype=np.intp)), ROUGH)
    bumped_deviation = _compare(evidence, craft, moved, prior.gearing(bumped))
    slope = np.where(moved.converged[:, None], (bumped_deviation - deviation) / BUMP, 0.0)
    step = -np.linalg.solve(np.eye(size) + slope @ slope.T, slope @ left + normal - start)
    length = float(np.abs(step).max())
    return np.asarray(step * (LEAP / max(length, LEAP)), dtype=np.float64)
