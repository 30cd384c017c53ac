"""A process that is started here ends with the one that started it, and with it all that it has started."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from rotorid_torch.core.processes.children import child
from tests.processes import goes_on, wait_until

STARTS = """
import sys, time
from rotorid_torch.core.processes.children import child
with child(["/bin/sh", "-c", f"sleep 60 & echo $$ $! > {sys.argv[1]}; wait"]) as running:
    running.wait()
"""


def processes(file: Path) -> list[int]:
    """Those that have written their numbers."""
    wait_until(lambda: file.exists() and file.read_text().endswith("\n"))
    return [int(word) for word in file.read_text().split()]


def test_a_killed_process_leaves_none_behind(tmp_path: Path):
    parent = subprocess.Popen([sys.executable, "-c", STARTS, str(tmp_path / "numbers")])
    started = processes(tmp_path / "numbers")
    assert all(goes_on(number) for number in started)
    parent.kill()
    parent.wait()
    wait_until(lambda: not any(goes_on(number) for number in started))


def test_an_exception_ends_all_that_was_started(tmp_path: Path):
    command = ["/bin/sh", "-c", f"sleep 60 & echo $$ $! > {tmp_path}/numbers; wait"]
    with suppress(ZeroDivisionError), child(command):
        started = processes(tmp_path / "numbers")
        _ = 1 / 0
    wait_until(lambda: not any(goes_on(number) for number in started))


@pytest.mark.parametrize(("does", "code"), [("exit 0", 0), ("exit 3", 3), ("kill -KILL $$", 128 + 9)])
def test_exit_code_and_output_are_those_of_the_command(does: str, code: int):
    with child(["/bin/sh", "-c", f"cat; echo out; echo err >&2; {does}"], stdout=-1, stderr=-1) as running:
        assert running.communicate(timeout=30) == ("out\n", "err\n")
    assert running.returncode == code
