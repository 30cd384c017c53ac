"""ArduPilot's logs as text: the same as the binary ones, as pymavlink reads them, damaged, and what is none."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from rotorid_torch.importing.autopilots.dataflash_text import read_text_or_dataflash
from tests.importing.log_writers import Topics, motion, write_dataflash, write_dataflash_text

SETTINGS = {
    "SERVO1_FUNCTION": 33,
    "SERVO2_FUNCTION": 34,
    "SERVO3_FUNCTION": 35,
    "SERVO4_FUNCTION": 36,
    "FRAME_CLASS": 1,
}


def topics(seconds: float = 4.0) -> Topics:
    time = 50.0 + np.arange(0.0, seconds, 0.01)
    m = motion(time - 50.0)
    gyros = {column: m[name].astype("<f4") for column, name in (("GyrX", "p"), ("GyrY", "q"), ("GyrZ", "r"))}
    attitude = {c: np.degrees(m[n]).astype("<f4") for c, n in (("Roll", "phi"), ("Pitch", "theta"), ("Yaw", "psi"))}
    outputs = {f"C{i}": np.round(1000.0 + 1000.0 * m[f"motor{i}"]).astype("<u2") for i in range(1, 5)}
    return {"IMU": (time, gyros), "ATT": (time[::4], {k: v[::4] for k, v in attitude.items()}), "RCOU": (time, outputs)}


def everything(_: str, fields: object) -> object:
    return fields


def test_a_text_log_is_the_same_flight_as_its_binary_one(tmp_path: Path):
    about = "ArduCopter V4.5.1 (0a1b2c3d), quad"
    binary = write_dataflash(tmp_path / "a.bin", topics(), SETTINGS, about)
    text = write_dataflash_text(tmp_path / "b.log", topics(), SETTINGS, about)
    one, two = (rotorid.import_log(file, tmp_path / file.stem) for file in (binary, text))
    assert {n: c.source for n, c in one.channels.items()} == {n: c.source for n, c in two.channels.items()}
    assert one.warnings == tuple(w.replace("b.log", "a.bin") for w in two.warnings)
    flights = [np.load(tmp_path / name / "flights" / f"{name}.npz") for name in "ab"]
    assert {*flights[0].files} == {*flights[1].files} >= {"motor1", "p", "phi"}
    for channel in flights[0].files:
        assert np.allclose(flights[0][channel], flights[1][channel], atol=1e-6, equal_nan=True), channel


def test_as_pymavlink_reads_it(tmp_path: Path):
    reader = pytest.importorskip("pymavlink.DFReader").DFReader_text
    file = write_dataflash_text(tmp_path / "a.log", topics(1.0), SETTINGS, "ArduCopter V4.5.1")
    known, read = [], reader(str(file), zero_time_base=True)
    while (message := read.recv_match(type=["ATT", "RCOU"])) is not None:
        known.append(message.to_dict())
    read.data_map.close()
    read.filehandle.close()
    log = read_text_or_dataflash(file, everything)
    for topic in ("ATT", "RCOU"):
        rows = [row for row in known if row["mavpackettype"] == topic]
        stream = log.streams[topic, 0]
        assert np.allclose(stream.time, [row["TimeUS"] * 1e-6 for row in rows])
        for column, values in stream.columns.items():
            assert np.allclose(values, [row[column] for row in rows], rtol=1e-6), column


def test_instances_have_a_column_by_the_log_s_own_units(tmp_path: Path):
    time = np.arange(0.0, 2.0, 0.01)
    lines = [
        "FMT, 9, 20, IMU, QBfff, TimeUS,I,GyrX,GyrY,GyrZ",
        "FMT, 4, 44, FMTU, QBNN, TimeUS,FmtType,UnitIds,MultIds",
    ]
    lines += ["FMTU, 0, 9, s#EEE, F-000"]
    lines += [f"IMU, {round(t * 1e6)}, {i}, {i + t}, 0.0, 0.0" for t in time for i in (0, 1)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    log = read_text_or_dataflash(tmp_path / "a.log", everything)
    assert [log.streams["IMU", i].columns["GyrX"][0] for i in log.instances("IMU")] == [0.0, 1.0]


def test_the_first_lines_of_older_logs_say_what_flew(tmp_path: Path):
    plane = write_dataflash_text(tmp_path / "p.log", topics(), before="\nArduPlane V3.8.2\nFree RAM: 4096")
    with pytest.raises(InputError, match="fixed wing"):
        rotorid.import_log(plane, tmp_path / "set")


def test_damaged_lines_are_passed_over_and_told(tmp_path: Path):
    file = write_dataflash_text(tmp_path / "a.log", topics(), SETTINGS)
    lines = file.read_text().split("\n")
    at = next(i for i, line in enumerate(lines) if line.startswith("RCOU")) + 40
    lines[at : at + 3] = ["RCOU, 17", "\x00" * 50, "RCOU, x, y, z, 1, 2"]
    file.write_text("\n".join(lines)[:-30])
    done = rotorid.import_log(file, tmp_path / "set")
    assert any("lines do not fit their topic" in warning for warning in done.warnings)
    assert "motor4" in done.channels


def test_a_log_by_its_content_and_what_is_none(tmp_path: Path):
    file = write_dataflash(tmp_path / "a.bin", topics(), SETTINGS)
    assert "p" in rotorid.import_log(file.rename(tmp_path / "a.log"), tmp_path / "set").channels
    for content in (b"", b"[INFO] started\n" * 100, b"\xff" * 100_000, b"FMT\n"):
        (tmp_path / "b.log").write_bytes(content)
        with pytest.raises(InputError, match="is no log of ArduPilot"):
            rotorid.import_log(tmp_path / "b.log", tmp_path / "none")


def test_a_log_without_outputs_says_what_to_record(tmp_path: Path):
    some = {name: topic for name, topic in topics().items() if name != "RCOU"}
    with pytest.raises(InputError, match=r"a log with RCOU \(LOG_BITMASK"):
        rotorid.import_log(write_dataflash(tmp_path / "a.bin", some, SETTINGS), tmp_path / "set")


@pytest.mark.parametrize("write", [write_dataflash, write_dataflash_text])
def test_joined_logs_are_boots_where_their_messages_are_the_same_ones(write: Callable[..., Path], tmp_path: Path):
    file = write(tmp_path / "a.log", topics(), SETTINGS)
    file.write_bytes(2 * file.read_bytes())
    assert len(rotorid.import_log(file, tmp_path / "set").flights) == 2


@pytest.mark.parametrize("change", ["other numbers", "other columns", "another order of columns"])
@pytest.mark.parametrize("write", [write_dataflash, write_dataflash_text])
def test_joined_logs_whose_messages_differ_are_told(write: Callable[..., Path], change: str, tmp_path: Path):
    """They were decoded by the first log's formats: attitudes of the second one as commands."""
    second = topics()
    if change == "other numbers":
        second = dict(reversed(second.items()))
    elif change == "other columns":
        second["ATT"] = (second["ATT"][0], {"Old": second["ATT"][1]["Roll"], **second["ATT"][1]})
    else:
        second["ATT"] = (second["ATT"][0], dict(reversed(second["ATT"][1].items())))
    files = write(tmp_path / "a.log", topics(), SETTINGS), write(tmp_path / "b.log", second, SETTINGS)
    files[0].write_bytes(b"".join(file.read_bytes() for file in files))
    with pytest.raises(InputError, match=r"a\.log: \w+: is defined anew: logs whose messages differ are joined"):
        rotorid.import_log(files[0], tmp_path / "set")
