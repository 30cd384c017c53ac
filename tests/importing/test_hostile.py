"""Logs are not to be trusted: whatever the bytes, a data set, or one line and nothing written."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from tests.importing.log_writers import px4_topics, write_dataflash, write_dataflash_text, write_ulog

WHOLE: dict[str, bytes] = {}


def whole(kind: str) -> bytes:
    """A small log of this kind, written once."""
    if kind not in WHOLE:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"a.{kind}"
            if kind == "ulg":
                write_ulog(file, px4_topics(seconds=2.0, fast=100.0), {"MAV_TYPE": 2})
            else:
                time = np.arange(0.0, 2.0, 0.02)
                waves = [np.sin(time * (i + 1)).astype("<f4") for i in range(4)]
                pulses = [(1500 + 300 * wave).astype("<u2") for wave in waves]
                gyro = dict(zip(("GyrX", "GyrY", "GyrZ"), waves, strict=False))
                outputs = dict(zip(("C1", "C2", "C3", "C4"), pulses, strict=True))
                write = write_dataflash if kind == "bin" else write_dataflash_text
                write(file, {"IMU": (time, gyro), "RCOU": (time, outputs)}, {"SERVO1_FUNCTION": 33.0})
            WHOLE[kind] = file.read_bytes()
    return WHOLE[kind]


def is_told_or_imported(content: bytes, kind: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file, out = Path(folder) / f"log.{kind}", Path(folder) / "set"
        file.write_bytes(content)
        try:
            rotorid.import_log(file, out)
        except InputError:
            assert not out.exists()
        else:
            rotorid.load(out)


@pytest.mark.parametrize("kind", ["ulg", "bin", "log"])
@settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_damaged_logs(kind: str, data: st.DataObject):
    content = bytearray(whole(kind))
    part = len(content) if data.draw(st.booleans()) else min(len(content), 3000)  # formats stand at the beginning
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, part - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(content))) if data.draw(st.booleans()) else len(content)
    is_told_or_imported(bytes(content[:cut]), kind)


@pytest.mark.parametrize("kind", ["csv", "npz", "mat", "parquet"])
@settings(max_examples=15, deadline=None, derandomize=True)
@given(content=st.binary(max_size=300))
def test_anything_named_as_a_table(kind: str, content: bytes):
    is_told_or_imported(content, kind)


def test_undamaged_they_are_imported():
    for kind in ("ulg", "bin", "log"):
        is_told_or_imported(whole(kind), kind)
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / f"log.{kind}").write_bytes(whole(kind))
            done = rotorid.import_log(Path(folder) / f"log.{kind}", Path(folder) / "set")
            assert "motor1" in done.channels
