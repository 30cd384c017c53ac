"""Where the rotors of a multirotor stand whose places are not declared: sign and share of each motor in p', q' and r'.

Thrust acts along -z wherever a rotor stands. What it does to the angular accelerations says where that is, up to the
arm over the inertia; where little of an axis is explained, its part of the places stays unknown. Where places, mass
and inertia are declared, the same answers say whether these can be.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.names import MOMENTS, RATES
from rotorid_torch.core.statistics import paired
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.signal_operations import averaged, half_of, lagged, shifted
from rotorid_torch.effects.spec import MotorSpec

LOOKED_AT = 12
"""Identify flights, at most."""
SAMPLES = 5000
"""Of each flight, from its middle."""
SMOOTHED_S = 0.03
"""Length of the centred mean that inputs and rates pass."""
LAGS_S, DELAYS_S = (0.0, 0.03, 0.06, 0.1), (0.0, 0.015, 0.03)
"""Lags and delays of the motors that are tried: without them an axis seems unexplained."""
TOLD = 0.3
"""R2 of an angular acceleration from which on the motors' shares in it count."""
SURE = 3.0
"""Standard errors by which a share must differ from none, for half of the motors at least."""
BLOCK_S = 2.0
"""Residuals of one such block may resemble each other."""
MIXED = 4
"""Combinations by which a mixer drives all motors, however many: thrust, roll, pitch and yaw."""
TORQUE_SHARE = 0.1
"""Torque over thrust as a share of the arm: usual for small propellers."""
FRAMES: Mapping[str, tuple[float, ...]] = {
    "quad-x": (45.0, 135.0, 225.0, 315.0),
    "quad-+": (0.0, 90.0, 180.0, 270.0),
    "hexa-x": (30.0, 90.0, 150.0, 210.0, 270.0, 330.0),
    "hexa-+": (0.0, 60.0, 120.0, 180.0, 240.0, 300.0),
    "octa-x": (22.5, 67.5, 112.5, 157.5, 202.5, 247.5, 292.5, 337.5),
    "octa-+": (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0),
    "coaxial-x": (45.0, 45.0, 135.0, 135.0, 225.0, 225.0, 315.0, 315.0),
}
"""Places of frames of a name, degrees from ahead towards the right; logs number the motors in many orders."""


EXPONENTS = (1.0, 2.0)
"""Of a motor command in thrust: commands are thrusts in some controllers, speeds in others."""
LEAST = 1e-3
"""Of a command, below which no rotor has a share of thrust."""


@dataclass(frozen=True)
class Mixer:
    """What motors do to the axes.

    shares : [motors, 3] of roll, pitch and yaw acceleration by a motor, of rms 1 on each axis; zero where it is not
    told. explained : R2 of the rows L M N that are told.
    """

    shares: Tensor
    explained: Mapping[str, float]

    def motors(self, arm: float, frame: str | None) -> tuple[MotorSpec, ...]:
        """The rotors with arms of this length: at the places of a frame that are nearest, or where the shares say."""
        x, y = self.shares[:, 1], -self.shares[:, 0]
        at = torch.stack([x, y], dim=1) * arm / math.sqrt(2.0)
        corners = FRAMES.get(frame or "", ())
        if {"L", "M"} <= set(self.explained) and len(corners) == len(at):
            angles = torch.tensor(corners, dtype=torch.float64).deg2rad()
            nominal = arm * torch.stack([angles.cos(), angles.sin()], dim=1)
            at = nominal[paired(-torch.cdist(at, nominal).numpy())]
        motors = []
        for (x, y), turn in zip(at.tolist(), self.shares[:, 2].tolist(), strict=True):
            ratio, spin = TORQUE_SHARE * arm * abs(turn), 1.0 if turn >= 0.0 else -1.0
            motors.append(MotorSpec(position=(x, y, 0.0), spin=spin, torque_ratio=ratio))
        return tuple(motors)


class Power(NamedTuple):
    """Least and most that a control power can be, over the declared one."""

    low: float
    high: float


def find_mixer(dataset: Dataset, inputs: Sequence[str]) -> Mixer:
    """From the identify flights; inputs : motor commands, or the rotors' speeds where they are measured."""
    speeds = inputs[0].startswith("omega")
    shares, explained = torch.zeros(len(inputs), len(MOMENTS), dtype=torch.float64), {}

    def thrusts(flight: Flight) -> Tensor:
        record = flight.bridged(inputs)
        return record.square() if speeds else record

    for k, (r2, share, error) in enumerate(answers_to(dataset, (*RATES, *inputs), thrusts, late=not speeds)):
        if r2 >= TOLD and int((share.abs() > SURE * error).sum()) >= len(inputs) / 2:
            shares[:, k], explained[MOMENTS[k]] = share / share.square().mean().sqrt(), r2
    return Mixer(shares, explained)


def answers_to(
    dataset: Dataset, channels: Sequence[str], columns: Callable[[Flight], Tensor], late: bool
) -> list[tuple[float, Tensor, Tensor]]:
    """R2 of p', q', r' by columns [T, n] of identify flights that have the channels; their factors and errors [n].

    late : whether the columns act with the lag and delay that explain most of each axis. Without flights empty.
    """
    flights = [f for f in (dataset.flights[n] for n in dataset.identify[:LOOKED_AT]) if f.has(*channels)]
    best: list[tuple[float, Tensor, Tensor]] = []
    for lag in () if not flights else LAGS_S if late else (0.0,):
        for delay in DELAYS_S if late else DELAYS_S[:1]:
            records = list(_records(flights, columns, lag, delay))
            fits = [_regressed(records, k, records[0][0].shape[1] // 2) for k in range(len(MOMENTS))]
            best = [max(pair, key=lambda one: one[0]) for pair in zip(best or fits, fits, strict=True)]
    return best


def _records(
    flights: Sequence[Flight], columns: Callable[[Flight], Tensor], lag: float, delay: float
) -> Iterator[tuple[Tensor, Tensor, int]]:
    """Thrust-like columns and their rates [T, 2 n], angular accelerations [T, 3] of each flight, about their means.

    And the samples of a block.
    """
    for flight in flights:
        dt, half = flight.dt, half_of(SMOOTHED_S, flight.dt)
        first = max(0, (flight.samples - SAMPLES) // 2)
        part = slice(first, first + SAMPLES)
        record = columns(flight)[part]
        every = record.new_ones(record.shape[1])
        late = lagged(shifted(record, delay * every, dt), lag * every, dt)
        s = averaged(late.mT, half)
        rates = averaged(flight.bridged(RATES)[part].mT, half)
        inside = slice(half + 1, -half - 1, max(1, half))
        z = torch.cat([s, torch.gradient(s, spacing=dt, dim=-1)[0]])[:, inside]
        turning = torch.gradient(rates, spacing=dt, dim=-1)[0][:, inside]
        block = max(1, round(BLOCK_S / (dt * max(1, half))))
        yield (z - z.mean(-1, keepdim=True)).mT, (turning - turning.mean(-1, keepdim=True)).mT, block


def _regressed(records: Sequence[tuple[Tensor, Tensor, int]], axis: int, motors: int) -> tuple[float, Tensor, Tensor]:
    """R2 of an axis, the motors' shares in it and their errors; yaw also answers how fast the rotors turn up.

    What a motor does beside the mixer's combinations is not known: there its share is nothing.

    Source of the errors: Liang and Zeger (1986), Biometrika 73 (robust covariance by clusters).
    """
    columns = slice(0, motors if MOMENTS[axis] != "N" else 2 * motors)
    z, y = torch.cat([one[0][:, columns] for one in records]), torch.cat([one[1][:, axis] for one in records])
    size = z.square().mean(0).sqrt()
    size = torch.where(size > 0.0, size, 1.0)
    _, _, ways = torch.linalg.svd(z[:, :motors] / size[:motors], full_matrices=False)
    mixed = torch.block_diag(*[ways[:MIXED].mT] * (z.shape[1] // motors)) / size[:, None]
    scaled = z @ mixed
    b = least_squares(scaled, y[:, None])[:, 0]
    left = y - scaled @ b
    inverse = torch.linalg.pinv(scaled.mT @ scaled, hermitian=True)
    blocks, at = [], 0
    for part, _, block in records:
        here = slice(at, at + len(part))
        blocks += [one.sum(0) for one in (scaled[here] * left[here, None]).split(block)]
        at += len(part)
    score = mixed @ inverse @ torch.stack(blocks).mT
    errors = score.square().sum(1).sqrt()
    shares, r2 = mixed @ b, 1.0 - float(left.square().sum() / y.square().sum().clamp(min=1e-300))
    by_thrust, by_speeding_up = (slice(k * motors, (k + 1) * motors) for k in (0, 1))
    if MOMENTS[axis] != "N":
        return r2, shares, errors
    if float(shares[by_thrust] @ shares[by_speeding_up]) <= 0.0:
        return 0.0, shares[by_thrust], errors[by_thrust]  # a controller that answers the rate, and no rotors
    parts = (by_thrust, by_speeding_up)
    surest = max(parts, key=lambda part: float((shares[part] / errors[part].clamp(min=1e-300)).abs().sum()))
    return r2, shares[surest], errors[surest]


def declared_powers(dataset: Dataset, inputs: Sequence[str]) -> dict[str, Power]:
    """Of roll and pitch by their rates (p, q), where mass, inertia and motors are declared and the motors explain them.

    inputs : as of `find_mixer`. A rotor has its share of the thrust -m az; by arms and inertia that makes angular
    accelerations a, and p' = b a. Where both sides have independent errors b lies between the regression of p' on a
    and, over R2, that of a on p'; three standard errors are added, and both exponents of the commands are allowed.
    Commands that answer the rates have errors that are not independent: b can then lie outside by a few tenths.

    Source: Klepper and Leamer (1984), Econometrica 52 (bounds of a regression with errors in all variables).
    """
    vehicle = dataset.vehicle
    if not inputs or vehicle.mass is None or vehicle.inertia is None or len(vehicle.motors) != len(inputs):
        return {}
    place = torch.tensor([m.position for m in vehicle.motors], dtype=torch.float64)
    turning = vehicle.mass * torch.linalg.inv(torch.tensor(vehicle.inertia, dtype=torch.float64))[:2, :2]
    arms = torch.stack([-place[:, 1], place[:, 0]], dim=1) @ turning.mT  # of p' and q' by a rotor's share of -az
    speeds, answers = inputs[0].startswith("omega"), []
    for exponent in EXPONENTS[1:] if speeds else EXPONENTS:

        def declared(flight: Flight, exponent: float = exponent) -> Tensor:
            lift = flight.bridged(inputs).clamp(min=LEAST) ** exponent
            return -flight.bridged(("az",)) * (lift / lift.sum(-1, keepdim=True)) @ arms

        answers.append(answers_to(dataset, (*RATES, "az", *inputs), declared, late=not speeds))
    powers = dict[str, Power]()
    for k, rate in enumerate(RATES[:2]):
        answered = [(r2, float(b[k]), SURE * float(se[k])) for r2, b, se in (one[k] for one in answers if one)]
        if answered and min(r2 for r2, _, _ in answered) >= TOLD:
            powers[rate] = Power(min(b - e for _, b, e in answered), max((b + e) / r2 for r2, b, e in answered))
    return powers
