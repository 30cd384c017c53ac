"""From a data set to the scalar problems of `gauss_markov` and back: power, time constant and trim of the forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.core.names import RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.identification.reconstruct import gauss_markov as gm
from rotorid_torch.identification.reconstruct import sensor_biases
from rotorid_torch.identification.reconstruct.motion import ACCELERATIONS

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
SEARCHED = 40
"""Identify flights that powers and time constants are sought in, at most; more make them no more certain."""
ADAPTIONS = 2
ADAPTED = 0.1
"""Least factor by which the power is lowered where a flight is quieter than its controls."""
ADAPT_S = 0.35
"""Width over which it is adapted; in half a second the quiet after a jump takes part in it."""


@dataclass(frozen=True, eq=False)
class ForceNoise:
    """X Y Z L M N per mass and inertia as Gauss-Markov processes.

    tau : [6] s. theta : [6, sources] power by what makes process noise, a constant first, at its rms, unit squared
    per s. active : which of all sources these are; rms : [sources] of them.
    variance : [6] of each about its trim. excited : [6] whether a channel of any flight sees the axis.
    """

    tau: Array
    theta: Array
    active: Array
    rms: Array
    variance: Array
    excited: Array


@dataclass(frozen=True, eq=False)
class LocalNoise:
    """The same in a few flights F with T samples in the longest, adapted to what each of them did.

    power : [T, F, 6] the sum of the sources, locally adapted. trim, spread : [F, 6] mean and standard deviation about
    it. excited : [F, 6] whether a channel sees the axis. variance_scale : [T, F, 6] factor on the variance of the
    smoothed force, from realised over expected process noise.
    """

    power: Array
    trim: Array
    spread: Array
    excited: Array
    variance_scale: Array

    def pick(self, which: Sequence[int]) -> LocalNoise:
        """Some of the flights."""
        i = list(which)
        scale = self.variance_scale[:, i]
        return LocalNoise(self.power[:, i], self.trim[i], self.spread[i], self.excited[i], scale)


@dataclass(frozen=True)
class _Record:
    """One axis of one flight: record (T,), whether it is the force's integral, standard deviation of a sample."""

    value: Array
    integral: bool
    noise: float


Biases = Mapping[str, Mapping[str, float]]
"""Constants to take off, by flight and channel."""


def find_force_noise(dataset: Dataset, biases: Biases, lines: Mapping[str, float]) -> ForceNoise:
    """Maximum likelihood on at most `SEARCHED` identify flights; lines : Hz of lines to take out, by channel."""
    searched = [dataset.flights[name] for name in dataset.some(SEARCHED)]
    dt = _interval(dataset)
    rows = _rows([_axes(dataset, flight, biases[flight.name], lines) for flight in searched], dt)
    longest = max(facts.samples for facts in dataset.facts.values())
    columns = [_columns(dataset, flight) for flight in searched]
    rms = np.sqrt(np.mean([_mean_square(column, longest) for column in columns], axis=0))
    active = rms > 0.0
    activity = _side_by_side(columns, len(rows.value))[..., active] / rms[active]
    variance, observed = _variances(dataset, biases, lines)
    axis, flight_of = np.tile(np.arange(6), len(searched)), np.repeat(np.arange(len(searched)), 6)
    fitted = np.isfinite(rows.value).sum(axis=0) > 0
    theta, tau = _search(rows, activity, axis, flight_of, _spread(rows, variance[axis]), fitted)
    return ForceNoise(tau, theta, active, rms[active], variance, observed)


def adapted(
    dataset: Dataset, names: Sequence[str], noise: ForceNoise, biases: Biases, lines: Mapping[str, float]
) -> LocalNoise:
    """Powers, trims and their errors in a few flights, whose powers follow what the forces did there."""
    flights = [dataset.flights[name] for name in names]
    dt = _interval(dataset)
    rows = _rows([_axes(dataset, flight, biases[flight.name], lines) for flight in flights], dt)
    samples, axis = len(rows.value), np.tile(np.arange(6), len(flights))
    activity = _side_by_side([_columns(dataset, flight) for flight in flights], samples)
    power = np.einsum("tfj,ij->tfi", activity[..., noise.active] / noise.rms, noise.theta).reshape(samples, -1)
    least_power, spread, tau = noise.theta[axis, 0], _spread(rows, noise.variance[axis]), noise.tau[axis]
    block = _block(dataset)
    trim = np.array([_level(rows.value[:, n], bool(rows.integral[n]), block, dt)[0] for n in range(len(axis))])
    for _ in range(ADAPTIONS):
        got = gm.smooth_rows(rows, power, tau, trim, spread)
        power, trim = np.maximum(power * gm.local_scale(got, power, dt, ADAPTED, ADAPT_S), least_power), got.trim
    last = gm.smooth_rows(rows, power, tau, trim, spread)
    least = np.where(rows.integral, QUIET_SHARE[True], QUIET_SHARE[False])
    scale = gm.local_scale(last, power, dt, least)
    shape = (len(flights), 6)
    return LocalNoise(
        power=power.reshape(samples, *shape),
        trim=last.trim.reshape(shape),
        spread=spread.reshape(shape),
        excited=(np.isfinite(rows.value).sum(axis=0) > 0).reshape(shape),
        variance_scale=(least + OWN_SHARE * (scale - least)).reshape(samples, *shape),
    )


def _interval(dataset: Dataset) -> float:
    """Sample interval, s: one for all flights."""
    return float(np.mean([facts.dt for facts in dataset.facts.values()]))


def _rows(flights: Sequence[Sequence[_Record]], dt: float) -> gm.Series:
    """Six records of each flight side by side; shorter ones end in missing samples."""
    flat = [record for flight in flights for record in flight]
    samples = max(len(record.value) for record in flat)
    value = np.stack([np.pad(r.value, (0, samples - len(r.value)), constant_values=np.nan) for r in flat], axis=1)
    return gm.Series(value, np.array([r.integral for r in flat]), np.array([r.noise for r in flat]), dt)


def _search(
    rows: gm.Series, activity: Array, axis: Array, flight_of: Array, spread: Array, fitted: Array
) -> tuple[Array, Array]:
    """Powers [6, J] and time constants [6], from block means of the identify flights; zero power where unseen."""
    theta, tau = np.zeros((6, activity.shape[-1])), np.ones(6)
    if not fitted.any():
        return theta, tau
    block = min(max(1, round(gm.SEARCH_STEP_S / rows.dt)), max(1, len(rows.value) // 50))
    mine = gm.Series(rows.value[:, fitted], rows.integral[fitted], rows.noise[fitted], rows.dt).averaged(block)
    group = (axis[fitted] >= 3).astype(int)
    driven = gm.block_means(activity, block)[:, flight_of[fitted]]
    sources = gm.Sources(driven, axis[fitted], group, spread[fitted])
    power, taus = gm.find_power(mine, sources)
    power = gm.largest_constant(mine, sources, power, taus)
    fitted_axes = np.unique(axis[fitted])
    theta[fitted_axes] = power[fitted_axes]
    tau[:3], tau[3:] = taus[0], taus[-1]
    return theta, tau


def _columns(dataset: Dataset, flight: Flight) -> Array:
    """Sources of process noise in a flight, [T, all sources], not scaled."""
    noise = np.array([dataset.noise(control) for control in dataset.controls])
    return gm.control_activity(flight.bridged(dataset.controls).numpy(), noise, flight.dt)


def _mean_square(columns: Array, samples: int) -> Array:
    """Mean square over so many samples of each column, held at its end."""
    return ((columns**2).sum(axis=0) + (samples - len(columns)) * columns[-1] ** 2) / samples


def _side_by_side(columns: Sequence[Array], samples: int) -> Array:
    """Columns of several flights as one array [T, F, J], held at their ends."""
    return np.stack([np.pad(column, ((0, samples - len(column)), (0, 0)), mode="edge") for column in columns], axis=1)


def _axes(dataset: Dataset, flight: Flight, bias: Mapping[str, float], lines: Mapping[str, float]) -> list[_Record]:
    """Records of X Y Z L M N of a flight, biases and vibration lines taken out; all NaN where nothing sees the axis."""

    def channel(name: str) -> Array:
        value = flight.channels[name].numpy() - bias.get(name, 0.0)
        return sensor_biases.without_line(value, flight.dt, lines[name]) if name in lines else value

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
    accelerations = sensor_biases.kinematic_acceleration(dataset, flight, bias) if kinematic else None
    lever = sensor_biases.lever_arm(dataset, flight)
    pushing = []
    for i, (name, speed) in enumerate(zip(SPECIFIC_FORCES, VELOCITIES, strict=True)):
        if flight.has(name):
            pushing.append(_Record(channel(name) - lever[:, i], False, dataset.noise(name)))
        elif accelerations is not None:
            drift = sensor_biases.integral(accelerations[:, i], flight.dt)
            pushing.append(_Record(flight.channels[speed].numpy() - drift, True, dataset.noise(speed)))
        else:
            pushing.append(_Record(nothing, False, 1.0))
    return pushing + turning


def _variances(dataset: Dataset, biases: Biases, lines: Mapping[str, float]) -> tuple[Array, Array]:
    """Variance [6] of the force of each axis about its mean, pooled over the flights that see it, and whether any does.

    One where none does.
    """
    block, dt = _block(dataset), _interval(dataset)
    total, count = np.zeros(6), np.zeros(6)
    for flight in dataset.flights.values():
        for i, record in enumerate(_axes(dataset, flight, biases[flight.name], lines)):
            if np.isfinite(record.value).any():
                total[i] += _level(record.value, record.integral, block, dt)[1]
                count[i] += 1
    return np.where(count > 0, total / np.maximum(count, 1), 1.0), count > 0


def _block(dataset: Dataset) -> int:
    """Samples of a tenth of a second; a quarter of the longest flight if that is less."""
    longest = max(facts.samples for facts in dataset.facts.values())
    return min(max(1, round(0.1 / _interval(dataset))), max(1, longest // 4))


def _level(value: Array, integral: bool, block: int, dt: float) -> tuple[float, float]:
    """Mean of the force in a record (T,) and its variance about it; zeros where nothing is recorded.

    Where the integral is recorded, the force is its slope over tenths of a second, and its mean is left to the filter.
    """
    coarse = gm.block_means(value, block)
    force = np.diff(coarse) / (block * dt) if integral else coarse
    force = force[~np.isnan(force)]
    if not force.size:
        return 0.0, 0.0
    return (0.0 if integral else float(force.mean())), float(force.var())


def _spread(rows: gm.Series, variance: Array) -> Array:
    """Standard deviation [N] of the force about its trim, given its variance [N]; not below the sensor's noise."""
    floor = (rows.noise * np.where(rows.integral, 1.0, 0.1)) ** 2
    return np.sqrt(np.maximum(variance, floor))
