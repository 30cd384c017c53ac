"""A quadrotor that is simulated by equations of its own comes back: thrust, control power, lag, delay, reaction."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
import torch
from scipy.signal import lfilter

import rotorid_torch as rotorid
from rotorid_torch.data import Dataset
from rotorid_torch.effects.spec import usual_arm
from rotorid_torch.identification.measured_states import MeasuredStates
from rotorid_torch.identification.mixer import find_mixer
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction, reconstruct
from rotorid_torch.identification.rotor_equations import seen_flights
from rotorid_torch.identification.rotor_regression import nonlinear, regress_rotors
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from rotorid_torch.run.pipeline import regressed
from rotorid_torch.run.result import Run
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.validate.rotor_moments import with_moments

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
COMMANDS = ("motor1", "motor2", "motor3", "motor4")
EFFECTS = ("propulsion.motor_lag", "control.delay", "propulsion.rotor_inertia")


def flown(
    seed: int,
    samples: int = 1600,
    voltage: np.ndarray | None = None,
    pitching: np.ndarray | None = None,
    reaction: float = REACTION,
    late: float = DELAY,
) -> dict[str, np.ndarray]:
    """Rates and specific force under random commands and a rate controller; rotors lag and their commands are late.

    voltage : of the battery [samples], over the usual one; commands count times it. pitching : angular acceleration
    [samples] by something else. reaction : yaw rate by the sum of spin times command.
    late : s by which commands are late.
    """
    other = np.zeros((samples, 3)) if pitching is None else np.outer(pitching, [0.0, 1.0, 0.0])
    share = np.ones(samples) if voltage is None else voltage
    rng = np.random.default_rng(seed)
    mix = np.stack([np.ones(4), -np.sign(PLACES[:, 1]), np.sign(PLACES[:, 0]), SPINS], axis=1)
    pushed = np.asarray(lfilter([0.1], [1, -0.9], rng.standard_normal((samples, 4)), axis=0))
    pushed = pushed * np.array([0.3, 0.1, 0.1, 0.2])
    behind, a, rates, reached = round(late / DT), np.exp(-DT / LAG), np.zeros(3), np.full(4, HOVER)
    commands, seen = [], []
    for k in range(samples):
        measured = rates + reaction * ((reached - HOVER) @ SPINS) * np.array([0.0, 0.0, 1.0])
        thrust = 0.2 + 1.5 * reached**2
        seen.append([*measured, -thrust.sum() / MASS])
        commands.append(HOVER + mix @ (pushed[k] - np.array([0.0, *(measured * [0.01, 0.01, 0.05])])))
        rates = rates + DT * ((ARMS @ thrust) / INERTIA + other[k])
        reached = a * reached + (1 - a) * commands[max(0, k - behind)] * share[max(0, k - behind)]
    noisy = np.array(seen) + rng.standard_normal((samples, 4)) * np.array([0.01, 0.01, 0.01, 0.02])
    channels = dict(zip(("p", "q", "r", "az"), noisy.T, strict=True))
    motors = {f"motor{i + 1}": c for i, c in enumerate(np.array(commands).T)}
    return {"time": DT * np.arange(samples), **channels, **motors}


@cache
def dataset() -> Dataset:
    return recorded({name: flown(k) for k, name in enumerate(("one", "two", "three"))})


def recorded(
    flights: dict[str, dict[str, np.ndarray]], vehicle: dict[str, Any] | None = None, **options: Any
) -> Dataset:
    declared = {"mass": MASS, "inertia": np.diag(INERTIA * 1.25).tolist(), "motors": MOTORS, "gravity": G}
    vehicle = declared if vehicle is None else vehicle
    noise = {c: {"noise": sd} for c, sd in (("p", 0.01), ("q", 0.01), ("r", 0.01), ("az", 0.02))}
    return Dataset.from_arrays(
        flights,
        identify=["one", "two"],
        validate=["three"],
        kind="multirotor",
        vehicle=vehicle,
        channels=noise,
        **options,
    )


@cache
def seen() -> Reconstruction:
    return reconstruct(dataset())


def test_what_is_linear_comes_back_by_regression_beside_lag_and_delay():
    model = build(propose(dataset(), seen(), EFFECTS))
    assert nonlinear(model) == ("propulsion.motor_lag.tau", "control.delay.common")
    found = regress_rotors(model, dataset(), seen())
    value = dict(zip(model.parameter_set.names, found.theta.tolist(), strict=True))
    assert value["propulsion.motor_lag.tau"] + value["control.delay.common"] == pytest.approx(LAG + DELAY, rel=0.3)
    slope = value["rotors.thrust.c1"] + 2.0 * value["rotors.thrust.c2"] * HOVER
    assert slope == pytest.approx(3.0 * HOVER, rel=0.1)
    assert {"az", "pdot", "qdot", "rdot"} <= set(found.by_row)
    assert min(float(found.by_row[row].r2) for row in ("az", "pdot", "qdot", "rdot")) > 0.9


def test_a_flight_without_an_accelerometer_says_nothing_of_thrust_and_all_else_of_moments():
    flights = {name: flown(k) for k, name in enumerate(("one", "two", "three"))}
    del flights["two"]["az"]
    data = recorded(flights)
    model = build(propose(dataset(), seen(), EFFECTS))
    found = regress_rotors(model, data, reconstruct(data))
    value = dict(zip(model.parameter_set.names, found.theta.tolist(), strict=True))
    slope = value["rotors.thrust.c1"] + 2.0 * value["rotors.thrust.c2"] * HOVER
    assert slope == pytest.approx(3.0 * HOVER, rel=0.1)
    assert min(float(found.by_row[row].r2) for row in ("az", "pdot", "qdot", "rdot")) > 0.9


def test_an_error_holds_what_differs_from_flight_to_flight():
    """Four flights, each late by its own time: the mean is as uncertain as their scatter says, not as noise says."""
    late = np.array([0.005, 0.01, 0.02, 0.025])
    flights = {f"late{k}": flown(10 + k, late=float(one)) for k, one in enumerate(late)}
    noise = {c: {"noise": sd} for c, sd in (("p", 0.01), ("q", 0.01), ("r", 0.01), ("az", 0.02))}
    data = Dataset.from_arrays(
        flights,
        identify=list(flights),
        kind="multirotor",
        vehicle={"mass": MASS, "inertia": np.diag(INERTIA * 1.25).tolist(), "motors": MOTORS, "gravity": G},
        channels=noise,
    )
    model = build(propose(data, reconstruct(data), ("control.delay", "propulsion.motor_lag")))
    errors = regress_rotors(model, data, reconstruct(data)).errors
    assert errors["control.delay.common"] == pytest.approx(late.std(ddof=1) / 2.0, rel=0.3)


def test_a_lag_that_the_rotors_inertia_makes_up_for_in_yaw_is_that_of_roll_and_pitch():
    """Yaw then looks as if motors followed at once, and is explained far better so than the others are with the lag."""
    data = recorded({name: flown(k, reaction=0.3, late=0.0) for k, name in enumerate(("one", "two", "three"))})
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction, EFFECTS[:1]))
    theta = regress_rotors(model, data, reconstruction).theta
    assert float(theta[model.parameter_set.index("propulsion.motor_lag.tau")]) == pytest.approx(LAG, rel=0.15)


@cache
def identified() -> Run:
    return rotorid.identify(dataset(), effects=EFFECTS)


def test_the_three_steps_find_the_vehicle_and_its_wrong_inertia():
    run = identified()
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


def test_a_moment_that_a_poorer_model_does_not_explain_is_free_again_in_a_richer_one():
    poor, _ = regressed(propose(dataset(), seen()), dataset(), seen())
    silent = ["rotors.power.L", "rotors.trim.L"]
    held = msgspec.structs.replace(
        poor, free=dict.fromkeys(silent, False), values=dict.fromkeys(silent, 0.0), effects=EFFECTS
    )
    rich, regressions = regressed(with_moments(held), dataset(), seen())
    model = build(rich)
    assert set(silent) <= set(model.parameter_set.free)
    power = float(regressions.theta[model.parameter_set.index("rotors.power.L")])
    assert power == pytest.approx(1.25, rel=0.1)


@pytest.mark.parametrize("places", [True, False])
def test_an_elevon_is_a_control_of_its_own_beside_the_motors(places: bool):
    flights = {}
    for k, name in enumerate(("one", "two", "three")):
        deflection = 0.1 * np.sin(np.arange(1600) * DT * (5.0 + k)) * np.cos(np.arange(1600) * DT * 2.0)
        flights[name] = flown(k, pitching=40.0 * deflection) | {"lon": deflection}
    data = recorded(flights, None if places else {"mass": MASS}, controls={"lon": {"unit": "rad"}})
    run = rotorid.identify(data, effects=EFFECTS[:2])
    values = {p.name: p.value for p in run.parameters}
    assert values["surfaces.M.lon"] == pytest.approx(40.0, rel=0.1)
    assert abs(values["surfaces.L.lon"] or 0.0) < 4.0
    assert not any(name.startswith("surfaces.X") for name in values)


def test_motors_that_warm_are_not_taken_for_a_battery():
    """Thrust is lost along every flight beside what the falling voltage takes: a trend of the flight's own."""
    time, flights = np.linspace(-0.5, 0.5, 1600), {}
    for k, name in enumerate(("one", "two", "three")):
        share = 1.0 - 0.01 * k - 0.03 * time + 0.01 * np.sin((20.0 + k) * time)
        flights[name] = flown(k, voltage=share) | {"voltage": 4.0 * share}
        flights[name]["az"] = flights[name]["az"] + 0.4 * time
    data = recorded(flights)
    seen_by_now = reconstruct(data)
    model = build(propose(data, seen_by_now, (*EFFECTS, "propulsion.voltage")))
    found = regress_rotors(model, data, seen_by_now)
    exponent = float(found.theta[model.parameter_set.index("propulsion.voltage.exponent")])
    assert exponent == pytest.approx(1.0, abs=0.25)
    level, slope = found.lines["one"]["az"]
    assert slope * 1600 * DT == pytest.approx(0.4, abs=0.15)
    assert abs(level) < 0.3


def test_a_voltage_that_its_sensor_shakes_is_a_voltage_all_the_same():
    """What shakes it for tenths of a second is as large as what the battery does, and would hide half of that."""
    time, flights, chance = np.linspace(-0.5, 0.5, 1600), {}, np.random.default_rng(5)
    for k, name in enumerate(("one", "two", "three")):
        share = 1.0 - 0.01 * k + 0.03 * np.sin((20.0 + k) * time)
        shaken = np.asarray(lfilter([0.01], [1.0, -0.95], chance.standard_normal(1600)))
        flights[name] = flown(k, voltage=share) | {"voltage": 4.0 * (share + shaken)}
    data = recorded(flights)
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction, (*EFFECTS, "propulsion.voltage")))
    theta = regress_rotors(model, data, reconstruction).theta
    assert float(theta[model.parameter_set.index("propulsion.voltage.exponent")]) == pytest.approx(1.0, abs=0.15)


def test_a_voltage_that_falls_with_every_load_at_once_acts_at_once():
    """Load draws the voltage down for tenths of a second, and the motors' lag comes after it."""
    time, flights, chance = np.arange(1600) * DT, {}, np.random.default_rng(6)
    for k, name in enumerate(("one", "two", "three")):
        share = 1.0 - 0.01 * k - 0.002 * time + np.asarray(lfilter([0.01], [1.0, -0.95], chance.standard_normal(1600)))
        flights[name] = flown(k, voltage=share, late=0.0) | {"voltage": 4.0 * share}
    data = recorded(flights)
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction, (*EFFECTS, "propulsion.voltage")))
    theta = regress_rotors(model, data, reconstruction).theta
    values = dict(zip(model.parameter_set.names, theta.tolist(), strict=True))
    assert values["propulsion.voltage.exponent"] == pytest.approx(1.0, abs=0.05)
    assert values["propulsion.voltage.fast"] == pytest.approx(1.0, abs=0.1)


def test_what_is_missing_for_a_moment_is_missing_for_a_moment():
    flights = {name: flown(k) for k, name in enumerate(("one", "two", "three"))}
    for channels in flights.values():
        for c in ("p", "q", "r", "az"):
            channels[c][400:460] = np.nan
    run = rotorid.identify(recorded(flights), effects=EFFECTS)
    known = {p.name: p.value for p in identified().parameters}
    found = {p.name: p.value for p in run.parameters}
    for name in ("propulsion.motor_lag.tau", "control.delay.common", "rotors.thrust.c2"):
        assert found[name] == pytest.approx(known[name], rel=0.1)


def test_places_that_are_not_declared_are_found_from_the_flights():
    flights = {name: flown(k) for k, name in enumerate(("one", "two", "three"))}
    mixer = find_mixer(recorded(flights, vehicle={}), COMMANDS)
    assert set(mixer.explained) == {"L", "M", "N"}
    right = np.stack([-PLACES[:, 1], PLACES[:, 0], 0.1 * SPINS], axis=1) / 0.1
    np.testing.assert_allclose(mixer.shares.numpy(), right, atol=0.3)
    for motor, at, spin in zip(mixer.motors(0.1, None), PLACES, SPINS, strict=True):
        assert np.sign(motor.position[:2]).tolist() == np.sign(at).tolist()
        assert motor.spin == spin
    named = mixer.motors(0.2, "quad-x")
    np.testing.assert_allclose([m.position[:2] for m in named], PLACES * 2.0 / np.sqrt(2.0), atol=1e-9)


@pytest.mark.parametrize("count", [6, 8])
def test_places_of_motors_that_a_mixer_moves_together_are_found(count: int):
    """Four combinations drive all of them; by noise alone each does something of its own."""
    angles = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    arms = np.stack([-np.sin(angles), np.cos(angles), (-1.0) ** np.arange(count)]) * np.sqrt([[2.0], [2.0], [1.0]])
    names = [f"motor{i + 1}" for i in range(count)]

    def hovering(seed: int) -> dict[str, np.ndarray]:
        rng = np.random.default_rng(seed)
        pushed = np.asarray(lfilter([0.1], [1, -0.9], rng.standard_normal((1600, 4)), axis=0))
        commands = 0.5 + 0.05 * pushed @ np.vstack([np.ones(count), arms]) + 5e-4 * rng.standard_normal((1600, count))
        rates = DT * np.cumsum((commands - 0.5) @ arms.T * [40.0, 30.0, 5.0], axis=0)
        rates += 0.005 * rng.standard_normal(rates.shape)
        az = -2.0 * G * commands.mean(1)
        return {
            "time": DT * np.arange(1600),
            **dict(zip((*"pqr", "az", *names), [*rates.T, az, *commands.T], strict=True)),
        }

    mixer = find_mixer(recorded({n: hovering(k) for k, n in enumerate(("one", "two", "three"))}, vehicle={}), names)
    assert set(mixer.explained) == {"L", "M", "N"}
    np.testing.assert_allclose(mixer.shares.numpy(), arms.T, atol=0.3)


def test_motors_of_unknown_places_thrust_along_z_and_moments_are_testable_where_flights_say_so():
    flights = {name: flown(k) for k, name in enumerate(("one", "two", "three"))}
    run = rotorid.identify(recorded(flights, vehicle={}), effects=EFFECTS[:2])
    assert not any(name.startswith("forces.") for name in run.model.parameter_set.names)
    value = {p.name: p.value or 0.0 for p in run.parameters}
    assert value["propulsion.motor_lag.tau"] + value["control.delay.common"] == pytest.approx(LAG + DELAY, abs=0.01)
    told = run.fit.flights["three"].responses
    assert min(told[a].r2_without_constant or 0.0 for a in ("pdot", "qdot", "az")) > 0.8
    still = {n: {**f, "p": f["r"] * 0.0 + 1e-3, "q": f["r"][::-1].copy()} for n, f in flights.items()}
    assert not {"L", "M"} & set(find_mixer(recorded(still, vehicle={}), COMMANDS).explained)


RADIUS, ABOVE = 0.3, 0.05


def near_the_ground(seed: int, samples: int = 1500) -> dict[str, np.ndarray]:
    """Up and down over a floor: thrust by Cheeseman and Bennett, and a drag; a controller of the height."""
    rng, dt = np.random.default_rng(seed), 0.02
    wanted = np.interp(np.arange(samples), np.arange(0, samples + 50, 50), rng.uniform(0.15, 1.0, samples // 50 + 1))
    height, climb, seen, commands = wanted[0], 0.0, [], []
    for k in range(samples):
        gain = 1.0 / (1.0 - (RADIUS / (4.0 * (height + ABOVE))) ** 2)
        command = HOVER + 0.15 * (wanted[k] - height) - 0.12 * climb + 0.01 * rng.standard_normal()
        force = -gain * 4.0 * (0.2 + 1.5 * command**2) / MASS
        seen.append([force, -climb, height])
        commands.append(command)
        climb, height = climb - dt * (force + G), max(height + dt * climb, 0.1)
    az, w, height_seen = (np.array(seen) + rng.standard_normal((samples, 3)) * np.array([0.05, 0.01, 0.002])).T
    still = {c: 0.001 * rng.standard_normal(samples) for c in ("u", "v", "p", "q", "r", "phi", "theta", "ax", "ay")}
    motors = {f"motor{i + 1}": np.array(commands) for i in range(4)}
    return {"time": dt * np.arange(samples), **still, "az": az, "w": w, "height": height_seen, **motors}


def test_ground_effect_comes_back_with_the_radius_and_the_height_of_the_rotors():
    data = recorded({name: near_the_ground(k) for k, name in enumerate(("one", "two", "three"))})
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction, ("environment.ground",)))
    found = regress_rotors(model, data, reconstruction)
    value = dict(zip(model.parameter_set.names, found.theta.tolist(), strict=True))
    assert value["environment.ground.radius"] == pytest.approx(RADIUS, rel=0.1)
    assert value["environment.ground.offset"] == pytest.approx(ABOVE, abs=0.02)
    assert found.explained["az"] > 0.9
    far = [without["one"] for without in (found.without,)]
    place = model.parameter_set.index("environment.ground.radius")
    assert float(far[0][place]) == pytest.approx(RADIUS, rel=0.15)  # as a fit without the first flight says


def braked(seed: int, hubs: float, samples: int = 1500) -> dict[str, np.ndarray]:
    """Sways and turns under a drag of 0.5/s along x and y, this share of which acts at the hubs."""
    chance, dt = np.random.default_rng(seed), 0.01
    time = dt * np.arange(samples)
    rate, size = chance.uniform(1.0, 2.5, (3, 4, 1)), np.array([0.05, 0.05, 0.1])[:, None, None]
    phase = rate * time + chance.uniform(0.0, 2.0 * np.pi, (3, 4, 1))
    (phi, theta, psi), (dphi, dtheta, dpsi) = ((size / 2.0 * s).sum(1) for s in (np.sin(phase), rate * np.cos(phase)))
    p, q = dphi - dpsi * np.sin(theta), dtheta * np.cos(phi) + dpsi * np.sin(phi) * np.cos(theta)
    r = dpsi * np.cos(phi) * np.cos(theta) - dtheta * np.sin(phi)
    thrust = MASS * (G + np.sin(3.0 * phase[0, 0]))
    velocity, seen, drag = np.zeros(3), [], np.array([-0.5, -0.5, 0.0])
    for k in range(samples):
        force = drag * velocity - np.array([0.0, 0.0, thrust[k] / MASS])
        seen.append([*velocity, *force])
        down = np.array([-np.sin(theta[k]), np.cos(theta[k]) * np.sin(phi[k]), np.cos(theta[k]) * np.cos(phi[k])])
        velocity = velocity + dt * (force + G * down - np.cross([p[k], q[k], r[k]], velocity))
    turning = np.gradient(np.stack([p, q, r]), dt, axis=1) * INERTIA[:, None]
    turning[2] += hubs * MASS * 0.5 * 0.02 * r
    each = np.linalg.solve(np.vstack([np.ones(4), ARMS]), np.vstack([thrust, turning]))
    channels = np.vstack([np.array(seen).T, p, q, r, phi, theta, psi])
    channels = channels + chance.standard_normal(channels.shape) * 0.003
    names = ("u", "v", "w", "ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi")
    motors = {f"motor{i + 1}": c for i, c in enumerate(np.sqrt((each - 0.2) / 1.5))}
    return {"time": time, **dict(zip(names, channels, strict=True)), **motors}


@pytest.mark.parametrize("hubs", [0.0, 1.0])
def test_drag_in_the_rotors_plane_brakes_yaw_as_far_as_it_does(hubs: float):
    """Other vehicles feel a linear drag about the centre of gravity: it is in the rotors' plane all the same."""
    data = recorded({name: braked(k, hubs) for k, name in enumerate(("one", "two", "three"))})
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction, ("propulsion.rotor_drag",)))
    theta = regress_rotors(model, data, reconstruction).theta
    value = dict(zip(model.parameter_set.names, theta.tolist(), strict=True))
    assert value["propulsion.rotor_drag.x"] == pytest.approx(0.5, rel=0.1)
    assert value["propulsion.rotor_drag.y"] == pytest.approx(0.5, rel=0.1)
    assert value["propulsion.rotor_drag.hubs"] == pytest.approx(hubs, abs=0.2)


def test_drag_of_rotors_on_arms_that_are_longer_than_supposed():
    """Where no places are declared, that the true arms brake yaw by more does not change the drag."""
    data = recorded({name: braked(k, 1.0) for k, name in enumerate(("one", "two", "three"))})
    reconstruction = reconstruct(data)
    spec, share, flat = propose(data, reconstruction, ("propulsion.rotor_drag",)), 0.6, sum(INERTIA[:2]) / INERTIA[2]
    shorter = [msgspec.structs.replace(m, position=tuple(share * x for x in m.position)) for m in spec.motors]
    model = build(msgspec.structs.replace(spec, motors=tuple(shorter), found_places={}))
    theta = regress_rotors(model, data, reconstruction).theta
    value = dict(zip(model.parameter_set.names, theta.tolist(), strict=True))
    assert value["propulsion.rotor_drag.x"] == pytest.approx(0.5, rel=0.02)
    assert value["propulsion.rotor_drag.y"] == pytest.approx(0.5, rel=0.02)
    assert value["propulsion.rotor_drag.hubs"] == pytest.approx(flat / share, rel=0.05)


def test_the_arm_of_a_body_is_read_from_its_inertia():
    """A Crazyflie 2.0 (27 g, 1.66e-5 kg m2) and an F450 frame (1.2 kg, 0.0155 kg m2) have arms of 46 and 227 mm."""
    assert usual_arm(0.027, np.eye(3) * 1.66e-5) == pytest.approx(0.046, rel=0.15)
    assert usual_arm(1.2, np.eye(3) * 0.0155) == pytest.approx(0.227, rel=0.15)


def test_a_flight_without_an_accelerometer_tells_what_it_has():
    """The thrust is that of the flight with specific force, the moments are those of both."""
    model = build(propose(dataset(), seen(), EFFECTS))
    records = Flights(dataset(), seen()).records(model, ("one", "two"))
    outputs = records.outputs.clone()
    outputs[1, :, model.body.outputs.index("az")] = torch.nan
    states = MeasuredStates.of(model, list(seen_flights(model, replace(records, outputs=outputs))))
    assert [("az" in one, "qdot" in one) for one in states.measured] == [(True, True), (False, True)]
    start = regress_rotors(model, dataset(), seen()).theta
    found = states.fitted(start, model.parameter_set.free)
    value = dict(zip(model.parameter_set.names, found.theta.tolist(), strict=True))
    assert value["rotors.thrust.c1"] + 2.0 * value["rotors.thrust.c2"] * HOVER == pytest.approx(3.0 * HOVER, rel=0.1)
    assert min(found.explained[row] for row in ("az", "qdot")) > 0.9


def test_a_gap_of_the_sensors_says_nothing():
    """What is regressed where all sensors are silent for a second of a flight is what the rest of the flights say."""
    silent = slice(600, 800)
    flights = {name: flown(k) for k, name in enumerate(("one", "two", "three"))}
    whole = recorded(flights)
    for channel in ("p", "q", "r", "az"):
        flights["one"][channel][silent] = np.nan
    found = {}
    for name, data in (("whole", whole), ("gap", recorded(flights))):
        reconstruction = reconstruct(data)
        model = build(propose(data, reconstruction, EFFECTS))
        fit = regress_rotors(model, data, reconstruction)
        found[name] = dict(zip(model.parameter_set.names, fit.theta.tolist(), strict=True)), fit
    (truth, before), (values, after) = found["whole"], found["gap"]
    # not the trims, for which constants of the flights stand as well
    physical = [n for n in before.errors if np.isfinite(before.errors[n]) and not n.startswith("rotors.trim.")]
    off = {n: abs(values[n] - truth[n]) / before.errors[n] for n in physical}
    assert max(off.values()) < 1.0
    assert all(after.explained[row] > before.explained[row] - 0.02 for row in before.explained)


def test_a_parameter_on_a_bound_does_not_widen_the_errors_of_others():
    """Commands that are recorded late ask for a delay below zero: errors are those of a fit that holds it at zero."""
    flights = {name: flown(k, late=0.0) for k, name in enumerate(("one", "two", "three"))}
    early = recorded(
        {n: {c: np.roll(r, 2) if c in COMMANDS else r for c, r in one.items()} for n, one in flights.items()}
    )
    model = build(propose(early, reconstruct(early), ("propulsion.motor_lag", "control.delay")))
    records = Flights(early, reconstruct(early)).records(model, early.identify)
    states = MeasuredStates.of(model, list(seen_flights(model, records)))
    start = regress_rotors(model, early, reconstruct(early)).theta
    delay = "control.delay.common"
    others = [name for name in model.parameter_set.free if name != delay]
    found, held = states.fitted(start, [*others, delay]), states.fitted(start, others)
    value = dict(zip(model.parameter_set.names, found.theta.tolist(), strict=True))
    assert value[delay] == 0.0
    assert np.isinf(found.errors[delay])
    assert {name: found.errors[name] for name in others} == pytest.approx(dict(held.errors), rel=1e-3)
    assert all(theta[model.parameter_set.index(delay)] >= 0.0 for theta in found.without)
