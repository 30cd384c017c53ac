"""NPZ, MATLAB and Parquet files as logs. Nothing is unpickled, no header is believed before the file bears it out."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from rotorid_torch.data.read import BYTES, CHANNELS
from rotorid_torch.errors import InputError
from rotorid_torch.importing.log import Choose, Log
from rotorid_torch.importing.mapping import Clock
from rotorid_torch.importing.tables import is_clock, table_log

Tables = dict[str, dict[str, np.ndarray]]
DEEPEST = 6
"""Structs inside structs."""


def need(package: str, extra: str, file: Path) -> Any:
    """Import a reader; InputError naming the extra that brings it, where it is not there."""
    try:
        return import_module(package)
    except ImportError:
        what = f"needs {package.partition('.')[0]} to be read, which is not here"
        raise InputError(file, "", what, f"it installed: pip install 'rotorid-torch[{extra}]'") from None


def read_npz(file: Path, choose: Choose, clock: Clock | None = None) -> Log:
    """Read the arrays of an npz: one dimension each, or columns, which become `name[0]`, `name[1]`, ...

    Raises
    ------
    InputError : where the file is no whole npz, or its headers say other than its bytes.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if len(members) > CHANNELS or total > BYTES:
                told = f"holds {len(members)} arrays of {total / 2**20:.0f} MiB in all"
                raise InputError(file, "", told, f"at most {CHANNELS} arrays and {BYTES / 2**20:.0f} MiB")
            arrays = {m.filename.removesuffix(".npy"): _member(file, archive, m) for m in members}
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError) as error:
        raise InputError(file, "", f"is not a whole npz file ({error})", "an npz as numpy.savez writes it") from None
    return _log(file, {"": dict(_columns(arrays))}, choose, clock)


def _member(file: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    name = member.filename.removesuffix(".npy")
    try:
        with archive.open(member) as stream:
            read = npy.read_array_header_1_0 if npy.read_magic(stream) == (1, 0) else npy.read_array_header_2_0
            shape, fortran, dtype = read(stream)
            if dtype.hasobject:
                raise InputError(file, name, "is a pickled object", "numbers; nothing is unpickled")
            count = int(np.prod(shape, dtype=object))
            if not 0 <= count * dtype.itemsize <= member.file_size:
                raise InputError(file, name, f"claims {count} numbers, more than the file has", "a whole array")
            data = stream.read(count * dtype.itemsize)
        return np.frombuffer(data, dtype, count).reshape(shape, order="F" if fortran else "C")
    except (ValueError, SyntaxError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(file, name, f"is not an array ({str(error).splitlines()[0]})", "an array") from None


HDF5 = 2
"""Major version of a .mat that is an HDF5 file: MATLAB calls it 7.3."""


def read_matlab(file: Path, choose: Choose, clock: Clock | None = None) -> Log:
    """Read the variables of a .mat up to version 7; a struct is a topic, a matrix becomes columns `name[0]`, ...

    Raises
    ------
    InputError : where the file is of version 7.3, damaged, or claims more than can be.
    """
    from scipy.io import loadmat, matlab, whosmat  # slow to import

    try:
        if matlab.matfile_version(file)[0] == HDF5:
            raise InputError(file, "", "is of version 7.3 (HDF5)", "version 7: in MATLAB, save(..., '-v7')")
        claimed = sum(int(np.prod(shape, dtype=object)) for _, shape, _ in whosmat(file))
        if claimed * 8 > BYTES:
            raise InputError(file, "", f"claims {claimed} numbers", f"at most {BYTES // 8}")
        content = loadmat(file, simplify_cells=True, chars_as_strings=False, verify_compressed_data_integrity=True)
    except InputError:
        raise
    except MemoryError:
        raise InputError(file, "", "claims more than memory holds", "a whole .mat file") from None
    except Exception as error:  # a damaged file fails in many ways, none of which is ours
        raise InputError(file, "", f"is not a whole .mat file ({error})", "a .mat of version 4 to 7") from None
    tables: Tables = {}
    _structs("", {name: v for name, v in content.items() if not name.startswith("__")}, tables, 0)
    return _log(file, tables, choose, clock)


def _structs(topic: str, content: Mapping[str, Any], tables: Tables, depth: int) -> None:
    """Arrays of a struct become the table of its topic, structs inside it topics `outer.inner`."""
    arrays = {str(name): value for name, value in content.items() if isinstance(value, np.ndarray)}
    tables[topic] = dict(_columns(arrays))
    for name, value in content.items():
        if isinstance(value, dict) and depth < DEEPEST:
            _structs(f"{topic}.{name}" if topic else str(name), value, tables, depth + 1)


def _columns(arrays: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """Numeric arrays as columns: of two dimensions along the longer, of one as they are."""
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub" or array.size == 0:
            continue
        if array.ndim == 1:
            yield name, array
        elif array.ndim == 2:
            long = array if array.shape[0] >= array.shape[1] else array.T
            if long.shape[1] > CHANNELS:
                continue
            if long.shape[1] == 1:
                yield name, long[:, 0]
            else:
                yield from ((f"{name}[{index}]", long[:, index]) for index in range(long.shape[1]))


def read_parquet(file: Path, choose: Choose, clock: Clock | None = None) -> Log:
    """Read the wanted numeric columns of a Parquet file; a column of dates is a clock in s.

    Raises
    ------
    InputError : where pyarrow is missing, or the file is damaged.
    """
    parquet = need("pyarrow.parquet", "parquet", file)
    arrow = need("pyarrow", "parquet", file)
    try:
        with parquet.ParquetFile(file, memory_map=True) as opened:
            schema = opened.schema_arrow
            fields = [f.name for f in schema if _is_number_or_date(arrow, f.type)]
            if len(schema) > 10 * CHANNELS or opened.metadata.num_rows * 8 > BYTES:
                told = f"claims {len(schema)} columns of {opened.metadata.num_rows} rows"
                raise InputError(file, "", told, f"at most {BYTES // 8} rows")
            kept = [n for n in fields if n in {*choose("", fields)} or is_clock("", n, clock)]
            columns = {name: _values(arrow, opened.read([name]).column(0)) for name in kept}
    except (arrow.ArrowException, OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        told = str(error).splitlines()[0][:120]
        raise InputError(file, "", f"is not a whole Parquet file ({told})", "a Parquet file of numbers") from None
    return table_log(file, {"": columns}, {"": fields}, clock)


def _is_number_or_date(arrow: Any, kind: Any) -> bool:
    t = arrow.types
    return t.is_integer(kind) or t.is_floating(kind) or t.is_boolean(kind) or t.is_timestamp(kind)


def _values(arrow: Any, column: Any) -> np.ndarray:
    if arrow.types.is_timestamp(column.type):
        nanoseconds = column.cast(arrow.timestamp("ns", column.type.tz)).cast(arrow.int64())
        return nanoseconds.to_numpy() * 1e-9
    return np.asarray(column.cast(arrow.float64()).to_numpy(), np.float64)


def _log(file: Path, tables: Tables, choose: Choose, clock: Clock | None) -> Log:
    """Log of tables in memory: the wanted columns, and of those only what is as long as its clock."""
    fields = {topic: list(columns) for topic, columns in tables.items() if columns}
    kept: Tables = {}
    for topic, columns in tables.items():
        wanted = {*choose(topic, list(columns))}
        named = {n: v for n, v in columns.items() if n in wanted or is_clock(topic, n, clock)}
        stamps = next((v for n, v in named.items() if is_clock(topic, n, clock)), None)
        odd = [n for n, v in named.items() if stamps is not None and len(v) != len(stamps)]
        if odd:
            told = f"has {len(named[odd[0]])} samples, its clock {len(stamps) if stamps is not None else 0}"
            raise InputError(file, odd[0], told, "as many")
        if named:
            kept[topic] = named
    return table_log(file, kept, fields, clock)
