"""Errors of the sensors beyond white noise, and the vibration that they feel. All in the axes of the data set.

A signal passes them in the order in which an instrument has them: place, vibration of the mounting, axes, scale, bias,
filter, delay.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorid_torch.simulation.rigid import Array, at_place

Three = tuple[float, float, float]
ACCELEROMETERS, GYROS = ("ax", "ay", "az"), ("p", "q", "r")


@dataclass(frozen=True)
class VibrationLine:
    """A vibration at `harmonic` times the rotor speed: amplitudes at accelerometers, m/s^2, and gyros, rad/s."""

    harmonic: int
    acceleration: Three
    rate: Three

    phases = (0.3, 1.9, 4.1, 2.6, 5.3, 0.9)  # rad, of ax ay az p q r at azimuth zero: a structure's own, but fixed


@dataclass(frozen=True)
class SensorErrors:
    """What the sensors do wrong; nothing by default.

    `bias` in SI, `scale` as a part, `delay` and `lag` (first-order filter) in s, `low_pass` (second-order filter) as
    natural frequency, rad/s, and damping, each by channel. `lever_arm`: the IMU's true place from the declared one, m;
    `rotation`: vector that turns the body's axes into the IMU's, rad.
    """

    bias: Mapping[str, float] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    delay: Mapping[str, float] = field(default_factory=dict)
    lag: Mapping[str, float] = field(default_factory=dict)
    low_pass: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    lever_arm: Three = (0.0, 0.0, 0.0)
    rotation: Three = (0.0, 0.0, 0.0)
    vibration: tuple[VibrationLine, ...] = ()


def readings(errors: SensorErrors, truth: Mapping[str, Array], azimuth: Array) -> dict[str, Array]:
    """What the sensors would read without noise, for the channels [T] that differ from the truth.

    truth : true channels of a flight, with time, rates and angular accelerations.
    azimuth : [T] of the rotor, rad.
    """
    read = {name: truth[name] for name in (*ACCELEROMETERS, *GYROS)}
    if any(errors.lever_arm):
        turning = _rows(truth, GYROS), _rows(truth, ("pdot", "qdot", "rdot"))
        felt = at_place(_rows(read, ACCELEROMETERS), *turning, np.asarray(errors.lever_arm))
        read |= dict(zip(ACCELEROMETERS, felt.T, strict=True))
    for line in errors.vibration:
        sizes = (*line.acceleration, *line.rate)
        for name, size, phase in zip((*ACCELEROMETERS, *GYROS), sizes, line.phases, strict=True):
            read[name] = read[name] + size * np.cos(line.harmonic * azimuth + phase)
    if any(errors.rotation):
        from scipy.spatial.transform import Rotation  # slow to import

        matrix = Rotation.from_rotvec(errors.rotation).as_matrix().T
        for names in (ACCELEROMETERS, GYROS):
            read |= dict(zip(names, matrix @ _rows(read, names).T, strict=True))
    for name in {*errors.scale, *errors.bias, *errors.lag, *errors.low_pass, *errors.delay}:
        read[name] = _instrument(errors, name, read.get(name, truth[name]), truth["time"])
    return {name: values for name, values in read.items() if values is not truth[name]}


def _rows(channels: Mapping[str, Array], names: tuple[str, ...]) -> Array:
    """These channels as [T, 3]."""
    return np.stack([channels[name] for name in names], axis=1)


def _instrument(errors: SensorErrors, name: str, values: Array, time: Array) -> Array:
    """Scale, bias, filter and delay of one channel; before the record the signal is held."""
    out = (1.0 + errors.scale.get(name, 0.0)) * values + errors.bias.get(name, 0.0)
    if lag := errors.lag.get(name, 0.0):
        out = _lagged(out, lag, time[1] - time[0])
    if low_pass := errors.low_pass.get(name):
        out = _low_passed(out, *low_pass, dt=time[1] - time[0])
    if delay := errors.delay.get(name, 0.0):
        from scipy.interpolate import CubicSpline  # slow to import

        out = np.asarray(CubicSpline(time, out)(np.maximum(time - delay, time[0])))
    return out


def _lagged(values: Array, lag: float, dt: float) -> Array:
    """First-order lag, exact for an input that is linear between samples, from its steady state."""
    from scipy.signal import lfilter  # slow to import

    decay = np.exp(-dt / lag)
    mean = lag / dt * (1.0 - decay)
    out, _ = lfilter([1.0 - mean, mean - decay], [1.0, -decay], values, zi=[mean * values[0]])
    return np.asarray(out, dtype=np.float64)


def _low_passed(values: Array, frequency: float, damping: float, dt: float) -> Array:
    """Second-order low-pass, exact for an input that is linear between samples, from its steady state."""
    from scipy.signal import cont2discrete, lfilter, lfilter_zi  # slow to import

    denominator = [1.0, 2.0 * damping * frequency, frequency**2]
    discrete: Any = cont2discrete(([frequency**2], denominator), dt, method="foh")
    b, a = np.ravel(discrete[0]), np.ravel(discrete[1])
    out, _ = lfilter(b, a, values, zi=lfilter_zi(b, a) * values[0])
    return np.asarray(out, dtype=np.float64)
