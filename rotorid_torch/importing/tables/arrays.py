"""NPZ, MATLAB and Parquet files as logs. Nothing is unpickled, no header is believed before the file bears it out."""

import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from rotorid_torch.core.storage.files import open_file
from rotorid_torch.core.storage.memory import bounded_memory
from rotorid_torch.data.reading import npz
from rotorid_torch.data.reading.read import BYTES, CHANNELS, SAMPLES
from rotorid_torch.errors import InputError
from rotorid_torch.importing.signals.mapping import Clock
from rotorid_torch.importing.signals.streams import TOLD, Choose, Log, header_name
from rotorid_torch.importing.tables import sidpac
from rotorid_torch.importing.tables.columns import is_clock, table_log

Tables = dict[str, dict[str, np.ndarray]]
DEEPEST = 6
"""Structs inside structs."""
READER_BYTES = 2 * BYTES
"""What a reader of another library may take beyond what the process has."""
TOO_MUCH = f"unpacks to over {READER_BYTES / 2**20:.0f} MiB"
COMPRESSED, PIECE = 15, 2**20
"""Type of a compressed element of a .mat file, and the bytes of it that are unpacked at a time."""


def need(package: str, extra: str, file: Path) -> Any:
    """Import a reader; InputError naming the extra that brings it, where it is not there."""
    try:
        return import_module(package)
    except ImportError:
        what = f"needs {package.partition('.')[0]} to be read, which is not here"
        raise InputError(file, "", what, f"it installed: pip install 'rotorid-torch[{extra}]'") from None


def read_npz(file: Path, choose: Choose, clock: Clock | None = None) -> Log:
    """Read the wanted arrays of an npz: one dimension each, or columns, which become `name[0]`, `name[1]`, ...

    Raises InputError where the file is no whole npz, its headers say other than its bytes, or it unpacks to too much.
    """
    with open_file(file, "a log") as stream, npz.opened(file, stream, CHANNELS) as archive:
        numbers = {n: h for n, h in archive.headers.items() if _is_numbers(h.dtype) or h.dtype.kind in "Mm"}
        others = {n: f"of type {h.dtype}" for n, h in archive.headers.items() if n not in numbers}
        left = _left(file, others, {*choose("", [*archive.headers])}, clock)
        columns = {n: [*_columns_of(n, h.shape)] for n, h in numbers.items()}
        every = [column for some in columns.values() for column in some]
        chosen = {*choose("", every)} | {column for column in every if is_clock("", column, clock)}
        wanted = [name for name, some in columns.items() if chosen.intersection(some)]
        npz.refuse_beyond(file, {name: archive.headers[name].bytes for name in wanted}, BYTES)
        arrays = {name: _in_seconds(archive.array(name)) for name in wanted}
    log = _log(file, {"": dict(_columns(arrays))}, {"": every}, choose, clock)
    return replace(log, warnings=(*log.warnings, *left))


def _left(file: Path, others: Mapping[str, str], chosen: set[str], clock: Clock | None) -> list[str]:
    """A sentence on what is no column of numbers, by name with its type.

    Raises InputError where it is among the chosen ones, or a clock by its name.
    """
    for name, kind in others.items():
        if name in chosen or is_clock("", name, clock):
            raise InputError(file, name, f"is {kind}", "numbers, one a sample")
    more = f" and {len(others) - TOLD} more" if len(others) > TOLD else ""
    return [f"left out, for it is no column of numbers: {', '.join([*others][:TOLD])}{more}"] if others else []


def _in_seconds(values: np.ndarray) -> np.ndarray:
    """Moments (T,) as seconds since 1970, durations in seconds, other values as they are."""
    since = values - np.datetime64(0, "s") if values.dtype.kind == "M" else values
    return since / np.timedelta64(1, "s") if since.dtype.kind == "m" else since


HDF5 = 2
"""Major version of a .mat that is an HDF5 file: MATLAB calls it 7.3."""


def read_matlab(file: Path, choose: Choose, clock: Clock | None = None) -> Log:
    """Read the variables of a .mat up to version 7; a struct is a topic, a matrix becomes columns `name[0]`, ...

    Raises InputError where the file is of version 7.3, damaged, or claims more than can be.
    """
    from scipy.io import loadmat, matlab, whosmat  # slow to import

    with open_file(file, "a log") as stream:
        try:
            if matlab.matfile_version(stream)[0] == HDF5:
                raise InputError(file, "", "is of version 7.3 (HDF5)", "version 7: in MATLAB, save(..., '-v7')")
            npz.refuse_beyond(file, dict(_unpacked(stream)), BYTES)
            claimed = {name: math.prod(shape) * 8 for name, shape, _ in whosmat(stream)}
            npz.refuse_beyond(file, claimed, BYTES)
            with bounded_memory(READER_BYTES):
                content = loadmat(
                    stream, simplify_cells=True, chars_as_strings=False, verify_compressed_data_integrity=True
                )
        except InputError:
            raise
        except MemoryError:
            raise InputError(file, "", TOO_MUCH, "a flight's arrays") from None
        except Exception as error:  # a damaged file fails in many ways, none of which is ours
            raise InputError(file, "", f"is not a whole .mat file ({error})", "a .mat of version 4 to 7") from None
    tables: Tables = {}
    _structs("", {name: v for name, v in content.items() if not name.startswith("__")}, tables, 0)
    inside = [topic for topic, columns in tables.items() if topic and sidpac.is_sidpac([*columns])]
    tables[""] |= tables.pop(inside[0]) if len(inside) == 1 else {}
    fields = {t: list(columns) for t, columns in tables.items() if columns}
    is_fdata = clock is None and sidpac.is_sidpac(fields.get("", ()))
    log = _log(file, tables, fields, choose, sidpac.clock() if is_fdata else clock)
    return replace(log, system=sidpac.SYSTEM) if is_fdata else log


def _unpacked(stream: BinaryIO) -> Iterator[tuple[str, int]]:
    """Bytes of each compressed element of a .mat of version 5 to 7, by counting; a level 4 file has none.

    Source: MathWorks, MAT-File Format: a header of 128 bytes, then elements of type, size and data.
    """
    stream.seek(0)
    head = stream.read(128)
    order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
    while order and len(tag := stream.read(8)) == 8:
        kind, size = struct.unpack(f"{order}2I", tag)
        after = stream.tell() + size
        if kind == COMPRESSED:
            yield f"element at byte {after - size}", _inflated(stream, size)
        stream.seek(after)


def _inflated(stream: BinaryIO, size: int) -> int:
    """Bytes that the next `size` of the stream unpack to, counted up to the budget."""
    packed, total = zlib.decompressobj(), 0
    while size > 0 and (data := stream.read(min(size, PIECE))):
        size -= len(data)
        while data and total <= BYTES:
            total += len(packed.decompress(data, PIECE))
            data = packed.unconsumed_tail
        if packed.eof or total > BYTES:
            break
    return total


def _structs(topic: str, content: Mapping[str, Any], tables: Tables, depth: int) -> None:
    """Arrays of a struct become the table of its topic, structs inside it topics `outer.inner`."""
    content = _unfolded(content, topic.rpartition(".")[2])
    arrays = {str(name): value for name, value in content.items() if isinstance(value, np.ndarray)}
    tables[topic] = dict(_columns(arrays))
    for name, value in content.items():
        for place, one in _members(str(name), value) if depth < DEEPEST else ():
            _structs(f"{topic}.{place}" if topic else place, one, tables, depth + 1)


def _members(name: str, value: Any) -> list[tuple[str, dict[str, Any]]]:
    """A struct under its name; an array of structs as `name(1)`, `name(2)`, ..."""
    if isinstance(value, dict):
        return [(name, value)]
    several = _cells(value)
    return [(f"{name}({i})", one) for i, one in enumerate(several, 1) if isinstance(one, dict)]


LISTS = ("VariableNames", "colheaders", "names", "varnames", "labels")
"""Members that name the columns of a matrix beside them: of a timetable, of importdata, of people."""
UNITS = ("VariableUnits", "units", "Units")
"""Members that have the units of named columns in their order, or by name."""
OF_ROWS = ("RowTimes", "rowtimes")
"""Clock of a timetable, beside its columns or among its properties."""


def _unfolded(content: Mapping[str, Any], own_name: str) -> dict[str, Any]:
    """A struct with each channel under its own name, with its unit in brackets where the struct tells it.

    An array of structs of numbers (table2struct) becomes columns; `time` with `signals`, as Simulink saves them, a
    timetable saved as struct (members, or `Variables` and `VariableNames`; also in `Properties`, with `VariableUnits`
    and `RowTimes`), a matrix beside a list of names, and a time series with `DataInfo.Units` take what these say.
    """
    columns = {str(name): _rows(value) for name, value in content.items()}
    signals = columns.get("signals")
    if "time" in columns and signals is not None:
        some = [one for _, one in _members("signals", columns.pop("signals")) if "values" in one]
        for number, one in enumerate(some, 1):
            columns[_text(one.get("label")) or (own_name if len(some) == 1 else f"signal{number}")] = one["values"]
    properties = columns.get("Properties")
    about = columns | (properties if isinstance(properties, dict) else {})
    names = next(filter(None, (_texts(about.get(key)) for key in LISTS)), [])
    columns = _named(columns, names)
    clock = next((np.ravel(about[key]) for key in OF_ROWS if isinstance(about.get(key), np.ndarray)), None)
    if clock is not None:
        columns = {name: value for name, value in columns.items() if name not in (*OF_ROWS, "Properties")}
        columns["Time"] = clock
    of_data = _text(info.get("Units")) if isinstance(info := columns.get("DataInfo"), dict) else ""
    listed = next((about[key] for key in UNITS if key in about), None)
    texts = _texts(listed)
    if not names and len(texts) == len(numbers := [n for n, v in columns.items() if _is_column(v)]):
        names = numbers  # the members themselves, in their order
    by_name = listed.items() if isinstance(listed, dict) else zip(names, texts, strict=False)
    for name, unit in (*((name, _text(unit)) for name, unit in by_name), ("Data", of_data)):
        if unit and name in columns and header_name(f"{name} [{unit}]")[1]:
            columns[f"{name} [{unit}]"] = columns.pop(name)
    return columns


def _named(columns: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Columns with those, or the rows, of a matrix that has as many as there are names in its place."""
    matrices = {k: v for k, v in columns.items() if isinstance(v, np.ndarray) and v.ndim == 2}
    fitting = {k: v.T for k, v in matrices.items() if v.shape[1] == len(names)}
    fitting = fitting or {k: v for k, v in matrices.items() if v.shape[0] == len(names)}
    if not names or not fitting:
        return columns
    key = "Variables" if "Variables" in fitting else next(iter(fitting))
    others = {name: value for name, value in columns.items() if name != key}
    return others | {name: fitting[key][i] for i, name in enumerate(names) if name}


def _texts(value: Any) -> list[str]:
    """Texts of a cell array, or of a matrix of characters with a text in each row; none of anything else."""
    characters = isinstance(value, np.ndarray) and value.dtype.kind == "U" and value.ndim == 2
    texts = [_text(cell) for cell in (value if characters else _cells(value))]
    return texts if any(texts) else []


def _cells(value: Any) -> list[Any]:
    """Members of a cell array or of an array of structs; none of anything else."""
    cells = [*np.ravel(value)] if isinstance(value, np.ndarray) and value.dtype.hasobject else value
    return cells if isinstance(cells, list) else []


def _rows(value: Any) -> Any:
    """An array of structs that hold a number each, as one struct of columns."""
    rows = _cells(value)
    if len(rows) < 2 or len(rows) > SAMPLES or not all(isinstance(row, dict) for row in rows):
        return value
    keys = [key for key in rows[0] if all(isinstance(row.get(key), int | float | np.number) for row in rows)]
    return {key: np.array([float(row[key]) for row in rows]) for key in keys} if keys else value


def _text(value: Any) -> str:
    """Text of MATLAB's characters; empty for anything else."""
    if isinstance(value, str):
        return value
    whole = isinstance(value, np.ndarray) and value.dtype.kind == "U"
    return "".join(str(part) for part in np.ravel(value)).strip() if whole else ""


def _columns(arrays: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """Numeric arrays as columns: of two dimensions along the longer, of one as they are."""
    for name, array in arrays.items():
        if not _is_numbers(array.dtype):
            continue
        long = array if array.ndim < 2 or array.shape[0] >= array.shape[1] else array.T
        yield from zip(_columns_of(name, array.shape), np.atleast_2d(long.T), strict=False)


def _columns_of(name: str, shape: Sequence[int]) -> Iterator[str]:
    """Names of an array's columns; none where it is no table of numbers."""
    if math.prod(shape) == 0 or len(shape) not in (1, 2) or (len(shape) == 2 and min(shape) > CHANNELS):
        return
    if len(shape) == 1 or min(shape) == 1:
        yield name
    else:
        yield from (f"{name}[{index}]" for index in range(min(shape)))


def _is_column(value: Any) -> bool:
    return isinstance(value, np.ndarray) and _is_numbers(value.dtype)


def _is_numbers(dtype: np.dtype[Any]) -> bool:
    return dtype.kind in "fiub"


def read_parquet(file: Path, choose: Choose, clock: Clock | None = None) -> Log:
    """Read the wanted numeric columns of a Parquet file; a column of dates is a clock in s.

    Raises InputError where pyarrow is missing, or the file is damaged.
    """
    parquet = need("pyarrow.parquet", "parquet", file)
    arrow = need("pyarrow", "parquet", file)
    with open_file(file, "a log") as stream:
        try:
            opened = parquet.ParquetFile(stream)
            schema, rows = opened.schema_arrow, opened.metadata.num_rows
            fields = [f.name for f in schema if _is_number_or_date(arrow, f.type)]
            others = {f.name: f"of type {f.type}" for f in schema if not _is_number_or_date(arrow, f.type)}
            left = _left(file, others, {*choose("", [f.name for f in schema])}, clock)
            if len(schema) > 10 * CHANNELS:
                raise InputError(file, "", f"claims {len(schema)} columns", f"at most {10 * CHANNELS}")
            wanted = [n for n in fields if n in {*choose("", fields)} or is_clock("", n, clock)]
            npz.refuse_beyond(file, {name: 8 * rows for name in wanted}, BYTES)
            with bounded_memory(READER_BYTES):
                columns = {name: _values(arrow, opened.read([name]).column(0)) for name in wanted}
        except InputError:
            raise
        except MemoryError:
            raise InputError(file, "", TOO_MUCH, "a flight's columns") from None
        except Exception as error:  # a damaged file fails in many ways, none of which is ours
            reason = (str(error).splitlines() or [""])[0][:120]
            raise InputError(file, "", f"is not a whole Parquet file ({reason})", "a Parquet file of numbers") from None
    return table_log(file, {"": columns}, {"": fields}, clock, left)


def _is_number_or_date(arrow: Any, kind: Any) -> bool:
    t = arrow.types
    kinds = t.is_integer, t.is_floating, t.is_decimal, t.is_boolean, t.is_timestamp, t.is_duration
    return any(is_of(kind) for is_of in kinds)


def _values(arrow: Any, column: Any) -> np.ndarray:
    kind, t = column.type, arrow.types
    if t.is_timestamp(kind) or t.is_duration(kind):
        nanoseconds = column.cast(arrow.duration("ns") if t.is_duration(kind) else arrow.timestamp("ns", kind.tz))
        return nanoseconds.cast(arrow.int64()).to_numpy() * 1e-9
    return np.asarray(column.cast(arrow.float64()).to_numpy(), np.float64)


def _clock_above(topic: str, samples: int, tables: Tables, clock: Clock | None) -> dict[str, np.ndarray]:
    """Clock of the nearest struct around a topic that has one of as many samples; nothing where none has."""
    while topic:
        topic = topic.rpartition(".")[0]
        for name, values in tables.get(topic, {}).items():
            if is_clock(topic, name, clock) and len(values) == samples:
                return {name: values}
    return {}


def _log(file: Path, tables: Tables, fields: Mapping[str, Sequence[str]], choose: Choose, clock: Clock | None) -> Log:
    """Log of tables in memory: the wanted columns, and of those only what is as long as its clock."""
    same_length: Tables = {}
    for topic, columns in tables.items():
        wanted = {*choose(topic, list(columns))}
        named = {n: v for n, v in columns.items() if n in wanted or is_clock(topic, n, clock)}
        stamps = next((v for n, v in named.items() if is_clock(topic, n, clock)), None)
        if stamps is None and named:
            named |= _clock_above(topic, len(next(iter(named.values()))), tables, clock)
        odd = [n for n, v in named.items() if stamps is not None and len(v) != len(stamps)]
        if odd:
            wrong = f"has {len(named[odd[0]])} samples, its clock {len(stamps) if stamps is not None else 0}"
            raise InputError(file, odd[0], wrong, "as many")
        if named:
            same_length[topic] = named
    return table_log(file, same_length, fields, clock)
