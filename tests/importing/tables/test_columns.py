"""Tables as people have them: rows before the names, units in brackets, no names at all, blackbox, MATLAB's structs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from tests.importing.log_writers import motion

TIME = np.arange(0.0, 8.0, 0.01)
KNOWN = motion(TIME)


def written(file: Path, before: str, header: str, columns: list[np.ndarray], mark: str = ",") -> Path:
    rows = "\n".join(mark.join(f"{x:.8g}" for x in row) for row in np.stack(columns, -1))
    file.write_text(before + (header + "\n" if header else "") + rows + "\n", encoding="utf-8")
    return file


def channels(file: Path, where: Path, given: object = None) -> dict[str, np.ndarray]:
    done = rotorid.import_log(file, where / "set", given)
    (flight,) = rotorid.load(done.folder).flights.values()
    return {name: values.numpy() for name, values in flight.channels.items()}


def near(found: dict[str, np.ndarray], tolerance: float = 1e-4, names: str = "p q phi") -> bool:
    return all(np.abs(found[n] - KNOWN[n])[2:-2].max() < tolerance for n in names.split())


ROWS = [TIME, KNOWN["motor1"] - 0.5, KNOWN["p"], KNOWN["q"], KNOWN["phi"]]
DEGREES = [TIME * 1e3, *ROWS[1:2], *(np.degrees(row) for row in ROWS[2:])]
NAMES = "time,lat,p,q,phi"


@pytest.mark.parametrize(
    ("before", "header", "mark"),
    [
        ("", NAMES, ","),
        ("Flight 7\nRecorder,X2\n\n", NAMES, ","),
        ('"Product","A recorder"\n"rate","100"\n"gains","1,2,3"\n', NAMES, ","),
        ("% a comment\n% another, with commas, in it\n", f"% {NAMES}", ","),
        ("".join(f"key{i};value {i}\n" for i in range(300)), NAMES.replace(",", ";"), ";"),
        ("Title of the table\n", " ".join(NAMES.split(",")), " "),
        ("", f"{NAMES}\ns,rad,rad/s,rad/s,rad", ","),
        ("Flight 8, of May\n", f"{NAMES}\ns,rad,rad/s,rad/s,rad", ","),
    ],
)
def test_rows_before_the_names_and_of_units(before: str, header: str, mark: str, tmp_path: Path):
    assert near(channels(written(tmp_path / "t.csv", before, header, ROWS, mark), tmp_path))


@pytest.mark.parametrize(
    ("header", "mark"),
    [
        ("time [ms],lat [rad],p [deg/s],q [deg/s],phi [deg]", ","),
        ("   time [ms]   lat [rad]  p [deg/s]   q [deg/s] phi [deg]", " "),
        ("time (ms)\tlat\tp (deg/s)\tq (deg/s)\tphi (deg)", "\t"),
        ("time[ms] lat[rad] p[deg/s] q[deg/s] phi[deg]", " "),
    ],
)
def test_units_in_the_header_are_believed(header: str, mark: str, tmp_path: Path):
    file = written(tmp_path / "t.txt", "", header, DEGREES, mark)
    assert near(channels(file, tmp_path))
    mapped = {"time": "time", "channels": {n: n for n in ("lat", "p", "q", "phi")}}
    assert near(channels(file, tmp_path, mapped))


@pytest.mark.parametrize("column", ["p/s", "p (deg)"])
def test_a_unit_in_a_header_that_does_not_fit_is_told_with_the_column(column: str, tmp_path: Path):
    file = written(tmp_path / "t.csv", "", NAMES.replace(",p,", f",{column},"), ROWS)
    with pytest.raises(InputError, match=re.escape(f"t.csv: '{column}': ") + r"'.*' does not measure p"):
        channels(file, tmp_path)


@pytest.mark.parametrize(
    "given",
    [
        {"columns": ["time", "lat", "p", "q", "phi"], "channels": {n: n for n in ("lat", "p", "q", "phi")}},
        {"time": {"field": 1}, "channels": {"lat": 2, "p": 3, "q": {"field": 4}, "phi": 5}},
        {"columns": ["time", "lat", "p", "q", "phi"]},
        {"columns": ["time", "stick"], "channels": {"lat": "stick", "p": "3", "q": "4", "phi": "5"}},
    ],
)
def test_tables_without_names_have_a_map_by_position(given: dict, tmp_path: Path):
    for ending in ("txt", "asc", "dat"):
        assert near(channels(written(tmp_path / f"t.{ending}", "", "", ROWS, " "), tmp_path, given))


def test_a_map_may_skip_rows(tmp_path: Path):
    before = "1,2,3,4,5\n6,7,8,9,10\n"
    file = written(tmp_path / "t.csv", before, "", ROWS)
    given = {"skip_rows": 2, "columns": NAMES.split(","), "channels": {n: n for n in ("lat", "p", "q", "phi")}}
    assert near(channels(file, tmp_path, given))
    with pytest.raises(InputError, match="has no row of names"):
        rotorid.import_log(file, tmp_path / "bare")


def box(header: str, low: float, high: float, time: str = "time", unit: str = "") -> tuple[str, str, list[np.ndarray]]:
    """A blackbox: rows before the names, the names, the columns."""
    gyros = [np.degrees(KNOWN["p"]), -np.degrees(KNOWN["q"]), -np.degrees(KNOWN["r"])]
    motors = [low + (high - low) * KNOWN[f"motor{i}"] for i in range(1, 5)]
    forces = [0.0 * TIME + 5.0 * np.sin(TIME), 3.0 * np.cos(TIME), 2048.0 + 10.0 * np.sin(TIME)]
    names = ["loopIteration", time, *(f"gyroADC[{i}]{unit}" for i in range(3)), *(f"motor[{i}]" for i in range(4))]
    names += [f"accSmooth[{i}]" for i in range(3)]
    return header, ",".join(f'"{name}"' for name in names), [TIME * 400, 5e7 + 1e6 * TIME, *gyros, *motors, *forces]


EXPLORER = '"Product","Blackbox flight data recorder"\n"firmwareVersion","4.4.0"\n"motorOutput","48,2047"\n'


@pytest.mark.parametrize(
    ("parts", "tolerance"),
    [
        (box(EXPLORER, 48.0, 2047.0), 1e-4),
        (box(EXPLORER.replace("48,2047", "158,2047"), 158.0, 2047.0), 1e-4),
        (box("", 48.0, 2047.0, "time (us)", " (deg/s)"), 1e-4),
        (box("", 1000.0, 2000.0, "time (us)"), 1e-4),
        (box('"minthrottle","1070"\n"maxthrottle","1950"\n', 1070.0, 1950.0), 1e-4),
    ],
)
def test_a_blackbox_needs_no_map(parts: tuple, tolerance: float, tmp_path: Path):
    found = channels(written(tmp_path / "t.csv", *parts[:2], parts[2]), tmp_path)
    assert near(found, tolerance, "p q r motor1 motor2 motor3 motor4")
    assert found["az"].mean() == pytest.approx(-9.81, abs=0.02)


def test_a_blackbox_of_a_helicopter(tmp_path: Path):
    names = ["loopIteration", "time (us)", *(f"gyroADC[{i}]" for i in range(3)), *(f"mixer[{i}]" for i in range(4))]
    gyros = [np.degrees(KNOWN["p"]), -np.degrees(KNOWN["q"]), -np.degrees(KNOWN["r"])]
    asked = [1000.0 * (KNOWN[f"motor{i}"] - 0.5) for i in range(1, 5)]
    columns = [TIME * 400, 1e6 * TIME, *gyros, *asked, 1800.0 + 10.0 * np.sin(TIME)]
    file = written(tmp_path / "t.csv", "", ",".join([*names, "headspeed"]), columns)
    found = channels(file, tmp_path)
    assert near(found, 1e-4, "p q r")
    assert np.abs(found["col"] - (KNOWN["motor4"] - 0.5)).max() < 1e-4
    assert found["omega"].mean() == pytest.approx(1800.0 * np.pi / 30.0, rel=0.01)


def test_a_blackbox_beyond_its_header_is_refused(tmp_path: Path):
    parts = box(EXPLORER.replace("48,2047", "1000,2000"), 48.0, 2047.0)
    with pytest.raises(InputError, match=r"motor\[0\] .motor1.: runs from .* to .*expected 1000 to 2000 .motorOutput"):
        channels(written(tmp_path / "t.csv", *parts[:2], parts[2]), tmp_path)


def test_a_blackbox_of_motors_that_turn_both_ways_is_refused(tmp_path: Path):
    parts = box(EXPLORER + '"features","4104"\n', 48.0, 2047.0)
    with pytest.raises(InputError, match="turns both ways, by features"):
        channels(written(tmp_path / "t.csv", *parts[:2], parts[2]), tmp_path)


def test_magnets_that_nothing_names_are_told(tmp_path: Path):
    _, header, columns = box("", 1000.0, 2000.0)
    table = written(tmp_path / "t.csv", "", header + ',"eRPM[0]"', [*columns, 100.0 + KNOWN["p"]])
    assert any("14 magnets" in told for told in rotorid.import_log(table, tmp_path / "set").warnings)
    table = written(tmp_path / "t.csv", '"motor_poles","12"\n', header + ',"eRPM[0]"', [*columns, 100.0 + KNOWN["p"]])
    assert not any("magnets" in told for told in rotorid.import_log(table, tmp_path / "set").warnings)


@pytest.mark.parametrize("name", ["eRPM[{}]", "eRPM(/100)[{}]"])
def test_speeds_of_a_blackbox_by_either_name(name: str, tmp_path: Path):
    before, header, columns = box(EXPLORER + '"motor_poles","12"\n', 48.0, 2047.0)
    header += "".join(f',"{name.format(i)}"' for i in range(4))
    turns = [60.0 * (1.0 + KNOWN[f"motor{i}"]) for i in range(1, 5)]
    speeds = channels(written(tmp_path / "t.csv", before, header, [*columns, *turns]), tmp_path)
    assert np.abs(speeds["omega2"] - turns[1] * 100.0 / 6.0 * np.pi / 30.0)[2:-2].max() < 0.1


# MATLAB


def test_sidpac_s_matrix_has_a_public_order(tmp_path: Path):
    import scipy.io

    fdata = np.zeros((len(TIME), 90))
    fdata[:, 0], fdata[:, 1] = TIME, 100.0 + np.sin(TIME)
    fdata[:, 2:4] = np.nan
    for i, name in enumerate(("p", "q", "r", "phi", "theta", "psi")):
        fdata[:, 4 + i] = np.degrees(KNOWN[name])
    fdata[:, 12], fdata[:, 13] = -1.0 + 0.01 * np.sin(TIME), np.degrees(0.1 * np.sin(2.0 * TIME))
    scipy.io.savemat(tmp_path / "s.mat", {"fdata": fdata, "t": TIME, "cbar": 2.0})
    found = channels(tmp_path / "s.mat", tmp_path)
    assert near(found, 1e-4, "p q r phi theta psi")
    assert np.abs(found["lon"] - 0.1 * np.sin(2.0 * TIME)).max() < 1e-6
    assert found["airspeed"].mean() == pytest.approx(0.3048 * 100.1, rel=0.01)
    assert found["az"].mean() == pytest.approx(-9.81, abs=0.05)
    assert "lat" not in found
    done = rotorid.import_log(tmp_path / "s.mat", tmp_path / "again")
    assert any("no data: beta alpha ax ay lat ped" in said for said in done.warnings)


def struct(kind: str) -> dict[str, object]:
    own = {"lat": KNOWN["motor1"] - 0.5, "p": KNOWN["p"], "q": KNOWN["q"], "phi": KNOWN["phi"]}
    matrix = np.stack([*own.values()], -1)
    names = np.array([*own], dtype=object)
    rows = [{"time": t, **{n: v[i] for n, v in own.items()}} for i, t in enumerate(TIME)]
    return {
        "members": {"tt": {"Time": TIME, **own}},
        "variables": {"tt": {"Time": TIME, "Variables": matrix, "VariableNames": names}},
        "properties": {"tt": {"Time": TIME, "Variables": matrix, "Properties": {"VariableNames": names}}},
        "rows": {"tt": np.array(rows, dtype=object)},
        "series": {"log": {n: {"Time": TIME, "Data": v} for n, v in own.items()}},
        "simulink": {"out": {"time": TIME, "signals": [{"values": v, "label": n} for n, v in own.items()]}},
    }[kind]


@pytest.mark.parametrize("kind", ["members", "variables", "properties", "rows", "series", "simulink"])
def test_timetables_and_time_series_saved_as_structs(kind: str, tmp_path: Path):
    import scipy.io

    scipy.io.savemat(tmp_path / "s.mat", struct(kind))
    assert near(channels(tmp_path / "s.mat", tmp_path), 1e-6)


def test_commands_that_step_from_rest_to_full_are_in_their_scale_on_a_slower_grid_too(tmp_path: Path):
    time = np.arange(0.0, 4.0, 2e-3)
    motors = [1.0 * (np.sin((2.0 + 0.1 * k) * time) > 0.0) for k in range(4)]
    names = "time,motor1,motor2,motor3,motor4,p,q,r"
    rates = [np.sin(2.0 * time + k) for k in range(3)]
    file = written(tmp_path / "t.csv", "", names, [time, *motors, *rates])
    checked = rotorid.check(rotorid.load(rotorid.import_log(file, tmp_path / "set").folder))
    assert not any("0…1" in one.sentence for one in checked.findings)
