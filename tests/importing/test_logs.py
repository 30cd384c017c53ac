"""Logs to data sets: known flights written in every format come back; what is bad is told in one line."""

from __future__ import annotations

import json
import re
import sys
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import rotorid_torch as rotorid
from rotorid_torch import cli
from rotorid_torch.commands.import_log import import_table
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.errors import InputError
from rotorid_torch.importing import flights
from rotorid_torch.importing.resample import on_grid
from rotorid_torch.importing.tables.csv import read_csv
from tests.fuzzing import older_topics, write_sdlog2
from tests.helpers import shared, small_folder
from tests.importing.log_writers import motion, px4_topics, write_dataflash, write_ulog

QUAD = {"MAV_TYPE": 2}
STICKS = {"lat": "motor1", "lon": "motor2", "col": "motor3", "ped": "motor4"}


def table(seconds: float = 10.0, hertz: float = 100.0, start: float = 0.0) -> dict[str, np.ndarray]:
    """A helicopter's flight as columns in SI."""
    time = np.arange(0.0, seconds, 1.0 / hertz)
    m = motion(time)
    sticks = {name: 0.2 * (m[motor] - 0.5) for name, motor in STICKS.items()}
    return {"time": start + time, **sticks, **{name: m[name] for name in ("p", "q", "r", "phi", "theta", "psi")}}


def csv(path: Path, columns: dict[str, np.ndarray], mark: str = ",") -> Path:
    rows = np.stack(list(columns.values()), -1)
    np.savetxt(path, rows, "%.10g", mark, header=mark.join(columns), comments="")
    return path


def close(dataset: rotorid.Dataset, names: str, tolerance: float, start: float = 0.0) -> None:
    """Whether channels are the known flight's, away from the ends."""
    (name,) = dataset.identify
    channels = dataset.flights[name].channels
    time = channels["time"].numpy()
    known, inside = motion(time + start), (time > 0.2) & (time < time[-1] - 0.2)
    for channel in names.split():
        assert np.abs(channels[channel].numpy() - known[channel])[inside].max() < tolerance, channel


def test_a_px4_log_comes_back_as_the_flight_it_was(tmp_path: Path):
    done = rotorid.import_log(write_ulog(tmp_path / "a b.ulg", px4_topics(), QUAD), tmp_path / "set")
    dataset = rotorid.load(done.folder)
    assert (dataset.kind, dataset.controls) == ("multirotor", ("motor1", "motor2", "motor3", "motor4"))
    assert dataset.identify == ("a_b",)
    assert done.rate == 250.0
    close(dataset, "p q r phi theta psi motor1 motor2 motor3 motor4", 3e-3)
    flight = dataset.flights["a_b"].channels
    from scipy.spatial.transform import Rotation

    known = motion(flight["time"].numpy())
    turned = Rotation.from_euler("ZYX", np.stack([known[n] for n in ("psi", "theta", "phi")], -1))
    body = turned.inv().apply(np.stack([known[n] for n in ("vn", "ve", "vd")], -1))
    middle = slice(100, -100)
    for i, name in enumerate("uvw"):
        assert np.abs(flight[name].numpy() - body[:, i])[middle].max() < 0.01
    assert done.channels["u"].source == ""
    assert done.channels["p"].source == "vehicle_angular_velocity.xyz[0]"
    console = Console(width=120, record=True, file=StringIO())
    console.print(import_table(done))
    text = console.export_text()
    assert re.search(r"p q r +│ rad/s │ vehicle_angular_velocity.xyz ", text)
    assert re.search(r"u v w +│ m/s +│ computed ", text)
    assert text.rstrip().endswith(f"Next: rotorid check {done.folder}")
    assert flight["height"][500] < 0.0 < flight["north"][500]
    assert check(dataset).dataset == "set"


def test_older_topics_instances_and_pulses(tmp_path: Path):
    topics = px4_topics()
    time, columns = topics.pop("actuator_motors")
    pulses = {f"output[{i}]": (1000.0 + 1000.0 * columns[f"control[{i}]"]).astype("<f4") for i in range(4)}
    pulses |= {f"output[{i}]": np.full(len(time), 900.0, "<f4") for i in range(4, 16)}
    rest = {name: np.full(len(time), 900.0, "<f4") for name in pulses}
    gyro_time, gyro = topics.pop("vehicle_angular_velocity")
    topics["sensor_combined"] = (gyro_time, {n.replace("xyz", "gyro_rad"): v for n, v in gyro.items()})
    topics |= {"actuator_outputs": (time, rest), "actuator_outputs[1]": (time, pulses)}
    done = rotorid.import_log(write_ulog(tmp_path / "a.ulg", topics, QUAD), tmp_path / "set")
    assert any("instances 0, 1: 1 is used" in told for told in done.warnings)
    close(rotorid.load(done.folder), "p q r motor1 motor2 motor3 motor4", 3e-3)


def copter(seconds: float = 10.0) -> dict[str, tuple]:
    """Messages of an ArduPilot quadrotor; outputs 3 and 4 drive motors 4 and 3."""

    def at(hertz: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        time = np.arange(0.0, seconds, 1.0 / hertz)
        return 50.0 + time, motion(time)

    time, m = at(200.0)
    forces = {f"Acc{a}": np.full(len(time), v, "<f4") for a, v in zip("XYZ", (0.0, 0.0, -9.81), strict=True)}
    topics: dict[str, tuple] = {
        "IMU": (time, {f"Gyr{a}": m[n].astype("<f4") for a, n in zip("XYZ", "pqr", strict=True)} | forces)
    }
    time, m = at(50.0)
    angles = {"Roll": "phi", "Pitch": "theta", "Yaw": "psi"}
    topics["ATT"] = (time, {name: np.degrees(m[key]).astype("<f4") for name, key in angles.items()})
    motors = {"C1": "motor1", "C2": "motor2", "C3": "motor4", "C4": "motor3"}
    topics["RCOU"] = (time, {name: np.round(1000 + 1000 * m[key]).astype("<u2") for name, key in motors.items()})
    return topics


FUNCTIONS = {"SERVO1_FUNCTION": 33, "SERVO2_FUNCTION": 34, "SERVO3_FUNCTION": 36, "SERVO4_FUNCTION": 35}


def test_an_ardupilot_log_comes_back_as_the_flight_it_was(tmp_path: Path):
    file = write_dataflash(tmp_path / "00000012.BIN", copter(), FUNCTIONS, "ArduCopter V4.5.7")
    done = rotorid.import_log(file, tmp_path / "set")
    assert done.rate == 200.0
    close(rotorid.load(done.folder), "p q r phi theta psi motor1 motor2 motor3 motor4", 6e-3)
    bare = write_dataflash(tmp_path / "bare.BIN", copter(), {}, "ArduCopter V4.5.7")
    assert any("no SERVOn_FUNCTION" in told for told in rotorid.import_log(bare, tmp_path / "bare").warnings)


def test_a_fixed_wing_is_told_in_one_line(tmp_path: Path, capsys):
    file = write_dataflash(tmp_path / "plane.bin", copter(), {}, "ArduPlane V4.0")
    assert cli.main(["import", str(file), "--out", str(tmp_path / "set")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "fixed wing" in told
    with pytest.raises(InputError, match="fixed wing"):
        rotorid.import_log(write_ulog(tmp_path / "p.ulg", px4_topics(3.0), {"MAV_TYPE": 1}), tmp_path / "set")
    assert not (tmp_path / "set").exists()


def test_the_real_log_of_a_fixed_wing_is_told_and_a_map_reads_it_nonetheless(tmp_path: Path):
    file = shared("flightdata", "logs", "ardupilot-plane.BIN")
    with pytest.raises(InputError, match=r"fixed wing \(ArduPlane V3\.8\.2-dev"):
        rotorid.import_log(file, tmp_path / "set")
    channels = {"lat": {"field": "RCOU.C1", "unit": "us"}, "p": "IMU.GyrX", "phi": {"field": "ATT.Roll", "unit": "deg"}}
    with pytest.raises(InputError, match=r"lasts \d\.?\d* s"):
        rotorid.import_log(file, tmp_path / "set", {"kind": "helicopter", "channels": channels})


def test_a_helicopter_of_ardupilot_has_its_sticks(tmp_path: Path):
    topics = copter()
    time, columns = topics.pop("RCOU")
    outputs = dict(zip(("ROut", "POut", "YOut", "AOut"), columns.values(), strict=True))
    topics["RATE"] = (time, {n: (v / 1000.0 - 1.5).astype("<f4") for n, v in outputs.items()})
    done = rotorid.import_log(write_dataflash(tmp_path / "h.bin", topics, {"FRAME_CLASS": 6}), tmp_path / "set")
    dataset = rotorid.load(done.folder)
    assert (dataset.kind, dataset.controls) == ("helicopter", ("lon", "lat", "col", "ped"))
    assert dataset.control_specs["lat"].unit == "norm"


def written(kind: str, folder: Path) -> Path:
    columns, file = table(), folder / f"flight.{kind}"
    if kind == "csv":
        return csv(file, columns)
    if kind == "txt":
        return csv(file, columns, "\t")
    if kind == "npz":
        np.savez(file, **columns)
    elif kind == "mat":
        import scipy.io

        scipy.io.savemat(file, columns)
    else:
        arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
        parquet.write_table(arrow.table(columns), file)
    return file


@pytest.mark.parametrize("kind", ["csv", "txt", "npz", "mat", "parquet"])
def test_tables_named_as_channels_need_no_map(tmp_path: Path, kind: str):
    done = rotorid.import_log(written(kind, tmp_path), tmp_path / "set")
    dataset = rotorid.load(done.folder)
    assert (done.rate, dataset.kind, dataset.controls) == (100.0, "helicopter", ("lon", "lat", "col", "ped"))
    close(dataset, "p q r phi theta psi", 1e-6)


MAP = """
time = { field = "t_ms", unit = "ms" }
[channels]
lat = { field = "stick", unit = "%", sign = -1, scale = 2.0, offset = 1.0 }
p = { field = "gx", unit = "deg/s" }
q = "gy"
r = { field = "gz", unit = "rpm" }
height = { field = "alt", unit = "ft" }
airspeed = { field = "ias", unit = "kn" }
mine = "gy"
"""


def mapped(folder: Path) -> tuple[Path, Path]:
    columns = {
        n: np.full(300, v)
        for n, v in {"stick": 20.0, "gx": 90.0, "gy": 0.5, "gz": 30.0, "alt": 100.0, "ias": 36.0}.items()
    }
    columns["stick"][::2] = 19.0
    columns = {"t_ms": 5000.0 + 20.0 * np.arange(300), **columns}
    (folder / "map.toml").write_text(MAP)
    return csv(folder / "odd.csv", columns), folder / "map.toml"


def test_a_map_gives_units_signs_scales_and_offsets(tmp_path: Path):
    file, toml = mapped(tmp_path)
    done = rotorid.import_log(file, tmp_path / "set", toml)
    dataset = rotorid.load(done.folder)
    with np.load(done.folder / "flights" / "odd.npz") as written:  # a data set leaves constant channels out
        last = {name: float(written[name][-2]) for name in written.files}
    assert last["lat"] == pytest.approx(-0.39)
    assert (last["p"], last["q"], last["r"]) == pytest.approx((np.pi / 2, 0.5, np.pi))
    assert (last["height"], last["airspeed"]) == pytest.approx((30.48, 18.52))
    assert dataset.control_specs["lat"].unit == "norm"
    assert any("'mine' is not known" in told for told in done.warnings)
    assert done.rate == 50.0


BAD_MAPS = {
    'field = "gx"': ('field = "gxx"', "there is no field 'gxx' (did you mean 'gx'?)"),
    'unit = "deg/s"': ('unit = "deg"', "'deg' does not measure p; expected one of rad/s"),
    'unit = "rpm"': ('unit = "rmp"', "'rmp' is not known (did you mean 'rpm'?)"),
    "sign = -1": ("sign = -2", "channels.lat.sign"),
    'field = "t_ms", unit = "ms"': ('field = "tms", unit = "ms"', "is missing (did you mean 't_ms'?)"),
    "scale = 2.0": ("scael = 2.0", "did you mean 'scale'?"),
    "[channels]": ("[channel]", "did you mean 'channels'?"),
    "lat = {": ("lta = {", "has no control that is known"),
    'q = "gy"': ("q = ", "is not TOML"),
}


@pytest.mark.parametrize("line", BAD_MAPS, ids=[told for _, told in BAD_MAPS.values()])
def test_bad_maps_are_told_in_one_line(tmp_path: Path, line: str, capsys):
    file, toml = mapped(tmp_path)
    toml.write_text(MAP.replace(line, BAD_MAPS[line][0], 1))
    assert cli.main(["import", str(file), "--out", str(tmp_path / "set"), "--map", str(toml)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert BAD_MAPS[line][1] in told
    assert not (tmp_path / "set").exists()


def test_an_unknown_topic_and_instance_in_a_map_of_a_flight_log(tmp_path: Path):
    file = write_ulog(tmp_path / "a.ulg", px4_topics(3.0), QUAD)
    for field, told in {
        "actuator_motor.control[0]": r"did you mean 'actuator_motors\.control\[0\]'",
        "actuator_motors[3].control[0]": "has actuator_motors",
        "actuator_motors.thrust_of_all": r"there are timestamp, control\[0\]",
    }.items():
        with pytest.raises(InputError, match=told):
            rotorid.import_log(file, tmp_path / "set", {"channels": {"motor1": field}})


def test_a_map_beside_the_built_in_one(tmp_path: Path):
    file = write_ulog(tmp_path / "a.ulg", px4_topics(3.0), QUAD)
    mapping = {"built_in": True, "channels": {"voltage": {"field": "battery_status.voltage_v", "unit": "mV"}}}
    with np.load(rotorid.import_log(file, tmp_path / "set", mapping).folder / "flights" / "a.npz") as written:
        channels = {name: written[name] for name in written.files}
    assert float(np.nanmean(channels["voltage"])) == pytest.approx(0.016)
    assert "motor4" in channels


def test_streams_of_one_flight_in_several_files(tmp_path: Path):
    fast, slow = table(hertz=200.0, start=7.0), table(hertz=40.0, start=7.0)
    imu = csv(tmp_path / "imu.csv", {name: fast[name] for name in ("time", "p", "q", "r")})
    sticks = csv(tmp_path / "sticks.csv", {"t": slow["time"], "x": slow["lat"]})
    mapping = {"together": True, "channels": {n: f"imu.{n}" for n in "pqr"} | {"lat": "sticks.x"}}
    dataset = rotorid.load(rotorid.import_log([imu, sticks], tmp_path / "set", mapping).folder)
    assert dataset.identify == ("imu",)
    close(dataset, "p q r", 2e-3)


def test_several_logs_are_flights_in_lists(tmp_path: Path):
    files = [
        csv(tmp_path / name / "log.csv", table(seconds))
        for name, seconds in (("a", 9.0), ("b", 8.0), ("c", 7.0))
        if not (tmp_path / name).mkdir()
    ]
    done = rotorid.import_log(files, tmp_path / "set")
    assert done.lists == {"identify": ["log"], "validate": ["log_2"], "acid": ["log_3"]}
    assert rotorid.load(done.folder).acid == ("log_3",)


def test_whole_flights_of_every_axis_are_in_identify(tmp_path: Path):
    """The only flight of an axis never is in acid; a second one of an axis may be."""
    files, time = [], np.arange(0.0, 30.0, 0.02)
    for number, axis in enumerate(("lat", "lat", "lat", "ped", "lon")):
        columns = {"time": time, **{stick: 1e-3 * np.sin(0.3 * time) for stick in ("lat", "lon", "ped")}}
        columns[axis] = 0.1 * np.sign(np.sin(time))
        files.append(csv(tmp_path / f"f{number}.csv", columns | {"p": np.sin(time)}))
    done = rotorid.import_log(files, tmp_path / "set")
    assert [moves for _, moves in done.flights.values()] == ["lat", "lat", "lat", "ped", "lon"]
    lists = done.lists
    assert {"f0", "f3", "f4"} <= {*lists["identify"]}
    assert sorted([*lists["validate"], *lists["acid"]]) == ["f1", "f2"]


def test_a_long_pause_makes_two_flights(tmp_path: Path):
    columns = table(20.0)
    columns["time"] = columns["time"] + 1e6 * (columns["time"] >= 12.0)
    done = rotorid.import_log(csv(tmp_path / "two.csv", columns), tmp_path / "set")
    assert {name: round(seconds) for name, (seconds, _) in done.flights.items()} == {"two_1": 12, "two_2": 8}


def test_what_was_declared_by_hand_survives_another_import(tmp_path: Path):
    log, place = csv(tmp_path / "one.csv", table()), tmp_path / "set"
    rotorid.import_log(log, place)
    assert not rotorid.import_log(log, place).warnings
    edited = (place / "dataset.toml").read_text(encoding="utf-8") + "\n# mine\n"
    (place / "dataset.toml").write_text(edited, encoding="utf-8")
    (told,) = rotorid.import_log(log, place).warnings
    assert told.endswith("what it declared is kept: dataset.before1.toml")
    rotorid.import_log(log, place)  # and another
    assert (place / "dataset.before1.toml").read_text(encoding="utf-8") == edited
    assert not (place / "dataset.before2.toml").exists()


def test_a_vehicle_filled_in_by_hand_stays_for_the_same_logs(tmp_path: Path):
    log, place = csv(tmp_path / "one.csv", table()), tmp_path / "set"
    rotorid.import_log(log, place)
    text = (place / "dataset.toml").read_text(encoding="utf-8")
    (place / "dataset.toml").write_text(text.replace("[vehicle]", "[vehicle]\nmass = 1.5"), encoding="utf-8")
    (told,) = rotorid.import_log(log, place, rate=25.0).warnings
    assert "its [vehicle] stays" in told
    assert rotorid.load(place).vehicle.mass == 1.5
    rotorid.import_log(csv(tmp_path / "two.csv", table()), place)
    assert rotorid.load(place).vehicle.mass is None


def test_question_marks_that_were_left_are_told_by_key(tmp_path: Path):
    place = rotorid.import_log(csv(tmp_path / "one.csv", table()), tmp_path / "set").folder
    file = place / "dataset.toml"
    file.write_text(file.read_text(encoding="utf-8").replace("# mass", "mass"), encoding="utf-8")
    with pytest.raises(InputError, match=r"dataset\.toml: mass: is \? in line \d+; expected numbers"):
        rotorid.load(place)


def test_a_mistake_in_a_map_s_vehicle_names_the_map(tmp_path: Path):
    file, toml = mapped(tmp_path)
    toml.write_text(toml.read_text() + "\n[vehicle]\nmass = -1.0\n")
    with pytest.raises(InputError, match=r"map\.toml: vehicle\.mass: "):
        rotorid.import_log(file, tmp_path / "set", toml)


def test_flights_that_leave_none_to_validate_by_are_told(tmp_path: Path):
    time = np.arange(0.0, 30.0, 0.02)
    for axis in ("lat", "lon"):
        columns = {stick: 1e-3 * np.sin(0.3 * time) for stick in ("lat", "lon")}
        columns[axis] = 0.1 * np.sign(np.sin(time))
        csv(tmp_path / f"{axis}.csv", {"time": time, "p": np.sin(time), **columns})
    done = rotorid.import_log([tmp_path / "lat.csv", tmp_path / "lon.csv"], tmp_path / "set")
    assert not done.lists["validate"]
    assert any(told.startswith("no flight is left for validate") for told in done.warnings)


def test_logs_of_two_vehicles_are_told(tmp_path: Path):
    four = write_ulog(tmp_path / "four.ulg", px4_topics(3.0), QUAD)
    other = write_ulog(tmp_path / "other.ulg", px4_topics(3.0), {**QUAD, "SYS_AUTOSTART": 5001})
    done = rotorid.import_log([four, other], tmp_path / "set")
    assert any(told.startswith("other.ulg: other motors or settings") for told in done.warnings)
    assert not any("other motors" in told for told in rotorid.import_log([four], tmp_path / "one").warnings)


def test_a_data_set_that_was_not_imported_stays(tmp_path: Path):
    place = small_folder(tmp_path / "mine")
    before = (place / "dataset.toml").read_text(encoding="utf-8")
    with pytest.raises(InputError, match="is not a data set whose description begins with 'Imported from'"):
        rotorid.import_log(csv(tmp_path / "one.csv", table()), place)
    assert (place / "dataset.toml").read_text(encoding="utf-8") == before


def test_a_log_inside_the_data_set_that_is_replaced_stays(tmp_path: Path):
    place = tmp_path / "set"
    flight = rotorid.import_log(csv(tmp_path / "one.csv", table()), place).folder / "flights" / "one.npz"
    before = flight.read_bytes()
    with pytest.raises(InputError, match=r"holds .*one\.npz, which is read"):
        rotorid.import_log(flight, place)
    (tmp_path / "link.npz").symlink_to(flight)
    with pytest.raises(InputError, match=r"holds .*link\.npz, which is read"):
        rotorid.import_log(tmp_path / "link.npz", place)
    assert flight.read_bytes() == before


def test_a_flight_among_many_goes_through_its_own_samples_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    columns, seen = table(40.0), []
    columns["time"] = columns["time"] + 100.0 * np.floor(columns["time"] / 4.0)

    def counted(time: np.ndarray, values: np.ndarray, grid: np.ndarray, *smooth: bool) -> np.ndarray:
        seen.append(len(time))
        return on_grid(time, values, grid, *smooth)

    monkeypatch.setattr(flights, "on_grid", counted)
    done = rotorid.import_log(csv(tmp_path / "ten.csv", columns), tmp_path / "set")
    assert len(done.flights) == 10
    assert max(seen) == 400


def test_split_finds_the_manoeuvres_and_shares_them_out(tmp_path: Path):
    time = np.arange(0.0, 160.0, 0.02)
    columns = {"time": time, **{name: np.zeros(len(time)) for name in (*STICKS, "p", "q", "r")}}
    order = ["lon", "lat", "col", "ped"] * 4
    for number, stick in enumerate(order):
        begin = 5.0 + 9.5 * number
        columns[stick] += 0.1 * ((time > begin) & (time < begin + 1)) - 0.1 * ((time > begin + 1) & (time < begin + 2))
    done = rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set", split=True)
    assert [kind for _, kind in done.flights.values()] == order
    assert [done.flights[name][1] for name in done.lists["identify"][:4]] == order[:4]
    assert {key: len(names) for key, names in done.lists.items()} == {"identify": 9, "validate": 3, "acid": 4}
    assert rotorid.load(done.folder).acid == tuple(done.lists["acid"])
    begins = [int(name.split("_")[1].rstrip("s")) for name in done.flights]
    assert np.abs(np.array(begins) - (3.0 + 9.5 * np.arange(16))).max() <= 1.0
    assert all(5.0 < seconds < 9.5 for seconds, _ in done.flights.values())


def test_nothing_moves_and_nothing_is_cut(tmp_path: Path):
    columns = table()
    columns |= {name: np.zeros(1000) for name in STICKS}
    done = rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set", split=True)
    assert list(done.flights) == ["f"]
    assert "not cut" in done.warnings[0]


def test_spikes_are_taken_out_and_named(tmp_path: Path):
    clean, spiked = table(), table()
    spiked["p"][[100, 500]] = 1e5, -3e38
    spiked["q"][200:210] = np.nan
    spiked["r"][300] = np.inf
    done = rotorid.import_log(csv(tmp_path / "f.csv", spiked), tmp_path / "set")
    assert any(
        "p reaches -3e+38 rad/s: 2 samples outside -100 to 100 rad/s taken as missing" in told for told in done.warnings
    )
    channels = rotorid.load(done.folder).flights["f"].channels
    assert np.nanmax(np.abs(channels["p"].numpy() - clean["p"])) < 1e-3
    assert int(channels["q"].isnan().sum()) == 10


def test_degrees_without_a_map_are_refused(tmp_path: Path):
    columns = table()
    columns["phi"] = 57.3 * columns["phi"]
    with pytest.raises(InputError, match=r"phi.*another unit"):
        rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set")
    columns["phi [deg]"] = columns.pop("phi")
    close(rotorid.load(rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set").folder), "phi", 2e-3)


CLOCKS = {
    "stands still": lambda t: 0.0 * t + 3.0,
    "runs back from": lambda t: np.where(np.arange(len(t)) // 5 % 2, t + 100.0, t),
    "repeats its stamps": lambda t: np.floor(t),
    "samples 10 s apart": lambda t: 1e3 * t,
    "has no stamp": lambda t: np.nan * t,
}


@pytest.mark.parametrize("told", CLOCKS)
def test_clocks_that_cannot_be_used(tmp_path: Path, told: str, capsys):
    columns = table()
    columns["time"] = CLOCKS[told](columns["time"])
    file = csv(tmp_path / "f.csv", columns)
    assert cli.main(["import", str(file), "--out", str(tmp_path / "set")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert told in error


def test_a_few_bad_stamps_are_left_out(tmp_path: Path):
    columns = table()
    columns["time"][[0, 400, 700]] = 1.7e9, 0.0, 1e12
    done = rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set")
    assert any("3 samples with a stamp that repeats or runs back" in told for told in done.warnings)
    close(rotorid.load(done.folder), "p q r", 1e-3, start=0.01)


def test_two_time_bases(tmp_path: Path):
    topics = px4_topics(4.0)
    time, columns = topics["actuator_motors"]
    other = {**topics, "actuator_motors": (time + 1e3, columns)}
    with pytest.raises(InputError, match=r"p runs from 100 to .* motor1 from .* on one clock"):
        rotorid.import_log(write_ulog(tmp_path / "a.ulg", other, QUAD), tmp_path / "set")
    time, columns = topics["battery_status"]
    topics["battery_status"] = (0.0 * time, columns)
    done = rotorid.import_log(write_ulog(tmp_path / "a.ulg", topics, QUAD), tmp_path / "set")
    assert any("voltage is left out: the clock of battery_status stands still" in told for told in done.warnings)


def test_empty_messages_are_no_channels(tmp_path: Path):
    topics = px4_topics(4.0)
    none = np.empty(0)
    topics["airspeed"] = (none, {"true_airspeed_m_s": none.astype("<f4")})
    topics = {
        "vehicle_acceleration": (np.array([100.0]), {f"xyz[{i}]": np.zeros(1, "<f4") for i in range(3)}),
        **topics,
    }
    file = tmp_path / "a.ulg"
    topics["airspeed"] = (np.array([100.0]), {"true_airspeed_m_s": np.array([np.nan], "<f4")})
    done = rotorid.import_log(write_ulog(file, topics, QUAD), tmp_path / "set")
    assert "airspeed" not in done.channels
    topics["actuator_motors"] = (np.array([100.0]), {f"control[{i}]": np.zeros(1, "<f4") for i in range(4)})
    with pytest.raises(InputError, match="actuator_motors"):
        rotorid.import_log(write_ulog(file, topics, QUAD), tmp_path / "set")


def test_missing_readers_name_their_extra(tmp_path: Path, monkeypatch, capsys):
    file = written("parquet", tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "pyarrow"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert cli.main(["import", str(file), "--out", str(tmp_path / "set")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "rotorid-torch[parquet]" in told


def test_hostile_arrays(tmp_path: Path):
    file = tmp_path / "x.npz"
    np.savez(file, time=np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="pickled"):
        rotorid.import_log(file, tmp_path / "set")
    np.savez(file, time=np.arange(9.0))
    content = file.read_bytes()
    at = content.index(b"(9,)")
    forged = content[:at] + b"(9999999999,)".ljust(4) + content[at + 4 + 9 :]
    file.write_bytes(forged)
    with pytest.raises(InputError):
        rotorid.import_log(file, tmp_path / "set")
    for name in ("x.npz", "x.mat", "x.parquet", "x.csv"):
        for content in (b"", b"\x00" * 700, bytes(range(256)) * 40, b"PK\x03\x04" + b"\xff" * 90):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(InputError):
                rotorid.import_log(tmp_path / name, tmp_path / "set")
    assert not (tmp_path / "set").exists()


def test_matlab_structs_are_topics_and_hdf5_is_told(tmp_path: Path):
    import scipy.io

    columns, file = table(), tmp_path / "f.mat"
    imu = {"t": columns["time"], "gyro": np.stack([columns[n] for n in "pqr"], 1)}
    inputs = {"t": columns["time"][::2], "stick": columns["lat"][::2]}
    scipy.io.savemat(file, {"log": {"imu": imu, "in": inputs, "note": "of May"}, "mass": 3.0}, do_compression=True)
    fields = {n: f"log.imu.gyro[{i}]" for i, n in enumerate("pqr")} | {"lat": "log.in.stick"}
    close(rotorid.load(rotorid.import_log(file, tmp_path / "set", {"channels": fields}).folder), "p q r", 1e-6)
    file.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + bytes(600))
    with pytest.raises(InputError, match=r"7\.3 \(HDF5\).*-v7"):
        rotorid.import_log(file, tmp_path / "set")


def test_csv_of_many_kinds(tmp_path: Path):
    columns, file = table(4.0), tmp_path / "f.csv"
    csv(file, columns)
    plain = file.read_text()
    header, *rows = plain.splitlines()
    german = [header.replace(",", ";"), *(row.replace(",", ";").replace(".", ",") for row in rows)]
    rows[7] = ",".join([*rows[7].split(",")[:-1], ""])
    units = ",".join(["s", *["furlong"] * (len(columns) - 1)])
    for text in (plain.replace("\n", "\r\n"), "\ufeff" + plain, "# " + plain, "\n".join(german)):
        file.write_text(text, newline="", encoding="utf-8")
        close(rotorid.load(rotorid.import_log(file, tmp_path / "set").folder), "p q r", 1e-6)
    file.write_text("\n".join(["", header, units, *rows, rows[-1][:20]]))
    done = rotorid.import_log(file, tmp_path / "set")
    assert any("line 3 holds no numbers" in told for told in done.warnings)
    assert any("the last, is cut" in told for told in done.warnings)
    close(rotorid.load(done.folder), "p q r psi", 1e-4)
    small = read_csv(file, lambda topic, names: names, block=300)
    whole = read_csv(file, lambda topic, names: names)
    assert np.isnan(whole.streams["", 0].columns["psi"]).sum() == 1
    assert np.array_equal(small.streams["", 0].columns["p"], whole.streams["", 0].columns["p"])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty"),
        ("time,lat\n1,2,3\n2,3,4\n", "line 2: has another number of fields"),
        ("time,lat\n0,1\n0.1,one\n0.2,2\n", "lat: is 'one' in line 3"),
        ("a,b\n1,2\n", "time: is missing"),
        ("p,p,time\n1,2,3\n", "p: is twice in the header"),
        ("1,2,3\n1,2,3\n", "has no row of names"),
        ("time,lat\n0,0.1\n0.5,0.2\n", "lasts 0.5 s"),
    ],
)
def test_bad_csv_is_told_with_its_line(tmp_path: Path, text: str, told: str):
    (tmp_path / "f.csv").write_text(text)
    with pytest.raises(InputError) as error:
        rotorid.import_log(tmp_path / "f.csv", tmp_path / "set")
    assert told in str(error.value)


@pytest.mark.parametrize("ending", ["csv", "ulg", "bin"])
def test_names_of_files_lead_nowhere(tmp_path: Path, ending: str):
    name = f"..évil {chr(7)}; rm.{ending}"
    files = {"csv": lambda f: csv(f, table()), "ulg": lambda f: write_ulog(f, px4_topics(3.0), QUAD)}
    files["bin"] = lambda f: write_dataflash(f, copter(3.0), FUNCTIONS)
    done = rotorid.import_log(files[ending](tmp_path / name), tmp_path / "set")
    assert list(done.flights) == ["vil_rm"]
    assert [file.name for file in (done.folder / "flights").iterdir()] == ["vil_rm.npz"]


def test_usage(tmp_path: Path, capsys):
    file = csv(tmp_path / "f.csv", table())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").touch()
    for words, told in (
        ([file, "--out", tmp_path / "mine"], "not a data set"),
        ([file, "--out", tmp_path / "set", "--rate", "0"], "out of range"),
        ([tmp_path / "no.csv", "--out", tmp_path / "set"], "no such file"),
        ([tmp_path / "f.xlsx", "--out", tmp_path / "set"], "no such file"),
        ([tmp_path / "mine", "--out", tmp_path / "set"], "is a folder"),
        ([file, "--out", tmp_path / "set", "--map", tmp_path / "no.toml"], "no such file"),
    ):
        assert cli.main(["import", *map(str, words)]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert told in error
    assert not (tmp_path / "set").exists()
    assert cli.main(["import", str(file), "--out", str(tmp_path / "set"), "--rate", "50", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["rate_hz"] == 50.0
    assert answer["lists"]["identify"] == ["f"]
    assert cli.main(["import", str(file), "--out", str(tmp_path / "set")]) == 0
    assert "data set:" in capsys.readouterr().out


LOGS = {
    "px4-cube-vtol-bench.ulg": (6.4, "is a VTOL"),
    "px4-appended.ulg": (9.5, "recorded at"),
    "px4-quad-sitl-takeoff.ulg": (31.1, "left out: recorded less often"),
    "px4-quad-sdlog2.px4log": (28.8, "vn, ve, north, east left out: never changes"),
}


@pytest.mark.parametrize("name", LOGS)
def test_real_logs_become_data_sets(name: str, tmp_path: Path):
    done = rotorid.import_log(shared("flightdata", "logs", name), tmp_path / "set", rate=100.0)
    dataset = rotorid.load(done.folder)
    (flight,) = dataset.flights.values()
    seconds, told = LOGS[name]
    assert flight.samples * flight.dt == pytest.approx(seconds, abs=0.1)
    assert any(told in sentence for sentence in done.warnings)
    assert flight.has("p", "q", "r", "phi", "theta", "psi", "ax", "ay", "az", "motor4", "height")
    if name == "px4-quad-sitl-takeoff.ulg":  # its settings place the motors: front right, back left, front left, ...
        motors = dataset.vehicle.motors
        assert [motor.spin for motor in motors] == ["ccw", "ccw", "cw", "cw"]
        assert motors[0].position == (0.1515, 0.245, 0.0)
    assert flight.has("u", "v", "w") == (name == "px4-quad-sitl-takeoff.ulg")  # the others had no receiver: not valid
    assert float(flight.channels["az"].nanmean()) == pytest.approx(-9.8, abs=0.3)


def test_memory_does_not_grow_with_topics_that_nobody_wants(tmp_path: Path):
    """Peak of a log of 40 MB, nine tenths of it unwanted, against the wanted columns: a few blocks beyond them."""
    import tracemalloc

    from rotorid_torch.importing import formats
    from rotorid_torch.importing.autopilots import ulog

    topics = px4_topics(20.0)
    time = np.arange(100.0, 120.0, 1e-3)
    topics["sensor_gyro_fifo"] = (time, {f"v[{i}]": np.zeros(len(time), "<f4") for i in range(200)})
    file = write_ulog(tmp_path / "a.ulg", topics, QUAD)
    peaks = []
    for repeat in (1, 2):
        file = write_ulog(tmp_path / "a.ulg", topics, QUAD, repeat)
        tracemalloc.start()
        ulog.read_ulog(file, lambda topic, names: formats.built_in_fields(topic, list(names)), block=2**20)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    wanted = file.stat().st_size / 2 - 808 * len(time)
    assert peaks[1] - peaks[0] < 3.0 * wanted
    assert peaks[1] < 0.2 * file.stat().st_size


@pytest.mark.parametrize("old", [b"Out0", b"Out2", b"Out3"])
def test_an_output_that_lost_its_label_is_missed(tmp_path: Path, old: bytes):
    file = write_sdlog2(tmp_path / "a.px4log", older_topics())
    file.write_bytes(file.read_bytes().replace(old, b"Name"))
    with pytest.raises(InputError, match=rf"OUT0\.{old.decode()}: is missing"):
        rotorid.import_log(file, tmp_path / "set")


def test_a_motor_output_that_lost_its_label_is_missed(tmp_path: Path):
    file = write_dataflash(tmp_path / "a.bin", copter(3.0), FUNCTIONS)
    file.write_bytes(file.read_bytes().replace(b"C1,C2,C3", b"C1,CX,C3"))
    with pytest.raises(InputError, match=r"RCOU\.C2: is missing"):
        rotorid.import_log(file, tmp_path / "set")


def test_a_message_with_the_name_of_another_one_is_passed_over(tmp_path: Path):
    file = write_dataflash(tmp_path / "a.bin", copter(3.0), FUNCTIONS)
    file.write_bytes(file.read_bytes().replace(b"ATT\x00", b"IMU\x00"))
    done = rotorid.import_log(file, tmp_path / "set")
    assert any("unknown form were passed over (IMU)" in told for told in done.warnings)
    assert done.channels["p"].source == "IMU.GyrX"
    assert "phi" not in done.channels


def test_pulses_that_no_servo_takes_are_no_commands(tmp_path: Path):
    topics = copter(3.0)
    time, columns = topics["RCOU"]
    columns["C2"][40:42] = 0, 2200  # none, and a little too long
    columns["C1"][40] = 65535
    topics["RCOU"] = (time, columns)
    done = rotorid.import_log(write_dataflash(tmp_path / "a.bin", topics, FUNCTIONS), tmp_path / "set")
    assert any(told.startswith("a.bin: motor1 reaches 64.5") for told in done.warnings)
    channels = rotorid.load(done.folder).flights["a"].channels
    assert float(channels["motor2"].nan_to_num().min()) >= 0.0
    assert float(channels["motor1"].nan_to_num().max()) <= 1.0


def test_infinite_samples_are_told(tmp_path: Path):
    columns = table()
    columns["lat"][300] = np.inf
    done = rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set")
    assert any("lat reaches inf" in told for told in done.warnings)


@pytest.mark.parametrize("letters", [("Qfff", "Qnff"), ("Qfff", "nfff"), ("QHHHH", "QHnHH"), ("Qffffff", "Qfnffff")])
def test_columns_that_a_damaged_format_makes_text(tmp_path: Path, letters: tuple[str, str]):
    """Whatever becomes of the lengths: a data set without the channel, or one line."""
    old, new = (letter.encode().ljust(16, b"\0") for letter in letters)
    file = write_dataflash(tmp_path / "a.bin", copter(3.0), FUNCTIONS)
    assert old in file.read_bytes()
    file.write_bytes(file.read_bytes().replace(old, new))
    assert cli.main(["import", str(file), "--out", str(tmp_path / "set")]) in (0, 2)


def test_outputs_that_a_damaged_format_makes_text(tmp_path: Path):
    file = write_sdlog2(tmp_path / "a.px4log", older_topics())
    file.write_bytes(file.read_bytes().replace(b"ffffffff".ljust(16, b"\0"), b"fnffffff".ljust(16, b"\0")))
    with pytest.raises(InputError, match=r"OUT0\.Out1: is missing"):
        rotorid.import_log(file, tmp_path / "set")


def test_an_even_record_stays_as_it_was_sampled(tmp_path: Path):
    """Between the samples lie means of two, whose noise is smaller."""
    columns = table(hertz=154.0)
    columns["p"] = columns["p"] + 0.01 * np.random.default_rng(0).standard_normal(len(columns["p"]))
    done = rotorid.import_log(csv(tmp_path / "even.csv", columns), tmp_path / "DATASET")
    flight = rotorid.load(done.folder)["even"]
    np.testing.assert_allclose(flight["p"].numpy(), columns["p"][: flight.samples], atol=1e-6)
