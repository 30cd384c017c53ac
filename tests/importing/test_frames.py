"""The vehicle's table that an import leaves to fill in: frames by settings, places by hand, a file that loads."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.importing.frames import FRAMES, template
from tests.importing.log_writers import write_dataflash, write_ulog
from tests.importing.test_flown import clock, commands, copter, floats, gyro, wired

FILLED = {
    "mass": "mass = 1.5",
    "inertia": "inertia = [[0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.03]]",
    "imu": "imu = [0, 0, 0]",
}


def filled(folder: Path) -> rotorid.Dataset:
    """The data set with the comment's # taken away and numbers put in."""
    file = folder / "dataset.toml"
    text = file.read_text()
    for key, line in FILLED.items():
        text = re.sub(rf"# {key} = [^\n]*\?[^\n]*", line, text)
    file.write_text(re.sub(r"^# (?=\[|[a-z_]+ = )", "", text, flags=re.MULTILINE))
    return rotorid.load(folder)


@pytest.mark.parametrize("frame", FRAMES)
def test_frames_are_balanced(frame: str):
    """Thrust makes no moment, drag no yaw, and every motor is on an arm of 1 m; half turn each way."""
    angles = np.radians([angle for angle, _ in FRAMES[frame]])
    places = np.stack([np.cos(angles), np.sin(angles)])
    spins = np.array([1.0 if spin == "ccw" else -1.0 for _, spin in FRAMES[frame]])
    assert np.abs(places.sum(axis=1)).max() < 1e-9
    assert spins.sum() == 0.0
    mixer = np.stack([np.ones(len(spins)), -places[1], places[0], spins])
    assert np.linalg.matrix_rank(mixer) == 4
    assert np.abs(mixer @ mixer.T - np.diag(np.diag(mixer @ mixer.T))).max() < 1e-9  # axes do not mix


@pytest.mark.parametrize(
    ("settings", "motors", "named", "second"),
    [
        ({"FRAME_CLASS": 1, "FRAME_TYPE": 1}, 4, "quad X", (-0.7071, -0.7071)),
        ({"FRAME_CLASS": 1, "FRAME_TYPE": 0}, 4, "quad +", (0.0, -1.0)),
        ({"FRAME_CLASS": 1, "FRAME_TYPE": 3}, 4, "quad H", (-0.7071, -0.7071)),
        ({"FRAME_CLASS": 2, "FRAME_TYPE": 1}, 6, "hexa X", (0.0, -1.0)),
        ({"FRAME_CLASS": 4, "FRAME_TYPE": 1}, 8, "coaxial octa X", (0.7071, -0.7071)),
        ({}, 4, "", (-0.7071, -0.7071)),
    ],
)
def test_ardupilot_s_frames_have_their_motors_in_order(settings, motors, named, second, tmp_path: Path):
    time = clock()
    pulses = np.concatenate([commands(time), commands(time)])[:motors]
    place = {"INS_POS1_X": 0.05, "INS_POS1_Z": -0.02}
    topics = copter(time, 1000.0 + 1000.0 * pulses)
    file = write_dataflash(tmp_path / "log.bin", topics, wired({i: i for i in range(1, motors + 1)}) | settings | place)
    done = rotorid.import_log(file, tmp_path / "set")
    text = (done.folder / "dataset.toml").read_text()
    assert (f"settings name {named}" if named else "no setting names the frame") in text
    vehicle = filled(done.folder).vehicle
    assert len(vehicle.motors) == motors
    assert vehicle.motors[1].position[:2] == pytest.approx(second, abs=1e-3)
    assert (vehicle.mass, vehicle.imu) == (1.5, (0.05, 0.0, -0.02))


@pytest.mark.parametrize(("start", "named"), [(4001, "quad X"), (5001, "quad +"), (12001, "coaxial octa X")])
def test_px4_s_frames(start: int, named: str, tmp_path: Path):
    time, motors = clock(), len(FRAMES[named])
    asked = floats({f"control[{i}]": commands(time)[i % 4] for i in range(motors)})
    topics = {"vehicle_angular_velocity": gyro(time), "actuator_motors": (time, asked)}
    done = rotorid.import_log(write_ulog(tmp_path / "log.ulg", topics, {"SYS_AUTOSTART": start}), tmp_path / "set")
    assert f"settings name {named}." in (done.folder / "dataset.toml").read_text()
    assert filled(done.folder).vehicle.motors[0].spin == FRAMES[named][0][1]


def test_what_is_declared_is_not_asked_for_and_helicopters_have_a_rotor():
    text = template(4, "quad X", {"mass": 1.0, "motors": [{}]}, {})
    assert "mass" not in text
    assert "position" not in text
    assert "position" not in template(4, "", {"frame": "quad-x"}, {})
    assert all(line.startswith("#") for line in text.strip().splitlines())
    assert "# [vehicle.rotor]\n# blades = ?" in template(None, "", {}, {})
