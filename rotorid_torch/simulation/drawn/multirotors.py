"""Data sets of drawn multirotors: manoeuvres, channels, rates and noise as in a data set, nothing undeclared.

Every drawn vehicle (see `multirotor_draws`) has a controller of its own that lets it follow the measured motion: body
rates and their changes at once, velocity and height by and by. Its commands are therefore its own. It feels no air,
unless it is asked to.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import msgspec
import numpy as np

from rotorid_torch.core.names import POSITIONS, RATES, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.schema import Motor, Vehicle
from rotorid_torch.simulation.drawn.data_sets import Drawn, in_memory
from rotorid_torch.simulation.drawn.multirotor_draws import draw, hover_balance, hovering, noise_of
from rotorid_torch.simulation.multirotor.channels import Channels, declared_motors, true_channels
from rotorid_torch.simulation.multirotor.control import ROWS, Targets
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.multirotor.flight import Fleet, FleetHistory, Task, fly_fleet
from rotorid_torch.simulation.rigid import Array, to_earth

QUICK, SLOW, SLOWER = 10.0, 2.5, 1.0
"""Hz: up to which body rates are followed, measured velocities, and velocities by measured places."""
AHEAD = np.isin(np.arange(ROWS), (*range(6, 9), *range(12, ROWS)))
"""Rows of the packed targets that are asked for early: accelerations, rates and their changes, lift."""
DRIFT = 0.15
"""Hz: what an accelerometer integrates to below this is no motion."""
TOGETHER = 160
"""Flights that fly side by side."""
AWAY, ALIKE = 1.5, 0.5
"""Rms of the difference of the rates from those followed, over the latter's: flown away from, and alike up to."""


def undrawable_multirotor(dataset: Dataset) -> str | None:
    """Why no clean multirotor can be drawn for a data set, in words; None where they can."""
    if len(dataset.vehicle.motors) != len(dataset.controls) or not dataset.vehicle.motors:
        return "the places of the motors are not declared"
    missing = [name for name in RATES if any(not facts.has(name) for facts in dataset.facts.values())]
    return f"flights lack {', '.join(missing)}" if missing else None


def _refuse_undrawable(dataset: Dataset) -> None:
    why = undrawable_multirotor(dataset)
    if why is not None:
        raise ValueError(why)


Effects = Mapping[str, Mapping[str, float]]
"""Values of parameters by name, of each effect."""


def clean_multirotors(
    dataset: Dataset, seed: int, draws: Sequence[int], effects: Effects = MappingProxyType({})
) -> Iterator[Drawn]:
    """Vehicles of the data set's frame, flown along its flights, one data set in memory per draw number.

    Every number has random streams of its own. A vehicle that does not stay near the measured motion is left out.

    effects : what a model of the data has, and these vehicles too, see `of_size`.

    Raises ValueError: `undrawable_multirotor`.
    """
    _refuse_undrawable(dataset)
    dt = min(facts.dt for facts in dataset.facts.values())
    courses = [_Course.of(flight, name, dt) for name, flight in dataset.flights.items()]
    hover = hovering(dataset)
    size = max(1, TOGETHER // len(courses))
    for first in range(0, len(draws), size):
        some = draws[first : first + size]
        craft = [draw(dataset, hover, np.random.default_rng([seed, number]), effects) for number in some]
        yield from _flown(dataset, courses, craft, seed, some)


def clean_balances(dataset: Dataset, seed: int, draws: Sequence[int]) -> Array:
    """How clean vehicles of the data set's frame balance in hover (`hover_balance`), [draws, 3].

    Raises ValueError: `undrawable_multirotor`.
    """
    _refuse_undrawable(dataset)
    hover = hovering(dataset)
    craft = (draw(dataset, hover, np.random.default_rng([seed, number]), {}) for number in draws)
    return np.stack([hover_balance(one) for one in craft])


def _flown(
    dataset: Dataset, courses: Sequence[_Course], craft: Sequence[Multirotor], seed: int, draws: Sequence[int]
) -> Iterator[Drawn]:
    """Some draws side by side."""
    columns = [one for one in craft for _ in courses]
    names = [f"{course.name}/{number}" for number in draws for course in courses]
    fleet = Fleet.of(columns, columns, courses[0].dt)
    tapes = [course.targets(one, fleet.step, fleet.every) for course in courses for one in craft[:1]]
    samples = max(course.samples for course in courses)
    steps = (samples - 1) * fleet.every + 1
    rows = np.stack([_held(tape, steps) for tape in tapes], axis=-1).swapaxes(0, 1)
    which = np.tile(np.arange(len(courses)), len(craft))
    late = np.array([round((one.drive.lag + one.drive.delay) / fleet.step) for one in columns])

    def targets(step: int) -> Array:
        """What shall be there now, and of accelerations and rates what shall be there when the drives have followed."""
        now, later = rows[step][:, which], rows[np.minimum(step + late, steps - 1), :, which].T
        return np.where(AHEAD[:, None], later, now)

    voltage = None
    if all(course.voltage is not None for course in courses):
        volts = np.stack([_held(course.volts(fleet.every), steps) for course in courses], axis=-1)
        voltage = lambda step: volts[step][which]  # noqa: E731
    with np.errstate(all="ignore"):  # what flies away is left out
        record = fly_fleet(fleet, Task(names, samples, targets, voltage), seed)
    noise = noise_of(dataset)
    for k, (number, one) in enumerate(zip(draws, craft, strict=True)):
        place = [k * len(courses) + j for j in range(len(courses))]
        misfit = _misfit(record, courses, place)
        if not misfit <= AWAY:
            continue
        measured = {
            course.name: _measured(one, record, at, course, noise, np.random.default_rng([seed, number, j]))
            for j, (course, at) in enumerate(zip(courses, place, strict=True))
        }
        yield Drawn(number, in_memory(dataset, measured, number, _declared(dataset.vehicle, one)), misfit <= ALIKE)


@dataclass(frozen=True)
class _Course:
    """A measured flight to follow: its time and channels, gaps bridged, on a grid of dt."""

    name: str
    dt: float
    samples: int
    flight: Flight
    time: Array
    rates: Array
    voltage: Array | None

    @classmethod
    def of(cls, flight: Flight, name: str, dt: float) -> _Course:
        """On a common grid from the flight's beginning to its end."""
        samples = int(np.floor(_seconds(flight)[-1] / dt + 1e-6)) + 1
        time = dt * np.arange(samples, dtype=np.float64)
        rates = _smooth(_columns(flight, RATES, time), QUICK, dt)
        voltage = _columns(flight, ("voltage",), time)[:, 0] if flight.has("voltage") else None
        return cls(name, dt, samples, flight, time, rates, voltage)

    def targets(self, craft: Multirotor, step: float, every: int) -> Array:
        """What the controller is asked for at every step, packed, [ROWS, steps]."""
        euler = self._euler()
        velocity, cutoff = self._velocity(euler)
        velocity = _smooth(velocity, cutoff, self.dt)
        gone = np.cumsum(0.5 * self.dt * (velocity[1:] + velocity[:-1]), axis=0)
        place = np.concatenate([np.zeros((1, 3)), gone])
        place[:, 2] -= self._height(craft.height)
        rows = np.zeros((self.samples, ROWS))
        targets = Targets.unpack(rows.T)
        targets.place[:], targets.velocity[:] = place.T, velocity.T
        targets.acceleration[:] = np.gradient(velocity, self.dt, axis=0).T
        targets.heading[:] = euler[2]
        targets.rate[:] = self.rates.T
        targets.turning[:] = np.gradient(self.rates, self.dt, axis=0).T
        targets.lift[:] = self._lift(cutoff)
        fine = step * np.arange((self.samples - 1) * every + 1)
        return np.stack([np.interp(fine, self.time, row) for row in rows.T])

    def volts(self, every: int) -> Array:
        """Measured voltage at every step, [steps]."""
        at = np.arange((self.samples - 1) * every + 1) / every
        return np.interp(at, np.arange(self.samples), self.voltage if self.voltage is not None else np.ones(1))

    def _read(self, names: tuple[str, ...]) -> Array:
        return _columns(self.flight, names, self.time)

    def _euler(self) -> Array:
        """Attitude, [3, T]; where it is not measured, what the rates integrate to, bank and pitch about level."""
        tilt = self._read(("phi", "theta")) if self.flight.has("phi", "theta") else self._about(self.rates[:, :2])
        turned = self.dt * np.cumsum(self.rates[:, 2]) if not self.flight.has("psi") else self._read(("psi",))[:, 0]
        return np.stack([*tilt.T, np.unwrap(turned)])

    def _velocity(self, euler: Array) -> tuple[Array, float]:
        """North east down, m/s, [T, 3], and up to which frequency it is worth following, Hz."""
        if self.flight.has(*VELOCITIES, "phi", "theta"):
            return np.einsum("ijt,tj->ti", to_earth(euler), self._read(VELOCITIES)), SLOW
        velocity = np.zeros((self.samples, 3))
        for k, name in enumerate(POSITIONS):
            if self.flight.has(name):
                place = _smooth(self._read((name,)), SLOWER, self.dt)[:, 0]
                velocity[:, k] = (-1.0 if name == "height" else 1.0) * np.gradient(place, self.dt)
        if self.flight.has("az") and not self.flight.has("height"):
            felt = self._read(("az",))
            velocity[:, 2:] = self._about(felt - felt.mean())
            if not self.flight.has("north", "east"):  # it flies where its bank and pitch take it
                bank, pitch, heading = euler
                ahead, right = self._about(9.81 * np.stack([-pitch, bank], axis=1)).T
                cosine, sine = np.cos(heading), np.sin(heading)
                velocity[:, :2] = np.stack([cosine * ahead - sine * right, sine * ahead + cosine * right], axis=1)
            return velocity, QUICK
        return velocity, SLOWER

    def _about(self, rate: Array) -> Array:
        """Integral of a rate, [T, n], about zero: what drifts is taken away."""
        total = self.dt * np.cumsum(rate, axis=0)
        return total - _smooth(total, DRIFT, self.dt)

    def _height(self, usual: float) -> float:
        return max(float(self._read(("height",))[0, 0]), 0.05) if self.flight.has("height") else usual

    def _lift(self, cutoff: float) -> Array:
        """Acceleration upwards that the velocity does not show: what the accelerometer has above its frequencies."""
        if not self.flight.has("az"):
            return np.zeros(self.samples)
        felt = -self._read(("az",))
        return (_smooth(felt, QUICK, self.dt) - _smooth(felt, cutoff, self.dt))[:, 0]


def _seconds(flight: Flight) -> Array:
    return flight.time.numpy() - float(flight.time[0])


def _columns(flight: Flight, names: tuple[str, ...], time: Array) -> Array:
    """Channels [T, n] of a flight at other times since its beginning, gaps bridged."""
    columns = flight.bridged(names).numpy()
    return np.stack([np.interp(time, _seconds(flight), column) for column in columns.T], axis=1)


def _smooth(columns: Array, cutoff: float, dt: float) -> Array:
    """Without what is faster than a frequency, in Hz, and not later, [T, n]."""
    share = 2.0 * cutoff * dt
    if share >= 0.9 or len(columns) < 30:
        return columns
    from scipy.signal import butter, sosfiltfilt  # slow to import

    return np.asarray(sosfiltfilt(butter(2, share, output="sos"), columns, axis=0), dtype=np.float64)


def _held(tape: Array, steps: int) -> Array:
    """A tape [..., T], its last value held to a number of steps."""
    more = steps - tape.shape[-1]
    return np.concatenate([tape, np.repeat(tape[..., -1:], more, axis=-1)], axis=-1) if more > 0 else tape[..., :steps]


def _misfit(record: FleetHistory, courses: Sequence[_Course], place: Sequence[int]) -> float:
    """Rms of the difference of the body rates from those followed, over the latter's; not a number: flown away."""
    off, size = 0.0, 0.0
    for course, at in zip(courses, place, strict=True):
        flown = record.rates[: course.samples, :, at]
        if not np.isfinite(flown).all() or np.abs(record.euler[: course.samples, :2, at]).max() > 1.4:
            return float("nan")
        off += float(((_smooth(flown, QUICK, course.dt) - course.rates) ** 2).sum())
        size += float((course.rates**2).sum())
    return float(np.sqrt(off / max(size, 1e-300)))


def _measured(
    craft: Multirotor,
    record: FleetHistory,
    at: int,
    course: _Course,
    noise: Mapping[str, float],
    chance: np.random.Generator,
) -> Channels:
    """The channels that the flight has, with its noise and gaps, at its own times, float64 of float32's digits."""
    flight, truth = course.flight, true_channels(craft, record, at)
    out: Channels = {"time": flight.time.numpy()}
    offsets = dict(zip((*RATES, "ax", "ay", "az", "phi", "theta"), chance.standard_normal(8), strict=True))
    scales = {**dict.fromkeys(RATES, craft.offsets[0]), **dict.fromkeys(("ax", "ay", "az"), craft.offsets[1])}
    scales |= dict.fromkeys(("phi", "theta"), craft.tilt)
    for channel, values in flight.channels.items():
        if channel not in truth or channel == "time":
            continue
        stream = np.random.default_rng([zlib.crc32(channel.encode()), int(chance.integers(2**31))])
        read = np.interp(_seconds(flight), record.time[: course.samples], truth[channel][: course.samples])
        read = read + scales.get(channel, 0.0) * offsets.get(channel, 0.0)
        read = read + noise.get(channel, 0.0) * stream.standard_normal(len(read))
        gaps = values.isnan().numpy()
        out[channel] = np.where(gaps, np.nan, read).astype(np.float32).astype(np.float64)
    return out


def _declared(vehicle: Vehicle, craft: Multirotor) -> Vehicle:
    """The declared vehicle with the drawn one's thrust curves and torque ratios, where such are declared at all."""

    def motor(declared: Motor, drawn: Mapping[str, object]) -> Motor:
        curve = tuple(drawn["thrust"]) if declared.thrust is not None else None  # pyright: ignore[reportArgumentType]
        ratio = drawn["torque_ratio"] if declared.torque_ratio is not None else None
        return msgspec.structs.replace(declared, thrust=curve, torque_ratio=ratio)

    motors = tuple(motor(*pair) for pair in zip(vehicle.motors, declared_motors(craft), strict=True))
    return msgspec.structs.replace(vehicle, motors=motors)
