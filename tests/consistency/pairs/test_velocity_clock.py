"""Clock of velocities without accelerometers: a shift is told beside drag; drag and a rotor's tilt are none."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.pairs.velocity_clock import velocity_clock
from rotorid_torch.data import Dataset, load
from tests.helpers import shared

DT, SAMPLES, GRAVITY = 0.01, 1500, 9.80665
NAMES = ("u", "v", "w", "p", "q", "r", "phi", "theta")


def gliding(late: float, drag: float = 0.1, tilt: float = 0.0, flights: int = 4, noise: float = 0.02) -> Dataset:
    """Small rolls and pitches that gravity turns into speed, with drag, and a force by rates as of a tilted rotor."""
    rng, made = np.random.default_rng(0), {}
    for k in range(flights):
        margin = 200
        time = DT * np.arange(SAMPLES + 2 * margin)
        hertz, phase = rng.uniform(0.1, 0.8, (2, 5)), rng.uniform(0, 2 * np.pi, (2, 5))
        angles = 0.1 * np.sin(2 * np.pi * hertz[..., None] * time + phase[..., None]).sum(1)
        theta, phi = angles
        q, p = np.gradient(angles, DT, axis=1)
        u, v, x = np.zeros_like(time), np.zeros_like(time), np.zeros(2)
        for i in range(len(time)):
            u[i], v[i] = x
            push = GRAVITY * np.array([-np.sin(theta[i]), np.cos(theta[i]) * np.sin(phi[i])])
            x = x + DT * (push + tilt * np.array([q[i], -p[i]]) - drag * x)
        shown = {"u": np.interp(time - late, time, u), "v": np.interp(time - late, time, v), "w": 0.0 * u}
        shown |= {"p": p, "q": q * np.cos(phi), "r": -q * np.sin(phi), "phi": phi, "theta": theta}
        kept = {name: values[margin:-margin] for name, values in shown.items()}
        kept = {name: values + noise * rng.standard_normal(SAMPLES) for name, values in kept.items()}
        made[f"f{k}"] = {"time": time[:SAMPLES], "lat": kept["p"], **kept}
    return Dataset.from_arrays(made, identify=list(made), controls={"lat": {"unit": "norm"}})


def without_accelerometers(name: str) -> Dataset:
    """A data set with what the clock needs and no specific forces."""
    data = load(shared("flightdata", name))
    kept = ("time", *data.controls, *NAMES)
    flights = {f: {c: data.flights[f].channels[c].numpy() for c in kept} for f in data.identify}
    return Dataset.from_arrays(flights, identify=data.identify, controls={c: {"unit": "rad"} for c in data.controls})


@pytest.mark.parametrize("late", [-0.2, -0.12, 0.15])
def test_a_shift_is_told_within_three_standard_errors_beside_drag(late: float) -> None:
    found = velocity_clock(gliding(late))
    assert found is not None
    assert abs(found.seconds - late) < 3.0 * found.se
    assert found.drag == pytest.approx((0.1, 0.1), abs=0.03)
    assert found.r2[3] > max(found.r2[:3])


def test_a_flight_that_is_mostly_missing_does_not_silence_the_others() -> None:
    dataset = gliding(0.15)
    flights = {n: {c: v.numpy().copy() for c, v in f.channels.items()} for n, f in dataset.flights.items()}
    flights["f0"]["u"][100:] = np.nan
    found = velocity_clock(Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "norm"}}))
    assert found is not None
    assert abs(found.seconds - 0.15) < 3.0 * found.se


@pytest.mark.parametrize(("late", "tilt"), [(0.0, 0.0), (0.03, 0.0), (0.0, 0.5)])
def test_nothing_is_told_where_clocks_agree_or_a_rotor_tilts(late: float, tilt: float) -> None:
    assert velocity_clock(gliding(late, tilt=tilt)) is None


def test_drag_alone_is_no_shift() -> None:
    assert velocity_clock(gliding(0.0, drag=0.4)) is None


def test_accelerometers_leave_it_to_exact_kinematics() -> None:
    dataset = gliding(-0.2)
    flights = {n: {**{c: v.numpy() for c, v in f.channels.items()}} for n, f in dataset.flights.items()}
    for arrays in flights.values():
        arrays["ax"] = 1e-9 * arrays["u"]
    felt = Dataset.from_arrays(flights, identify=list(flights), controls={"lat": {"unit": "norm"}})
    assert velocity_clock(felt) is None


@pytest.mark.parametrize("name", ["uh60-hover", "uh60-delay", "ah1-hover", "uh60b-hover", "uh60-60kt", "nanodrone"])
def test_clean_vehicles_without_their_accelerometers_show_none(name: str) -> None:
    assert velocity_clock(without_accelerometers(name)) is None


@pytest.mark.parametrize("name", ["uh60-hover", "nanodrone"])
def test_their_velocities_moved_are_found_but_for_what_a_rotor_imitates(name: str) -> None:
    moved = without_errors(without_accelerometers(name), {"delay.velocities": 0.15})
    found = velocity_clock(moved)
    assert found is not None
    assert -0.22 < found.seconds < -0.14


def test_measured_velocities_that_are_early() -> None:
    found = velocity_clock(load(shared("flightdata", "trex550-translation")))
    assert found is not None
    assert found.seconds == pytest.approx(-0.142, abs=0.01)
    assert found.drag == pytest.approx((0.09, 0.09), abs=0.03)
