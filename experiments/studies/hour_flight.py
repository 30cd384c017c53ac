"""How long does a check of a one-hour flight at 200 Hz take? Manoeuvres of the flight-test aircraft, laid end to end.

hour_flight.py [--minutes 60] [--hertz 200] [--out FILE.json]: one JSON line with seconds and memory.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from rotorid_torch.data import load
from rotorid_torch.data.write import write_dataset
from rotorid_torch.run.check import check, write_check
from rotorid_torch.run.output.monitor import Monitor
from rotorid_torch.simulation import fly

PIECES = ("f321_lon", "f321_lat", "f321_col", "f321_ped", "dbl_lon_p", "dbl_lat_p", "dbl_col_p", "dbl_ped_p")
PAUSE_S = 0.5
"""Between manoeuvres the record is missing: the aircraft was flown back to its trim."""


def main() -> int:
    """Fly, lay end to end, check, and tell seconds and megabytes."""
    options = parser().parse_args()
    with tempfile.TemporaryDirectory(prefix="rotorid-hour-") as folder:
        fly(Path(folder) / "flown", seed=1, flights=PIECES)
        write_hour(Path(folder) / "flown", Path(folder) / "hour", 60.0 * options.minutes, options.hertz)
        begin = time.perf_counter(), time.process_time()
        dataset = load(Path(folder) / "hour")
        loaded = time.perf_counter()
        result = check(dataset)
        checked = time.perf_counter()
        write_check(Path(folder) / "run", dataset, result, 0, Monitor())
        end = time.perf_counter(), time.process_time()
    figures = {
        "samples": dataset.facts["hour"].samples,
        "channels": len(dataset.facts["hour"].channels),
        "load_s": loaded - begin[0],
        "check_s": checked - loaded,
        "write_s": end[0] - checked,
        "total_s": end[0] - begin[0],
        "total_cpu_s": end[1] - begin[1],
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "warnings": [f.sentence for f in result.findings if f.severity in ("error", "warning")],
    }
    line = json.dumps(figures)
    if options.out:
        options.out.write_text(line + "\n")
    sys.stdout.write(line + "\n")
    return 0


def write_hour(flown: Path, out: Path, seconds: float, hertz: float) -> None:
    """Write a data set of one flight of so many seconds from the identify flights of another."""
    dataset = load(flown)
    parts = [_at_rate(dataset, name, hertz) for name in dataset.identify]
    count, pause = round(seconds * hertz), round(PAUSE_S * hertz)
    channels: dict[str, list[np.ndarray]] = {name: [] for name in parts[0]}
    length, k = 0, 0
    while length < count:
        for name, rows in channels.items():
            value = parts[k % len(parts)][name]
            edge = value[-1] if name in dataset.controls else np.nan
            rows += [value, np.full(pause, edge)]
        length += len(parts[k % len(parts)]["p"]) + pause
        k += 1
    hour = {name: np.concatenate(rows)[:count].astype(np.float32) for name, rows in channels.items()}
    hour["time"] = np.arange(count) / hertz
    # the interpolated noise is smaller than the declared one: none is declared
    write_dataset(out, {"hour": hour}, name="hour", identify=["hour"], vehicle=dataset.vehicle)


def _at_rate(dataset, name: str, hertz: float) -> dict[str, np.ndarray]:
    flight = dataset.flights[name]
    grid = np.arange(0.0, float(flight.time[-1]), 1.0 / hertz)
    time = flight.time.numpy()
    return {c: np.interp(grid, time, v.numpy()) for c, v in flight.channels.items() if c != "time"}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    command_line = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    command_line.add_argument("--minutes", type=float, default=60.0)
    command_line.add_argument("--hertz", type=float, default=200.0)
    command_line.add_argument("--out", type=Path, metavar="FILE")
    return command_line


if __name__ == "__main__":
    sys.exit(main())
