"""Commands of rotorid that are killed, starved of room or given damaged files: how each is run, and what is left of it.

A trial has a place of its own: a folder to work in, a cache, a folder for temporary files, and a mark in the
environment by which processes that outlive the command are known.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
TICKS = os.sysconf("SC_CLK_TCK")
LOOK_S = 0.005
"""s between two looks at a running command."""
PATIENCE_S = 300.0
"""s after which a command that was to end by itself is given up."""
LINGER_S = 5.0
"""s that processes of a killed command may go on."""
EFFECTS = ("control.delay", "control.lag")
"""Candidates of the closed loops here: few, so that a loop takes seconds."""
FLOWN_S, DRAWS = 1.0, 6
"""Length of the flights that `fly` flies here, s; clean aircraft that are drawn, none fewer."""
DRIVER = """
import functools, json, os, signal, sys
plan = json.loads(sys.argv[1])
events, over = 0, False

def mutates(event, arguments):
    if event == "open":
        path, mode, flags = arguments
        writes = bool((flags or 0) & (os.O_WRONLY | os.O_RDWR)) or any(m in (mode or "") for m in "wax+")
        return writes and not str(path).startswith(("/dev/", "/proc/"))
    if event == "ctypes.dlsym":
        return arguments[1] == "renameat2"
    return event in ("os.rename", "os.mkdir", "os.rmdir", "os.remove")

def watch(event, arguments):
    global events
    if over or not mutates(event, arguments):
        return
    events += 1
    if events == plan["event"]:
        os.killpg(os.getpid(), plan["signal"]) if plan["group"] else os.kill(os.getpid(), plan["signal"])

import rotorid_torch.cli
import rotorid_torch.simulation
rotorid_torch.simulation.fly = functools.partial(rotorid_torch.simulation.fly, seconds=plan["seconds"])
if sys.argv[2] == "close-loop":
    from rotorid_torch.trace import loop
    from rotorid_torch.trace.terms.settings import SETTINGS
    loop.candidates = lambda spec: (plan["effects"], [])
    object.__setattr__(SETTINGS, "level", 1.0 / (1 + plan["draws"]))
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.addaudithook(watch)
code = rotorid_torch.cli.main(sys.argv[2:])
over = True
open(plan["count"], "w").write(str(events))
sys.exit(code)
"""
"""The command with short flights and few candidates; counts changes of files, and can die just before one."""


class Kill(Enum):
    """How a command is ended: signal, and whether the whole group gets it."""

    KILL_ALL = (signal.SIGKILL, True)
    KILL_MAIN = (signal.SIGKILL, False)
    TERM_MAIN = (signal.SIGTERM, False)
    INT_ALL = (signal.SIGINT, True)

    @property
    def cleans(self) -> bool:
        """Whether the command may clean up behind itself."""
        return self.value[0] != signal.SIGKILL


@dataclass(frozen=True)
class Ended:
    """A command that has ended: exit code, lines on stderr, processor seconds, events that changed files."""

    code: int
    lines: tuple[str, ...]
    cpu_s: float
    events: int

    @property
    def poor(self) -> str:
        """What is wrong with the way in which it told of a failure; empty where nothing is."""
        if any("Traceback" in line for line in self.lines):
            return "a traceback"
        return "'unexpected'" if any("unexpected" in line for line in self.lines) else ""


@dataclass
class Place:
    """Where a trial happens: `work` holds what the command writes, beside it cache and temporary files.

    seconds : length of flights that are flown here.
    """

    root: Path
    seconds: float = FLOWN_S
    mark: str = field(default_factory=lambda: os.urandom(8).hex())
    cache: Path = field(init=False)
    tmp: Path = field(init=False)

    def __post_init__(self) -> None:
        """Make the folders, all empty but for the cache."""
        self.cache, self.tmp = self.root / "cache", self.root / "tmp"
        for folder in (self.work, self.tmp):
            folder.mkdir(parents=True)

    @property
    def work(self) -> Path:
        """Folder that the command writes in."""
        return self.root / "work"

    @property
    def out(self) -> Path:
        """What the command writes."""
        return self.work / "out"

    def start(
        self, arguments: Sequence[str | Path], kill: Kill = Kill.KILL_ALL, event: int = 0, powerless: bool = False
    ) -> subprocess.Popen[str]:
        """Start a command in a session of its own.

        kill, event : how it dies before which event that changes files; 0 for never. powerless : without the rights of
        root to read and write everything.
        """
        number, group = kill.value
        plan = {"seconds": self.seconds, "effects": EFFECTS, "draws": DRAWS}
        plan |= {"event": event, "signal": number, "group": group, "count": str(self.root / "count")}
        command = [sys.executable, "-c", DRIVER, json.dumps(plan), *map(str, arguments)]
        if powerless and os.geteuid() == 0:
            command = ["setpriv", "--inh-caps=-all", "--bounding-set=-all", "--", *command]
        with (self.root / "stderr").open("w") as errors:
            return subprocess.Popen(
                command,
                env=self.environment(),
                cwd=self.root,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                text=True,
                start_new_session=True,
            )

    def environment(self) -> dict[str, str]:
        """One thread, the code of this folder, cache and temporary files of this place."""
        fixed = {"OMP_NUM_THREADS": "1", "ROTORID_THREADS": "1", "MPLBACKEND": "Agg", "PYTHONDONTWRITEBYTECODE": "1"}
        places = {"PYTHONPATH": str(ROOT), "ROTORID_CACHE": str(self.cache), "TMPDIR": str(self.tmp)}
        return {**os.environ, **fixed, **places, "ROTORID_TORTURE": self.mark}

    def run(self, arguments: Sequence[str | Path], powerless: bool = False) -> Ended:
        """Run a command to its end."""
        return self.ended(self.start(arguments, powerless=powerless))

    def ended(self, process: subprocess.Popen[str], patience_s: float = PATIENCE_S) -> Ended:
        """Wait for a command; one that does not end is killed, and has the exit code of that."""
        deadline = time.monotonic() + patience_s
        used = 0.0
        while process.returncode is None and not os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
            used = cpu_s(process.pid)
            if time.monotonic() > deadline:
                os.killpg(process.pid, signal.SIGKILL)
            time.sleep(LOOK_S)
        used = cpu_s(process.pid) or used
        code = process.wait()
        count = self.root / "count"
        events = int(count.read_text()) if count.exists() else 0
        count.unlink(missing_ok=True)
        lines = (self.root / "stderr").read_text(encoding="utf-8", errors="replace").splitlines()
        return Ended(code, tuple(lines), used, events)

    def alive(self) -> dict[int, str]:
        """Processes of this place, with their commands."""
        mark, living = f"ROTORID_TORTURE={self.mark}".encode(), {}
        for entry in Path("/proc").iterdir():
            if entry.name.isdecimal():
                try:
                    if mark in (entry / "environ").read_bytes():
                        living[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                except OSError:
                    continue
        return living

    def lingering_s(self) -> float:
        """Seconds until no process of this place is alive; those that do not end are killed: infinity."""
        begin = time.monotonic()
        while living := self.alive():
            if time.monotonic() - begin > LINGER_S:
                for process in living:
                    os.kill(process, signal.SIGKILL)
                return float("inf")
            time.sleep(0.05)
        return time.monotonic() - begin


def cpu_s(process: int) -> float:
    """Processor seconds of a process, and of its children that have ended; zero where there is no such process."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / TICKS


def wait_for(process: subprocess.Popen[str], reached: Callable[[], bool]) -> bool:
    """Whether something happens while a command runs."""
    while process.poll() is None:
        if reached():
            return True
        time.sleep(LOOK_S)
    return False


def send(process: subprocess.Popen[str], kill: Kill) -> None:
    """End a command."""
    number, group = kill.value
    if process.poll() is None:
        (os.killpg if group else os.kill)(process.pid, number)


def names(folder: Path) -> list[str]:
    """All that lies in a folder and below, by path."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*")) if folder.is_dir() else []


def content(path: Path) -> dict[str, str]:
    """Digest of each file below a folder, by path; of a file alone by "."."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file() or p.is_symlink())
    return {str(f.relative_to(path)): _digest(f.read_bytes() if f.is_file() else b"") for f in files}


TIMES = ("time_s", "peak_memory_mb")
"""Entries of a report that are never twice the same."""


def numbers(path: Path) -> dict[str, str]:
    """The same of what a command computed: without times, memory, and the files that tell of them."""
    told = content(path)
    for name in list(told):
        if re.match(r"log\.txt|report\.html|tensorboard/", name):
            del told[name]
        if name.endswith("report.json"):
            report = json.loads((path / name).read_bytes())
            told[name] = _digest(json.dumps({k: v for k, v in report.items() if k not in TIMES}).encode())
    return told


def _digest(what: bytes) -> str:
    return hashlib.sha256(what).hexdigest()


def differences(one: Mapping[str, str], other: Mapping[str, str]) -> str:
    """Names of files that differ; empty where none does."""
    return ", ".join(sorted(n for n in {*one, *other} if one.get(n) != other.get(n)))


def copied(source: Path, place: Path) -> None:
    """Copy a file or a folder with modes and links; nothing where there is nothing."""
    if source.is_dir():
        shutil.copytree(source, place, symlinks=True)
    elif source.exists():
        shutil.copy2(source, place)
