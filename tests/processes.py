"""Several processes of one run, as torchrun would start them, and what becomes of them."""

from __future__ import annotations

import os
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path


def of_ranks(size: int, command: Sequence[str], *own: Mapping[str, str]) -> list[subprocess.Popen[str]]:
    """The command in so many processes; `own` are each one's further environment variables, or none."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    given = {"WORLD_SIZE": str(size), "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "OMP_NUM_THREADS": "1"}
    return [
        subprocess.Popen(
            command,
            env={**os.environ, **given, "RANK": str(rank), **more},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank, more in enumerate(own or [{}] * size)
    ]


def ended(processes: list[subprocess.Popen[str]]) -> tuple[list[int], list[str], list[str]]:
    """Exit codes, outputs and errors by rank."""
    told = [process.communicate(timeout=300) for process in processes]
    return [process.returncode for process in processes], [out for out, _ in told], [err for _, err in told]


def write_earlier(out: Path) -> None:
    """A RUN that was there before."""
    out.mkdir()
    (out / "report.json").write_text('{"format": 1, "rotorid": "0", "command": "identify"}', encoding="utf-8")


def wait_until(what: Callable[[], object]) -> None:
    """Until it is true; AssertionError after a minute."""
    for _ in range(1200):
        if what():
            return
        time.sleep(0.05)
    raise AssertionError("what is waited for does not come")


def goes_on(process: int) -> bool:
    """Whether a process works, and has not only not been waited for."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
