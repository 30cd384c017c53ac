"""Steady wind in hovers and figures of eight of multirotors, by the closed loop.

Each data set is five flights on several headings and three to validate by, in one wind from 40 degrees right of north;
the loop reads no truth. A case is right where wind is named, or is a member of the group that is named, its direction
within 20 degrees, its size within 30 %, and nothing else is named that the vehicle does not have. One JSON line each.

    python steady_wind.py --vehicles quad multirotor-3 --speeds 4 8 12

A case takes 2 minutes of a processor; `--quick` flies one in flights of 4 s.
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import dataclass

import numpy as np
import tyro
from multirotor_effects import loop_report, sizes
from recorded.lines import failure, version

from rotorid_torch.simulation import fly
from rotorid_torch.simulation.multirotor.hidden import HIDDEN
from rotorid_torch.simulation.multirotor.vehicles import multirotor

WIND = "environment.wind"
FLIGHTS = (
    *("hover_p", "hover_p-120deg", "hover_p-240deg", "eight_p", "eight_p-90deg"),
    *("eight_n", "eight_n-180deg", "eight_n-270deg"),
)
FROM = math.radians(40.0)
"""Where the built-in wind blows from."""
AMISS = 20.0, 0.3
"""Degrees and share by which a wind that is found may be off."""


@dataclass
class Args:
    """Which cases."""

    vehicles: tuple[str, ...] = ("quad",)
    """Built-in vehicles."""
    speeds: tuple[float, ...] = (4.0, 8.0, 12.0)
    """Of the wind, m/s."""
    seconds: float = 12.0
    """Of each flight."""
    quick: bool = False
    """One wind in short flights."""


def run_case(vehicle: str, speed: float, seconds: float) -> dict:
    """Fly in a wind, close the loop, and say what came of it."""
    size = speed / multirotor(vehicle).speed  # the built-in wind is as fast as the vehicle flies
    line: dict = {"case": f"{version()}/{vehicle}/{speed:g} m/s", "vehicle": vehicle, "wind": speed}
    before = time.process_time()
    flown = fly(None, vehicle=vehicle, flights=FLIGHTS, effects=[(WIND, size)], seconds=seconds, seed=round(speed))
    try:
        report = loop_report(flown.dataset())
    except Exception as error:  # a study goes on; the line tells
        return line | failure(error)
    verdict = report["verdict"]
    line |= {"kind": verdict["kind"], "named": verdict["effects"], "sizes": sizes(report, verdict["effects"])}
    line |= found(line["sizes"], speed)
    false = set(verdict["effects"]) - {WIND, *HIDDEN[WIND].brings}
    right = line.get("direction_off", 180.0) <= AMISS[0] and abs(line.get("size", 0.0) - 1.0) <= AMISS[1]
    line["outcome"] = "right" if right and (not false or verdict["kind"] == "group") else "wrong" if false else "missed"
    return line | {"cpu_s": round(time.process_time() - before, 1)}


def found(values: dict[str, list[float]], speed: float) -> dict[str, float]:
    """Degrees by which the direction of the wind is off, and its size over the true one; nothing where none is."""
    parts = [values.get(f"{WIND}.{axis}") for axis in ("north", "east")]
    if None in parts:
        return {}
    wind = np.array([part[0] for part in parts if part])
    size, true = float(np.hypot(*wind)), -np.array([math.cos(FROM), math.sin(FROM)])
    off = math.degrees(math.acos(float(np.clip(wind @ true / max(size, 1e-9), -1.0, 1.0))))
    return {"direction_off": round(off, 2), "size": round(size / speed, 3)}


def main() -> int:
    """Run the cases."""
    args = tyro.cli(Args)
    speeds, seconds = (args.speeds[:1], 4.0) if args.quick else (args.speeds, args.seconds)
    for vehicle in args.vehicles:
        for speed in speeds:
            sys.stdout.write(json.dumps(run_case(vehicle, speed, seconds)) + "\n")
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
