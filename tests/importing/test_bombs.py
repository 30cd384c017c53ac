"""Small files that unpack to much are refused by what their headers, or a count of their bytes, say."""

from __future__ import annotations

import csv
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import format as npy

from rotorid_torch.data import load
from rotorid_torch.data.reading import read
from rotorid_torch.errors import InputError
from rotorid_torch.importing.formats import own_fields, read_log
from rotorid_torch.importing.tables import arrays
from tests.helpers import ROOT, small_folder

CHANNELS = ("time", "lat", "p", "q", "r", "phi", "theta", "psi", "u", "v", "w", "ax", "ay", "az")
COMPRESSED, MATRIX, INT8, UINT8, INT32, UINT32, DOUBLE = 15, 14, 1, 2, 5, 6, 9
"""Types of elements in a .mat, see MathWorks, MAT-File Format."""


def npz(path: Path, samples: int) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in CHANNELS:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                npy.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (samples,)})
                for left in range(8 * samples, 0, -(2**20)):
                    stream.write(bytes(min(left, 2**20)))


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<2I", kind, len(data)) + data + bytes(-len(data) % 8)


def head(kind: int, shape: tuple[int, int], name: bytes) -> bytes:
    return (
        element(UINT32, struct.pack("<2I", kind, 0)) + element(INT32, struct.pack("<2i", *shape)) + element(INT8, name)
    )


def written(path: Path, before: bytes, zeros: int) -> None:
    """A .mat of one compressed element: some bytes, then zeros."""
    packer = zlib.compressobj(1)
    packed = packer.compress(before) + b"".join(
        packer.compress(bytes(min(k, 2**20))) for k in range(zeros, 0, -(2**20))
    )
    packed += packer.flush()
    version = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(version + struct.pack("<2I", COMPRESSED, len(packed)) + packed)


def mat(path: Path, samples: int, stored: int = DOUBLE, size: int = 8) -> None:
    body = head(6, (samples, 1), b"p") + struct.pack("<2I", stored, size * samples)
    written(path, struct.pack("<2I", MATRIX, len(body) + size * samples) + body, size * samples)


def mat_of_small_numbers(path: Path, samples: int) -> None:
    mat(path, samples, UINT8, 1)


def mat_struct(path: Path, samples: int) -> None:
    inner = head(6, (samples, 1), b"") + struct.pack("<2I", DOUBLE, 8 * samples)
    outer = head(2, (1, 1), b"s") + element(INT32, struct.pack("<i", 32)) + element(INT8, b"p".ljust(32, b"\0"))
    outer += struct.pack("<2I", MATRIX, len(inner) + 8 * samples) + inner
    written(path, struct.pack("<2I", MATRIX, len(outer) + 8 * samples) + outer, 8 * samples)


def parquet(path: Path, samples: int) -> None:
    import pyarrow
    import pyarrow.parquet

    part = pyarrow.table({name: np.zeros(samples // 8) for name in CHANNELS})
    with pyarrow.parquet.ParquetWriter(path, part.schema) as writer:
        for _ in range(8):
            writer.write_table(part)


BOMBS: dict[str, tuple[str, Callable[[Path, int], None]]] = {
    "npz": ("npz", npz),
    "mat": ("mat", mat),
    "mat of small numbers": ("mat", mat_of_small_numbers),
    "mat struct": ("mat", mat_struct),
    "parquet": ("parquet", parquet),
}


def choose(topic: str, fields: object) -> list[str]:
    return own_fields(topic, list(fields))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("kind", BOMBS)
def test_budgets(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(arrays, "BYTES", 2**20)
    ending, write = BOMBS[kind]
    file = tmp_path / f"a.{ending}"
    write(file, 2**19)
    assert file.stat().st_size < 2**18
    with pytest.raises(InputError, match="unpacks to over 1 MiB"):
        read_log(file, choose, None)


def test_arrays_that_nobody_wants_are_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(arrays, "BYTES", 2**20)
    rows = np.arange(200) * 0.01
    np.savez_compressed(tmp_path / "a.npz", time=rows, lat=rows, p=rows, video=np.zeros((2000, 1000)))
    log = read_log(tmp_path / "a.npz", choose, None)
    assert [*log.streams["", 0].columns] == ["lat", "p"]
    assert "video[3]" in log.fields[""]


def test_a_flight_of_a_data_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = small_folder(tmp_path / "set")
    npz(folder / "flights" / "one.npz", 2**18)
    monkeypatch.setattr(read, "BYTES", 2**20)
    with pytest.raises(InputError, match=r"one\.npz: time: unpacks to over 1 MiB"):
        load(folder)


@pytest.mark.parametrize("ending", ["csv", "txt"])
def test_a_field_that_is_longer_than_a_row(tmp_path: Path, ending: str):
    file = tmp_path / f"a.{ending}"
    file.write_text("time,lat,p\n0,1,2\n0.1,x," + "1" * (csv.field_size_limit() + 1) + "\n0.2,1,2\n")
    with pytest.raises(InputError, match=r"line 3: is no row \(field larger than field limit"):
        read_log(file, choose, None)


@pytest.mark.slow
@pytest.mark.parametrize("kind", BOMBS)
def test_gigabytes_in_a_small_file(tmp_path: Path, kind: str):
    """As a command: at most 2 GB, whatever the file unpacks to."""
    ending, write = BOMBS[kind]
    file = tmp_path / f"a.{ending}"
    write(file, 250_000_000 if ending == "mat" else 20_000_000)
    assert file.stat().st_size < 20e6
    code = "import resource, sys; from rotorid_torch import cli; code = cli.main(sys.argv[1:])\n"
    code += "assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2e6; sys.exit(code)"
    command = [sys.executable, "-c", code, "import", str(file), "--out", str(tmp_path / "set")]
    ended = subprocess.run(command, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.count("\n") == 1
