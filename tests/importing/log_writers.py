"""Small writers of ULog and DataFlash, so that every defect can be written on purpose; and a flight to put in."""

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

LETTERS = {"<f4": "f", "<f8": "d", "<u8": "Q", "<u2": "H", "<i2": "h", "<u1": "B", "<i4": "i"}
NAMES = {"<f4": "float", "<f8": "double", "<u8": "uint64_t", "<u2": "uint16_t", "<i4": "int32_t", "<u1": "uint8_t"}
Topics = Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray]]]


def message(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def ulog_head(parameters: Mapping[str, float] | None = None) -> bytes:
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    head += message("I", bytes([len("char[3] sys_name")]) + b"char[3] sys_namePX4")
    for name, value in (parameters or {}).items():
        kind = "int32_t" if isinstance(value, int) else "float"
        key = f"{kind} {name}".encode()
        head += message("P", bytes([len(key)]) + key + struct.pack("<i" if isinstance(value, int) else "<f", value))
    return head


def ulog_format(topic: str, columns: Mapping[str, np.ndarray]) -> bytes:
    """Format message; columns `name[0]`, `name[1]` are one array, `name[0].a`, `name[0].b` topics inside the topic."""
    inner = {name.partition(".")[2]: v for name, v in columns.items() if "]." in name}
    if inner:
        (base,) = {name.partition("[")[0] for name in columns if "]." in name}
        count = len({name.partition("]")[0] for name in columns if "]." in name})
        members = ";".join(f"{NAMES[v.dtype.str.replace('|', '<')]} {n}" for n, v in inner.items())
        outer = f"{topic}:uint64_t timestamp;{topic}_part[{count}] {base};"
        return message("F", f"{topic}_part:{members};".encode()) + message("F", outer.encode())
    counts: dict[str, int] = {}
    kinds: dict[str, str] = {}
    for name, values in columns.items():
        bare = name.partition("[")[0]
        counts[bare] = counts.get(bare, 0) + ("[" in name)
        kinds[bare] = NAMES[values.dtype.str.replace("|", "<")]
    fields = [f"{kinds[n]}[{c}] {n}" if c else f"{kinds[n]} {n}" for n, c in counts.items()]
    return message("F", f"{topic}:uint64_t timestamp;{';'.join(fields)};".encode())


def records(number: int, stamps: np.ndarray, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Data messages as one structured array."""
    fields = [("size", "<u2"), ("kind", "u1"), ("id", "<u2"), ("timestamp", "<u8")]
    rows = np.zeros(len(stamps), np.dtype([*fields, *((name, values.dtype) for name, values in columns.items())]))
    rows["size"], rows["kind"], rows["id"], rows["timestamp"] = rows.dtype.itemsize - 3, 68, number, stamps
    for name, values in columns.items():
        rows[name] = values
    return rows


def write_ulog(path: Path, topics: Topics, parameters: Mapping[str, float] | None = None, repeat: int = 1) -> Path:
    """ULog of topics, each time (T,) in s and columns; `topic[1]` is a second instance; data by whole seconds.

    `repeat` writes all of it so many times, one after the other in time.
    """
    every = [(np.round(time * 1e6).astype(np.uint64), columns) for time, columns in topics.values()]
    second = np.uint64(1_000_000)
    whole = int(max(stamps[-1] for stamps, _ in every) // second) + 1
    rows = [records(number, stamps, columns) for number, (stamps, columns) in enumerate(every)]
    parts = [[block[block["timestamp"] // second == s] for block in rows] for s in range(whole)]
    bare = [name.partition("[")[0] for name in topics]
    with path.open("wb") as file:
        file.write(ulog_head(parameters))
        for name, (_, columns) in dict(zip(bare, every, strict=True)).items():
            file.write(ulog_format(name, columns))
        for number, name in enumerate(topics):
            instance = int(name.partition("[")[2].rstrip("]") or 0)
            file.write(message("A", struct.pack("<BH", instance, number) + bare[number].encode()))
        for _ in range(repeat):
            for blocks in parts:
                for block in blocks:
                    file.write(block.tobytes())
                    block["timestamp"] += np.uint64(whole) * second
    return path


def dataflash_format(number: int, length: int, name: str, letters: str, columns: str) -> bytes:
    texts = struct.pack("<4s16s64s", name.encode(), letters.encode(), columns.encode())
    return b"\xa3\x95\x80" + bytes([number, length]) + texts


def write_dataflash(
    path: Path,
    topics: Topics,
    parameters: Mapping[str, float] | None = None,
    about: str = "",
    units: Mapping[str, str] | None = None,
) -> Path:
    """DataFlash log of topics, each time (T,) in s and columns; data by whole seconds; `units` by topic."""
    with path.open("wb") as file:
        file.write(dataflash_format(0x80, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"))
        file.write(dataflash_format(2, 31, "PARM", "QNf", "TimeUS,Name,Value"))
        file.write(dataflash_format(3, 75, "MSG", "QZ", "TimeUS,Message"))
        for name, value in (parameters or {}).items():
            file.write(b"\xa3\x95\x02" + struct.pack("<Q16sf", 0, name.encode(), value))
        file.write(b"\xa3\x95\x03" + struct.pack("<Q64s", 0, about.encode()))
        blocks = []
        for number, (name, (time, columns)) in enumerate(topics.items(), 10):
            fields = [("head", "<u2"), ("id", "u1"), ("TimeUS", "<u8")]
            rows = np.zeros(len(time), np.dtype([*fields, *((n, v.dtype) for n, v in columns.items())]))
            rows["head"], rows["id"], rows["TimeUS"] = 0x95A3, number, np.round(time * 1e6)
            for column, values in columns.items():
                rows[column] = values
            letters = "Q" + "".join(LETTERS[v.dtype.str.replace("|", "<")] for v in columns.values())
            file.write(dataflash_format(number, rows.dtype.itemsize, name, letters, ",".join(["TimeUS", *columns])))
            blocks.append(rows)
        if units:
            file.write(dataflash_format(4, 44, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"))
        for name, marks in (units or {}).items():
            number = 10 + [*topics].index(name)
            file.write(b"\xa3\x95\x04" + struct.pack("<QB16s16s", 0, number, marks.encode(), b""))
        for second in range(int(max(time[-1] for time, _ in topics.values())) + 1):
            for rows in blocks:
                file.write(rows[rows["TimeUS"] // 1_000_000 == second].tobytes())
    return path


def write_dataflash_text(
    path: Path, topics: Topics, parameters: Mapping[str, float] | None = None, about: str = "", before: str = ""
) -> Path:
    """The same as text, one message a line; `before` are lines before the first message."""
    lines = [before] if before else []
    lines += ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns", "FMT, 2, 31, PARM, QNf, TimeUS,Name,Value"]
    lines += ["FMT, 3, 75, MSG, QZ, TimeUS,Message", f"MSG, 0, {about}"]
    lines += [f"PARM, 0, {name}, {value}" for name, value in (parameters or {}).items()]
    stamped: list[tuple[int, str]] = []
    for number, (name, (time, columns)) in enumerate(topics.items(), 10):
        letters = "Q" + "".join(LETTERS[v.dtype.str.replace("|", "<")] for v in columns.values())
        lines.append(f"FMT, {number}, 89, {name}, {letters}, {','.join(['TimeUS', *columns])}")
        stamps = np.round(time * 1e6).astype(np.int64)
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        stamped += [
            (us, f"{name}, {us}, " + ", ".join(map(str, row))) for us, row in zip(stamps.tolist(), rows, strict=True)
        ]
    path.write_text("\n".join([*lines, *(line for _, line in sorted(stamped, key=lambda one: one[0]))]) + "\n")
    return path


def motion(time: np.ndarray) -> dict[str, np.ndarray]:
    """A known flight at these times: angles, the body rates that belong to them, motors, velocity north-east-down."""
    wave = 2.0 * np.pi * np.array([0.4, 0.3, 0.1])
    size = np.array([0.2, 0.15, 0.5])
    phi, theta, psi = (a * np.sin(w * time) for a, w in zip(size, wave, strict=True))
    rolled, pitched, yawed = (a * w * np.cos(w * time) for a, w in zip(size, wave, strict=True))
    made = {"phi": phi, "theta": theta, "psi": psi + 1.0}
    made["p"] = rolled - yawed * np.sin(theta)
    made["q"] = pitched * np.cos(phi) + yawed * np.sin(phi) * np.cos(theta)
    made["r"] = -pitched * np.sin(phi) + yawed * np.cos(phi) * np.cos(theta)
    made |= {f"motor{i + 1}": 0.5 + 0.2 * np.sin(2.0 * np.pi * (0.2 + 0.1 * i) * time) for i in range(4)}
    return made | {"vn": 3.0 * np.sin(time), "ve": 2.0 * np.cos(time), "vd": -np.sin(0.5 * time)}


def quaternion(phi: np.ndarray, theta: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """Quaternion (4, T) from body to north-east-down axes, scalar first."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", np.stack([psi, theta, phi], -1)).as_quat(scalar_first=True).T


def px4_topics(seconds: float = 12.0, start: float = 100.0, fast: float = 400.0) -> dict[str, tuple]:
    """Topics of a newer PX4 quadrotor, each at a rate of its own, stamped from `start` on."""

    def at(hertz: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        time = np.arange(0.0, seconds, 1.0 / hertz)
        return start + time, motion(time)

    topics: dict[str, tuple] = {}
    time, m = at(fast)
    topics["vehicle_angular_velocity"] = (time, {f"xyz[{i}]": m[n].astype("<f4") for i, n in enumerate("pqr")})
    time, m = at(100.0)
    turned = quaternion(m["phi"], m["theta"], m["psi"])
    topics["vehicle_attitude"] = (time, {f"q[{i}]": turned[i].astype("<f4") for i in range(4)})
    time, m = at(50.0)
    velocity = {name: m[key].astype("<f4") for name, key in (("vx", "vn"), ("vy", "ve"), ("vz", "vd"))}
    place = {name: (0.1 * time).astype("<f4") for name in ("x", "y", "z")}
    topics["vehicle_local_position"] = (time, place | velocity)
    time, m = at(250.0)
    motors = {f"control[{i}]": m[f"motor{i + 1}"].astype("<f4") for i in range(4)}
    rest = {f"control[{i}]": np.full(len(time), np.nan, "<f4") for i in range(4, 12)}
    topics["actuator_motors"] = (time, motors | rest)
    time, _ = at(5.0)
    topics["battery_status"] = (time, {"voltage_v": np.full(len(time), 16.0, "<f4")})
    return topics
