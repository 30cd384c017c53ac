"""A quadrotor that is simulated by equations of its own comes back: thrust, control power, lag, delay, reaction."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import rotorid_torch as rotorid
from rotorid_torch.data import Dataset
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction, reconstruct
from rotorid_torch.identification.rotor_regression import regress_rotors, with_memory
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build

DT, MASS, G = 0.005, 0.5, 9.80665
INERTIA = np.array([3e-3, 4e-3, 6e-3])
PLACES, SPINS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * 0.1, np.array([1, -1, 1, -1])
TORQUE, LAG, DELAY, REACTION = 0.012, 0.05, 0.015, 1.5
ARMS = np.stack([-PLACES[:, 1], PLACES[:, 0], TORQUE * SPINS])
MOTORS = [
    {"position": [*at.tolist(), 0.0], "spin": "ccw" if s > 0 else "cw", "torque_ratio": TORQUE}
    for at, s in zip(PLACES, SPINS, strict=True)
]
HOVER = float(np.sqrt((MASS * G / 4 - 0.2) / 1.5))
EFFECTS = ("propulsion.motor_lag", "control.delay", "propulsion.rotor_inertia")


def flown(seed: int, samples: int = 1600) -> dict[str, np.ndarray]:
    """Rates and specific force under random commands and a rate controller; rotors lag and their commands are late."""
    rng = np.random.default_rng(seed)
    mix = np.stack([np.ones(4), -np.sign(PLACES[:, 1]), np.sign(PLACES[:, 0]), SPINS], axis=1)
    pushed = np.asarray(lfilter([0.1], [1, -0.9], rng.standard_normal((samples, 4)), axis=0))
    pushed = pushed * np.array([0.3, 0.1, 0.1, 0.2])
    behind, a, rates, reached = round(DELAY / DT), np.exp(-DT / LAG), np.zeros(3), np.full(4, HOVER)
    commands, seen = [], []
    for k in range(samples):
        measured = rates + REACTION * ((reached - HOVER) @ SPINS) * np.array([0.0, 0.0, 1.0])
        thrust = 0.2 + 1.5 * reached**2
        seen.append([*measured, -thrust.sum() / MASS])
        commands.append(HOVER + mix @ (pushed[k] - np.array([0.0, *(measured * [0.01, 0.01, 0.05])])))
        rates = rates + DT * (ARMS @ thrust) / INERTIA
        reached = a * reached + (1 - a) * commands[max(0, k - behind)]
    noisy = np.array(seen) + rng.standard_normal((samples, 4)) * np.array([0.01, 0.01, 0.01, 0.02])
    channels = dict(zip(("p", "q", "r", "az"), noisy.T, strict=True))
    motors = {f"motor{i + 1}": c for i, c in enumerate(np.array(commands).T)}
    return {"time": DT * np.arange(samples), **channels, **motors}


@cache
def dataset() -> Dataset:
    return recorded({name: flown(k) for k, name in enumerate(("one", "two", "three"))})


def recorded(flights: dict[str, dict[str, np.ndarray]], vehicle: dict[str, Any] | None = None) -> Dataset:
    declared = {"mass": MASS, "inertia": np.diag(INERTIA * 1.25).tolist(), "motors": MOTORS, "gravity": G}
    vehicle = declared if vehicle is None else vehicle
    noise = {c: {"noise": sd} for c, sd in (("p", 0.01), ("q", 0.01), ("r", 0.01), ("az", 0.02))}
    return Dataset.from_arrays(
        flights, identify=["one", "two"], validate=["three"], kind="multirotor", vehicle=vehicle, channels=noise
    )


@cache
def seen() -> Reconstruction:
    return reconstruct(dataset())


def test_what_is_linear_comes_back_by_regression_beside_lag_and_delay():
    model = build(propose(dataset(), seen(), EFFECTS))
    assert with_memory(model) == ("propulsion.motor_lag.tau", "control.delay.common")
    found = regress_rotors(model, dataset(), seen())
    value = dict(zip(model.parameter_set.names, found.theta.tolist(), strict=True))
    assert value["propulsion.motor_lag.tau"] + value["control.delay.common"] == pytest.approx(LAG + DELAY, rel=0.3)
    slope = value["rotors.thrust.c1"] + 2.0 * value["rotors.thrust.c2"] * HOVER
    assert slope == pytest.approx(3.0 * HOVER, rel=0.1)
    assert {"az", "pdot", "qdot", "rdot"} <= set(found.regressions)
    assert min(float(found.regressions[row].r2) for row in ("az", "pdot", "qdot", "rdot")) > 0.9


def test_the_three_steps_find_the_vehicle_and_its_wrong_inertia():
    run = rotorid.identify(dataset(), effects=EFFECTS)
    found = {p.name: p for p in run.parameters}
    assert run.estimate.fit.minimum.converged
    assert found["propulsion.motor_lag.tau"].value == pytest.approx(LAG, abs=0.003)
    # the commands act from the sample at which they are told: half a sample beyond the delay
    assert found["control.delay.common"].value == pytest.approx(DELAY + 0.5 * DT, abs=0.003)
    assert found["propulsion.rotor_inertia.N"].value == pytest.approx(REACTION, rel=0.1)
    for axis in "LMN":
        assert found[f"rotors.power.{axis}"].value == pytest.approx(1.25, rel=0.05)
    assert not any(name.startswith("forces.") for name in found)  # no damping, no speed derivatives


def test_instant_motors_have_no_damping_to_hide_behind():
    run = rotorid.identify(dataset())
    assert {name.partition(".")[0] for name in run.model.parameter_set.names} == {"rotors"}
    assert all((p.value or 0.0) >= 0.0 for p in run.parameters if p.name.startswith("rotors.power"))


def test_what_is_missing_for_a_moment_is_missing_for_a_moment():
    flights = {name: flown(k) for k, name in enumerate(("one", "two", "three"))}
    for channels in flights.values():
        for c in ("p", "q", "r", "az"):
            channels[c][400:460] = np.nan
    run = rotorid.identify(recorded(flights), effects=EFFECTS)
    known = {p.name: p.value for p in rotorid.identify(dataset(), effects=EFFECTS).parameters}
    found = {p.name: p.value for p in run.parameters}
    for name in ("propulsion.motor_lag.tau", "control.delay.common", "rotors.thrust.c2"):
        assert found[name] == pytest.approx(known[name], rel=0.1)


def test_motors_of_unknown_places_have_free_derivatives():
    run = rotorid.identify(recorded({name: flown(k) for k, name in enumerate(("one", "two", "three"))}, vehicle={}))
    assert {"forces.L.motor1", "forces.N.motor4"} <= set(run.model.parameter_set.names)
    assert (run.scores["validate"] or np.inf) < 1.0
