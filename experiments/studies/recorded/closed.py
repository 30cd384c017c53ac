"""Closed loops of data sets that a study makes, one line of its record each, beside what the sets hide."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import rotorid_torch as rotorid
from recorded.lines import append_line, failure, read_lines, version

Made = tuple[Callable[[], rotorid.Dataset], Mapping[str, float]]
"""What makes a data set, and the sizes of the effects that are hidden in it, by full name."""


def closed(made: Made) -> dict[str, Any]:
    """Verdict, names, and sizes beside the true ones."""
    line: dict[str, Any] = {"true": dict(made[1])}
    try:
        loop = rotorid.close_loop(made[0]())
    except Exception as error:  # a study goes on; the line tells
        return line | failure(error)
    assert loop.verdict is not None
    verdict = loop.verdict
    shown = [e for e in loop.effects if e.id in verdict.effects]
    sizes = {p.name: [p.value, p.se] for e in shown for p in e.parameters if p.value is not None}
    line |= {"kind": verdict.kind, "named": list(verdict.effects)}
    line["suspected"] = [row.id for row in loop.effects if row.verdict == "suspected"]
    return line | {"sizes": sizes, "sentence": verdict.sentence}


def close_loops(sets: Mapping[str, Made], settings: str, record: Path) -> None:
    """Close the loops of these sets by name that the record does not hold, keep their lines, and print all.

    settings : how the sets are made, in words; lines of other settings are not theirs.
    """
    kept = {line["case"]: line for line in read_lines(record)}
    for name, made in sets.items():
        case = f"{version()} {name} {settings}"
        line = kept.get(case) or {"case": case} | closed(made)
        if case not in kept:
            append_line(record, line)
        print(json.dumps(line))
