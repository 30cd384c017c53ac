"""Two PX4 logs of the built-in quadrotor, as a pilot would bring them: each a few manoeuvres with rests between."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import rotorid_torch as rotorid
from rotorid_torch.data.schema import Motor
from tests.importing.log_writers import quaternion, write_ulog

MANOEUVRES = (("thrust_p", "roll_p", "pitch_p", "yaw_p"), ("mixed_n", "random_a"))


def write_logs(folder: Path) -> list[Path]:
    """Rates, forces and motor commands at 100 Hz, attitude at 50 Hz, and settings that say where the motors are."""
    data = rotorid.fly(None, vehicle="quad", flights=[name for names in MANOEUVRES for name in names]).dataset()
    written = []
    for number, names in enumerate(MANOEUVRES, 1):
        topics: dict[str, tuple] = {}
        start = 20.0
        for name in names:
            flight = {n: np.asarray(v) for n, v in data[name].channels.items()}
            for topic, part in _topics(flight, start).items():
                parts = (topics[topic], part) if topic in topics else (part,)
                time = np.concatenate([one[0] for one in parts])
                topics[topic] = (time, {c: np.concatenate([one[1][c] for one in parts]) for c in part[1]})
            start += float(flight["time"][-1]) + 12.0  # a pause between two flights of a log
        motors = {f"CA_ROTOR{i}_{k}": v for i, at in enumerate(data.vehicle.motors) for k, v in _place(at).items()}
        settings = {"MAV_TYPE": 2, "CA_ROTOR_COUNT": len(data.vehicle.motors), **motors}
        written.append(write_ulog(folder / f"flight{number}.ulg", topics, settings))
    return written


def _place(motor: Motor) -> dict[str, float]:
    x, y, _ = motor.position
    return {"PX": x, "PY": y, "PZ": 0.0, "KM": 0.05 if motor.spin == "ccw" else -0.05}


def _topics(flight: dict[str, np.ndarray], start: float) -> dict[str, tuple[np.ndarray, dict[str, np.ndarray]]]:
    time = flight["time"] - flight["time"][0] + start
    turned = quaternion(flight["phi"], flight["theta"], flight["psi"])

    def columns(pattern: str, rows) -> dict[str, np.ndarray]:
        return {pattern.format(i): np.asarray(row, "<f4") for i, row in enumerate(rows)}

    return {
        "vehicle_angular_velocity": (time, columns("xyz[{}]", (flight[n] for n in "pqr"))),
        "vehicle_acceleration": (time, columns("xyz[{}]", (flight[f"a{n}"] for n in "xyz"))),
        "vehicle_attitude": (time[::2], columns("q[{}]", turned[:, ::2])),
        "actuator_motors": (time, columns("control[{}]", (flight[f"motor{i}"] for i in range(1, 5)))),
    }
