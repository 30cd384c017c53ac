"""From a record to channels: what is true, and what sensors read of it; and what a maker declares of the vehicle."""

import zlib
from typing import Any

import numpy as np

from rotorid_torch.simulation.helicopter.sensor_errors import readings
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.multirotor.flight import FleetHistory, Hover
from rotorid_torch.simulation.multirotor.manoeuvres import lists
from rotorid_torch.simulation.multirotor.rotor import Blades
from rotorid_torch.simulation.rigid import Array, at_place, to_earth

Channels = dict[str, Array]
BODY = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "north", "east", "height", "ax", "ay", "az")


def measured_names(craft: Multirotor) -> tuple[str, ...]:
    """Channels of a flight, in the order of the files."""
    each = range(1, craft.count + 1)
    speeds = tuple(f"omega{k}" for k in each) if craft.telemetry else ()
    return ("time", *(f"motor{k}" for k in each), *speeds, "voltage", *BODY)


def true_channels(craft: Multirotor, record: FleetHistory, flight: int) -> Channels:
    """All channels of one flight without noise, with the loads X Y Z (N) and L M N (N m); time in s from zero.

    Velocity and place are those of the declared centre of gravity; the loads are about the true one. What sensors of an
    altered vehicle read instead of the truth is `effect_NAME`, as is what else only that vehicle has.
    """
    euler, rates = record.euler[:, :, flight], record.rates[:, :, flight]
    angular, force = record.angular[:, :, flight], record.specific_force[:, :, flight]
    earth = to_earth(euler.T)
    arm = np.asarray(craft.reference)
    place = record.place[:, :, flight] + np.einsum("ijt,j->ti", earth, arm)
    velocity = np.einsum("jit,tj->ti", earth, record.velocity[:, :, flight]) + np.cross(rates, arm)
    felt = at_place(force, rates, angular, np.asarray(craft.imu))
    out: Channels = {"time": record.time, "voltage": record.voltage[:, flight]}
    for k in range(craft.count):
        out[f"motor{k + 1}"] = record.commands[:, k, flight]
        out[f"omega{k + 1}"] = record.speeds[:, k, flight]
    height = -place[:, 2]
    columns = (*velocity.T, *rates.T, *euler.T, place[:, 0], place[:, 1], height, *felt.T)
    out |= dict(zip(BODY, columns, strict=True))
    out |= dict(zip(("pdot", "qdot", "rdot"), angular.T, strict=True))
    out |= dict(zip("XYZ", record.force[:, :, flight].T, strict=True))
    out |= dict(zip("LMN", record.moment[:, :, flight].T, strict=True))
    out |= _hidden(craft, record, flight, earth)
    read = readings(craft.sensors, out, np.zeros(len(record.time)))
    out |= {f"effect_{name}": values for name, values in read.items()}
    return {name: np.ascontiguousarray(values) for name, values in out.items()}


def _hidden(craft: Multirotor, record: FleetHistory, flight: int, earth: Array) -> Channels:
    """Signals of what only an altered vehicle has.

    `effect_wind_u` ... : velocity of the air, body axes, m/s; `effect_ground` : part of the induced velocity that the
    ground takes away; `effect_swing_x`, `_y` : angle of the rope to the north and east of the vertical, rad.
    """
    out: Channels = {}
    if any(craft.air.wind) or craft.air.gusts:
        air = np.einsum("jit,tj->ti", earth, record.air[:, :, flight])
        out |= {f"effect_wind_{name}": speed for name, speed in zip("uvw", air.T, strict=True)}
    if craft.air.ground:
        out["effect_ground"] = record.spared[:, flight]
    if craft.load is not None:
        out |= {f"effect_swing_{n}": np.arcsin(record.swing[:, k, flight]) for k, n in enumerate("xy")}
    return out


def measured_channels(craft: Multirotor, truth: Channels, flight: str, seed: int) -> Channels:
    """Channels as sensors read them: with noise, offsets and a tilt of the attitude by flight, and in their steps.

    float32, but time exact in float64. Every channel of every flight has a stream of its own.
    """
    out: Channels = {}
    offsets = _offsets(craft, flight, seed)
    for name in measured_names(craft):
        if name == "time":
            out[name] = truth[name]
            continue
        kind = name.rstrip("0123456789")
        stream = np.random.default_rng([seed, zlib.crc32(f"{flight}/{name}".encode())])
        read = truth[name] if kind == "motor" else truth.get(f"effect_{name}", truth[name])
        noisy = read + offsets.get(name, 0.0) + craft.noise[kind] * stream.standard_normal(len(read))
        if kind in craft.resolution:
            noisy = craft.resolution[kind] * np.round(noisy / craft.resolution[kind])
        out[name] = noisy.astype(np.float32)  # pyright: ignore[reportArgumentType]
    return out


def _offsets(craft: Multirotor, flight: str, seed: int) -> dict[str, float]:
    """Constants of a flight: of gyros and accelerometers, and the tilt of the attitude's axes."""
    chance = np.random.default_rng([seed, zlib.crc32(f"{flight}/offsets".encode())]).standard_normal(8)
    gyro, accelerometer = craft.offsets
    sizes = (*(gyro,) * 3, *(accelerometer,) * 3, *(craft.tilt,) * 2)
    names = ("p", "q", "r", "ax", "ay", "az", "phi", "theta")
    return {name: size * float(value) for name, size, value in zip(names, sizes, chance, strict=True)}


def declare(craft: Multirotor, name: str, flights: tuple[str, ...], description: str) -> dict[str, Any]:
    """The data set's dataset.toml, for a clean vehicle as its maker knows it."""
    channels = measured_names(craft)
    noise = {channel: craft.noise[channel.rstrip("0123456789")] for channel in channels if channel != "time"}
    motors = [f"motor{k + 1}" for k in range(craft.count)]
    return {
        "format": 1,
        "name": name,
        "kind": "multirotor",
        "description": description,
        "vehicle": {
            "mass": craft.mass,
            "inertia": [list(row) for row in craft.inertia],
            "gravity": craft.gravity,
            "air_density": craft.air_density,
            "imu": list(craft.imu),
            "motors": declared_motors(craft),
        },
        "controls": {
            motor: {"unit": "norm", "limits": [0.0, 1.0], "noise": noise[motor], "positive": "faster"}
            for motor in motors
        },
        "channels": {channel: {"noise": sd} for channel, sd in noise.items() if channel not in motors},
        "flights": lists(flights),
        "model": {"reference": "hover"},
    }


def declared_motors(craft: Multirotor) -> list[dict[str, Any]]:
    """Places, spins, thrust curves of the kind: a parabola through what a bench tells, of command or rotor speed."""
    hover = Hover.of([craft.with_like_rotors()], Blades.of([craft.propeller], np.array([craft.air_density])))
    drive, commands = craft.drive, np.linspace(0.15, 0.95, 33)
    speeds = drive.full_speed * (drive.idle + (1.0 - drive.idle) * commands**drive.exponent)
    motors = []
    for k, (place, spin) in enumerate(zip(craft.places, craft.spins, strict=True)):
        curve = float(hover.curve[k, 0])
        parabola = np.polynomial.polynomial.polyfit(commands, curve * speeds**2, 2)
        thrust = [0.0, 0.0, curve] if craft.telemetry else [float(c) for c in parabola]
        spun = "ccw" if spin > 0 else "cw"
        ratio = float(hover.ratio[k, 0])
        motors.append({"position": list(place), "spin": spun, "thrust": thrust, "torque_ratio": ratio})
    return motors
