"""A wrong time base, or rates in another unit: one ratio of attitude and rates, and what velocities say of it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from rotorid_torch.consistency.pairs.time_base import time_base
from rotorid_torch.consistency.sensor_pairs import agreement, attitude_pairs
from rotorid_torch.data import Dataset
from rotorid_torch.run.check import check

DT, SAMPLES, G = 0.01, 1500, 9.80665
Arrays = dict[str, np.ndarray]


def turning_about(axis: int, noise: float = 2e-3, size: float = 0.3) -> Arrays:
    """A flight that turns about one axis alone for a few seconds, with exact kinematics but for noise."""
    time = DT * np.arange(SAMPLES)
    window = np.where((time > 4.0) & (time < 8.0), np.sin(np.pi * (time - 4.0) / 4.0) ** 2, 0.0)
    angles = np.zeros((SAMPLES, 3))
    angles[:, axis] = size * window * np.sin(3.0 * time)
    rates = np.gradient(angles, DT, axis=0)
    phi, theta = angles[:, 0], angles[:, 1]
    down = np.stack([-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)], axis=1)
    speed = np.stack([np.sin(0.9 * time), np.sin(1.1 * time + 1.0), 0.5 * np.sin(0.7 * time)], axis=1)
    felt = np.gradient(speed, DT, axis=0) + np.cross(rates, speed) - G * down
    exact = np.concatenate([rates, angles, speed, felt], axis=1)
    rng = np.random.default_rng(axis)
    values = exact + noise * rng.standard_normal(exact.shape)
    channels = ("p", "q", "r", "phi", "theta", "psi", "u", "v", "w", "ax", "ay", "az")
    stick = 0.1 * window * np.sin(3.0 * time + 0.5)
    return {"time": time, "lon": stick, **dict(zip(channels, values.T, strict=True))}


def data_of(flights: dict[str, Arrays], leave_out: str = "") -> Dataset:
    chosen = {n: {c: v for c, v in f.items() if c not in leave_out.split()} for n, f in flights.items()}
    return Dataset.from_arrays(chosen, identify=[*chosen])


def slowed(factor: float, noise: float = 2e-3) -> dict[str, Arrays]:
    """One flight for each axis, whose stamps run so many times as slowly."""
    flights = {f"f{axis}": turning_about(axis, noise) for axis in range(3)}
    return {n: f | {"time": factor * f["time"]} for n, f in flights.items()}


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_time_base_is_told_where_every_axis_moves_in_one_flight_alone(factor: float):
    base = time_base(data_of(slowed(factor)))
    assert base is not None
    assert base.of == "time"
    assert base.ratio == pytest.approx(1.0 / factor, rel=0.02)


def test_rows_that_are_lost_at_random_under_even_stamps_are_a_time_base_and_no_scale():
    flights = {}
    for axis in range(3):
        rows = np.random.default_rng(axis).random(SAMPLES) > 0.06
        made = {c: x[rows] for c, x in turning_about(axis).items()}
        flights[f"f{axis}"] = made | {"time": DT * np.arange(rows.sum())}
    wrong = [f for f in check(data_of(flights)).findings if f.severity in ("warning", "error") and "time" in f.channel]
    assert len(wrong) == 1
    assert re.search("[4-8]% of the rows were lost under even stamps", wrong[0].sentence)


def test_a_scale_of_all_gyros_is_no_time_base():
    flights = {f"f{axis}": turning_about(axis) for axis in range(3)}
    scaled = {n: f | {c: f[c] / 1.03 for c in ("p", "q", "r")} for n, f in flights.items()}
    assert time_base(data_of(scaled)) is None


def test_the_error_of_a_ratio_is_that_of_noise_where_one_flight_alone_moves():
    flights = data_of(slowed(1.0)).flights.values()
    ratios = [a for pair in attitude_pairs() if (a := agreement(pair, flights)) is not None]
    assert all(a.scale_se < 0.02 for a in ratios)
    assert all(abs(a.scale - 1.0) < 4.0 * a.scale_se + 0.5 * (a.bounds[1] - a.bounds[0]) for a in ratios)


def test_an_axis_that_noise_hides_does_not_veto_a_time_base():
    flights = slowed(2.0)
    still = flights["f2"]
    rng = np.random.default_rng(9)
    for channel in ("psi", "r"):
        still[channel] = 0.4 * still[channel] + 1e-2 * rng.standard_normal(SAMPLES)
    base = time_base(data_of(flights))
    assert base is not None
    assert base.of == "time"
    assert base.ratio == pytest.approx(0.5, rel=0.03)


def test_a_third_axis_of_another_ratio_is_no_time_base():
    flights = slowed(2.0)
    flights["f2"]["r"] = 0.5 * flights["f2"]["r"]
    assert time_base(data_of(flights)) is None


@pytest.mark.parametrize("leave_out", ["", "u v w ax ay az"])
def test_rates_in_degrees_a_second_are_an_error_of_their_unit(leave_out: str):
    flights = {f"f{axis}": turning_about(axis, size=0.1) for axis in range(3)}
    rng = np.random.default_rng(0)
    for flight in flights.values():  # gyros that wander, so that their integrals say nothing and reading believes them
        for rate in ("p", "q", "r"):
            wander = 0.05 * np.sin(0.4 * flight["time"] + rng.uniform(0.0, 6.0))
            flight[rate] = np.degrees(flight[rate] + wander)
    errors = check(data_of(flights, leave_out)).findings
    (said,) = [f for f in errors if f.severity == "error"]
    assert said.channel == "p q r"
    assert "57.3 times" in said.sentence
    assert "deg/s" in said.sentence
