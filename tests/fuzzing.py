"""Damaged inputs of every kind, and what a command may make of them.

An input is written whole, damaged by one of a few ways (bytes, labels, values, keys), and read by its command. Whatever
the damage: a documented exit code, one line where it is refused, within bounds of time and memory, the input unchanged
and nothing left behind. Where a value became one that no aircraft has, the command refuses it, leaves it out, or says
something that it does not say of the whole input.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import re
import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rotorid_torch import cli
from rotorid_torch.core.storage.memory import bounded_memory
from rotorid_torch.data import load
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import save
from tests.helpers import small_arrays, small_folder, small_toml
from tests.importing.log_writers import Topics, dataflash_format, motion, px4_topics, write_dataflash, write_ulog
from tests.known_models import body_spec, scattered

MEMORY, SECONDS = 2 * 2**30, 60
"""What a command may take beyond what the process has, and how long it may take."""
CODES = (0, 2, 3)
"""Documented exit codes of a command that was not interrupted: done, bad input, a data set that is not usable."""
LOGS = ("ulg", "bin", "px4log", "csv", "npz", "mat", "parquet")
KINDS = (*LOGS, "check", "identify", "model", "report")
Chance = np.random.Generator


@dataclass(frozen=True)
class Damage:
    """What was done to an input, and whether it made a value that no aircraft has."""

    what: str
    impossible: bool = False


@dataclass(frozen=True)
class Answer:
    """What a command gave: exit code, outputs, and the fault that was found; empty where there is none."""

    code: int
    out: str
    err: str
    fault: str = ""


# inputs


def flown(seconds: float = 3.0, hertz: float = 50.0) -> dict[str, np.ndarray]:
    """A multirotor's flight as a table in SI."""
    time = np.arange(0.0, seconds, 1.0 / hertz)
    m = motion(time)
    wanted = ("p", "q", "r", "phi", "theta", "psi", "motor1", "motor2", "motor3", "motor4")
    falling = {"ax": 0.0 * time, "ay": 0.0 * time, "az": -9.81 + 0.01 * np.sin(time)}
    return {"time": time, **{name: m[name] for name in wanted}, "u": m["vn"], "v": m["ve"], "w": m["vd"], **falling}


def copter_topics(seconds: float = 3.0) -> dict[str, tuple]:
    """Messages of an ArduPilot quadrotor."""
    time = 20.0 + np.arange(0.0, seconds, 0.02)
    m = motion(time)
    imu = {f"Gyr{a}": m[n].astype("<f4") for a, n in zip("XYZ", "pqr", strict=True)}
    imu |= {f"Acc{a}": np.full(len(time), v, "<f4") for a, v in zip("XYZ", (0.1, 0.0, -9.81), strict=True)}
    attitude = {"Roll": "phi", "Pitch": "theta", "Yaw": "psi"}
    state = {"VN": "vn", "VE": "ve", "VD": "vd", "PN": "vn", "PE": "ve", "PD": "vd"}
    return {
        "IMU": (time, imu),
        "ATT": (time, {name: np.degrees(m[key]).astype("<f4") for name, key in attitude.items()}),
        "XKF1": (time, {name: m[key].astype("<f4") for name, key in state.items()}),
        "RCOU": (time, {f"C{i}": np.round(1000 + 1000 * m[f"motor{i}"]).astype("<u2") for i in range(1, 5)}),
        "BAT": (time, {"Volt": (16.0 - 0.01 * time).astype("<f4")}),
    }


def older_topics(seconds: float = 3.0) -> dict[str, tuple]:
    """Messages of an older PX4 quadrotor, stamped by a message of their own."""
    time = 20.0 + np.arange(0.0, seconds, 0.02)
    m = motion(time)
    imu = {f"Gyro{a}": m[n].astype("<f4") for a, n in zip("XYZ", "pqr", strict=True)}
    imu |= {f"Acc{a}": np.full(len(time), v, "<f4") for a, v in zip("XYZ", (0.1, 0.0, -9.81), strict=True)}
    attitude = {"Roll": "phi", "Pitch": "theta", "Yaw": "psi"}
    pulses = {f"Out{i}": (1000 + 1000 * m[f"motor{i + 1}"]).astype("<f4") for i in range(4)}
    still = {f"Out{i}": np.full(len(time), 900.0, "<f4") for i in range(4, 8)}
    return {
        "TIME": (time, {"StartTime": np.round(time * 1e6).astype("<u8")}),
        "IMU": (time, imu),
        "ATT": (time, {name: m[key].astype("<f4") for name, key in attitude.items()}),
        "LPOS": (
            time,
            {name: m[key].astype("<f4") for name, key in zip(("VX", "VY", "VZ"), ("vn", "ve", "vd"), strict=True)},
        ),
        "OUT0": (time, pulses | still),
    }


def write_sdlog2(path: Path, topics: Topics) -> Path:
    """The framing of DataFlash without stamps: TIME comes before the messages that it stamps."""
    letters = {"<f4": "f", "<u8": "Q"}
    rows, content = [], [dataflash_format(0x80, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    for number, (name, (time, columns)) in enumerate(topics.items(), 10):
        fields = [("head", "<u2"), ("id", "u1"), *((n, v.dtype) for n, v in columns.items())]
        table = np.zeros(len(time), np.dtype(fields))
        table["head"], table["id"] = 0x95A3, number
        for column, values in columns.items():
            table[column] = values
        form = "".join(letters[v.dtype.str] for v in columns.values())
        content.append(dataflash_format(number, table.dtype.itemsize, name, form, ",".join(columns)))
        rows.append(table)
    shortest = min(len(table) for table in rows)
    content += [table[at : at + 1].tobytes() for at in range(shortest) for table in rows]
    path.write_bytes(b"".join(content))
    return path


def topics_of(kind: str) -> dict[str, tuple]:
    """Topics of a whole log of this kind, each time (T,) and columns; a table has one without a name."""
    if kind == "ulg":
        return px4_topics(seconds=3.0, fast=100.0)
    if kind in ("bin", "px4log"):
        return copter_topics() if kind == "bin" else older_topics()
    columns = flown()
    return {"": (columns.pop("time"), columns)}


def write_log(kind: str, topics: Mapping[str, tuple], path: Path) -> None:
    """Write a log of this kind."""
    with np.errstate(all="ignore"):  # values that a format cannot hold
        if kind == "ulg":
            write_ulog(path, topics, {"MAV_TYPE": 2})
        elif kind == "bin":
            write_dataflash(path, topics, {f"SERVO{i}_FUNCTION": float(32 + i) for i in range(1, 5)}, "ArduCopter")
        elif kind == "px4log":
            write_sdlog2(path, topics)
        else:
            time, columns = topics[""]
            write_table(kind, {"time": time, **columns}, path)


def write_table(kind: str, columns: Mapping[str, np.ndarray], path: Path) -> None:
    """Write columns of one length as a table of this kind."""
    if kind == "csv":
        np.savetxt(path, np.stack([*columns.values()], -1), "%.9g", ",", header=",".join(columns), comments="")
    elif kind == "npz":
        np.savez(path, allow_pickle=False, **columns)
    elif kind == "mat":
        import scipy.io

        scipy.io.savemat(path, dict(columns), do_compression=True)
    else:
        import pyarrow
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.table(dict(columns)), path)


# damages

EXTREMES = (1e30, -1e30, 1e10, 1.7e308, -1.7e308, math.inf, -math.inf, 3.4e38)
"""Samples and numbers that no aircraft has, in whatever unit."""
PLAUSIBLE = (0.0, 1e-300, math.nan, -0.0)
"""Samples that an aircraft may have, or that are missing."""


def damaged_values(values: np.ndarray, chance: Chance) -> tuple[np.ndarray, Damage]:
    """A channel with one, some or all samples replaced or scaled."""
    extreme = chance.random() < 0.7
    value = float(chance.choice(EXTREMES if extreme else PLAUSIBLE))
    result = values.astype(np.float64)
    share = chance.choice(["one", "a hundredth", "a tenth", "a stretch", "all"])
    count = len(values)
    start = int(chance.integers(0, count))
    chosen = {
        "one": np.array([start]),
        "a hundredth": np.flatnonzero(chance.random(count) < 0.01),
        "a tenth": np.flatnonzero(chance.random(count) < 0.1),
        "a stretch": np.arange(start, min(count, start + 1 + count // 5)),
        "all": np.arange(count),
    }[str(share)]
    result[chosen] = value
    with np.errstate(all="ignore"):
        stored = result.astype(values.dtype)
    return stored, Damage(f"{share}: {value:g}", extreme and len(chosen) > 0 and values.dtype.kind == "f")


def damaged_clock(time: np.ndarray, chance: Chance) -> tuple[np.ndarray, Damage]:
    """A clock that stands, runs back, jumps, repeats or is in another unit."""
    at, result = int(chance.integers(1, len(time) - 1)), time.copy()
    way = str(chance.choice(["stands", "runs back", "jumps", "far stamp", "repeats", "slow", "nan"]))
    if way == "stands":
        result[at:] = time[at]
    elif way == "runs back":
        result = result[::-1].copy()
    elif way == "jumps":
        result[at:] += float(chance.choice([0.5, 20.0, 1e3]))
    elif way == "far stamp":
        result[at] = float(chance.choice([0.0, 1e9, 1e15]))
    elif way == "repeats":
        result = np.repeat(result[::2], 2)[: len(time)]
        result = np.pad(result, (0, len(time) - len(result)), mode="edge")
    elif way == "slow":
        result = result[0] + (result - result[0]) * float(chance.choice([1e-3, 1e3]))
    else:
        result[at] = 0.0
    return result, Damage(f"clock {way}")


def damaged_bytes(content: bytes, chance: Chance) -> tuple[bytes, Damage]:
    """Bytes flipped, set, cut, left out, doubled, or set to the largest numbers."""
    data = bytearray(content)
    length = len(data)
    begin = length if chance.random() < 0.5 else min(length, 2000)  # what describes the rest stands at an end
    way = str(chance.choice(["flip", "set", "cut", "hole", "double", "zeros", "largest", "swap"]))
    at = int(chance.integers(0, max(begin, 1)))
    if chance.random() < 0.2:
        at = max(0, length - 1 - at)
    size = int(chance.choice([1, 2, 4, 8, 60, 700]))
    if way == "flip":
        for _ in range(int(chance.integers(1, 9))):
            data[int(chance.integers(0, max(begin, 1)))] ^= 1 << int(chance.integers(0, 8))
    elif way == "set":
        data[at : at + size] = chance.bytes(size)
    elif way == "cut":
        del data[at:]
    elif way == "hole":
        del data[at : at + size]
    elif way == "double":
        data[at:at] = data[at : at + size]
    elif way == "zeros":
        data[at : at + size] = bytes(len(data[at : at + size]))
    elif way == "largest":
        data[at : at + size] = (b"\xff" * 7 + b"\x7f")[-min(size, 8) :]
    else:
        other = int(chance.integers(0, length))
        one, two = bytes(data[at : at + size]), bytes(data[other : other + size])
        data[at : at + len(two)], data[other : other + len(one)] = two, one
    return bytes(data), Damage(f"bytes: {way} at {at}, {size}")


def damaged_label(content: bytes, chance: Chance) -> tuple[bytes, Damage]:
    """A word of the file as another word of it, or as something else, once or everywhere."""
    words = sorted({*re.findall(rb"[A-Za-z_][A-Za-z0-9_\[\]]{1,24}", content[:20_000])})
    if not words:
        return content, Damage("no label")
    old = words[int(chance.integers(0, len(words)))]
    others = [w for w in words if len(w) == len(old)]
    odd = (b"\x1b[31m" * 8, b"[red]" * 8, b"\xff\xfe" * 20, b"A" * 40, b"../" * 12, b"\x00" * 40)
    new = others[int(chance.integers(0, len(others)))] if chance.random() < 0.5 else odd[int(chance.integers(0, 6))]
    new = new[: len(old)]
    count = 1 if chance.random() < 0.5 else -1
    return content.replace(old, new, count), Damage(f"label {old!r} to {new!r}")


def damaged_log(kind: str, chance: Chance, path: Path) -> Damage:
    """Write a log of this kind, damaged in one way."""
    topics = topics_of(kind)
    way = chance.random()
    if way < 0.45:
        topic = str(chance.choice([*topics]))
        time, columns = topics[topic]
        if way < 0.1:
            time, damage = damaged_clock(time, chance)
        else:
            name = str(chance.choice([*columns]))
            values, damage = damaged_values(columns[name], chance)
            columns = {**columns, name: values}
            damage = Damage(f"{topic}.{name} {damage.what}", damage.impossible and topic != "TIME")
        write_log(kind, {**topics, topic: (time, columns)}, path)
        return damage
    write_log(kind, topics, path)
    harm = damaged_label if way < 0.65 else damaged_bytes
    content, damage = harm(path.read_bytes(), chance)
    path.write_bytes(content)
    return damage


NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.])")
MAY_BE_SMALL = ("imu", "inertia", "limits")
"""Keys of which some number may be as small as it likes, and negative."""
DECLARED = ("1e300", "-1e300", "nan", "inf", "-1.0", "1e-300", "1e-30", "1e30", "-1e-9", "1e10")


def damaged_toml(text: str, chance: Chance) -> tuple[str, Damage]:
    """A dataset.toml with a number, a line, a key or a word changed."""
    way = str(chance.choice(["number", "number", "line", "double", "word", "type"]))
    lines = text.splitlines()
    at = int(chance.integers(0, len(lines)))
    if way in ("number", "type"):
        places = [*NUMBER.finditer(text)][1:]  # the first is the format
        place = places[int(chance.integers(0, len(places)))]
        words = DECLARED if way == "number" else ('"x"', "[]", "true", "{}", "1970-01-01", "[[]]", "0x7fffffffffffffff")
        new = str(chance.choice(words))
        key = text[: place.start()].rpartition("\n")[2].partition("=")[0].strip()
        impossible = way == "number" and not (key in MAY_BE_SMALL and abs(float(new)) <= 1.0)
        return text[: place.start()] + new + text[place.end() :], Damage(f"{key} {new}", impossible)
    if way == "line":
        del lines[at]
    elif way == "double":
        lines.insert(at, lines[at])
    else:
        lines[at] = lines[at].replace("a", str(chance.choice(["b", "\x1b", '"', "é", "=", "]"])), 1)
    return "\n".join(lines), Damage(f"{way} {at}")


FLOWN = ("time", "lat", "lon", "p", "q", "r", "phi", "theta", "az")


def flights() -> dict[str, dict[str, np.ndarray]]:
    """Three flights of few channels, so that a command takes no longer than it must."""
    return {name: {c: arrays[c][:300] for c in FLOWN} for name, arrays in small_arrays().items()}


def write_set(folder: Path) -> None:
    """Write a data set of these flights."""
    small_folder(folder)
    for name, arrays in flights().items():
        np.savez(folder / "flights" / f"{name}.npz", allow_pickle=False, **arrays)


def damaged_set(chance: Chance, folder: Path) -> Damage:
    """Write a data set, damaged in one way."""
    write_set(folder)
    toml, flight = folder / "dataset.toml", folder / "flights" / f"{chance.choice(['one', 'two', 'three'])}.npz"
    way = chance.random()
    if way < 0.4:
        text, damage = damaged_toml(small_toml(), chance)
        toml.write_text(text, encoding="utf-8", errors="replace")
        return damage
    if way < 0.8:
        arrays = flights()[flight.stem]
        name = str(chance.choice([*arrays]))
        harm = damaged_clock if name == "time" else damaged_values
        arrays[name], damage = harm(arrays[name], chance)
        np.savez(flight, allow_pickle=False, **arrays)
        return Damage(f"{flight.stem} {name} {damage.what}", damage.impossible)
    content, damage = damaged_bytes(flight.read_bytes(), chance)
    flight.write_bytes(content)
    return damage


def _leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, (*path, key))
    elif isinstance(value, list | tuple) and value:
        for index, item in enumerate(value):
            yield from _leaves(item, (*path, index))
    else:
        yield path, value


def _plainly(value: Any) -> Any:
    """Tuples as lists, so that a part can be replaced."""
    if isinstance(value, dict):
        return {key: _plainly(item) for key, item in value.items()}
    return [_plainly(item) for item in value] if isinstance(value, list | tuple) else value


def damaged_document(document: Any, chance: Chance, numbers: tuple[float, ...]) -> tuple[Any, Damage]:
    """Nested plain data with a number, or anything, replaced, or a key left out."""
    document = _plainly(document)
    leaves = [*_leaves(document)]
    numeric = [path for path, value in leaves if isinstance(value, float)]
    replace_number = bool(numeric) and chance.random() < 0.6
    choices = numeric if replace_number else [path for path, _ in leaves]
    path = choices[int(chance.integers(0, len(choices)))]
    owner = document
    for step in path[:-1]:
        owner = owner[step]
    name = ".".join(map(str, path))
    if replace_number:
        owner[path[-1]] = float(chance.choice(numbers))
        return document, Damage(f"{name} {owner[path[-1]]:g}", True)
    way = int(chance.integers(0, 8))
    if way == 7:
        del owner[path[-1]]
        return document, Damage(f"{name} left out")
    owner[path[-1]] = (None, "x", -1, [], {}, True, [[]])[way]
    return document, Damage(f"{name} {owner[path[-1]]!r}")


@cache
def _model() -> bytes:
    spec = body_spec(mass=1000.0, inertia=((500.0, 0.0, -50.0), (0.0, 2000.0, 0.0), (-50.0, 0.0, 1800.0)))
    spec = body_spec(
        mass=spec.mass, inertia=spec.inertia, controls=("lon", "lat"), control_units={"lon": "rad", "lat": "rad"},
        patterns={row: [c for c in columns if c not in ("col", "ped")] for row, columns in spec.patterns.items()},
        sizes={"p": 0.1, "row.L": 1.0},
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        save(scattered(build(spec)), spec, Path(folder) / "model.pt")
        return (Path(folder) / "model.pt").read_bytes()


def damaged_model(chance: Chance, path: Path) -> Damage:
    """Write a model.pt, damaged in one way."""
    way = chance.random()
    if way < 0.4:
        content, damage = damaged_bytes(_model(), chance)
        path.write_bytes(content)
        return damage
    held = torch.load(io.BytesIO(_model()), weights_only=True)
    if way < 0.8:
        held["spec"], damage = damaged_document(held["spec"], chance, (*EXTREMES, math.nan))
    else:
        state = dict(held["state"])
        name = str(chance.choice([*state]))
        tensor = state[name].clone()
        changes: list[Callable[[], Any]] = [
            lambda: tensor * float(chance.choice((*EXTREMES, math.nan))),
            lambda: tensor[..., :-1],
            lambda: tensor.float(),
            lambda: tensor.unsqueeze(0).expand(100_000, *tensor.shape),
            lambda: tensor.to_sparse(),
            lambda: tensor.tolist(),
        ]
        at = int(chance.integers(0, len(changes)))
        state[name] = changes[at]()
        held["state"], damage = state, Damage(f"state {name} {at}", at == 0)
    torch.save(held, path)
    return damage


REPORT: dict[str, Any] = {
    "format": 1, "rotorid": "0", "command": "identify", "dataset": {"name": "hover", "sha256": "00"}, "seed": 0,
    "time_s": {"reconstruct": 1.0, "ftr": 1.0, "ml": 2.0, "trace": 0.0, "total": 4.0}, "peak_memory_mb": 300.0,
    "before": {
        "parameters": [
            {"name": "forces.L.p", "value": -3.0, "se": 0.1, "unit": "1/s", "bounds": [-50.0, 0.0],
             "at_bound": False, "status": "free"},
        ],
        "modes": [{"eigenvalue": [-0.3, 0.2], "name": "phugoid"}],
        "flights": {
            "one": {
                "list": "identify", "J": 0.5, "J_noise": 0.1, "J_trim": 1.0,
                "windows": {"median": 0.5, "p10": 0.4, "p90": 0.6},
                "channels": {"p": {"rmse": 0.1, "r2": 0.9, "theil": 0.1, "theil_parts": [0.1, 0.2, 0.7]}},
            },
        },
        "scores": {"identify": 0.5, "validate": 0.6, "acid": None},
    },
    "after": None, "verdict": None, "effects": [], "unknown": None, "warnings": ["a sentence"],
}  # fmt: skip


def damaged_report(chance: Chance, path: Path) -> Damage:
    """Write a report.json, damaged in one way."""
    content = json.dumps(REPORT, indent=1).encode()
    if chance.random() < 0.5:
        content, damage = (damaged_bytes if chance.random() < 0.7 else damaged_label)(content, chance)
    else:
        document, damage = damaged_document(REPORT, chance, (math.nan, math.inf, -math.inf, -1e30))
        unbounded = r"before\.(parameters\.0\.value|modes|flights\.one\.channels\.p\.(r2|theil_parts)).* -1e\+30"
        damage = Damage(damage.what, damage.impossible and not re.match(unbounded, damage.what))
        content = json.dumps(document).encode()
    path.write_bytes(content)
    return damage


# judgement


def prepared(kind: str, chance: Chance, place: Path) -> tuple[list[str], Path, Damage]:
    """Damaged input in the folder `place`: the command that reads it, what that may write, and the damage."""
    if kind in LOGS:
        damage = damaged_log(kind, chance, place / f"log.{kind}")
        return ["import", str(place / f"log.{kind}"), "--out", str(place / "out"), "--json"], place / "out", damage
    if kind == "report":
        (place / "run").mkdir()
        return ["show", str(place / "run")], place / "out", damaged_report(chance, place / "run" / "report.json")
    if kind == "model":
        small_folder(place / "set")
        damage = damaged_model(chance, place / "model.pt")
        command = ["simulate", str(place / "model.pt"), str(place / "set"), "--flight", "one", "--seconds", "1"]
        return [*command, "--out", str(place / "out.npz"), "--json"], place / "out.npz", damage
    damage = damaged_set(chance, place / "set")
    written = ["--out", str(place / "out")] if kind == "identify" else []
    return [kind, str(place / "set"), *written, "--json"], place / "out", damage


def whole_input(kind: str, place: Path) -> list[str]:
    """The same without damage."""
    if kind in LOGS:
        write_log(kind, topics_of(kind), place / f"log.{kind}")
        return ["import", str(place / f"log.{kind}"), "--out", str(place / "out"), "--json"]
    if kind == "report":
        (place / "run").mkdir()
        (place / "run" / "report.json").write_text(json.dumps(REPORT))
        return ["show", str(place / "run")]
    if kind != "model":
        write_set(place / "set")
    else:
        small_folder(place / "set")
        (place / "model.pt").write_bytes(_model())
        command = ["simulate", str(place / "model.pt"), str(place / "set"), "--flight", "one", "--seconds", "1"]
        return [*command, "--out", str(place / "out.npz"), "--json"]
    return [kind, str(place / "set"), *(["--out", str(place / "out")] if kind == "identify" else []), "--json"]


@contextmanager
def _within(seconds: int) -> Iterator[None]:
    def late(number: int, frame: object) -> None:
        raise TimeoutError(f"takes over {seconds} s")

    earlier = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, earlier)


def run(command: list[str]) -> Answer:
    """Run a command in this process, within bounds of time and memory."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), bounded_memory(MEMORY):
        try:
            with _within(SECONDS):
                code = cli.main(command)
        except TimeoutError as error:
            return Answer(1, out.getvalue(), err.getvalue(), str(error))
    return Answer(code, out.getvalue(), err.getvalue())


def _digests(place: Path, besides: Path) -> dict[Path, str]:
    files = (f for f in place.rglob("*") if besides not in (f, *f.parents))
    return {f: hashlib.sha256(f.read_bytes()).hexdigest() if f.is_file() else "folder" for f in files}


@contextmanager
def _temporary_files() -> Iterator[str]:
    """A folder in which temporary files are made until the block ends."""
    earlier = tempfile.tempdir
    with tempfile.TemporaryDirectory() as folder:
        tempfile.tempdir = folder
        try:
            yield folder
        finally:
            tempfile.tempdir = earlier


@dataclass(frozen=True)
class Result:
    """What an answer says, besides numbers: verdicts, warnings, findings; and the numbers that came out."""

    told: frozenset[str]
    numbers: Mapping[str, np.ndarray]


def _result(kind: str, answer: Answer, out: Path) -> Result:
    if kind == "report":
        return Result(frozenset(), {"text": np.frombuffer(answer.out.encode(), np.uint8)})
    said = json.loads(answer.out)
    if kind in LOGS:
        flights = load(out).flights
        numbers = {f"{i}.{c}": v.numpy() for i, f in enumerate(flights.values()) for c, v in f.channels.items()}
        return Result(frozenset(said["warnings"]), numbers)
    if kind == "model":
        with np.load(out) as archive:
            return Result(frozenset(said["warnings"]), {name: archive[name] for name in archive.files})
    if kind == "check":
        told = {f"{f['severity']} {f['channel']} {f['sentence']}" for f in said["findings"] if f["severity"] != "good"}
        return Result(frozenset(told), {"text": np.frombuffer(answer.out.encode(), np.uint8)})
    parameters = said["before"]["parameters"]
    values = np.array([p["value"] if p["value"] is not None else np.nan for p in parameters])
    return Result(frozenset(said["warnings"]), {"parameters": values})


@cache
def _of_whole(kind: str) -> Result:
    with tempfile.TemporaryDirectory() as folder:
        command = whole_input(kind, Path(folder))
        answer = run(command)
        assert answer.code == 0, answer.err
        return _result(kind, answer, Path(folder) / ("out.npz" if kind == "model" else "out"))


def _is_silent_nonsense(kind: str, answer: Answer, out: Path) -> bool:
    """Whether nothing is said that is not said of the whole input, though numbers are other ones, or are believed."""
    whole, now = _of_whole(kind), _result(kind, answer, out)
    if now.told - whole.told:
        return False
    if kind in ("check", "identify", "report"):
        return True
    names = whole.numbers.keys() & now.numbers.keys()
    return any(_differ(whole.numbers[name], now.numbers[name]) for name in names)


def _differ(one: np.ndarray, two: np.ndarray) -> bool:
    if one.shape != two.shape:
        return True
    finite = np.isfinite(one) & np.isfinite(two)
    return bool((np.abs(one - two)[finite] > 1e-3 * (1.0 + np.abs(one[finite]))).any())


def judged(kind: str, seed: int) -> tuple[Damage, Answer]:
    """Damage an input by a seed, run its command, and judge the answer."""
    chance = np.random.default_rng([KINDS.index(kind), seed])
    _of_whole(kind)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        command, out, damage = prepared(kind, chance, place)
        before = _digests(place, out)
        with _temporary_files() as temporary:
            answer = run(command)
            left = os.listdir(temporary)
        fault = answer.fault or _fault(kind, answer, out, damage)
        if not fault and _digests(place, out) != before:
            fault = "the folder of the input is not as it was"
        if not fault and left:
            fault = f"left behind: {left[0]}"
    return damage, Answer(answer.code, answer.out, answer.err, fault)


def _fault(kind: str, answer: Answer, out: Path, damage: Damage) -> str:
    if answer.code not in CODES or "unexpected" in answer.err or "Traceback" in answer.err:
        return f"crash: {answer.err.strip()}"
    if re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f]", answer.out + answer.err):
        return "control characters are printed"
    if answer.code == 2:
        if not re.fullmatch(r"rotorid: [^\n]+; expected [^\n]+\n", answer.err) or answer.out:
            return f"not one line: {answer.err!r}"
        return "something was written" if out.exists() else ""
    if damage.impossible and answer.code == 0 and _is_silent_nonsense(kind, answer, out):
        return "silent nonsense"
    return ""
