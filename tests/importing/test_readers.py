"""Flight logs as read: against the readers of their own makers, in blocks of any size, and damaged on purpose."""

import struct
from pathlib import Path

import numpy as np
import pytest

from rotorid_torch.errors import InputError
from rotorid_torch.importing.autopilots.dataflash import read_dataflash
from rotorid_torch.importing.autopilots.ulog import read_ulog
from rotorid_torch.importing.signals.streams import Log
from tests.helpers import shared
from tests.importing.log_writers import dataflash_format, message, px4_topics, ulog_head, write_dataflash, write_ulog

ULOGS = ("px4-cube-vtol-bench.ulg", "px4-appended.ulg", "px4-quad-sitl-takeoff.ulg")


def everything(topic: str, fields: object) -> object:
    return fields


def same(one: Log, two: Log) -> bool:
    return one.streams.keys() == two.streams.keys() and all(
        np.array_equal(one.streams[key].columns[name], values, equal_nan=True)
        for key, stream in two.streams.items()
        for name, values in stream.columns.items()
    )


@pytest.mark.parametrize("name", ULOGS)
def test_real_ulogs_are_read_as_pyulog_reads_them(name: str, capsys):
    file = shared("flightdata", "logs", name)
    pyulog = pytest.importorskip("pyulog")
    known = {(d.name, d.multi_id): d.data for d in pyulog.ULog(str(file)).data_list}
    log = read_ulog(file, everything)
    assert {*log.streams} == {*known}
    for key, stream in log.streams.items():
        for column, values in stream.columns.items():
            assert np.array_equal(values, known[key][column], equal_nan=True), (key, column)
        if "timestamp_sample" not in known[key]:
            assert np.allclose(stream.time, known[key]["timestamp"] * 1e-6, rtol=0.0, atol=1e-6)
    assert same(log, read_ulog(file, everything, block=100_000))


@pytest.mark.parametrize("name", ["ardupilot-plane.BIN", "px4-quad-sdlog2.px4log"])
def test_real_dataflash_logs_are_read_as_pymavlink_reads_them(name: str):
    file = shared("flightdata", "logs", name)
    reader = pytest.importorskip("pymavlink.DFReader").DFReader_binary(str(file), zero_time_base=True)
    known: dict[str, list[dict]] = {}
    compared = ["ATT", "IMU", "OUT0", "NKF1", "RCOU", "BARO"]
    while (read := reader.recv_match(type=compared)) is not None:
        known.setdefault(read.get_type(), []).append(read.to_dict())
    reader.close()
    log = read_dataflash(file, everything)
    for (topic, _), stream in log.streams.items():
        for column, values in stream.columns.items():
            if topic in known:
                expected = [row[column] for row in known[topic]]
                assert np.allclose(values, expected, rtol=1e-6, equal_nan=True), (topic, column)
    assert same(log, read_dataflash(file, everything, block=50_000))
    assert log.parameters


def test_own_ulog_and_pyulogs_copy_of_it_are_the_same(tmp_path: Path):
    pyulog = pytest.importorskip("pyulog")
    file = write_ulog(tmp_path / "a.ulg", px4_topics(seconds=3.0), {"MAV_TYPE": 2, "CAL": 0.5})
    pyulog.ULog(str(file)).write_ulog(str(tmp_path / "b.ulg"))
    one, two = read_ulog(file, everything), read_ulog(tmp_path / "b.ulg", everything)
    assert same(one, two)
    assert one.parameters == two.parameters == {"MAV_TYPE": 2.0, "CAL": 0.5}


def test_only_what_is_wanted_is_kept(tmp_path: Path):
    file = write_ulog(tmp_path / "a.ulg", px4_topics(seconds=3.0))
    log = read_ulog(file, lambda topic, fields: ["q[0]"] if topic == "vehicle_attitude" else [])
    assert {key: list(stream.columns) for key, stream in log.streams.items()} == {("vehicle_attitude", 0): ["q[0]"]}
    assert "xyz[2]" in log.fields["vehicle_angular_velocity"]


@pytest.mark.parametrize("keep", [0.3, 0.5, 0.777, 0.99])
def test_a_cut_ulog_is_read_up_to_there(tmp_path: Path, keep: float):
    whole = write_ulog(tmp_path / "a.ulg", px4_topics(seconds=4.0))
    cut = tmp_path / "cut.ulg"
    cut.write_bytes(whole.read_bytes()[: int(keep * whole.stat().st_size) // 2 * 2 + 1])
    log, known = read_ulog(cut, everything), read_ulog(whole, everything)
    assert any("ends in the middle of a message" in told for told in log.warnings)
    stream, all_of_it = log.streams["actuator_motors", 0], known.streams["actuator_motors", 0]
    assert 0 < len(stream.time) <= len(all_of_it.time)
    assert np.array_equal(stream.time, all_of_it.time[: len(stream.time)])


def test_a_cut_dataflash_log_is_read_up_to_there(tmp_path: Path):
    time = np.arange(0.0, 4.0, 0.01)
    whole = write_dataflash(tmp_path / "a.bin", {"IMU": (time, {"GyrX": np.sin(time).astype("<f4")})})
    (tmp_path / "cut.bin").write_bytes(whole.read_bytes()[:-7])
    log = read_dataflash(tmp_path / "cut.bin", everything)
    assert len(log.streams["IMU", 0].time) == len(time) - 1
    assert "ends in the middle of a message" in log.warnings[0]


def test_damage_inside_is_passed_over_at_the_next_sync(tmp_path: Path):
    file = write_ulog(tmp_path / "a.ulg", px4_topics(seconds=2.0))
    data = file.read_bytes()
    sync = message("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12")
    rest = message("D", struct.pack("<HQ", 4, 110_000_000) + struct.pack("<f", 12.0))
    file.write_bytes(data + b"\x07\xff\xee\x00garbage" * 20 + sync + rest)
    log = read_ulog(file, everything)
    assert log.streams["battery_status", 0].columns["voltage_v"][-1] == 12.0
    assert any("damaged" in told for told in log.warnings)


def test_damage_inside_dataflash_is_passed_over(tmp_path: Path):
    time = np.arange(0.0, 2.0, 0.01)
    file = write_dataflash(tmp_path / "a.bin", {"IMU": (time, {"GyrX": np.sin(time).astype("<f4")})})
    data = file.read_bytes()
    file.write_bytes(data[:-15] + b"\x01\x02\xa3\x95\xfe" * 9 + data[-15:])
    log = read_dataflash(file, everything, block=64)
    assert len(log.streams["IMU", 0].time) == len(time)
    assert any("damaged" in told for told in log.warnings)


FORGED = {
    "huge array": "timestamp;float[2000000000] x",
    "larger than a message": "timestamp;double[60000] x",
    "nothing many times": "timestamp;none[60000] x",
}


@pytest.mark.parametrize("form", FORGED.values(), ids=FORGED)
def test_formats_that_no_message_can_have_are_refused(tmp_path: Path, form: str):
    file = tmp_path / "forged.ulg"
    formats = message("F", f"forged:uint64_t {form};".encode()) + message("F", b"none:deeper[60000] y;")
    formats += message("F", b"deeper:") + message("A", struct.pack("<BH", 0, 1) + b"forged")
    file.write_bytes(ulog_head() + formats)
    with pytest.raises(InputError, match="forged"):
        read_ulog(file, everything)


@pytest.mark.parametrize("form", ["quaternion x", "forged inner"])
def test_topics_of_unknown_form_and_inside_themselves_are_passed_over(tmp_path: Path, form: str):
    file = write_ulog(tmp_path / "a.ulg", px4_topics(seconds=2.0))
    odd = message("F", f"forged:uint64_t timestamp;{form};".encode()) + message("A", b"\x00\x63\x00forged")
    file.write_bytes(file.read_bytes() + odd + message("D", b"\x63\x00" + bytes(12)))
    log = read_ulog(file, everything)
    assert len(log.streams) == len(px4_topics())
    assert "topics of unknown form were passed over: forged (" in log.warnings[0]


def test_many_topics_of_many_fields_are_refused(tmp_path: Path):
    file = tmp_path / "forged.ulg"
    formats = b"".join(message("F", f"t{i}:uint64_t timestamp;uint8_t[60000] x;".encode()) for i in range(9))
    asked = b"".join(message("A", struct.pack("<BH", 0, i) + f"t{i}".encode()) for i in range(9))
    file.write_bytes(ulog_head() + formats + asked)
    with pytest.raises(InputError, match="one field too many"):
        read_ulog(file, everything)


def test_unknown_flags_and_other_files_are_refused(tmp_path: Path):
    file = tmp_path / "x.ulg"
    file.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8) + message("B", bytes(8) + b"\x02" + bytes(31)))
    with pytest.raises(InputError, match="incompatible flags"):
        read_ulog(file, everything)
    for content in (b"", b"ULo", b"no log at all, but text"):
        file.write_bytes(content)
        for read in (read_ulog, read_dataflash):
            with pytest.raises(InputError, match="begins otherwise"):
                read(file, everything)


def test_appended_offsets_that_lead_nowhere_end(tmp_path: Path):
    topics = px4_topics(seconds=2.0)
    data = write_ulog(tmp_path / "a.ulg", topics).read_bytes()
    flags = bytes(8) + b"\x01" + bytes(7) + struct.pack("<3Q", 5, 17, 2**61)
    (tmp_path / "b.ulg").write_bytes(data[:16] + message("B", flags) + data[16 + 43 :])
    log = read_ulog(tmp_path / "b.ulg", everything)
    assert len(log.streams) <= len(topics)


def test_a_dataflash_format_of_no_length_does_not_hang(tmp_path: Path):
    file = tmp_path / "a.bin"
    head = dataflash_format(0x80, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    forged = dataflash_format(7, 0, "EVIL", "Qf", "TimeUS,x") + dataflash_format(8, 9, "ODD", "Qddd", "TimeUS,a,b,c")
    file.write_bytes(head + forged + b"\xa3\x95\x07" * 50 + b"\xa3\x95\x08" + bytes(6))
    log = read_dataflash(file, everything)
    assert log.streams == {}
    assert any("unknown form" in told for told in log.warnings)


def test_instances_of_a_dataflash_topic_are_streams_of_their_own(tmp_path: Path):
    time = np.arange(0.0, 1.0, 0.01)
    columns = {"I": (np.arange(100) % 2).astype("<u1"), "GyrX": np.arange(100).astype("<f4")}
    log = read_dataflash(write_dataflash(tmp_path / "a.bin", {"IMU": (time, columns)}), everything)
    assert log.instances("IMU") == [0, 1]
    assert np.array_equal(log.streams["IMU", 1].columns["GyrX"], np.arange(1, 100, 2))
