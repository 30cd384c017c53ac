"""Is anything lost or believed that should not be? Commands killed, caches damaged, disks full, places in the way.

torture.py [--only kill reconstruct] [--quick] [--out torture]: each trial is a JSON line in trials.jsonl,
with its faults; what has a line of the same code is not tried again. At the end a table, and one JSON line.

The trials, all drawn from the seed:

* kills of fly, import, reconstruct, identify and close-loop at drawn moments of their processor time and just before
  drawn changes of files, with and without an earlier result; kills while a model is compiled, or while clean aircraft
  are drawn. The earlier result is whole or absent, no process goes on, the rerun gives the numbers of an undisturbed
  run, and nothing is left beside the result, in the cache, among temporary files.
* libraries and draws of the cache that are damaged in many ways: the numbers are right, one line says so.
* full disks, read-only and unreadable folders, things in the way: exit code 2, one line that names the place, and
  everything as before.

Full and read-only disks are small file systems in memory: they need the rights of root, and are left out without.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import tyro
from recorded.lines import append_line, read_lines, version
from recorded.tables import markdown
from torture_study.base import Base, filled
from torture_study.damages import FLOOR_DAMAGES, LIBRARY_DAMAGES, Damage
from torture_study.trials import (
    LINGER_S,
    Ended,
    Kill,
    Place,
    content,
    copied,
    cpu_s,
    differences,
    names,
    numbers,
    send,
    wait_for,
)

MOMENTS = 20
"""Kills of each command; half of them at moments of its processor time, half just before a change of a file."""
FEW_MOMENTS = 5
"""Kills during a compilation, and while clean aircraft are drawn."""
PAGE = 4096
"""Bytes that a file system in memory hands out at once."""
COMMANDS = ("fly", "import", "reconstruct", "identify", "close-loop")


@dataclass
class Args:
    """Command line: what is tried, how often, and where."""

    out: Path = Path("torture")
    only: tuple[str, ...] = ()
    """Beginnings of the names of trials."""
    seed: int = 0
    quick: bool = False


@dataclass(frozen=True)
class Trial:
    """A trial: its name, the kind it is counted among, and what it does; that returns its faults and more."""

    name: str
    kind: str
    run: Callable[[Base, np.random.Generator, Place], dict]


def killed(
    base: Base, place: Place, command: str, earlier: bool, disturb: Callable[[Place, list[str]], tuple[Ended, Kill]]
) -> dict:
    """Disturb a command, look what is left, run it again undisturbed and look again."""
    expected = base.result(command, over=earlier and command in ("fly", "import"))
    if not place.cache.exists():
        copied(base.cache, place.cache)
    cache, faults = names(base.cache), []
    if earlier:
        copied(base.earlier(command), place.out)
    before = content(place.out)
    arguments = filled(base.arguments(command), place.out)
    ended, kill = disturb(place, arguments)
    linger = place.lingering_s()
    if linger > LINGER_S:
        faults.append("processes go on")
    after = numbers(place.out)
    state = "new" if after == numbers(expected) else "as before" if content(place.out) == before else "broken"
    if state == "broken":
        faults.append(f"the result is broken: {differences(after, numbers(expected))}"[:200])
    if ended.code == 130 and (left := [n for n in os.listdir(place.work) if n != "out"] + os.listdir(place.tmp)):
        faults.append(f"left behind: {', '.join(left)}")
    if ended.code not in (0, 130, -2, -9, -15) or (ended.code == 130 and len(ended.lines) != 1):
        faults.append(f"exit code {ended.code}: {ended.lines}")
    again = place.run(arguments)
    if again.code or again.lines:
        faults.append(f"the rerun ends with {again.code}: {again.lines}")
    if wrong := differences(numbers(place.out), numbers(expected)):
        faults.append(f"the rerun differs in {wrong}"[:200])
    faults += leftovers(place, cache)
    return {"faults": faults, "how": kill.name, "code": ended.code, "state": state, "linger_s": round(linger, 2)}


def leftovers(place: Place, cache: Sequence[str]) -> list[str]:
    """What lies where nothing should."""
    lists = {"beside the result": [n for n in os.listdir(place.work) if n != "out"]}
    lists |= {"among temporary files": os.listdir(place.tmp)}
    lists |= {"in the cache": sorted(set(names(place.cache)) - set(cache))}
    return [f"left {where}: {', '.join(left)}" for where, left in lists.items() if left]


def _drawn(rng: np.random.Generator) -> Kill:
    return [*Kill][rng.integers(len(Kill))]


def kill_at_moment(base: Base, rng: np.random.Generator, place: Place, command: str, earlier: bool) -> dict:
    """A kill when a drawn share of the processor time is used up."""
    base.result(command)
    moment, kill = base.cpu[f"{command}-1"] * rng.uniform(0.05, 1.0), _drawn(rng)

    def disturb(place: Place, arguments: list[str]) -> tuple[Ended, Kill]:
        process = place.start(arguments)
        wait_for(process, lambda: cpu_s(process.pid) >= moment)
        send(process, kill)
        return place.ended(process), kill

    return {"cpu_s": round(moment, 2), **killed(base, place, command, earlier, disturb)}


def kill_at_event(base: Base, rng: np.random.Generator, place: Place, command: str, earlier: bool) -> dict:
    """A kill just before a drawn one of the things that the command does to files."""
    name = f"{command}-1"
    base.result(command)
    if earlier and command in ("fly", "import"):
        base.result(command, over=True)
        name += "-over"
    event, kill = int(rng.integers(1, base.events[name] + 1)), _drawn(rng)

    def disturb(place: Place, arguments: list[str]) -> tuple[Ended, Kill]:
        return place.ended(place.start(arguments, kill, event)), kill

    return {"event": event, **killed(base, place, command, earlier, disturb)}


def kill_compiler(base: Base, rng: np.random.Generator, place: Place) -> dict:
    """A kill while a model is compiled."""
    base.result("reconstruct")
    copied(base.cache, place.cache)
    for file in place.cache.rglob("*.so"):
        file.unlink()
    return _kill_beside(base, rng, place, "reconstruct", ("cc1plus", "g++", "collect2"), 1.5)


def kill_draws(base: Base, rng: np.random.Generator, place: Place) -> dict:
    """A kill while clean aircraft are drawn."""
    base.result("draws")
    copied(base.cache, place.cache)
    for file in sorted(place.cache.rglob("draws/*/[0-9]*.json"))[:4]:
        file.unlink()
    return _kill_beside(base, rng, place, "draws", ("rotorid_torch.trace",), 8.0)


def _kill_beside(
    base: Base, rng: np.random.Generator, place: Place, command: str, words: Sequence[str], within_s: float
) -> dict:
    """A kill some time after another process has begun to work for the command, known by a word of its command line."""
    wait_s, kill = rng.uniform(0.0, within_s), _drawn(rng)

    def disturb(place: Place, arguments: list[str]) -> tuple[Ended, Kill]:
        process = place.start(arguments)
        wait_for(process, lambda: any(word in line for line in place.alive().values() for word in words))
        time.sleep(wait_s)
        send(process, kill)
        return place.ended(process), kill

    return {"wait_s": round(wait_s, 2), **killed(base, place, command, False, disturb)}


def damaged(
    base: Base,
    rng: np.random.Generator,
    place: Place,
    command: str,
    pattern: str,
    damage: Damage,
    powerless: bool = False,
) -> dict:
    """Damage a file of the cache that the command uses: the numbers are right, one line says so, the file is new."""
    expected = numbers(base.result(command))
    copied(base.cache, place.cache)
    before = content(place.cache)
    file = _damage_one([place.cache / name for name in used(base, command, pattern)], damage, rng)
    after_damage = content(file)
    ended = place.run(filled(base.arguments(command), place.out), powerless=powerless)
    faults = []
    if ended.code:
        faults.append(f"exit code {ended.code}: {ended.lines}"[:300])
    elif wrong := differences(numbers(place.out), expected):
        faults.append(f"other numbers in {wrong}"[:200])
    if len(ended.lines) != 1:
        faults.append(f"{len(ended.lines)} lines tell of it: {ended.lines}"[:300])
    mended = file.is_file() and not file.is_symlink() and file.stat().st_mode & 0o777 in (0o600, 0o644, 0o755, 0o700)
    if not mended or (content(file) == after_damage != {".": before[str(file.relative_to(place.cache))]}):
        faults.append("the file is not made anew")
    return {"faults": faults + leftovers(place, names(base.cache)), "line": ended.lines[:1]}


def used(base: Base, command: str, pattern: str) -> list[str]:
    """Files of the cache that a command needs, the largest first, by what it makes in an empty cache."""
    note = base.root / f"{command}-uses.json"
    if not note.exists():
        with tempfile.TemporaryDirectory(dir=base.root) as folder:
            alone = Place(Path(folder) / "place")
            if command == "draws":
                copied(base.cache, alone.cache)
            else:
                alone.run(filled(base.arguments(command), alone.out))
            files = sorted(alone.cache.rglob(pattern), key=lambda f: (-f.stat().st_size, f.name))
            note.write_text(json.dumps([str(f.relative_to(alone.cache)) for f in files]))
    return json.loads(note.read_text())


def _damage_one(files: Sequence[Path], damage: Damage, rng: np.random.Generator) -> Path:
    """Damage the first of some files that can be damaged so; LookupError where none can."""
    for file in files:
        with suppress(LookupError):
            damage(file, rng)
            return file
    raise LookupError("no file of the cache can be damaged so")


@contextmanager
def disk(folder: Path, room: int, read_only: bool = False) -> Iterator[None]:
    """A small file system in memory at a folder, of so many bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={max(room, PAGE)},mode=755", "tmpfs", str(folder)], check=True)
    try:
        if read_only:
            subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def refused(
    base: Base, place: Place, command: str, out: Path, named: Path, early: bool, powerless: bool = False, code: int = 2
) -> dict:
    """Run a command that cannot do its work: one line names the place, and everything is as before.

    early : it is told before the work begins, so to say in less than half of its time. Asked only where the work
        takes longer than the start, whose time scatters from run to run.
    """
    if not place.cache.exists():
        copied(base.cache, place.cache)
    base.result(command)
    before, inputs = content(place.work), {**content(base.rates), **content(base.log)}
    ended = place.run(filled(place_arguments(base, command, place), out), powerless=powerless)
    faults = []
    if ended.code != code:
        faults.append(f"exit code {ended.code}: {ended.lines}"[:300])
    if len(ended.lines) != 1 or str(named) not in ended.lines[0]:
        faults.append(f"no line, or a line that does not name {named}: {ended.lines}"[:300])
    if ended.poor:
        faults.append(f"it tells of {ended.poor}: {ended.lines}"[:300])
    startup_s = base.startup_s(command)
    work_s = base.cpu[f"{command}-1"] - startup_s
    if early and work_s > startup_s and (late_s := ended.cpu_s - startup_s) > 0.5 * work_s:
        faults.append(f"told after {late_s:.1f} of {work_s:.1f} s")
    if content(place.work) != before or {**content(base.rates), **content(base.log)} != inputs:
        faults.append(f"files differ: {differences(content(place.work), before)}")
    faults += leftovers_beside(place, before)
    return {"faults": faults, "line": ended.lines[:1]}


def place_arguments(base: Base, command: str, place: Place) -> tuple[str, ...]:
    """The command, with inputs from the place where copies of them lie there."""
    there = {source: place.work / copy for source, copy in COPIES.items() if (place.work / copy).exists()}
    copies = {str(getattr(base, source)): str(copy) for source, copy in there.items()}
    return tuple(copies.get(word, word) for word in base.arguments(command))


def leftovers_beside(place: Place, before: dict[str, str]) -> list[str]:
    """New files in the folders of a place."""
    new = sorted(set(content(place.work)) - set(before)) + os.listdir(place.tmp)
    return [f"left: {', '.join(new)}"] if new else []


def full(base: Base, rng: np.random.Generator, place: Place, command: str, share: float) -> dict:
    """The result goes to a disk with room for a share of it."""
    files = [f for f in (base.result(command), *base.result(command).rglob("*")) if f.is_file()]
    pages = sum(math.ceil(f.stat().st_size / PAGE) for f in files)
    with disk(place.work / "disk", int(share * pages) * PAGE):
        return refused(base, place, command, place.work / "disk" / "out", place.work / "disk", early=False)


def read_only(base: Base, rng: np.random.Generator, place: Place, command: str) -> dict:
    """The result goes to a disk that is read-only."""
    with disk(place.work / "disk", 2**20, read_only=True):
        return refused(base, place, command, place.work / "disk" / "out", place.work / "disk", early=True)


def without_permission(base: Base, rng: np.random.Generator, place: Place, command: str) -> dict:
    """The result goes to a folder without permission to write."""
    folder = place.work / "locked"
    folder.mkdir(mode=0o555)
    return refused(base, place, command, folder / "out", folder, early=True, powerless=True)


def in_the_way(base: Base, rng: np.random.Generator, place: Place, command: str, make: Callable[[Path], Path]) -> dict:
    """Something of the user lies where the result goes; `make` returns the path that is asked for."""
    out = make(place.out)
    return refused(base, place, command, out, place.out, early=True)


def unreadable(
    base: Base, rng: np.random.Generator, place: Place, command: str, source: str, part: str, mode: int
) -> dict:
    """An input that must not be read."""
    name = COPIES[source]
    copied(getattr(base, source), place.work / name)
    target = place.work / name / part if part else place.work / name
    target.chmod(mode)
    try:
        return refused(base, place, command, place.out, place.work / name, early=True, powerless=True)
    finally:
        target.chmod(0o755)


def starved(base: Base, rng: np.random.Generator, place: Place, command: str, folder: str) -> dict:
    """No room for the cache, or for temporary files: the numbers are right, or one line names the place."""
    where = place.cache if folder == "cache" else place.tmp
    if folder == "tmp" and command != "reconstruct":  # that one compiles
        copied(base.cache, place.cache)
    expected = numbers(base.result(command))
    with disk(where, 16384):
        ended = place.run(filled(base.arguments(command), place.out))
        alive = bool(place.lingering_s() > LINGER_S)
        left = [] if folder == "cache" else os.listdir(where)
    faults = [f"left: {', '.join(left)}"] if left else []
    right = ended.code == 0 and (bool(ended.lines) or numbers(place.out) == expected)  # uncompiled, and it says so
    told = ended.code == 2 and len(ended.lines) == 1 and str(where) in ended.lines[0]
    if not right and not told:
        faults.append(f"exit code {ended.code}: {ended.lines}"[:300])
    if ended.poor or alive or len(ended.lines) > 1:
        faults.append(f"{'processes go on ' if alive else ''}{ended.lines}"[:300])
    return {"faults": faults, "line": ended.lines[:1]}


def _file(out: Path) -> Path:
    out.write_text("a letter")
    return out


def _thesis(out: Path) -> Path:
    out.mkdir()
    (out / "thesis.txt").write_text("ten years of work")
    return out


def _below_file(out: Path) -> Path:
    _file(out)
    return out / "out"


def _missing_parent(out: Path) -> Path:
    return out / "missing" / "out"


def _link_to_file(out: Path) -> Path:
    out.with_name("letter").write_text("a letter")
    out.symlink_to("letter")
    return out


WAYS: dict[str, Callable[[Path], Path]] = {
    "a file": _file,
    "a folder": _thesis,
    "a file as parent": _below_file,
    "a link": _link_to_file,
    "no parent": _missing_parent,
}
COPIES = {"rates": "rates", "log": "log.csv", "model": "model"}
"""Names of copies of what all trials read, in a place."""
STARVED = (
    *(("cache", command) for command in ("reconstruct", "draws")),
    *(("tmp", command) for command in ("reconstruct", "identify", "draws")),
)
"""What has no room, and who needs it."""
UNREADABLE = (
    *((command, "rates", "dataset.toml", 0) for command in ("check", "identify", "reconstruct", "close-loop")),
    *((command, "rates", "flights/two.npz", 0) for command in ("check", "identify")),
    *((command, "rates", "flights", mode) for command, mode in (("check", 0), ("identify", 0o444))),
    *((command, "rates", "", mode) for command, mode in (("close-loop", 0), ("simulate", 0), ("check", 0o444))),
    ("import", "log", "", 0),
    *(("simulate", "model", part, 0) for part in ("model.pt", "")),
)
"""Command, input, part of it, and the mode that hides it."""


def trials() -> Iterator[Trial]:
    """All of them."""
    for command in COMMANDS:
        for k in range(MOMENTS):
            kill = partial((kill_at_moment, kill_at_event)[k % 2], command=command, earlier=k % 4 < 2)
            yield Trial(f"kill {command} {k}", f"kills of {command}", kill)
    for k in range(FEW_MOMENTS):
        yield Trial(f"compile {k}", "kills during a compile", kill_compiler)
        yield Trial(f"draw {k}", "kills while clean aircraft are drawn", kill_draws)
    for name, damage in LIBRARY_DAMAGES.items():
        how = {"pattern": "*.so", "damage": damage, "powerless": name == "unreadable"}
        command = "identify" if name.startswith("constant") else "reconstruct"
        yield Trial(f"library {name}", "damaged libraries", partial(damaged, command=command, **how))
    for name, damage in FLOOR_DAMAGES.items():
        how = {"pattern": "draws/*/0.json", "damage": damage}
        yield Trial(f"draws {name}", "damaged draws", partial(damaged, command="draws", **how))
    yield from _of_places()


def _of_places() -> Iterator[Trial]:
    """Those of disks and folders."""
    for command in (*COMMANDS, "check", "simulate"):
        for share in (0.0, 0.5, 0.85):
            yield Trial(f"full {command} {share}", "full disk", partial(full, command=command, share=share))
        yield Trial(f"read-only {command}", "read-only", partial(read_only, command=command))
        yield Trial(f"locked {command}", "read-only", partial(without_permission, command=command))
        for way, make in WAYS.items():
            if not (way == "no parent" and command in ("fly", "import")):  # these make the folders above
                make_it = partial(in_the_way, command=command, make=make)
                yield Trial(f"in the way {command} {way}", "in the way", make_it)
    for folder, command in STARVED:
        name = f"no room {folder} {command}"
        yield Trial(name, "no room for cache or temporary files", partial(starved, command=command, folder=folder))
    for command, source, part, mode in UNREADABLE:
        hide = partial(unreadable, command=command, source=source, part=part, mode=mode)
        yield Trial(f"unreadable {command} {source} {part} {mode:o}", "unreadable", hide)


def main(args: Args) -> None:
    """Try what has no line yet, and end with a table and one JSON line."""
    args.out.mkdir(parents=True, exist_ok=True)
    file, base = args.out.absolute() / "trials.jsonl", Base(args.out.absolute() / f"base-{version()}")
    base.root.mkdir(exist_ok=True)
    wanted = [t for t in trials() if t.name in QUICK or not args.quick]
    wanted = [t for t in wanted if not args.only or any(t.name.startswith(o) for o in args.only)]
    lines = {line["case"]: line for line in read_lines(file) if line["version"] == version()}
    for k, trial in enumerate(wanted):
        case = f"{trial.name} seed {args.seed}"
        if case not in lines:
            lines[case] = {"case": case, "kind": trial.kind, "version": version(), **tried(trial, base, args.seed)}
            append_line(file, lines[case])
        said = "; ".join(lines[case]["faults"]) or lines[case].get("skipped", "right")
        print(f"{k + 1}/{len(wanted)} {case}: {said}", file=sys.stderr)
    chosen = [lines[f"{trial.name} seed {args.seed}"] for trial in wanted]
    print(table(chosen))
    print(json.dumps({"trials": len(chosen), "faulty": {c["case"]: c["faults"] for c in chosen if c["faults"]}}))


QUICK = ("kill reconstruct 2", "in the way reconstruct a file")


def tried(trial: Trial, base: Base, seed: int) -> dict:
    """A trial in a place of its own, which is removed afterwards."""
    rng = np.random.default_rng([seed, *trial.name.encode()])
    folder = Path(tempfile.mkdtemp(prefix="torture-"))
    begin = time.monotonic()
    place = Place(folder / "place")
    try:
        told = trial.run(base, rng, place)
    except (LookupError, PermissionError, subprocess.CalledProcessError) as error:
        told = {"faults": [], "skipped": str(error)}
    finally:
        place.lingering_s()
        shutil.rmtree(folder, ignore_errors=True)
    return {**told, "wall_s": round(time.monotonic() - begin, 1)}


def table(lines: Sequence[dict]) -> str:
    """A row for each kind of trial."""
    rows = []
    for kind in dict.fromkeys(line["kind"] for line in lines):
        own = [line for line in lines if line["kind"] == kind]
        skipped = sum("skipped" in line for line in own)
        rows.append((kind, str(len(own) - skipped), str(sum(bool(line["faults"]) for line in own)), str(skipped or "")))
    total = [str(sum(int(row[k] or 0) for row in rows)) for k in (1, 2, 3)]
    return markdown(("what", "trials", "with a fault", "left out"), [*rows, ("all", *total)])


if __name__ == "__main__":
    main(tyro.cli(Args))
