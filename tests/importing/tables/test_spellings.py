"""Tables as other programs write them: units in the names, encodings, decimal commas, exponents, columns of words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from tests.importing.log_writers import quaternion
from tests.importing.tables.test_columns import KNOWN, TIME, channels, near

ANGULAR = ("p", "q", "r", "phi", "theta", "psi")
MOTORS = [f"motor{i}" for i in range(1, 5)]


def plain(degrees: bool = False) -> dict[str, np.ndarray]:
    return {
        "time": TIME,
        **{name: np.degrees(KNOWN[name]) if degrees else KNOWN[name] for name in ANGULAR},
        **{name: KNOWN[name] for name in MOTORS},
    }


def text(columns: dict[str, object], mark: str = ",", before: str = "", header: str = "") -> str:
    rows = [[v[i] if isinstance(v[i], str) else f"{v[i]:.9g}" for v in columns.values()] for i in range(len(TIME))]
    return before + "\n".join([header or mark.join(columns), *(mark.join(row) for row in rows)]) + "\n"


NAMES = [*ANGULAR, *MOTORS]
UNITS = {
    "capitals": ["TIME (sec)", "P (deg/sec)", "Q (deg/sec)", "R (DEG/S)", "PHI (deg)", "THETA (deg)", "PSI (deg)"],
    "commas": ['"time, s"', '"p, deg/s"', '"q, deg/s"', '"r, deg/s"', '"phi, deg"', '"theta, deg"', '"psi, deg"'],
    "strokes": ["time / s", "p / (deg/s)", "q / (deg/s)", "r / (deg/s)", "phi / deg", "theta / deg", "psi / deg"],
    "braces": ["time {s}", "p {deg/s}", "q {deg/s}", "r {deg/s}", "phi {deg}", "theta {deg}", "psi {deg}"],
    "in the name": ["time_s", "p_degps", "q_deg_s", "r_dps", "phi_deg", "theta_deg", "psi_deg"],
    "powers": ["time [s]", "p [deg.s-1]", "q [deg s^-1]", "r [deg·s⁻¹]", "phi [deg]", "theta [deg]", "psi [deg]"],
    "words": [
        "time",
        "p (degrees/second)",
        "q [degrees per sec]",
        "r (Deg per S)",
        "phi (degs)",
        "theta (degree)",
        "psi_deg",
    ],
    "short": ["t [sec]", "p [dps]", "q [dps]", "r [dps]", "phi [deg]", "theta [deg]", "psi [deg]"],
}


@pytest.mark.parametrize("form", UNITS)
def test_units_are_believed_however_they_are_written(form: str, tmp_path: Path):
    motors = [name.upper() if form == "capitals" else name for name in MOTORS]
    (tmp_path / "t.csv").write_text(text(plain(degrees=True), header=",".join([*UNITS[form], *motors])))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-4, " ".join(NAMES))


@pytest.mark.parametrize("form", ["{} ({})", "{} [{}]", "{}, {}", "{} / {}"])
def test_units_are_believed_behind_names_of_several_words(form: str, tmp_path: Path):
    words = ["Roll Rate", "Pitch  Rate", "Rate of Yaw", "Roll Att. 1", "Pitch", "Heading of Nose"]
    header = [f'"{form.format(*pair)}"' for pair in zip(words, 3 * ["deg/s"] + 3 * ["deg"], strict=True)]
    (tmp_path / "t.csv").write_text(text(plain(degrees=True), header=",".join(["Time (s)", *header, *MOTORS])))
    fields = [field.strip('"') for field in header]
    mapping = {"channels": dict(zip(ANGULAR, [*fields[:3], *words[3:]], strict=True)) | {m: m for m in MOTORS}}
    assert near(channels(tmp_path / "t.csv", tmp_path, mapping), 1e-4, " ".join(NAMES))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "latin-1"])
def test_encodings_of_spreadsheets(encoding: str, tmp_path: Path):
    units = ["time", "p [°/s]", "q [°/s]", "r [°/s]", "phi [°]", "theta [°]", "psi [°]", *MOTORS]
    before = b"\xfe\xff" if encoding == "utf-16-be" else b""
    content = text(plain(degrees=True), "\t", header="\t".join(units))
    (tmp_path / "t.txt").write_bytes(before + content.encode(encoding))
    assert near(channels(tmp_path / "t.txt", tmp_path), 1e-4, " ".join(NAMES))


def test_rows_that_end_without_line_feeds(tmp_path: Path):
    (tmp_path / "t.csv").write_bytes(text(plain()).replace("\n", "\r").encode())
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-4, " ".join(NAMES))


@pytest.mark.parametrize("mark", ["\t", ";"])
@pytest.mark.parametrize("before", ["", "Flight;7\nof May\n\n"])
def test_decimal_commas(mark: str, before: str, tmp_path: Path):
    (tmp_path / "t.txt").write_text(text(plain(), mark, before).replace(".", ","))
    assert near(channels(tmp_path / "t.txt", tmp_path), 1e-4, " ".join(NAMES))


@pytest.mark.parametrize(
    ("mark", "group", "point"), [(";", ".", ","), (";", ",", "."), (",", ",", "."), (",", ".", ",")]
)
def test_thousands(mark: str, group: str, point: str, tmp_path: Path):
    def written(value: float) -> str:
        digits = f"{value:,.4f}".translate({44: group, 46: point, 45: "\u2212" if group > "a" else "-"})
        return f'"{digits}"' if mark == "," else digits

    columns = plain() | {"height": 1500.0 + KNOWN["p"]}
    (tmp_path / "t.csv").write_text(text({n: list(map(written, v)) for n, v in columns.items()}, mark))
    found = channels(tmp_path / "t.csv", tmp_path)
    assert near(found, 1e-3, " ".join(NAMES))
    assert np.abs(found["height"] - columns["height"])[2:-2].max() < 1e-3


@pytest.mark.parametrize("mark", ["|", " | "])
def test_strokes_between_columns(mark: str, tmp_path: Path):
    rows = text(plain(), mark).replace("\n", f"{mark.rstrip()}\n")
    (tmp_path / "t.txt").write_text(rows)
    assert near(channels(tmp_path / "t.txt", tmp_path), 1e-4, " ".join(NAMES))


@pytest.mark.parametrize("mark", [",", "\t", " "])
@pytest.mark.parametrize("before", ["", "# of May, in calm air\n# by X\n#\n"])
@pytest.mark.parametrize("units", ["", "# s deg/s deg/s deg/s deg deg deg - - - -\n"])
def test_names_between_blanks_above_other_marks(mark: str, before: str, units: str, tmp_path: Path):
    written = text(plain(degrees=bool(units)), mark, before, "# " + " ".join(plain()))
    head = "# " + " ".join(plain()) + "\n"
    (tmp_path / "t.txt").write_text(written.replace(head, head + units))
    assert near(channels(tmp_path / "t.txt", tmp_path), 1e-4, " ".join(NAMES))


def test_groups_above_the_names(tmp_path: Path):
    groups = ",".join(["clock", *["IMU"] * 3, *["EKF"] * 3, *["OUT"] * 4])
    (tmp_path / "t.csv").write_text(text(plain(), before=f"{groups}\n"))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-4, " ".join(NAMES))


def test_a_number_without_a_unit_has_a_dash(tmp_path: Path):
    names = [f"{name} [-]" if name in MOTORS else name for name in plain()]
    (tmp_path / "t.csv").write_text(text(plain(), header=",".join(names)))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-4, " ".join(NAMES))


@pytest.mark.parametrize("header", ["time [min]", "t (min)", "time"])
def test_a_clock_in_minutes(header: str, tmp_path: Path):
    units = "" if "m" in header[4:] else "min,rad/s,rad/s,rad/s,rad,rad,rad,-,-,-,-\n"
    columns = {header if n == "time" else n: v / 60.0 if n == "time" else v for n, v in plain().items()}
    (tmp_path / "t.csv").write_text(text(columns).replace("\n", "\n" + units, 1))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-4, " ".join(NAMES))


@pytest.mark.parametrize("letter", ["D", "d"])
def test_exponents_of_fortran(letter: str, tmp_path: Path):
    rows = [" ".join(f"{v[i]:16.9E}".replace("E", letter) for v in plain().values()) for i in range(len(TIME))]
    (tmp_path / "t.asc").write_text("\n".join([" ".join(plain()), *rows]) + "\n")
    assert near(channels(tmp_path / "t.asc", tmp_path), 1e-4, " ".join(NAMES))


@pytest.mark.parametrize("before", ["", "Flight 7\nDate,2026-01-01\n\n", '"gains","40,30,23"\n"rate","100"\n'])
def test_columns_of_words_beside_the_numbers(before: str, tmp_path: Path):
    (tmp_path / "t.csv").write_text(text(plain() | {"mode": ["HOVER"] * len(TIME)}, before=before))
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-4, " ".join(NAMES))


def test_columns_that_are_no_channels_are_told(tmp_path: Path):
    names = [{"p": "Roll Rate", "q": "q [furlong]", "phi": "phi_m"}.get(name, name) for name in plain()]
    (tmp_path / "t.csv").write_text(text(plain(), header=",".join(names)))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set")
    told, hint = done.warnings
    assert 'p = { field = "Roll Rate", unit = ... }' in hint
    assert told.endswith("left out, for no channel has such a name and unit: Roll Rate, q [furlong], phi_m")


@pytest.mark.parametrize(("unit", "of_a_degree"), [("", 1.0), (" [deg]", 1.0), (" [rad]", np.pi / 180.0)])
def test_latitude_and_longitude_are_no_sticks(unit: str, of_a_degree: float, tmp_path: Path):
    degrees = {"lat": 0.8 + 1e-5 * TIME, "lon": 0.1 + 1e-6 * TIME}
    place = {"time": TIME, **{f"{name}{unit}": of_a_degree * values for name, values in degrees.items()}}
    (tmp_path / "t.csv").write_text(text(place | plain()))
    found = channels(tmp_path / "t.csv", tmp_path)
    assert {"north", "east"} <= found.keys()
    assert found.keys().isdisjoint(("lat", "lon"))
    assert found["north"][-1] - found["north"][0] == pytest.approx(110_574.0 * 1e-5 * TIME[-1], rel=0.01)


def test_words_after_the_numbers_and_names_once_more_are_left_out(tmp_path: Path):
    whole = text(plain()).splitlines()
    lines = [*whole[:401], whole[0], "", *whole[401:], "", "END OF LOG", "rows 800"]
    (tmp_path / "t.csv").write_text("\n".join(lines))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set")
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-4, " ".join(MOTORS))
    assert any("hold no numbers and were left out" in told for told in done.warnings)
    (tmp_path / "t.csv").write_text("\n".join([*whole[:401], "1,2", *whole[401:]]))
    with pytest.raises(InputError, match="another number of fields"):
        rotorid.import_log(tmp_path / "t.csv", tmp_path / "again")


def test_a_matrix_omega_of_three_columns_beside_four_motors_is_a_vector(tmp_path: Path):
    matrices = {"omega": np.stack([KNOWN[c] for c in "pqr"], -1), "motor": np.stack([KNOWN[m] for m in MOTORS], -1)}
    np.savez(tmp_path / "t.npz", time=TIME, **matrices)
    done = rotorid.import_log(tmp_path / "t.npz", tmp_path / "set")
    assert {*rotorid.load(done.folder).flights["t"].channels} == {"time", *MOTORS}
    assert any('p = { field = "omega[0]", unit = ... }' in told for told in done.warnings)


def test_places_in_whole_counts_are_degrees(tmp_path: Path):
    columns = plain() | {"lat": np.round(1e7 * (47.3 + 1e-5 * TIME)), "lon": np.round(1e7 * (8.5 + 1e-6 * TIME))}
    (tmp_path / "t.csv").write_text(text(columns))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set")
    north = rotorid.load(done.folder).flights["t"].channels["north"].numpy()
    assert north[-1] - north[0] == pytest.approx(111_170.0 * 1e-5 * TIME[-1], rel=0.01)
    assert any("counts of 1e-07 degrees" in told for told in done.warnings)


@pytest.mark.parametrize(("share", "taken"), [(1.0, True), (100.0, False)])
def test_controls_in_percent_that_are_shares_of_one(share: float, taken: bool, tmp_path: Path):
    columns = {f"{n} [%]" if n in MOTORS else n: share * v if n in MOTORS else v for n, v in plain().items()}
    (tmp_path / "t.csv").write_text(text(columns))
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set")
    assert any("shares of 1 and no percent" in told for told in done.warnings) == taken
    assert near(channels(tmp_path / "t.csv", tmp_path), 1e-4, " ".join(MOTORS))


def test_units_that_nothing_else_tells_are_told(tmp_path: Path):
    columns = plain() | {f"omega{i}": 900.0 * KNOWN[f"motor{i}"] for i in (1, 2)} | {"omega3 [rpm]": KNOWN["motor3"]}
    (tmp_path / "t.csv").write_text(text(columns))
    (told,) = (w for w in rotorid.import_log(tmp_path / "t.csv", tmp_path / "set").warnings if "no header says" in w)
    assert "no header says a unit: omega1, omega2 taken in rad/s" in told
    assert "omega3" not in told


def test_speeds_that_no_rotor_has_in_radians_are_rpm_and_those_between_are_asked_for(tmp_path: Path):
    for speed, name in ((40_000.0, "omega1"), (6000.0, "omega1"), (258.0, "omega")):
        (tmp_path / "t.csv").write_text(text(plain() | {name: speed * (1.0 + 0.01 * KNOWN["p"])}))
        if speed > 10_000.0:
            assert np.median(channels(tmp_path / "t.csv", tmp_path)[name]) == pytest.approx(4189.0, rel=1e-2)
            continue
        with pytest.raises(InputError, match=rf"{name}: has no unit.*{name} \[rpm\] or \[rad/s\]"):
            channels(tmp_path / "t.csv", tmp_path)


@pytest.mark.parametrize(("size", "told"), [(0.3, False), (0.9, True)])
def test_sticks_that_move_farther_than_blades(size: float, told: bool, tmp_path: Path):
    columns = {n: v for n, v in plain().items() if n not in MOTORS} | {"lon": size * np.sin(TIME)}
    (tmp_path / "t.csv").write_text(text(columns))
    warned = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set").warnings
    assert any("lon taken in rad of a blade (else write lon [%])" in w for w in warned) == told


def test_motors_and_speeds_that_are_counted_from_zero(tmp_path: Path):
    columns = {n: v for n, v in plain().items() if not n.startswith("motor")}
    columns |= {f"motor{i}": KNOWN[f"motor{i + 1}"] for i in range(4)}
    columns |= {f"omega{i} [rpm]": 6000.0 * KNOWN[f"motor{i + 1}"] for i in range(4)}
    (tmp_path / "t.csv").write_text(text(columns))
    found = channels(tmp_path / "t.csv", tmp_path)
    assert near(found, 1e-4, " ".join(MOTORS))
    assert np.abs(found["omega4"] - 200.0 * np.pi * KNOWN["motor4"])[2:-2].max() < 0.1
    assert "motor0" not in found


def test_quaternions_and_velocities_to_north_need_no_map(tmp_path: Path):
    turned = quaternion(KNOWN["phi"], KNOWN["theta"], KNOWN["psi"])
    columns = {n: v for n, v in plain().items() if n not in ("phi", "theta", "psi")}
    columns |= {f"q{i}": turned[i] for i in range(4)} | {n: KNOWN[n] for n in ("vn", "ve", "vd")}
    (tmp_path / "t.csv").write_text(text(columns))
    found = channels(tmp_path / "t.csv", tmp_path)
    assert near(found, 1e-4, "phi theta psi")
    speed = np.sqrt(sum(KNOWN[n] ** 2 for n in ("vn", "ve", "vd")))
    assert np.abs(np.sqrt(sum(found[n] ** 2 for n in "uvw")) - speed)[2:-2].max() < 1e-3
    assert found["w"].mean() != pytest.approx(0.0, abs=1e-6)


# blackbox


def box(gyro: str = "gyroADC[{}]", rate: float = 180.0 / np.pi, force: str = "accSmooth[{}]", g: float = 2048.0):
    columns = {"loopIteration": TIME * 400.0, "time (us)": 1e6 * (TIME + 50.0)}
    columns |= {gyro.format(i): rate * KNOWN[n] * (1 if i == 0 else -1) for i, n in enumerate("pqr")}
    columns |= {f"motor[{i}]": 1000.0 + 1000.0 * KNOWN[f"motor{i + 1}"] for i in range(4)}
    return columns | {force.format(i): g * (v + 0.01 * np.sin(TIME)) for i, v in enumerate((0.0, 0.0, 1.0))}


def blackbox(tmp_path: Path, columns: dict[str, object], before: str = "", names: str = "p q r motor1 motor4"):
    (tmp_path / "t.csv").write_text(text(columns, before=before))
    found = channels(tmp_path / "t.csv", tmp_path)
    assert near(found, 1e-3, names)
    assert found["az"].mean() == pytest.approx(-9.81, abs=0.05)
    return found


@pytest.mark.parametrize(
    "columns",
    [
        box("gyroADC[{}] (rad/s)", 1.0),
        box("gyroADC[{}] (deg/s)", force="accSmooth[{}] (g)", g=1.0),
        box(force="accSmooth[{}] (m/s/s)", g=9.80665),
        {n.replace("(us)", "(s)"): v * (1e-6 if "time" in n else 1.0) for n, v in box().items()},
        box() | {"flightModeFlags (flags)": ["ANGLE_MODE|ARM"] * len(TIME)},
    ],
)
def test_a_blackbox_in_the_units_of_the_decoder(columns: dict, tmp_path: Path):
    blackbox(tmp_path, columns)


@pytest.mark.parametrize("line", ['"gyroScale","1.0642252e-9"', '"gyro.scale","0x3d79c190"'])
def test_gyros_of_older_firmware_are_counts_of_a_scale(line: str, tmp_path: Path):
    """16.4 counts for a deg/s."""
    before = f'"Product","Blackbox"\n"firmwareType","Cleanflight"\n{line}\n"acc_1G","4096"\n"minthrottle","1000"\n'
    blackbox(tmp_path, box("gyroData[{}]", 16.4 * 180.0 / np.pi, g=4096.0), before)


def test_gyros_of_a_blackbox_in_high_resolution(tmp_path: Path):
    before = '"Product","Blackbox"\n"gyro_scale","0x3f800000"\n"blackbox_high_resolution","1"\n'
    blackbox(tmp_path, box(rate=1800.0 / np.pi), before)
    in_degrees = box("gyroADC[{}] (deg/s)")  # of a decoder that has taken it out
    blackbox(tmp_path, in_degrees, before)


@pytest.mark.parametrize(
    ("force", "before", "told"),
    [
        ("accSmooth[{}]", "", True),
        ("accSmooth[{}]", '"Product","x"\n"acc_1G","2048"\n', False),
        ("accSmooth[{}] (g)", "", False),
    ],
)
def test_counts_of_an_accelerometer_that_nothing_names_are_told(force: str, before: str, told: bool, tmp_path: Path):
    columns = box(force=force, g=1.0 if "(g)" in force else 2048.0)
    (tmp_path / "t.csv").write_text(text(columns, before=before))
    warned = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set").warnings
    assert any(w.startswith("t.csv: ax, ay, az: 2048 counts for 1 g, by default") for w in warned) == told


def test_accelerometers_of_rotorflight(tmp_path: Path):
    asked = {f"mixer[{i}]": 1000.0 * (KNOWN[f"motor{i + 1}"] - 0.5) for i in range(4)}
    columns = {name: values for name, values in box(force="accADC[{}]").items() if not name.startswith("motor")}
    blackbox(tmp_path, columns | asked | {"headspeed": 1800.0 + TIME}, names="p q r")


def test_a_blackbox_without_accelerometers_says_so(tmp_path: Path):
    (tmp_path / "t.csv").write_text(text({n: v for n, v in box().items() if not n.startswith("acc")}))
    told = rotorid.import_log(tmp_path / "t.csv", tmp_path / "s").warnings
    assert any("ax ay az (no accSmooth, accADC)" in sentence for sentence in told)


@pytest.mark.parametrize(
    ("name", "version", "counts"),
    [
        ("vbat (mV)", "", 1e3),
        ("vbatLatest (V)", "", 1.0),
        ("vbatLatest", "4.4.0", 1e2),
        ("vbatLatest", "3.5.2", 1e1),
        ("vbatLatest", "INAV 2.6.1", 1e2),
    ],
)
def test_voltage_of_a_blackbox(name: str, version: str, counts: float, tmp_path: Path):
    before = f'"Product","Blackbox"\n"firmwareVersion","{version}"\n' if version else ""
    found = blackbox(tmp_path, box() | {name: counts * (16.0 + np.sin(TIME))}, before)
    assert np.abs(found["voltage"] - 16.0 - np.sin(TIME)).max() < 1e-2


@pytest.mark.parametrize(
    ("whole", "beyond", "count"),
    [("secs", "nsecs", 1e9), ("header.stamp.sec", "header.stamp.nanosec", 1e9), ("time_s", "time_us", 1e6)],
)
def test_a_clock_in_two_columns_is_one(whole: str, beyond: str, count: float, tmp_path: Path):
    columns, stamps = plain(), TIME + 7.3
    del columns["time"]
    halves = {whole: np.floor(stamps), beyond: np.round(count * (stamps % 1.0))}
    (tmp_path / "t.csv").write_text(text(halves | columns))
    found = channels(tmp_path / "t.csv", tmp_path)
    assert near(found, 1e-4, " ".join(NAMES))
