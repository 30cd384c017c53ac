"""From states to channels: what the sensors read, with white noise that is independent for every flight and seed."""

import zlib

import numpy as np

from rotorid_torch.simulation.flight.simulation import FlightHistory
from rotorid_torch.simulation.helicopter.aircraft import AZIMUTH, BLADES, CONTROL_NAMES, CONTROLS, SPEED, Aircraft
from rotorid_torch.simulation.helicopter.sensor_errors import readings
from rotorid_torch.simulation.rigid import Array, at_place, to_earth

Channels = dict[str, Array]

NOISE = {
    **dict.fromkeys(("u", "v", "w", "ax", "ay", "az"), 0.05),
    **dict.fromkeys(("p", "q", "r", "phi", "theta", "psi"), 0.002),
    **dict.fromkeys(("a0", "a1", "b1"), 0.001),
    **dict.fromkeys(("lon", "lat", "col", "ped"), 0.0005),
    "height": 0.2,
    "omega": 0.02,
}
"""Standard deviation of a sample, SI."""

MEASURED = (
    *("time", "lon", "lat", "col", "ped", "u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "height"),
    *("ax", "ay", "az", "a0", "a1", "b1"),
)
"""Channels of a flight, in the order of the files."""

MIRRORED = (
    *("v", "p", "r", "phi", "psi", "east", "ay", "Y", "L", "N", "pdot", "rdot"),
    *("effect_wind_v", "effect_swing_y", "effect_curvature_s"),
)


def true_channels(aircraft: Aircraft, record: FlightHistory, flight: int) -> Channels:
    """All channels of one flight without noise, with the loads X Y Z (N) and L M N (N m); time in s from zero.

    Velocity and place are those of the declared centre of gravity; the loads are about the true one. What the sensors
    of an altered aircraft read instead of the truth is there as `effect_NAME`, as is what else only that aircraft has.

    Flapping is in multi-blade coordinates, beta(psi) = a0 - a1 cos(psi) - b1 sin(psi), psi = 0 aft.
    """
    x = record.states[:, :, flight]
    out: Channels = {"time": record.time}
    names = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "north", "east", "height")
    out |= dict(zip(("lon", "lat", "col", "ped"), x[:, CONTROLS].T, strict=True))
    out |= dict(zip(names, x[:, :12].T, strict=True))
    force, angular = record.specific_force[:, :, flight], record.angular[:, :, flight]
    felt = at_place(force, x[:, 3:6], angular, np.asarray(aircraft.imu))
    out |= dict(zip(("ax", "ay", "az"), felt.T, strict=True))
    out |= dict(zip(("a0", "a1", "b1"), flapping(aircraft, x), strict=True))
    out["omega"] = x[:, SPEED]
    out |= dict(zip(("pdot", "qdot", "rdot"), angular.T, strict=True))
    out |= dict(zip("XYZ", record.force[:, :, flight].T, strict=True))
    out |= dict(zip("LMN", record.moment[:, :, flight].T, strict=True))
    out |= {name: signal[:, flight] for name, signal in record.hidden.items()}
    if any(aircraft.reference):
        _move_reference(aircraft, out)
    if aircraft.clockwise:
        out |= {name: -out[name] for name in MIRRORED if name in out}
    read = readings(aircraft.sensors, out, x[:, AZIMUTH])
    out |= {f"effect_{name}": values for name, values in read.items()}
    return {name: np.ascontiguousarray(values) for name, values in out.items()}


def _move_reference(aircraft: Aircraft, out: Channels) -> None:
    """Velocity and place of the declared centre of gravity instead of the true one."""
    arm, omega = np.asarray(aircraft.reference), np.stack([out[c] for c in "pqr"], axis=1)
    for name, extra in zip("uvw", np.cross(omega, arm).T, strict=True):
        out[name] = out[name] + extra
    north, east, down = np.einsum("ijt,j->it", to_earth(np.stack([out[c] for c in ("phi", "theta", "psi")])), arm)
    out["north"], out["east"], out["height"] = out["north"] + north, out["east"] + east, out["height"] - down


def flapping(aircraft: Aircraft, x: Array) -> tuple[Array, Array, Array]:
    """Coning, longitudinal and lateral flapping from the blades' own flap, rad, [T] each.

    Two blades do not determine the tilt at an instant; their flap rate gives the missing half.

    Source: Johnson, Helicopter Theory, section 8.2 (multi-blade coordinates).
    """
    count = aircraft.rotor.blades
    flap, rate = x[:, BLADES : BLADES + 2 * count].reshape(-1, 2, count).swapaxes(0, 1)
    azimuth = x[:, [AZIMUTH]] + aircraft.rotor.spacing.T
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    mean = flap.mean(1)
    if count > 2:
        return mean, -2.0 * (flap * cosine).mean(1), -2.0 * (flap * sine).mean(1)
    turned, swing = (rate - rate.mean(1, keepdims=True)) / x[:, [SPEED]], flap - mean[:, None]
    return mean, (turned * sine - swing * cosine).mean(1), -(turned * cosine + swing * sine).mean(1)


def measured_channels(truth: Channels, names: tuple[str, ...], flight: str, seed: int) -> Channels:
    """Channels as the sensors read them: truth, or where there is an `effect_NAME` of the sensor that, and white noise.

    float32, but time exact in float64. Every channel of every flight has a stream of its own: neither a subset of
    flights nor another length changes it.
    """
    out: Channels = {}
    for name in names:
        if name == "time":
            out[name] = truth[name]
            continue
        stream = np.random.default_rng([seed, zlib.crc32(f"{flight}/{name}".encode())])
        read = truth[name] if name in CONTROL_NAMES else truth.get(f"effect_{name}", truth[name])
        noisy = read + NOISE[name] * stream.standard_normal(len(truth[name]))
        out[name] = noisy.astype(np.float32)  # pyright: ignore[reportArgumentType]
    return out
