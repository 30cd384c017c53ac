"""Velocities from position and attitude: exact on cubics, as noisy as told, and enough to identify from.

And from specific forces and attitude: true to the motion, whatever constant errors accelerometers have.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, POSITIONS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data import Dataset, load
from rotorid_torch.data.velocities.dead_reckoning import DeadReckoning, Sizes, likeliest
from rotorid_torch.data.velocities.source import with_velocities
from tests.helpers import shared

DT = 0.01
NOISE = 0.002
TIME = DT * np.arange(600)


def data(position: np.ndarray, attitude: np.ndarray, **more: np.ndarray) -> Dataset:
    still = {c: 0.01 * np.sin((k + 1) * TIME) for k, c in enumerate(("lat", *RATES))}
    named = {**dict(zip(POSITIONS, position, strict=True)), **dict(zip(ATTITUDES, attitude, strict=True))}
    told = {c: {"noise": NOISE} for c in POSITIONS}
    return Dataset.from_arrays({"f": {"time": TIME, **still, **named, **more}}, identify=["f"], channels=told)


def turning() -> np.ndarray:
    return np.stack([0.3 * np.sin(TIME), 0.2 * np.cos(2.0 * TIME), 0.5 * TIME])


def test_a_cubic_path_gives_its_velocity_exactly():
    path = np.stack([TIME**3 / 40.0, 2.0 * TIME - TIME**2, 1.0 + 0.5 * TIME])
    got = with_velocities(data(path, turning())).flights["f"]
    back = rigid.position_rates(got.stack(VELOCITIES), got.stack(ATTITUDES))[15:-15]
    exact = np.stack([3.0 * TIME**2 / 40.0, 2.0 - 2.0 * TIME, 0.5 + 0.0 * TIME], axis=-1)[15:-15]
    torch.testing.assert_close(back, torch.from_numpy(exact), rtol=0.0, atol=1e-9)
    assert bool(got.channels["u"][:15].isnan().all())


def test_the_noise_is_that_of_the_record_and_no_score_knows_the_channels():
    noise = NOISE * np.random.default_rng(3).standard_normal((3, len(TIME)))
    seen = with_velocities(data(np.stack([TIME, TIME, TIME]) + noise, 1e-9 * turning()))
    for channel, level in zip(VELOCITIES, (1.0, 1.0, -1.0), strict=True):
        away = seen.flights["f"].channels[channel][15:-15] - level
        assert float(away.std()) == pytest.approx(seen.noise(channel), rel=0.2)
    assert set(seen.scored()).isdisjoint(VELOCITIES)
    assert "not measured" in seen.warnings[-1]


def test_axes_that_are_not_known_better_count_at_speed_and_a_long_way_does_not():
    rng = np.random.default_rng(5)
    path = np.stack([20.0 * TIME, 0.0 * TIME, 0.0 * TIME]) + 0.003 * rng.standard_normal((3, len(TIME)))
    attitude = 0.01 * rng.standard_normal((3, len(TIME)))
    named = {**dict(zip(POSITIONS, path, strict=True)), **dict(zip(ATTITUDES, attitude, strict=True))}
    rates = {c: 0.01 * np.sin(TIME) for c in ("lat", *RATES)}
    raw = Dataset.from_arrays({"f": {"time": TIME, **rates, **named}}, identify=["f"])
    made = with_velocities(raw)
    v = made.flights["f"].channels["v"][15:-15]
    assert float(v.std()) == pytest.approx(made.noise("v"), rel=0.3)


def test_a_missing_position_leaves_a_gap_and_nothing_else():
    path = np.stack([TIME, 2.0 * TIME, 1e-9 * TIME])
    path[0, 300] = np.nan
    u = with_velocities(data(path, 1e-9 * turning())).flights["f"].channels["u"]
    assert bool(u[285:316].isnan().all())
    torch.testing.assert_close(u[316:500], torch.ones_like(u[316:500]))


def test_what_was_measured_or_cannot_be_made_stays_as_it_is():
    path = np.stack([TIME, TIME, TIME])
    measured = data(path, turning(), w=np.sin(TIME))
    assert with_velocities(measured) is measured
    no_heading = data(path, np.stack([*turning()[:2], np.full_like(TIME, np.nan)]))
    assert with_velocities(no_heading) is no_heading
    held = with_velocities(data(np.repeat(path[:, ::20], 20, axis=1), turning()))
    assert "held or missing" in held.warnings[-1]
    assert with_velocities(held).warnings == held.warnings
    assert with_velocities(data(0.0 * path, turning())).derived == frozenset()  # a position that never changes is dead
    hovering = 0.001 * np.round(20.0 * np.stack([np.sin(TIME)] * 3))  # motion capture to a millimetre
    assert with_velocities(data(hovering, turning())).derived == {"u", "v", "w"}
    gaps = path.copy()
    gaps[:, ::10] = np.nan
    assert "u" not in with_velocities(data(gaps, turning())).flights["f"].channels
    assert "u" not in held.flights["f"].channels


GRAVITY = 9.80665
AT_REST = 1.5
"""s for which the vehicle below is trimmed."""


def inertial(
    reference: str = "hover", arm: tuple[float, ...] = (0.0, 0.0, 0.0), error: float = 0.0, kind: str = "helicopter"
) -> tuple[Dataset, torch.Tensor]:
    """A flight with an IMU alone, in level flight at 20 m/s that turns and climbs after a while; and its u v w."""
    time = torch.arange(0.0, 20.0, 0.01, dtype=torch.float64)
    after = (time - AT_REST).clamp(min=0.0)
    ramp, none = 1.0 - torch.exp(-after.square()), torch.zeros_like(time)
    speed = 0.0 if reference == "hover" else 20.0
    moves = torch.stack((4.0 * torch.sin(0.5 * after), 3.0 * torch.sin(0.8 * after), torch.sin(0.7 * after)), dim=-1)
    level = moves * ramp[:, None] + torch.tensor([speed, 0.0, 0.0], dtype=torch.float64)
    attitude = torch.stack((0.2 * torch.sin(after), 0.1 * torch.sin(1.3 * after), 0.3 * torch.sin(0.4 * after)), dim=-1)
    attitude = attitude * ramp[:, None] + torch.tensor([0.0, 0.05, 0.7], dtype=torch.float64)
    cos, sin = torch.cos(torch.tensor(0.7)), torch.sin(torch.tensor(0.7))
    level = torch.stack((level[:, 0] * cos - level[:, 1] * sin, level[:, 0] * sin + level[:, 1] * cos, level[:, 2]), -1)

    def in_body(velocity: torch.Tensor) -> torch.Tensor:
        axes = rigid.position_rates(torch.eye(3, dtype=torch.float64)[:, None], attitude)
        return torch.einsum("itk,tk->ti", axes, velocity)

    slope = torch.stack(torch.gradient(attitude, spacing=0.01, dim=0)[:1])[0]
    phi, theta = attitude[:, 0], attitude[:, 1]
    p = slope[:, 0] - slope[:, 2] * torch.sin(theta)
    q = slope[:, 1] * torch.cos(phi) + slope[:, 2] * torch.cos(theta) * torch.sin(phi)
    r = slope[:, 2] * torch.cos(theta) * torch.cos(phi) - slope[:, 1] * torch.sin(phi)
    rates = torch.stack((p, q, r), dim=-1)
    velocity = in_body(level)
    at_imu = level + rigid.position_rates(rigid.cross(rates, torch.tensor(arm, dtype=torch.float64)), attitude)
    acceleration = torch.gradient(at_imu, spacing=0.01, dim=0)[0]
    acceleration[:, 2] += GRAVITY
    forces = in_body(acceleration) + error
    noise = 1e-4 * torch.from_numpy(np.random.default_rng(2).standard_normal((len(time), 9)))
    columns = torch.cat((forces, rates, attitude), dim=-1) + noise
    flight = {"time": time, "lat": torch.where(after > 0.0, torch.sin(after), none)}
    flight |= dict(zip((*SPECIFIC_FORCES, *RATES, *ATTITUDES), columns.unbind(-1), strict=True))
    if reference == "airspeed":
        flight["airspeed"] = level.norm(dim=-1)
    controls = {} if kind == "helicopter" else {"motor1": {}}
    if controls:
        flight["motor1"] = flight.pop("lat").abs()
    made = Dataset.from_arrays(
        {"f": flight},
        identify=["f"],
        kind=kind,
        vehicle={"imu": list(arm), "gravity": GRAVITY},
        model={"reference": reference},
    )
    return made, velocity


@pytest.mark.parametrize("reference", ["hover", "20 m/s", "38.877 kt", "airspeed"])
def test_specific_forces_and_attitude_give_the_velocity(reference: str):
    data, velocity = inertial(reference, arm=(0.5, -0.2, 1.0))
    made = with_velocities(data)
    away = made.flights["f"].stack(VELOCITIES) - velocity
    assert float(away.square().mean().sqrt()) < 0.15  # of 3 m/s
    assert made.dead_reckoned
    assert set(made.scored()).isdisjoint(VELOCITIES)
    assert "dead reckoned" in made.warnings[-1]
    assert "u" not in made.recorded().flights["f"].channels


def test_what_accelerometers_are_off_by_in_trim_makes_no_drift():
    data, velocity = inertial(error=0.3)  # 6 m/s after 20 s
    away = with_velocities(data).flights["f"].stack(VELOCITIES) - velocity
    assert float(away.square().mean().sqrt()) < 0.9


def test_behind_a_gap_the_velocity_is_not_told():
    """What pushed the vehicle while the IMU was silent is unknown."""
    data, velocity = inertial()
    flight = data.flights["f"].to_numpy()
    for channel in (*SPECIFIC_FORCES, *RATES):
        flight[channel][800:900] = np.nan
    gap = Dataset.from_arrays(
        {"f": flight}, identify=["f"], vehicle={"imu": [0.0] * 3, "gravity": GRAVITY}, model={"reference": "hover"}
    )
    made = with_velocities(gap)
    found = made.flights["f"].stack(VELOCITIES)
    assert float((found[:800] - velocity[:800]).square().mean().sqrt()) < 0.15
    assert bool(found[800:].isnan().all())
    assert "up to the first gap in f" in made.warnings[-1]


def test_a_drift_of_minutes_stays_bounded():
    data, _ = inertial()
    flight = data.flights["f"].to_numpy()
    time = 0.01 * np.arange(30_000)
    rng = np.random.default_rng(4)
    long = {c: np.resize(v, len(time)) + 1e-4 * rng.standard_normal(len(time)) for c, v in flight.items()}
    long |= {"time": time, "ax": long["ax"] + 0.1 * np.sin(0.02 * time)}  # 10 m/s by itself
    made = with_velocities(Dataset.from_arrays({"f": long}, identify=["f"], model={"reference": "hover"}))
    assert float(made.flights["f"].stack(VELOCITIES).abs().max()) < 15.0


def test_sizes_have_the_likelihood_of_a_gaussian_and_are_found_from_flights():
    rng, knots = np.random.default_rng(7), np.arange(0.0, 60.0)
    true = Sizes(0.5, 0.1, 0.15)
    drift, speed = true.covariances(knots)
    drifts = rng.multivariate_normal(np.zeros(60), drift, size=(10, 3))
    speeds = rng.multivariate_normal(np.zeros(60), speed, size=(10, 3))
    flights = [(knots, (d + v).T) for d, v in zip(drifts, speeds, strict=True)]
    gaussian = multivariate_normal(np.zeros(60), drift + speed)
    exact = sum(-gaussian.logpdf(v.T).sum() - 0.5 * v.size * np.log(2.0 * np.pi) for _, v in flights)
    away = np.log([0.5 / 2.0, 0.1 / 0.2, 0.15 / 0.05])
    assert true.implausibility(flights) == pytest.approx(exact + 0.5 * float(away @ away), rel=1e-9)
    found = likeliest(flights)
    assert found.speed == pytest.approx(0.5, rel=0.15)
    assert found.acceleration == pytest.approx(0.15, rel=0.2)
    off = [found.drift(knots, v) - d.T for (_, v), d in zip(flights, drifts, strict=True)]
    assert np.sqrt(np.mean(np.square(off))) < 0.4 < 4.0 < np.sqrt(np.mean(np.square(drifts)))


@pytest.mark.parametrize("name", ["sag", "nanodrone"])
def test_measured_imus_follow_motion_capture(name: str):
    data = load(shared("flightdata", name))
    errors, moves, reckoning = [], [], DeadReckoning.of(data, 0.0)
    measured = {f: data.flights[f].bridged(VELOCITIES) for f in data.identify}
    for flight, velocity in measured.items():
        start = float(velocity[: data.quiet(flight), 0].mean())
        made = replace(reckoning, speed=start).flight(data.flights[flight]).stack(VELOCITIES)
        errors.append(float((made - velocity).square().mean()))
        moves.append(float(velocity.var(dim=0).mean()))
    assert np.mean(errors) < 0.5 * np.mean(moves)


def test_nothing_is_dead_reckoned_from_an_unknown_speed_nor_of_a_multirotor():
    data, _ = inertial("a forward flight")
    assert with_velocities(data) is data
    rotors, _ = inertial(kind="multirotor")
    assert with_velocities(rotors) is rotors


def test_a_slow_record_has_velocities_too():
    data, _ = inertial()
    slow = {c: v[::100] for c, v in data.flights["f"].to_numpy().items()}
    made = with_velocities(Dataset.from_arrays({"f": slow}, identify=["f"], model={"reference": "hover"}))
    assert bool(made.flights["f"].stack(VELOCITIES).isfinite().all())
