"""One closed loop of the golden study as one JSON line, by public parts of the package that all its versions have."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import torch
from recorded.lines import failure, version

import rotorid_torch as rotorid
from golden_study.cases import Case, Kind, flights_of
from rotorid_torch.effects.registry import registered

Z95 = 1.96
QUICK_LIBRARY = ("control.delay",)


@contextmanager
def without_entries(effects: Sequence[str]) -> Iterator[None]:
    """Entries of the library that cannot be tested on any vehicle, as if nobody had written them.

    Processes that fly clean aircraft are handed the effects that are testable, so they need not know of it.
    """
    library = registered()
    removed = {name: library[name] for name in effects if name in library}

    def untestable(cls: type, spec: object) -> str:
        return "taken out of the library"

    for name, effect in removed.items():
        changed = {"untestable": classmethod(untestable), "__module__": effect.__module__}
        library[name] = type(effect.__name__, (effect,), changed)
    try:
        yield
    finally:
        library.update(removed)


def removed_by(case: Case) -> tuple[str, ...]:
    """Effects whose entries are taken out of the library in a case."""
    if case.kind is Kind.QUICK:
        return tuple(name for name in registered() if name not in QUICK_LIBRARY)
    return (case.hidden or ()) if case.kind is Kind.REMOVED else ()


def key(case: Case) -> str:
    """Of a case with the version of the package that runs it."""
    return f"{version()} {case.key}"


def run_case(case: Case, shared: Path, aircraft: Path) -> dict:
    """Close the loop blind, and say what came of it; an error of any kind is a result too.

    Parameters
    ----------
    shared : folder of the sets of other people. aircraft : folder of the drawn aircraft.
    """
    torch.set_num_threads(1)
    hidden = None if case.hidden is None else list(case.hidden)
    line = {"case": key(case), "code": version(), "git": commit(), "half": case.half, "kind": case.kind}
    line |= {"hidden": hidden, "also": list(case.also), "size": case.size, "aircraft": case.aircraft}
    line |= {"dataset": case.dataset, "seed": None if case.dataset else case.seed}
    cached, began, used = _cached_files(), time.perf_counter(), _processor_seconds()
    try:
        with tempfile.TemporaryDirectory() as folder, without_entries(removed_by(case)):
            flown = flights_of(case, shared, aircraft, Path(folder))
            line |= {"flights": flown.dataset.sha256[:8]}
            began, used = time.perf_counter(), _processor_seconds()
            loop = rotorid.close_loop(flown.dataset)
        line |= summary(loop, flown.true)
        if set(line["named"]) & set(removed_by(case)):
            line |= {"failed": "this version names what is not in its library"}
    except Exception as error:
        line |= failure(error)
    line |= {"seconds": round(time.perf_counter() - began, 1), "cpu_s": round(_processor_seconds() - used, 1)}
    return line | {"cold": _cached_files() > cached}


def summary(loop: rotorid.Loop, true: Mapping[str, float]) -> dict:
    """What a closed loop says, and how far named sizes are from the true ones."""
    verdict, before = loop.verdict, loop.before
    assert verdict is not None
    assert before is not None
    after = loop.after or before
    accepted = [row for row in loop.effects if row.verdict == "accepted"]
    fitted = {p.name.rpartition(".")[0] for p in after.parameters}
    named = [row for row in accepted if row.role == "undeclared"]
    names = [row.id for row in named]
    unknown = loop.record.unknown
    return {
        "verdict": verdict.kind,
        "sentence": verdict.sentence,
        "named": names,
        "group": [e for e in verdict.effects if verdict.kind == "group" and e not in names],
        "suspected": [row.id for row in loop.effects if row.verdict == "suspected"],
        # what the nominal model has from the start stands there under the name of its own part
        "structure": [row.id for row in accepted if row.role == "structure" and row.id in fitted],
        "p": {row.id: p for row in loop.effects if (p := getattr(row, "p", None)) is not None},
        "sizes": {p.name: size(p.value, p.se, true.get(p.name)) for row in named for p in row.parameters},
        "unknown": unknown and {"where": unknown.where, "goes_with": unknown.goes_with, "since_s": unknown.since_s},
        "J": {
            when: {n: _rounded(getattr(fit.scores, n)) for n in ("identify", "validate", "acid")}
            for when, fit in (("before", before), ("after", after))
        },
        "warnings": len(loop.record.warnings),
    }


def size(value: float | None, error: float | None, true: float | None) -> dict:
    """A size, its standard error, the true one where there is one, and whether the 95 % interval holds that."""
    complete = value is not None and error is not None and true is not None
    return {
        "value": _rounded(value),
        "se": _rounded(error),
        "true": _rounded(true),
        "holds": abs(value - true) <= Z95 * error if complete else None,
    }


@cache
def commit() -> str:
    """The commit of the checkout that the package is loaded from, as `git describe` tells it."""
    root = Path(rotorid.__file__).parents[1]
    command = ["git", "-C", str(root), "describe", "--tags", "--always"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or "no git"


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")


def _processor_seconds() -> float:
    """Of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def _cached_files() -> int:
    """Files in the folder of the cache: a case that adds some had clean aircraft to fly."""
    return sum(1 for _ in Path(os.environ["ROTORID_CACHE"]).rglob("*"))
