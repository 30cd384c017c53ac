"""Does a drawn helicopter resemble the flown one? Trim and derivatives of both, estimated alike.

Forces and moments of the data set are regressed on motion and controls at the frequencies of the manoeuvres. What the
drawn aircraft's linear model makes of the same measured motion and controls is regressed in the same way, so that the
correlations of the flights and the lag of rotor and inflow are in both tables.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rotorid_torch.data import Dataset
from rotorid_torch.simulation.flight.sensors import MIRRORED
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES
from rotorid_torch.simulation.multiblade.trim import Complex
from rotorid_torch.simulation.rigid import Array

ROWS = ("X", "Y", "Z", "L", "M", "N", "omega")
COLUMNS = ("u", "v", "w", "p", "q", "r", *CONTROL_NAMES)

BAND, PERIODS = (0.1, 2.0), 2.0  # Hz; and at least so many periods in a flight
LIKE, SMALL = 0.15, 0.05  # an entry is alike within this share of itself, and of the row's largest contribution
MOVING = 1.3  # rms of a rotor speed over its noise, from which on it is not held
GOVERNED = 2.0  # how much less alike governors are than airframes
ATTITUDE, RIGGING = 0.02, 0.05  # rad: trims of two helicopters of one kind; of their controls, rigging included
MOST = 30  # identify flights that are looked at


@dataclass(frozen=True)
class Recorded:
    """One flight as numpy arrays (T,), gaps bridged, turned into the mirror where the rotor turns clockwise."""

    dt: float
    samples: int
    channels: Mapping[str, Array]

    def get(self, channel: str, otherwise: float) -> Array:
        """A channel, or a constant where the flight has none."""
        return self.channels[channel] if channel in self.channels else np.full(self.samples, otherwise)


@dataclass(frozen=True)
class Evidence:
    """What the flights say of the aircraft.

    `table`, `tolerance` [7, 10]: in-band derivatives and what counts as alike (infinite: not asked for); `motion`
    [frequency, 10] and `frequency` [frequency] rad/s of all flights; `project` [10, 2 frequency]: least squares on it;
    `trim` [6] and its tolerance: phi, theta, controls.
    """

    table: Array
    tolerance: Array
    motion: Complex
    frequency: Array
    project: Array
    trim: Array
    trim_tolerance: Array

    def tabulate(self, loads: Complex) -> Array:
        """Table [..., 7, 10] of loads [..., frequency, 7] at these frequencies."""
        return np.swapaxes(self.project @ np.concatenate([loads.real, loads.imag], axis=-2), -1, -2)


def mirrored(dataset: Dataset) -> bool:
    """Whether the main rotor turns clockwise."""
    rotor = dataset.vehicle.rotor
    return rotor is not None and rotor.direction == "cw"


def rotor_moves(dataset: Dataset) -> bool:
    """Whether the data set shows a rotor speed that is not held."""
    return dataset.scales().get("omega", 0.0) > MOVING * dataset.noise("omega")


def recorded(dataset: Dataset, name: str) -> Recorded:
    """A flight of the data set."""
    flight, mirror = dataset.flights[name], mirrored(dataset)
    measured = [channel for channel in flight.channels if channel != "time" and flight.has(channel)]
    columns = flight.bridged(measured).numpy().T
    signs = {channel: -1.0 if mirror and channel in MIRRORED else 1.0 for channel in measured}
    channels = {channel: signs[channel] * column for channel, column in zip(measured, columns, strict=True)}
    return Recorded(flight.dt, flight.samples, channels)


def reference(dataset: Dataset) -> dict[str, float]:
    """The data set's trim, in the mirror where the rotor turns clockwise."""
    mirror = mirrored(dataset)
    return {name: -value if mirror and name in MIRRORED else value for name, value in dataset.reference().items()}


def look(dataset: Dataset) -> Evidence:
    """Trim and derivatives of the data set's identify flights, of `MOST` of them."""
    trim = reference(dataset)
    imu = np.asarray(dataset.vehicle.imu or (0.0, 0.0, 0.0)) * ([1.0, -1.0, 1.0] if mirrored(dataset) else 1.0)
    parts = [_transformed(recorded(dataset, name), trim, dataset.vehicle.gravity, imu) for name in dataset.some(MOST)]
    parts = [part for part in parts if len(part[0])]
    frequency = np.concatenate([part[0] for part in parts])
    motion, loads = np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts])
    jumps = np.zeros((len(frequency), len(parts)))
    jumps[np.arange(len(frequency)), np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])] = 1.0
    columns = np.hstack([motion, jumps])
    stacked = np.concatenate([columns.real, columns.imag])
    size = np.linalg.norm(stacked, axis=0) + 1e-300
    project = np.linalg.pinv(stacked / size, rcond=1e-9) / size[:, None]
    response = np.concatenate([loads.real, loads.imag])
    fitted = project @ response
    left = response - stacked @ fitted
    freedom = max(len(stacked) - stacked.shape[1], 1)
    spread = np.sqrt((left * left).sum(0)[:, None] / freedom * (project[:10] ** 2).sum(1)[None])
    excursions = np.sqrt((np.abs(motion) ** 2).mean(0))
    table = fitted[:10].T
    tolerance = _tolerance(table, spread, excursions)
    if not rotor_moves(dataset):
        tolerance[ROWS.index("omega")] = np.inf
    tolerance[ROWS.index("omega")] *= GOVERNED
    level = np.array([trim.get(name, np.nan) for name in ("phi", "theta", *CONTROL_NAMES)])
    loose = np.array([ATTITUDE, ATTITUDE, *(RIGGING for _ in CONTROL_NAMES)])
    angles = [dataset.control_specs[name].unit == "rad" for name in CONTROL_NAMES]
    usable = np.isfinite(level) & np.array([True, True, *angles])
    return Evidence(
        table, tolerance, motion, frequency, project[:10], np.where(usable, level, 0.0), np.where(usable, loose, np.inf)
    )


def _tolerance(table: Array, error: Array, excursions: Array) -> Array:
    """What counts as alike: a share of the entry, and of its row's largest contribution; infinite where unknown."""
    usable = np.isfinite(table) & np.isfinite(error) & (excursions > 0.0)
    parts = np.where(usable, np.abs(table) * excursions, 0.0)
    largest = parts.max(1, keepdims=True)
    alike = np.hypot(LIKE * parts, SMALL * largest) / np.where(excursions > 0.0, excursions, 1.0)
    return np.where(usable & (largest > 0.0), np.hypot(np.where(usable, error, 0.0), alike), np.inf)


def _transformed(
    flight: Recorded, trim: Mapping[str, float], gravity: float, imu: Array
) -> tuple[Array, Complex, Complex]:
    """Frequencies, rad/s, with transforms of the columns and of the loads, at full periods of the flight.

    The jump between a flight's ends is the same at all of them: a constant that the regression takes out.

    Source: Morelli and Klein, Aircraft System Identification, section 5.3 (finite Fourier transform of derivatives).
    """
    length = flight.samples * flight.dt
    low, high = int(np.ceil(max(PERIODS, BAND[0] * length))), int(np.floor(min(BAND[1], 0.25 / flight.dt) * length))
    places = np.arange(low, min(high, flight.samples // 2) + 1)
    frequency = 2.0 * np.pi / length * places.astype(np.float64)

    def transform(values: Array) -> Complex:
        return np.fft.rfft(values)[places].astype(np.complex128) * flight.dt

    def shifted(channel: str) -> Array:
        return flight.get(channel, trim.get(channel, 0.0)) - trim.get(channel, 0.0)

    motion = np.stack([transform(shifted(name)) for name in COLUMNS], axis=1)
    angular = 1j * frequency[:, None] * motion[:, 3:6]
    if all(name in flight.channels for name in ("ax", "ay", "az")):
        felt = np.stack([transform(shifted(name)) for name in ("ax", "ay", "az")], axis=1)
        force = felt - np.cross(angular, imu)
    elif all(name in flight.channels for name in ("u", "v", "w", "phi", "theta")):
        turning = np.stack([transform(part) for part in _turning(flight, gravity)], axis=1)
        force = 1j * frequency[:, None] * motion[:, :3] + turning
    else:
        force = np.full((len(places), 3), np.nan + 0j)
    speed = transform(shifted("omega")) if "omega" in flight.channels else np.full(len(places), np.nan + 0j)
    return frequency, motion, np.column_stack([force, angular, speed])


def _turning(flight: Recorded, gravity: float) -> Array:
    """What specific force has beyond the rates of velocity: turning axes and gravity, [3, T]."""
    u, v, w, p, q, r, phi, theta = (flight.channels[name] for name in ("u", "v", "w", "p", "q", "r", "phi", "theta"))
    along = q * w - r * v + gravity * np.sin(theta)
    right = r * u - p * w - gravity * np.cos(theta) * np.sin(phi)
    return np.stack([along, right, p * v - q * u - gravity * np.cos(theta) * np.cos(phi)])
