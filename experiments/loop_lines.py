"""One JSON line of one closed loop: verdict, evidence, parameters, and errors before and after."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import msgspec

import rotorid_torch
from rotorid_torch.run.closing import Loop
from rotorid_torch.run.pipeline import Run
from rotorid_torch.run.records import FitRecord

UNSEEN = ("validate", "acid")
Scores = dict[str, float | None]


def loop_line(loop: Loop, hidden: Sequence[str] = (), truth: Mapping[str, float] | None = None) -> dict:
    """What a closed loop said.

    Parameters
    ----------
    hidden : what was hidden, where that is known; its evidence is set against the strongest of the others.
    truth : true parameters by full name.
    """
    verdict, before = loop.verdict, loop.before
    assert verdict is not None
    assert before is not None
    after = loop.after or before
    named = joined(loop, "undeclared")
    members = [e for e in verdict.effects if verdict.kind == "group" and e not in named]
    return {
        "verdict": verdict.kind,
        "sentence": verdict.sentence,
        "named": named,
        "group": members,
        "structure": joined(loop, "structure"),
        "evidence": _evidence(loop, hidden),
        "parameters": _parameters(loop, truth or {}),
        "unknown": None if loop.record.unknown is None else msgspec.to_builtins(loop.record.unknown),
        "J": {"before": _scores(before), "after": _scores(after), "noise": _noise(before)},
        "noise_removed": {"before": _removed(before), "after": _removed(after)},
        "warnings": list(loop.record.warnings),
        "time_s": msgspec.to_builtins(loop.record.time_s),
    }


def joined(loop: Loop, role: str) -> list[str]:
    """Effects of a role that the loop added; what the nominal model has from the start is none."""
    added = loop.tracing.structure if loop.tracing else ()
    accepted = [e for e in loop.effects if e.role == role and e.verdict == "accepted"]
    return [e.id for e in accepted if role != "structure" or e.id in added]


def told_line(run: Run | None, why: str, hidden: Sequence[str]) -> dict:
    """Errors and parameters of the fit that was told what is hidden, or why there is none."""
    if run is None:
        return {"told": {"none": why}}
    own = tuple(f"{e}." for e in hidden)
    found = {p.name: {"value": p.value, "se": p.se} for p in run.parameters if p.name.startswith(own)}
    return {"told": {"J": _scores(run.fit), "noise_removed": _removed(run.fit), "parameters": found}}


def failure(error: Exception) -> dict:
    """A run that ended with an error; it is tried again next time."""
    return {"failed": f"{type(error).__name__}: {error}"}


def read_lines(file: Path) -> list[dict]:
    """Lines that are there, the last one of each case; a line that a killed run left half is not."""
    found: dict[str, dict] = {}
    for text in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        found[line["case"]] = line
    return list(found.values())


@cache
def version() -> str:
    """Of the package's code, eight digits: runs with the same came of the same code."""
    digest, root = hashlib.sha256(), Path(rotorid_torch.__file__).parent
    for file in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".h", ".toml")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:8]


RECORDED = tuple(
    "case code study hidden size aircraft drawn verdict sentence named group structure parameters unknown failed"
    " noise_removed told seconds".split()
)
"""What a record of studies keeps of a line: all that tables are made of."""


def record_lines(record: Path, lines: Sequence[dict]) -> list[dict]:
    """Put lines of a study into the record, in place of those of the same case; returns all it holds."""
    known = {line["case"]: line for line in read_lines(record)}
    for line in lines:
        case = f"study {line['study']}, {line['case']}"
        known[case] = {n: line[n] for n in RECORDED if n in line} | {"case": case}
    record.parent.mkdir(parents=True, exist_ok=True)
    record.write_text("".join(json.dumps(known[case]) + "\n" for case in sorted(known)), encoding="utf-8")
    return list(known.values())


def append_line(file: Path, line: dict) -> None:
    """Add a line, behind a half one on a line of its own."""
    text = json.dumps(line) + "\n"
    with file.open("a+b") as stream:
        if stream.tell():
            stream.seek(-1, 2)
            text = text if stream.read(1) == b"\n" else "\n" + text
        stream.write(text.encode())


def _evidence(loop: Loop, hidden: Sequence[str]) -> dict:
    """Verdict, gain and floor of what is hidden, and of the other effect that comes highest over its floor."""
    rows = {
        e.id: {
            "verdict": e.verdict,
            "reason": e.reason,
            "gain": e.gain,
            "floor": e.floor,
            "group": list(e.group),
            "smallest_visible": None if e.smallest_visible is None else msgspec.to_builtins(e.smallest_visible),
        }
        for e in loop.effects
    }
    over = {n: r["gain"] / r["floor"] for n, r in rows.items() if n not in hidden and r["gain"] and r["floor"]}
    highest = max(over, key=lambda n: over[n], default=None)
    other = None if highest is None else {"id": highest, **rows[highest]}
    return {"hidden": {e: rows[e] for e in hidden if e in rows}, "other": other}


def _parameters(loop: Loop, truth: Mapping[str, float]) -> dict:
    """Parameters of the undeclared effects that were found, and their true values where there are such."""
    found = [p for e in loop.effects if e.role == "undeclared" for p in e.parameters if e.verdict != "rejected"]
    return {p.name: {"value": p.value, "se": p.se, "unit": p.unit, "true": truth.get(p.name)} for p in found}


def _scores(fit: FitRecord) -> Scores:
    return {name: getattr(fit.scores, name) for name in ("identify", *UNSEEN)}


def _noise(fit: FitRecord) -> Scores:
    """J_noise of the lists of unseen flights."""
    return {name: _rms([f.J_noise for f in fit.flights.values() if f.list == name]) for name in UNSEEN}


def _removed(fit: FitRecord) -> Scores:
    """Error of the lists without the noise: sqrt(J^2 - J_noise^2)."""
    total, noise = _scores(fit), _noise(fit)
    return {n: _difference(total[n], noise[n]) for n in UNSEEN}


def _difference(total: float | None, noise: float | None) -> float | None:
    return None if total is None or noise is None else math.sqrt(max(total * total - noise * noise, 0.0))


def _rms(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return math.sqrt(sum(v * v for v in known) / len(known)) if known else None
