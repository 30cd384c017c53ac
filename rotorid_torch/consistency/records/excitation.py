"""What the controls did: which moved, how far, and how much of it was not the answer to the aircraft's own motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.records.answers import answers
from rotorid_torch.consistency.records.vibration import spectrum
from rotorid_torch.core import names
from rotorid_torch.core.statistics import without_line
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.reading.noise import running_mean, white_noise
from rotorid_torch.data.schema import Motor

BAND_HZ = (0.2, 4.0)
"""Band in which a rotorcraft answers its controls; from 2/T where the flights are short."""


STILL = {"p": 0.008, "q": 0.008, "r": 0.004, "az": 0.04, "w": 0.02}
"""Rms in the band of the controls, in rad/s, m/s² and m/s, below which nothing was flown.

They are the errors of small inertial units, so that a model of less motion would be one of the unit: 0.008 rad/s about
1 Hz, and 0.004 rad/s of the slower yaw about 0.5 Hz, are 0.07° of attitude; 0.04 m/s² are 4 mg of bias; 0.02 m/s is the
noise of a receiver's velocity. What stands on a bench has 0.001 to 0.0035 rad/s, a test flight 0.02.
"""

TURNS = {"roll": "p", "pitch": "q", "yaw": "r"}
"""What the axes of the motors turn."""
NEAR = 0.002
"""Share of a control's range within which it is on a limit."""
ANSWER_S = 0.1
"""Shift of the motion by which an answer of the aircraft and one of a controller are told apart."""

CLEARLY = 0.7
"""Ratio of what is left then and before, below which it is the aircraft's."""
END, TO_END = (0.9, 1.0), 0.5
"""Last part of the spectrum, as shares of the Nyquist frequency, and how much of the white part's amplitude it has in
a record that no filter passed: a low-pass before sampling leaves less than half there."""


@dataclass(frozen=True)
class Axis:
    """One thing that controls do: a control itself, or what motors do together; `weights` (n,) of the `controls`."""

    name: str
    weights: np.ndarray
    controls: tuple[str, ...]


def turned_by_places(motors: Sequence[Motor]) -> dict[str, np.ndarray]:
    """Weights (motors,) of what motors at their declared places and spins do about each axis, in any scale."""
    x, y, _ = np.array([motor.position for motor in motors]).T
    return {"roll": -y, "pitch": x, "yaw": np.array([1.0 if motor.spin == "ccw" else -1.0 for motor in motors])}


def control_axes(dataset: Dataset) -> tuple[Axis, ...]:
    """The controls, or for motors their sums about the axes: thrust, roll, pitch and yaw.

    The sums are by declared places, else by what the motors do to the body.
    """
    controls, motors = dataset.controls, dataset.vehicle.motors or ()
    weights = dict[str, np.ndarray]()
    if all(map(names.is_motor, controls)):
        if len(motors) == len(controls):
            weights = turned_by_places(motors)
        elif not motors and (effects := answers(dataset, controls)) and {*effects.shown(("p", "q"))} == {"p", "q"}:
            weights = {axis: effects.weights(rate) for axis, rate in TURNS.items() if effects.shown((rate,))}
    if not weights:
        return tuple(Axis(c, np.eye(len(controls))[i], (c,)) for i, c in enumerate(controls))
    weights = {"thrust": np.ones(len(controls)), **weights}
    scaled = {name: w / np.abs(w).sum() for name, w in weights.items() if np.abs(w).sum() > 0.0}
    return tuple(Axis(name, w, controls) for name, w in scaled.items())


@dataclass(frozen=True)
class Excitation:
    """One axis of the controls over the identify flights.

    `independent` is the share of its variance in the band that neither the aircraft's motion nor the other axes
    explain; `leads`: the motion explains it better 0.1 s later than 0.1 s earlier, as an answer of the aircraft does
    and a controller's does not; `moved` the flights in which it moved beyond its noise; `travel` its largest excursion
    from trim; `above_white` its power in the band over that of its white part there; `white` the standard deviation of
    that white part, `in_band` its rms in the band; `to_end`: it is white to the end of the spectrum.
    """

    axis: Axis
    independent: float
    leads: bool
    moved: tuple[str, ...]
    travel: float
    above_white: float
    white: float
    in_band: float
    to_end: bool


def excitations(dataset: Dataset) -> tuple[Excitation, ...]:
    """Figures of every axis, see `Excitation`."""
    flights, axes = [dataset.flights[name] for name in dataset.identify], control_axes(dataset)
    motion = [c for c in (*names.RATES, "phi", "theta") if all(dataset.facts[f.name].has(c) for f in flights)]
    mixed = np.stack([axis.weights for axis in axes], axis=1)
    count = len(dataset.controls)
    lines = [_in_band(f, [*dataset.controls, *motion]) for f in flights]

    def at(shift_s: float) -> np.ndarray:
        """Rows of all lines, the axes first, then the motion so much later."""
        later = [np.exp(2j * np.pi * hertz * shift_s)[:, None] * values[:, count:] for hertz, values in lines]
        both = [np.concatenate([v[:, :count] @ mixed, m], axis=1) for (_, v), m in zip(lines, later, strict=True)]
        return np.concatenate([part for values in both for part in (np.real(values), np.imag(values))])

    now, later, earlier = at(0.0), at(ANSWER_S), at(-ANSWER_S)
    return tuple(
        _excitation(dataset, axis, _share_left(now, i), _share_left(later, i) < CLEARLY * _share_left(earlier, i))
        for i, axis in enumerate(axes)
    )


def correlations(dataset: Dataset) -> tuple[list[str], np.ndarray]:
    """Names of the axes and of the motion, and their correlation (n, n) in the band over the identify flights."""
    flights, axes = [dataset.flights[name] for name in dataset.identify], control_axes(dataset)
    motion = [c for c in names.BODY if all(dataset.facts[f.name].has(c) for f in flights)]
    mixed, count = np.stack([axis.weights for axis in axes], axis=1), len(dataset.controls)
    lines = np.concatenate([_in_band(f, [*dataset.controls, *motion])[1] for f in flights])
    both = np.concatenate([lines[:, :count] @ mixed, lines[:, count:]], axis=1)
    product = np.real(both.conj().T @ both)
    size = np.sqrt(np.maximum(np.diag(product), np.finfo(float).tiny))
    return [*(axis.name for axis in axes), *motion], product / np.outer(size, size)


def _excitation(dataset: Dataset, axis: Axis, independent: float, leads: bool) -> Excitation:
    moved, travel, records = [], 0.0, []
    noise = float(np.sqrt((axis.weights**2) @ [dataset.noise(c) ** 2 for c in dataset.controls]))
    squares = samples = 0.0
    for flight in (dataset.flights[name] for name in dataset.identify):
        values = flight.bridged(dataset.controls).numpy() @ axis.weights
        width = max(1, round(0.1 / flight.dt))
        smooth = running_mean(values, width)
        away = smooth - smooth[flight.lead()].mean()
        records.append(values)
        travel = max(travel, float(np.abs(away).max()))
        squares, samples = squares + float(away @ away), samples + len(away)
        moved.append((flight.name, float(np.sqrt(np.mean(away**2))), 4.0 * noise / np.sqrt(width)))
    usual = 0.25 * np.sqrt(squares / samples)
    white = white_noise(records)
    dt = dataset.facts[dataset.identify[0]].dt
    density, in_band = power_in_band(records, dt)
    return Excitation(
        axis=axis,
        independent=independent,
        leads=leads,
        moved=tuple(name for name, rms, least in moved if rms > max(least, usual)),
        travel=travel,
        above_white=density / white**2 if white > 0.0 else np.inf,
        white=white if np.isfinite(white) else 0.0,
        in_band=in_band,
        to_end=white_noise(records, END) > TO_END * white,
    )


def power_in_band(records: Sequence[np.ndarray], dt: float) -> tuple[float, float]:
    """Mean power of a line in the band, as a white record of that variance had it everywhere, and the rms there."""
    hertz, power = spectrum([_bridged(record) for record in records], dt)
    chosen = power[(hertz >= BAND_HZ[0]) & (hertz <= BAND_HZ[1])]
    return float(chosen.mean() * (len(hertz) - 1)), float(np.sqrt(chosen.sum()))


def _bridged(record: np.ndarray) -> np.ndarray:
    """A record (T,) with missing samples on a line between those beside them; as it is without any sample."""
    at = np.flatnonzero(np.isfinite(record))
    return np.interp(np.arange(len(record)), at, record[at]) if len(at) else record


def share_at(dataset: Dataset, control: str) -> tuple[float, float]:
    """Largest share of a flight that a control is on a declared limit, and largest distance beyond one.

    Motors that are all at their least stand on the ground, and on no limit.
    """
    limits = dataset.control_specs[control].limits
    if limits is None:
        return 0.0, 0.0
    spreads = [facts.spreads[control] for facts in dataset.facts.values()]
    on = max(
        _share_at(f.bridged([control])[:, 0].numpy(), limits, motors_off(dataset, f)) for f in dataset.flights.values()
    )
    return on, max(max(limits[0] - s.low, s.high - limits[1], 0.0) for s in spreads)


@dataclass(frozen=True)
class Moves:
    """Identify flights in which a control moved beyond its noise, and its largest excursion from trim in any."""

    flights: tuple[str, ...]
    travel: float


def moves(dataset: Dataset, controls: Sequence[str]) -> dict[str, Moves]:
    """What these controls did in the identify flights."""
    width = max(1, round(0.1 / dataset.facts[dataset.identify[0]].dt))
    moved: dict[str, list[str]] = {control: [] for control in controls}
    travel = dict.fromkeys(controls, 0.0)
    for flight in (dataset.flights[name] for name in dataset.identify):
        for control, values in zip(controls, flight.bridged(controls).numpy().T, strict=True):
            smooth = running_mean(values, width)
            away = smooth - smooth[flight.lead()].mean()
            least = max(4.0 * dataset.noise(control) / np.sqrt(width), 0.25 * dataset.scales()[control])
            moved[control] += [flight.name] if np.sqrt(np.mean(away**2)) > least else []
            travel[control] = max(travel[control], float(np.abs(away).max()))
    return {control: Moves(tuple(moved[control]), travel[control]) for control in controls}


def _share_at(values: np.ndarray, limits: tuple[float, float], off: np.ndarray) -> float:
    margin = NEAR * (limits[1] - limits[0])
    return float(np.mean(((values <= limits[0] + margin) & ~off) | (values >= limits[1] - margin)))


def motors_off(dataset: Dataset, flight: Flight) -> np.ndarray:
    """Where all motors are at their least (T,)."""
    motors = [c for c in dataset.controls if names.is_motor(c)]
    least = [limits[0] + NEAR * (limits[1] - limits[0]) for c in motors if (limits := dataset.control_specs[c].limits)]
    if not motors or len(least) < len(motors):
        return np.zeros(flight.samples, bool)
    return np.all(flight.bridged(motors).numpy() <= least, axis=1)


def _share_left(lines: np.ndarray, column: int) -> float:
    y, x = lines[:, column], np.delete(lines, column, axis=1)
    x = x / np.maximum(np.linalg.norm(x, axis=0), np.finfo(float).tiny)
    left = y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0] if x.shape[1] else y
    return float((left @ left) / max(y @ y, np.finfo(float).tiny))


def _in_band(flight: Flight, channels: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (lines,) in Hz and Fourier lines (lines, n) in the band of Hann-windowed channels without trend."""
    values = without_line(flight.bridged(channels).nan_to_num(0.0).numpy())
    hertz = np.fft.rfftfreq(flight.samples, flight.dt)
    chosen = (hertz >= max(BAND_HZ[0], 2.0 / (flight.samples * flight.dt))) & (hertz <= BAND_HZ[1])
    return hertz[chosen], np.fft.rfft(values * np.hanning(flight.samples)[:, None], axis=0)[chosen]
