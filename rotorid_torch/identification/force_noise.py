"""From a data set to the scalar problems of `gauss_markov` and back: power, time constant and trim of the forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.core.names import RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.identification import gauss_markov as gm
from rotorid_torch.identification.motion import ACCELERATIONS
from rotorid_torch.identification.sensor_errors import integral, kinematic_acceleration, lever_arm, without_line

Array = np.ndarray

QUIET_SHARE = {False: 0.5, True: 0.25}
"""Variance of a smoothed force that measurement noise alone makes, of what a steady Gauss-Markov model expects.

Half where the force is measured, a quarter where its integral is (Wiener smoother of noise with spectrum 1/w^2, 1/w^4).
"""
OWN_SHARE = 0.7
"""Share of the Gauss-Markov model's own error that real forces cause.

At times shorter than the smoother sees, they are smoother than a first-order process. Measured where the forces are
known (flight-test aircraft in hover): with 1 the truth lies within one standard deviation in 76 to 84 % of samples.
Derived from the frequency at which the records' spectra sink into the noise, the share is too small where forces jump:
the truth then leaves three standard deviations more often.
"""
ADAPTIONS = 2
ADAPTED = 0.1
"""Least factor by which the power is lowered where a flight is quieter than its controls."""
ADAPT_S = 0.35
"""Width over which it is adapted; in half a second the quiet after a jump takes part in it."""


@dataclass(frozen=True, eq=False)
class ForceNoise:
    """X Y Z L M N per mass and inertia as Gauss-Markov processes, for all flights F and samples T of the longest.

    tau : [6] s. sources : names of what makes process noise, "constant" first; theta : [6, sources] power by source
    at its rms over the identify flights, unit squared per s. power : [T, F, 6] the sum, locally adapted.
    trim, spread : [F, 6] mean and standard deviation about it. seen : [F, 6] whether a channel sees the axis.
    variance_scale : [T, F, 6] factor on the variance of the smoothed force, from realised over expected process noise.
    """

    tau: Array
    sources: tuple[str, ...]
    theta: Array
    power: Array
    trim: Array
    spread: Array
    seen: Array
    variance_scale: Array


@dataclass(frozen=True)
class _Record:
    """One axis of one flight: record (T,), whether it is the force's integral, standard deviation of a sample."""

    value: Array
    integral: bool
    noise: float


def find_force_noise(dataset: Dataset, biases: Sequence[Mapping[str, float]], lines: Mapping[str, float]) -> ForceNoise:
    """Maximum likelihood on the identify flights, then held; adapted once, locally, in every flight.

    biases : constants to take off, per flight; lines : Hz of vibration lines to take out, by channel.
    """
    flights = list(dataset.flights.values())
    records = [_axes(dataset, flight, bias, lines) for flight, bias in zip(flights, biases, strict=True)]
    samples, dt = max(flight.samples for flight in flights), float(np.mean([flight.dt for flight in flights]))
    flat = [record for flight in records for record in flight]
    value = np.stack([np.pad(r.value, (0, samples - len(r.value)), constant_values=np.nan) for r in flat], axis=1)
    rows = gm.Rows(value, np.array([r.integral for r in flat]), np.array([r.noise for r in flat]), dt)
    activity, sources = _activity(dataset, flights, samples)
    axis, flight_of = np.tile(np.arange(6), len(flights)), np.repeat(np.arange(len(flights)), 6)
    seen = np.isfinite(value).sum(axis=0) > 0
    mean, spread = _spread(rows, axis, seen)
    fitted = np.isin(flight_of, [i for i, f in enumerate(flights) if f.name in dataset.identify]) & seen
    theta, tau = _search(rows, activity, axis, flight_of, spread, fitted)
    power = np.einsum("tfj,ij->tfi", activity, theta).reshape(samples, -1)
    least_power, trim = theta[axis, 0], mean
    for _ in range(ADAPTIONS):
        got = gm.smooth_rows(rows, power, tau[axis], trim, spread)
        power, trim = np.maximum(power * gm.local_scale(got, power, dt, ADAPTED, ADAPT_S), least_power), got.trim
    last = gm.smooth_rows(rows, power, tau[axis], trim, spread)
    least = np.where(rows.integral, QUIET_SHARE[True], QUIET_SHARE[False])
    scale = gm.local_scale(last, power, dt, least)
    shape = (len(flights), 6)
    return ForceNoise(
        tau=tau,
        sources=sources,
        theta=theta,
        power=power.reshape(samples, *shape),
        trim=last.trim.reshape(shape),
        spread=spread.reshape(shape),
        seen=seen.reshape(shape),
        variance_scale=(least + OWN_SHARE * (scale - least)).reshape(samples, *shape),
    )


def _search(
    rows: gm.Rows, activity: Array, axis: Array, flight_of: Array, spread: Array, fitted: Array
) -> tuple[Array, Array]:
    """Powers [6, J] and time constants [6], from block means of the identify flights; zero power where unseen."""
    theta, tau = np.zeros((6, activity.shape[-1])), np.ones(6)
    if not fitted.any():
        return theta, tau
    block = min(max(1, round(gm.SEARCH_STEP_S / rows.dt)), max(1, len(rows.value) // 50))
    mine = gm.Rows(rows.value[:, fitted], rows.integral[fitted], rows.noise[fitted], rows.dt).averaged(block)
    group = (axis[fitted] >= 3).astype(int)
    found, taus = gm.find_power(
        mine, gm.block_means(activity, block)[:, flight_of[fitted]], axis[fitted], group, spread[fitted]
    )
    found = gm.largest_constant(
        mine, gm.block_means(activity, block)[:, flight_of[fitted]], found, taus, axis[fitted], group, spread[fitted]
    )
    known = np.unique(axis[fitted])
    theta[known] = found[known]
    tau[:3], tau[3:] = taus[0], taus[-1]
    return theta, tau


def _activity(dataset: Dataset, flights: list[Flight], samples: int) -> tuple[Array, tuple[str, ...]]:
    """Sources of process noise [T, F, J], each of rms 1 over the identify flights; silent ones left out."""
    noise = np.array([dataset.noise(control) for control in dataset.controls])
    columns = []
    for flight in flights:
        made = gm.control_activity(flight.bridged(dataset.controls).numpy(), noise, flight.dt)
        columns.append(np.pad(made, ((0, samples - len(made)), (0, 0)), mode="edge"))
    activity = np.stack(columns, axis=1)
    chosen = [i for i, flight in enumerate(flights) if flight.name in dataset.identify]
    rms = np.sqrt((activity[:, chosen] ** 2).mean(axis=(0, 1)))
    names = ["constant", *(f"{c} {memory:g} s" for memory in gm.MEMORIES_S for c in dataset.controls)]
    active = rms > 0.0
    return activity[..., active] / rms[active], tuple(n for n, on in zip(names, active, strict=True) if on)


def _axes(dataset: Dataset, flight: Flight, bias: Mapping[str, float], lines: Mapping[str, float]) -> list[_Record]:
    """Records of X Y Z L M N of a flight, biases and vibration lines taken out; all NaN where nothing sees the axis."""

    def channel(name: str) -> Array:
        value = flight.channels[name].numpy() - bias.get(name, 0.0)
        return without_line(value, flight.dt, lines[name]) if name in lines else value

    nothing = np.full(flight.samples, np.nan)
    turning = [
        _Record(channel(rate), True, dataset.noise(rate))
        if flight.has(rate)
        else _Record(channel(dot), False, dataset.noise(dot))
        if flight.has(dot)
        else _Record(nothing, True, 1.0)
        for rate, dot in zip(RATES, ACCELERATIONS, strict=True)
    ]
    kinematic = flight.has(*VELOCITIES, *RATES, "phi", "theta")
    known = kinematic_acceleration(dataset, flight, bias) if kinematic else None
    lever = lever_arm(dataset, flight)
    pushing = []
    for i, (name, speed) in enumerate(zip(SPECIFIC_FORCES, VELOCITIES, strict=True)):
        if flight.has(name):
            pushing.append(_Record(channel(name) - lever[:, i], False, dataset.noise(name)))
        elif known is not None:
            drift = integral(known[:, i], flight.dt)
            pushing.append(_Record(flight.channels[speed].numpy() - drift, True, dataset.noise(speed)))
        else:
            pushing.append(_Record(nothing, False, 1.0))
    return pushing + turning


def _spread(rows: gm.Rows, axis: Array, seen: Array) -> tuple[Array, Array]:
    """Mean of the force in each row and its standard deviation about it, the latter pooled over the flights of an axis.

    Where the integral is recorded, the force is its slope over tenths of a second.
    """
    block = min(max(1, round(0.1 / rows.dt)), max(1, len(rows.value) // 4))
    coarse = gm.block_means(rows.value, block)
    slope = np.diff(coarse, axis=0) / (block * rows.dt)
    mean, variance = np.zeros(len(axis)), np.zeros(len(axis))
    for n in np.flatnonzero(seen):
        force = slope[:, n] if rows.integral[n] else coarse[:, n]
        force = force[~np.isnan(force)]
        if force.size:
            mean[n], variance[n] = (0.0 if rows.integral[n] else force.mean()), force.var()
    floor = (rows.noise * np.where(rows.integral, 1.0, 0.1)) ** 2
    pooled = np.array([variance[(axis == i) & seen].mean() if ((axis == i) & seen).any() else 1.0 for i in range(6)])
    return mean, np.sqrt(np.maximum(pooled[axis], floor))
