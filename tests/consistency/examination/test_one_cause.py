"""One cause is told once: what follows from a wrong unit, axis, clock or sensor error is no finding of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid, solve_ivp
from scipy.signal import cont2discrete, lfilter, lfilter_zi
from scipy.spatial.transform import Rotation

from rotorid_torch.consistency.examination import frames, samples
from rotorid_torch.consistency.examination.check import check as examined
from rotorid_torch.consistency.examination.finding import Finding
from rotorid_torch.data import Dataset
from rotorid_torch.run.check import check
from tests.consistency.examination.test_check import rolling

G = 9.80665
Arrays = dict[str, np.ndarray]


def grave(change: Callable[[Arrays], Arrays]) -> list[Finding]:
    flights = {f"f{seed}": with_path(rolling(seed)) for seed in range(3)}
    flights = {name: flight | change(flight) for name, flight in flights.items()}
    result = check(Dataset.from_arrays(flights, identify=[*flights]))
    return [f for f in result.findings if f.severity in ("error", "warning")]


def with_path(flight: Arrays) -> Arrays:
    """The flight with its path over ground."""
    turned = Rotation.from_euler("ZYX", np.stack([flight[c] for c in ("psi", "theta", "phi")], axis=1))
    velocity = turned.apply(np.stack([flight[c] for c in "uvw"], axis=1))
    path = cumulative_trapezoid(velocity, flight["time"], axis=0, initial=0.0).T
    return flight | {"north": path[0], "east": path[1], "height": -path[2]}


def scaled(channels: str, factor: float) -> Callable[[Arrays], Arrays]:
    return lambda flight: {channel: factor * flight[channel] for channel in channels.split()}


def without_gravity(flight: Arrays) -> Arrays:
    phi, theta = flight["phi"], flight["theta"]
    fall = (-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta))
    return {c: flight[c] + G * part for c, part in zip(("ax", "ay", "az"), fall, strict=True)}


def late(channels: str, seconds: float) -> Callable[[Arrays], Arrays]:
    return lambda f: {c: np.interp(f["time"] - seconds, f["time"], f[c]) for c in channels.split()}


LEFT_UP = "v w q r theta psi ay az"


def turned(angle: float) -> Callable[[Arrays], Arrays]:
    """The IMU turned about x."""
    turn = Rotation.from_rotvec([-angle, 0.0, 0.0])

    def of(flight: Arrays) -> Arrays:
        triads = (("p", "q", "r"), ("ax", "ay", "az"))
        parts = [zip(t, turn.apply(np.stack([flight[c] for c in t], axis=1)).T, strict=True) for t in triads]
        return {c: values for part in parts for c, values in part}

    return of


CAUSES: dict[str, tuple[Callable[[Arrays], Arrays], str, str]] = {
    "knots": (scaled("u v w", 3600.0 / 1852.0), "u v", "knots"),
    "in g": (scaled("ax ay az", 1.0 / G), "az", "seems to be in g"),
    "taken for g": (scaled("ax ay az", G), "az", "taken for g"),
    "without gravity": (without_gravity, "ax ay az", "without gravity"),
    "height down": (scaled("height", -1.0), "height", "positive down"),
    "gyro bias": (lambda f: {"q": f["q"] + 0.05}, "q", "q off by +0.05"),
    "late attitude": (late("phi theta psi", 0.12), "phi theta psi", "attitude 120 ms late"),
    "late velocity": (late("u v w", 0.2), "u v w", "velocities 200 ms late"),
    "forward left up": (scaled(f"{LEFT_UP} east", -1.0), LEFT_UP, "forward, left, up"),
    "w up": (scaled("w", -1.0), "w", "positive up"),
    "turned": (turned(0.6), "p q r phi theta psi", "turned by 34.4°"),
    "slow stamps": (lambda f: {"time": 2.0 * f["time"]}, "time p q r", "time base is wrong"),
    "late height": (late("height", 1.0), "height", "height 1.00 s late"),
    "late path": (late("north east", 0.7), "north east", "0.70 s late"),
    "map": (lambda f: {"psi": f["psi"] + np.radians(170.0)}, "north east", "turned by"),
}


@pytest.mark.parametrize("name", CAUSES)
def test_one_cause_is_one_finding(name: str):
    change, channels, words = CAUSES[name]
    (one,) = [f for f in grave(change) if not f.sentence.startswith(("nowhere follow", "only "))]
    assert one.channel == channels
    assert words in one.sentence


def test_no_cause_is_told_that_was_not_asked_for():
    flights = {f"f{seed}": rolling(seed) for seed in range(2)}
    data = Dataset.from_arrays({n: f | scaled("u v w", 3.6)(f) for n, f in flights.items()}, identify=[*flights])
    assert [f.channel for f in examined(data, (frames.frames,)).findings] == ["u v"]
    assert examined(data, (samples.stamps,)).findings == ()


def test_an_attitude_that_does_not_follow_the_rates_contradicts_them():
    rng = np.random.default_rng(0)
    found = grave(lambda flight: {"phi": 1e-3 * rng.standard_normal(len(flight["phi"]))})
    assert ("error", "phi p") in [(f.severity, f.channel) for f in found]


@pytest.mark.parametrize("seconds", [0.1, 0.2])
def test_a_filter_takes_the_noise_too_and_is_no_time_base(seconds: float):
    """Behind a lag of 0.2 s the rates are 7 % smaller, as with stamps that run too fast, but late."""
    flights = {f"f{seed}": with_path(rolling(seed)) for seed in range(3)}
    (numerator,), divisor, _ = cont2discrete(([1.0], [seconds, 1.0]), 0.01, "foh")
    still = lfilter_zi(numerator, divisor)
    for flight in flights.values():
        flight |= {c: lfilter(numerator, divisor, flight[c], zi=still * flight[c][0])[0] for c in "pqr"}
    data = Dataset.from_arrays(flights, identify=[*flights], channels={c: {"noise": 1e-3} for c in "pqr"})
    told = [
        f for f in check(data).findings if f.severity in ("error", "warning") and "nowhere follow" not in f.sentence
    ]
    (only,) = told
    assert only.channel == "p q r"
    assert f"rates through a lag of {1e3 * seconds:.0f} ms" in only.sentence


def rocking(seed: int, push: float) -> Arrays:
    """A flight at 10 m/s to the right that rocks about x and heaves by so many m/s² that its accelerometers feel."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.01)
    phi, p, felt = 0.03 * np.sin(6.0 * time), 0.18 * np.cos(6.0 * time), push * np.sin(3.0 * time)

    def change(t: float, x: np.ndarray) -> list[float]:
        tilt, rate = 0.03 * np.sin(6.0 * t), 0.18 * np.cos(6.0 * t)
        return [G * np.sin(tilt) + rate * x[1], push * np.sin(3.0 * t) + G * (np.cos(tilt) - 1.0) - rate * x[0]]

    v, w = solve_ivp(change, (0.0, 20.0), [10.0, 0.0], t_eval=time, rtol=1e-8).y
    moving = {"phi": phi, "p": p, "v": v, "w": w, "az": felt - G, "lat": 0.1 * np.cos(6.1 * time)}
    still = dict.fromkeys(("u", "q", "r", "theta", "psi", "ax", "ay"), 0.0 * time)
    return {"time": time} | {c: x + 1e-3 * rng.standard_normal(len(time)) for c, x in (still | moving).items()}


def test_a_flight_that_alone_shows_the_wrong_unit_is_not_told_apart():
    """Accelerometers in g, where one flight heaves and the others hardly do: it is no odd one."""
    flights = {f"f{seed}": rocking(seed, 3.0 if seed == 3 else 0.0) for seed in range(4)}
    assert not examined(Dataset.from_arrays(flights, identify=[*flights])).of("error")
    flights = {name: flight | scaled("ax ay az", 1.0 / G)(flight) for name, flight in flights.items()}
    errors = examined(Dataset.from_arrays(flights, identify=[*flights])).of("error")
    assert [error.channel for error in errors] == ["az"]
