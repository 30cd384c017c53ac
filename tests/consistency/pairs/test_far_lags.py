"""Far clocks that only a model ties to the others: velocities without accelerometers, and controls."""

from __future__ import annotations

import re

import numpy as np
import pytest

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.examination.frames import frames
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.pairs.far_lags import lag_of_controls, lag_of_velocities, late_positions
from rotorid_torch.data import Dataset, load
from rotorid_torch.data.flight import Flight
from tests.consistency.pairs.test_alignment import late
from tests.helpers import shared

DT, SAMPLES = 0.01, 3000
CONTROLS, VELOCITIES, ATTITUDE, RATES = ("lon", "lat"), ("u", "v", "w"), ("phi", "theta", "psi"), ("p", "q", "r")


def flown(seed: int) -> dict[str, np.ndarray]:
    """A helicopter near hover: controls make roll and pitch accelerations, gravity and drag the velocities."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(SAMPLES)
    hertz, phase = np.exp(rng.uniform(np.log(0.1), np.log(1.2), (2, 7))), rng.uniform(0.0, 2.0 * np.pi, (2, 7))
    lon, lat = 0.02 * np.sin(2.0 * np.pi * hertz[..., None] * time + phase[..., None]).sum(axis=1)
    x = np.zeros((6, SAMPLES))
    for i in range(1, SAMPLES):
        u, v, p, q, phi, theta = x[:, i - 1]
        rates = (
            -9.8 * theta - 0.05 * u + 0.5 * q,
            9.8 * phi - 0.08 * v - 0.5 * p,
            12.0 * lat[i] - 3.0 * p - 2.0 * phi,
            10.0 * lon[i] - 2.0 * q - 1.5 * theta,
            p,
            q,
        )
        x[:, i] = x[:, i - 1] + DT * np.array(rates)
    made = dict(zip(("u", "v", "p", "q", "phi", "theta"), x, strict=True))
    made |= {"w": np.zeros(SAMPLES), "r": np.zeros(SAMPLES), "psi": np.zeros(SAMPLES), "lon": lon, "lat": lat}
    noise = {**dict.fromkeys(VELOCITIES, 0.05), **dict.fromkeys(RATES + ATTITUDE, 0.002)}
    return {"time": time} | {n: v + noise.get(n, 1e-4) * rng.standard_normal(SAMPLES) for n, v in made.items()}


FLOWN = {f"f{seed}": flown(seed) for seed in range(3)}


def dataset(made: dict) -> Dataset:
    return Dataset.from_arrays(made, identify=[*made], controls={c: {"unit": "rad"} for c in CONTROLS})


@pytest.mark.parametrize("seconds", [-3.0, -0.5, 0.4, 1.0, 5.0])
def test_velocities_without_accelerometers_have_their_time_and_are_the_only_error(seconds: float):
    data = dataset(late(FLOWN, VELOCITIES, seconds))
    assert alignment(data).clocks["velocities"] == pytest.approx(seconds, abs=0.06)
    (only,) = (f for f in check(data).findings if f.severity == "error")
    assert only.channel == "u v w"


@pytest.mark.parametrize(("channels", "unit"), [(ATTITUDE, "attitude"), (RATES, "rates")])
def test_velocities_say_which_of_attitude_and_rates_is_late(channels: tuple[str, ...], unit: str):
    clocks = alignment(dataset(late(FLOWN, channels, 0.6))).clocks
    assert clocks == {unit: pytest.approx(0.6, abs=0.03)}


@pytest.mark.parametrize("seconds", [-2.0, 0.4, 1.0, 5.0])
def test_far_controls_have_their_time_and_are_the_only_error(seconds: float):
    data = dataset(late(FLOWN, CONTROLS, seconds))
    lag = lag_of_controls(list(data.flights.values()), data.controls, (-1.0, 0.1))
    assert lag is not None
    assert lag.seconds == pytest.approx(seconds, abs=0.05)
    assert lag.alone
    (only,) = (f for f in check(data).findings if f.severity == "error")
    assert "the controls are" in only.sentence


def of_another_simulator(channels: tuple[str, ...], seconds: float) -> Dataset:
    """Flights of a helicopter with rate and attitude feedback, with these channels so much later than the others."""
    data = load(shared("flightdata", "uh60-hover"))

    def moved(flight: Flight) -> Flight:
        by, count = round(seconds / flight.dt), flight.samples
        first, last = max(by, 0), count + min(by, 0)
        some = {c: x[first - by : last - by] if c in channels else x[first:last] for c, x in flight.channels.items()}
        return Flight(flight.name, flight.dt, some | {"time": flight.channels["time"][: last - first]})

    return data.changed(moved)


@pytest.mark.parametrize(
    ("channels", "seconds", "said"),
    [
        (("lon", "lat", "col", "ped"), 0.4, "the controls are 0.3[67] s late"),
        (("ax", "ay", "az"), 0.4, "accelerations 0.40[0-5] s late"),
        (("ax", "ay", "az"), -0.4, "accelerations 0.40[0-5] s early"),
        (VELOCITIES, 4.5, "velocities 4.(49[6-9]|50[0-4]) s late"),
        (VELOCITIES, -4.5, "velocities 4.(49[6-9]|50[0-4]) s early"),
    ],
)
def test_a_late_stream_under_a_controller_is_one_error_of_all_flights(channels: tuple, seconds: float, said: str):
    (only,) = (f for f in check(of_another_simulator(channels, seconds)).findings if f.severity == "error")
    assert re.match(said, only.sentence)
    assert (only.channel, only.flight) == (" ".join(channels), "")


def test_controls_that_swing_alike_for_long_tell_no_clock():
    """A sine of 1 s period fits at every period."""
    time = np.arange(0.0, 20.0, 0.02)
    swing = {name: np.sin(2.0 * np.pi * time + k) for k, name in enumerate((*RATES, *ATTITUDE))}
    flights = {f"f{k}": {"time": time, "lat": np.sin(2.0 * np.pi * time - k), **swing} for k in (1, 2)}
    data = Dataset.from_arrays(flights, identify=list(flights))
    lag = lag_of_controls(list(data.flights.values()), data.controls, (-1.0, 0.1))
    assert lag is None or not lag.alone
    assert not [f for f in check(data).findings if "the controls are" in f.sentence]


def test_records_of_one_clock_have_no_lag():
    data = dataset(FLOWN)
    assert not [f for f in check(data).findings if f.severity == "error" or " late (" in f.sentence]
    velocities = lag_of_velocities(list(data.flights.values()), 9.80665)
    assert velocities is not None
    assert abs(velocities.seconds) < 0.06


def test_controls_that_explain_nothing_have_no_lag():
    noise = 0.1 * np.random.default_rng(0).standard_normal((2, SAMPLES))
    made = {name: flight | dict(zip(CONTROLS, noise, strict=True)) for name, flight in FLOWN.items()}
    data = dataset(made)
    lag = lag_of_controls(list(data.flights.values()), data.controls, (-1.0, 0.1))
    assert lag is None or lag.left > 0.5 * lag.left_near


@pytest.mark.parametrize(
    ("seconds", "noise"), [(1.0, 0.0), (-2.5, 0.0), (4.0, 0.0), (0.5, 0.0), (0.55, 0.15), (-1.0, 0.15)]
)
def test_positions_that_are_far_off_have_their_time(seconds: float, noise: float):
    flights = {}
    for seed in range(3):
        flight = flown(seed)
        climb = 0.3 * np.sin(flight["time"] * (0.5 + 0.2 * seed)) + 0.2 * np.sin(1.7 * flight["time"] + seed)
        flight["w"] = -climb
        up = -(flight["w"] * np.cos(flight["phi"]) + flight["v"] * np.sin(flight["phi"])) * np.cos(flight["theta"])
        height = DT * np.cumsum(up + flight["u"] * np.sin(flight["theta"]))
        late = np.interp(flight["time"] - seconds, flight["time"], height)
        flights[f"f{seed}"] = flight | {"height": late + noise * np.random.default_rng(seed).standard_normal(SAMPLES)}
    data = Dataset.from_arrays(flights, identify=[*flights])
    (one,) = [f for f in check(data).findings if f.channel == "height" and "against velocity" in f.sentence]
    assert ("late" if seconds > 0.0 else "early") in one.sentence
    told, error = (float(x) for x in re.findall(r"[\d.]+(?= s |\))", one.sentence)[:2])
    assert told == pytest.approx(abs(seconds), abs=max(3.0 * error, 0.02))


def test_positions_that_are_exchanged_on_a_round_are_no_clocks():
    """North follows east by a quarter of the round, nearly."""
    time, flights = DT * np.arange(4000), {}
    for k in range(2):
        rng, still = np.random.default_rng(k), np.zeros(4000)
        u = 0.4 * np.cos(0.3 * time + k) + 0.04 * np.sin(0.71 * time)
        v = 0.4 * np.sin(0.3 * time + k) + 0.04 * np.sin(1.1 * time)
        made = dict.fromkeys((*RATES, *ATTITUDE, "w"), still) | {"u": u, "v": v, "lat": 0.01 * np.sin(time)}
        noisy = {c: x + 0.002 * rng.standard_normal(4000) for c, x in made.items()}
        places = {"north": DT * np.cumsum(v), "east": DT * np.cumsum(u)}
        flights[f"f{k}"] = {"time": time} | noisy | {c: x + 0.01 * rng.standard_normal(4000) for c, x in places.items()}
    data = Dataset.from_arrays(flights, identify=[*flights])
    assert late_positions(data)
    (told,) = frames(data)
    assert told.sentence.startswith("by velocity and attitude north and east are exchanged")


MOTORS = ("motor1", "motor2", "motor3", "motor4")
MIX = np.array([[-1.0, 1.0, 1.0, -1.0], [1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]])


def hovering(seed: int, seconds: float = 8.0) -> dict[str, np.ndarray]:
    """A quadrotor whose controller answers rates and angles, their noise among them, beside pulses on every axis."""
    rng, samples = np.random.default_rng(seed), round(seconds / DT)
    asked = 0.3 * rng.choice([-1.0, 0.0, 1.0], (3, samples // 40 + 1)).repeat(40, axis=1)
    x, motors, read = np.zeros((2, 3)), np.zeros((samples, 4)), np.zeros((samples, 2, 3))
    turned = np.array([[60.0], [60.0], [12.0]])
    for i in range(samples):
        read[i] = x + 0.002 * rng.standard_normal((2, 3))
        motors[i] = MIX.T @ ((8.0 * (asked[:, i] - read[i, 1]) - 4.0 * read[i, 0]) / turned[:, 0])
        turning = turned * MIX @ motors[i] / 4.0 + 0.3 * rng.standard_normal(3)
        x = x + DT * np.stack([turning, x[0]])
    made = dict(zip((*RATES, *ATTITUDE), read.reshape(samples, 6).T, strict=True))
    return {"time": DT * np.arange(samples)} | made | dict(zip(MOTORS, 0.5 + 0.1 * motors.T, strict=True))


@pytest.mark.parametrize("seconds", [-2.5, -0.5, 0.0, 0.4, 2.0])
def test_motors_on_another_clock_are_the_only_error_under_a_controller(seconds: float):
    made = {f"f{seed}": hovering(seed) for seed in range(4)}
    data = Dataset.from_arrays(late(made, MOTORS, seconds) if seconds else made, identify=[*made])
    errors = [f for f in check(data).findings if f.severity == "error"]
    told = [re.search(r"the controls are ([\d.]+) s (late|early)", f.sentence).groups() for f in errors]
    clocks = [float(number) * (1.0 if word == "late" else -1.0) for number, word in told]
    assert clocks == [pytest.approx(one, abs=0.02) for one in [seconds] if one]


@pytest.mark.parametrize("seed", range(10))
def test_motors_of_one_short_flight_have_no_other_clock(seed: int):
    data = Dataset.from_arrays({"f": hovering(seed)}, identify=["f"])
    assert not [f for f in check(data).findings if "the controls are" in f.sentence]


def augmented(seed: int) -> dict[str, np.ndarray]:
    """A helicopter's roll and pitch under a controller of rates and attitude, test inputs beside it; controls known."""
    rng = np.random.default_rng(seed)
    count, power = 1500, np.array([10.0, 8.0])
    x, asked = np.zeros((4, count)), np.zeros((2, count))
    begin, width = 100 + 20 * rng.integers(5), 40 + 10 * rng.integers(3)
    for k, sign in enumerate((1, 1, 1, -1, -1, 1, -1)):
        asked[seed % 2, begin + k * width : begin + (k + 1) * width] = 0.03 * sign
    controls = np.zeros((2, count))
    for i in range(count):
        rates, angles = x[:2, i - 1], x[2:, i - 1]
        controls[:, i] = asked[:, i] - 0.15 * rates - 0.25 * angles + 2e-4 * rng.standard_normal(2)
        turning = power * controls[:, max(i - 4, 0)] - np.array([1.5, 1.0]) * rates
        x[:, i] = x[:, i - 1] + 0.01 * np.concatenate([turning, rates])
    noisy = x + 0.001 * rng.standard_normal(x.shape)
    made = dict(zip(("p", "q", "phi", "theta"), noisy, strict=True)) | {"lat": controls[0], "lon": controls[1]}
    return made | {"time": 0.01 * np.arange(count), "r": 0.001 * rng.standard_normal(count)}


AUGMENTED = {f"f{seed}": augmented(seed) for seed in range(4)}


@pytest.mark.parametrize("seconds", [-1.5, -0.5, 0.0, 0.5, 2.0])
def test_controls_on_another_clock_are_an_error_under_a_controller(seconds: float):
    data = dataset(late(AUGMENTED, CONTROLS, seconds))
    far = [f for f in check(data).findings if "the controls are" in f.sentence]
    assert len(far) == (seconds != 0.0)
    for one in far:
        told = re.search(r"([.0-9]+) s (late|early)", one.sentence)
        assert told
        assert float(told[1]) == pytest.approx(abs(seconds), abs=0.08)
        assert told[2] == ("late" if seconds > 0.0 else "early")


@pytest.mark.parametrize("seed", range(4))
def test_controls_under_a_controller_are_on_one_clock_in_any_two_flights(seed: int):
    two = {f"f{k}": augmented(10 * seed + k) for k in range(2)}
    assert not [f for f in check(dataset(two)).findings if "the controls are" in f.sentence]
