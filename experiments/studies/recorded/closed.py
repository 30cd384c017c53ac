"""Closed loops of data sets that a study makes, one line of its record each, beside what the sets hide."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import rotorid_torch as rotorid
from recorded.lines import append_line, failure, read_lines, version


@dataclass
class Args:
    """Which sets, and how they are flown."""

    sets: tuple[str, ...]
    record: Path
    """One line for each set and version."""
    seconds: float = 15.0
    """Of each flight."""
    seed: int = 0
    quick: bool = False
    """One set alone, of flights of 6 s."""

    @classmethod
    def of(cls, sets: Mapping[str, Any], record: str) -> Args:
        """All sets, with a record of this name beside the others."""
        return cls(tuple(sets), Path(__file__).parents[1] / "records" / record)


def closed(make: Callable[[], rotorid.Dataset], true: Mapping[str, float]) -> dict[str, Any]:
    """Verdict, names, and sizes beside the true ones, which are by full name."""
    line: dict[str, Any] = {"true": dict(true)}
    try:
        loop = rotorid.close_loop(make())
    except Exception as error:  # a study goes on; the line tells
        return line | failure(error)
    assert loop.verdict is not None
    verdict = loop.verdict
    shown = [e for e in loop.effects if e.id in verdict.effects]
    sizes = {p.name: [p.value, p.se] for e in shown for p in e.parameters if p.value is not None}
    line |= {"kind": verdict.kind, "named": list(verdict.effects)}
    line["suspected"] = [row.id for row in loop.effects if row.verdict == "suspected"]
    return line | {"sizes": sizes, "sentence": verdict.sentence}


def close_loops(
    args: Args, make: Callable[[str, Args], rotorid.Dataset], true: Callable[[str], Mapping[str, float]]
) -> None:
    """Close the loops of the sets that the record does not hold, keep their lines, and print all.

    make : a set by its name. true : sizes of the effects that are hidden in it.
    """
    kept = {line["case"]: line for line in read_lines(args.record)}
    for name in args.sets:
        case = f"{version()} {name} {args.seconds:g} s #{args.seed}"
        line = kept.get(case) or {"case": case} | closed(partial(make, name, args), true(name))
        if case not in kept:
            append_line(args.record, line)
        print(json.dumps(line))
