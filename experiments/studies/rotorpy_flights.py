"""What does the closed loop say of multirotors that RotorPy flies? One line for each set, beside what the set hides.

RotorPy (Folk, Paulos and Kumar, 2023) is another group's simulator: first-order motors, drag in the rotors' planes,
thrust lost by climbing, drag of the body, steady wind. Its own controller follows sums of sines, circles and steps at
400 Hz; records have 100 Hz and white noise. Its Hummingbird without any drag is flown as well, with one cause each.

Expected: the causes named, sizes within a few per cent, `control.delay` or `propulsion.motor_lag` for the motors' 5 ms.
RotorPy is installed by whoever runs this: `pip install --no-deps rotorpy`. A set takes 1 to 2 minutes of a processor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import tyro
from recorded.closed import Args, close_loops
from scipy.spatial.transform import Rotation

import rotorid_torch as rotorid

STEP, EVERY = 0.0025, 4
"""s of a step of the simulation and its controller, and steps of a sample."""
NOISE = {"u v w": 0.03, "p q r": 0.01, "phi theta psi": 0.004, "north east height": 0.01, "ax ay az": 0.1}
"""Standard deviations, SI."""
FLIP = np.diag([1.0, -1.0, -1.0])
"""From RotorPy's axes (forward, left, up; north, west, up) to ours, and back."""
FLIGHTS = {"identify": "sines steps circle sines steps", "validate": "sines steps", "acid": "circle"}
DRAGLESS = dict.fromkeys(("c_Dx", "c_Dy", "c_Dz", "k_d", "k_z", "k_h"), 0.0)


@dataclass(frozen=True)
class Set:
    """Flights of one vehicle: RotorPy's parameters that are changed, and what acts besides.

    speed : usual, m/s. wind : north and east, m/s. late : s by which commands act late. weak : share of its thrust that
    the third rotor lacks. true : sizes of the effects that are hidden, by full name.
    """

    vehicle: str
    true: Mapping[str, float]
    changes: Mapping[str, float] = field(default_factory=dict)
    speed: float = 2.0
    wind: tuple[float, float] = (0.0, 0.0)
    late: float = 0.0
    weak: float = 0.0


MOTORS = {"propulsion.motor_lag.tau": 0.005}
DRAGGED = MOTORS | {"propulsion.rotor_drag.x": 0.90, "propulsion.rotor_drag.y": 0.90}
WHOLE = MOTORS | {"forces.drag.x": 0.01, "propulsion.rotor_drag.x": 0.446, "propulsion.axial_inflow.z": 0.87}
SETS = {
    "clean": Set("hummingbird", MOTORS, DRAGLESS),
    "lag": Set("hummingbird", {"propulsion.motor_lag.tau": 0.06}, DRAGLESS | {"tau_m": 0.06}),
    "rotor drag": Set("hummingbird", DRAGGED, DRAGLESS | {"k_d": 2.4e-4}),
    "wind": Set(
        "hummingbird",
        DRAGGED | {"environment.wind.north": 4.0, "environment.wind.east": -2.0},
        DRAGLESS | {"k_d": 2.4e-4},
        wind=(4.0, -2.0),
    ),
    "delay": Set("hummingbird", MOTORS | {"control.delay.common": 0.02}, DRAGLESS, late=0.02),
    "weak rotor": Set("hummingbird", MOTORS | {"propulsion.unequal.motor3": 0.12}, DRAGLESS, weak=0.12),
    "hummingbird": Set("hummingbird", WHOLE),
    "fast hummingbird": Set("hummingbird", WHOLE, speed=5.0),
    "crazyflie": Set(
        "crazyflie",
        {"propulsion.motor_lag.tau": 0.072, "propulsion.rotor_drag.x": 0.244, "propulsion.axial_inflow.z": 0.18},
        speed=1.5,
    ),
}
"""By name; sizes as RotorPy's parameters give them at hover."""


def course(kind: str, speed: float, chance: np.random.Generator) -> Callable[[float], dict[str, Any]]:
    """What the controller is to follow at a time: place and its derivatives (north, west, up), heading and its rate."""
    zero, names = np.zeros(3), ("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot")
    if kind == "steps":
        places, headings = chance.uniform(-1.0, 1.0, (20, 3)), chance.uniform(-0.8, 0.8, 20)
        places = places * np.array([0.6, 0.6, 0.4]) * max(0.5 * speed, 0.7) + [0.0, 0.0, 5.0]

        def stepped(t: float) -> dict[str, Any]:
            k = int(t // 2.0)
            return dict.fromkeys(names, zero) | {"x": places[k], "yaw": headings[k], "yaw_dot": 0.0}

        return stepped
    if kind == "circle":
        radius = chance.uniform(1.0, 2.5)
        rate, phase = np.full((3, 1), speed / radius), np.array([[0.5 * np.pi], [0.0], [0.0]])
        size, turn = radius * np.array([[1.0], [1.0], [0.0]]), 0.0
    else:
        rate, phase = 2.0 * np.pi * chance.uniform(0.08, 0.35, (3, 3)), chance.uniform(0.0, 2.0 * np.pi, (3, 3))
        size, turn = chance.uniform(0.3, 1.0, (3, 3)), 0.6
        size = size / (size * rate).sum(axis=1, keepdims=True) * speed * np.array([[1.0], [1.0], [0.4]])

    def flown(t: float) -> dict[str, Any]:
        moved = {n: (size * rate**k * np.sin(rate * t + phase + 0.5 * k * np.pi)).sum(1) for k, n in enumerate(names)}
        moved["x"] = moved["x"] + np.array([0.0, 0.0, 5.0])
        return moved | {"yaw": turn * np.sin(0.6 * t), "yaw_dot": 0.6 * turn * np.cos(0.6 * t)}

    return flown


def sample(state: dict[str, Any], force: np.ndarray, mass: float) -> dict[str, float]:
    """What would be measured of a state without noise, in our channels."""
    earth = Rotation.from_quat(state["q"]).as_matrix()
    ours = FLIP @ earth @ FLIP
    columns = (
        *(FLIP @ earth.T @ state["v"]),
        *(FLIP @ state["w"]),
        *(np.arctan2(ours[2, 1], ours[2, 2]), -np.arcsin(ours[2, 0]), np.arctan2(ours[1, 0], ours[0, 0])),
        *(state["x"] * np.array([1.0, -1.0, 1.0])),
        *(FLIP @ force / mass),
    )
    return dict(zip(" ".join(NOISE).split(), map(float, columns), strict=True))


def flight(one: Set, parameters: dict[str, Any], kind: str, seconds: float, seed: list[int]) -> dict[str, np.ndarray]:
    """Channels of one flight; the controller knows the vehicle as it is declared."""
    from rotorpy.controllers.quadrotor_control import SE3Control  # pyright: ignore[reportMissingImports]
    from rotorpy.vehicles.multirotor import Multirotor  # pyright: ignore[reportMissingImports]

    chance = np.random.default_rng(seed)
    craft, control, goal = Multirotor(parameters), SE3Control(parameters), course(kind, one.speed, chance)
    wrench, thrusts = craft.compute_body_wrench, np.sqrt([1.0, 1.0, 1.0 - one.weak, 1.0])
    craft.compute_body_wrench = lambda rates, speeds, air: wrench(rates, speeds * thrusts, air)
    hover = np.sqrt(parameters["mass"] * craft.g / (4.0 * parameters["k_eta"]))
    begun, wind = goal(0.0), np.array([one.wind[0], -one.wind[1], 0.0])
    state: dict[str, Any] = {"x": begun["x"], "v": begun["x_dot"], "w": np.zeros(3), "wind": wind}
    state |= {"q": Rotation.from_euler("z", begun["yaw"]).as_quat(), "rotor_speeds": np.full(4, hover)}
    queue, rows, most = [np.full(4, hover)] * round(one.late / STEP), [], parameters["rotor_speed_max"]
    for k in range(-round(2.0 / STEP), round(seconds / STEP)):
        commands = control.update(max(k, 0) * STEP, state, goal(max(k, 0) * STEP))["cmd_motor_speeds"]
        commands = np.clip(commands, parameters["rotor_speed_min"], most)
        if k >= 0 and k % EVERY == 0:
            air = Rotation.from_quat(state["q"]).as_matrix().T @ (state["v"] - wind)
            force, _ = craft.compute_body_wrench(state["w"], state["rotor_speeds"], air)
            motors = {f"motor{i + 1}": c / most for i, c in enumerate(commands)}
            rows.append({"time": k * STEP} | motors | sample(state, force, parameters["mass"]))
        queue.append(commands)
        state = {**craft.step(state, {"cmd_motor_speeds": queue.pop(0)}, STEP), "wind": wind}
    record = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    record["psi"] = np.unwrap(record["psi"])
    for names, size in NOISE.items():
        record |= {name: record[name] + size * chance.standard_normal(len(rows)) for name in names.split()}
    return record


def data_set(name: str, args: Args) -> rotorid.Dataset:
    """Flights of a set, with the places and spins of the motors and the mass declared."""
    from rotorpy.vehicles import crazyflie_params, hummingbird_params  # pyright: ignore[reportMissingImports]

    one = SETS[name]
    declared = {"hummingbird": hummingbird_params, "crazyflie": crazyflie_params}[one.vehicle].quad_params
    parameters, flights, lists = {**declared, **one.changes}, dict[str, Any](), dict[str, list[str]]()
    for listed, kinds in FLIGHTS.items():
        for k, kind in enumerate(kinds.split()):
            called = f"{kind}_{listed[0]}{k}"
            seed = [args.seed, list(SETS).index(name), len(flights)]
            flights[called] = flight(one, parameters, kind, args.seconds, seed)
            lists.setdefault(listed, []).append(called)
    places, turns = parameters["rotor_pos"].values(), parameters["rotor_directions"]
    motors = [
        {"position": (FLIP @ p).tolist(), "spin": "cw" if d > 0 else "ccw"} for p, d in zip(places, turns, strict=True)
    ]
    vehicle = {"mass": parameters["mass"], "gravity": 9.81, "motors": motors}
    return rotorid.Dataset.from_arrays(flights, **lists, kind="multirotor", name=name, vehicle=vehicle)


def main(args: Args) -> None:
    """Close the loop of every set that the record does not hold, and print the lines."""
    if args.quick:
        args = replace(args, sets=("clean",), seconds=6.0)

    close_loops(args, data_set, lambda name: SETS[name].true)


if __name__ == "__main__":
    main(tyro.cli(Args, prog="experiments/studies/rotorpy_flights.py", default=Args.of(SETS, "rotorpy.jsonl")))
