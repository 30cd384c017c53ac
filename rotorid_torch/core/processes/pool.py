"""Processes of this package that each carry out a request; what they write is there as soon as it is made."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rotorid_torch.core.processes.children import child
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.core.storage.atomic import TEMPORARY, Unwritable

NO_ROOM = 2
"""Exit code of a process that finds no room for temporary files."""
WATCH_S = 0.5
"""s between two looks at the processes, at each of which ranks tell each other that they are there."""


def results(
    module: str, requests: Sequence[Path], folder: Path, ranks: Ranks = ALONE
) -> Generator[dict[str, Any], None, None]:
    """New files NAME.json in a folder, by name, that processes `python -m MODULE REQUEST` write there; till all end.

    Processes that are at work still are killed when the iterator is closed. ranks : each has processes and a folder of
    its own, and all of them are given the files of all.

    Raises Unwritable where a process has found no room for temporary files, RuntimeError where one has failed, with the
    last line of what it said.
    """
    with ExitStack() as stack:
        workers = [stack.enter_context(worker(module, file)) for file in requests]
        at_work, names = True, set[str]()
        while at_work:
            at_work = any(ranks.gather(any(one.poll() is None for one in workers)))
            new = {file.stem: file for file in folder.glob("*.json") if file.stem not in names}
            names |= new.keys()
            parts = ranks.gather({name: json.loads(file.read_text()) for name, file in new.items()})
            yield {name: content for part in parts for name, content in part.items()}
            time.sleep(WATCH_S if at_work else 0.0)
        for one, file in zip(workers, requests, strict=True):
            _refuse_failure(module, one.returncode, file)


@contextmanager
def worker(module: str, request: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that carries out a request by this very package, whatever the working folder holds."""
    root = str(Path(__file__).parents[3])
    places = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    alone = {"OMP_NUM_THREADS": "1", "ROTORID_THREADS": "1", "PYTHONPATH": places, "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", module, str(request)]
    with request.with_suffix(".log").open("w") as log, child(command, env=os.environ | alone, stderr=log) as running:
        yield running


def _refuse_failure(module: str, code: int, request: Path) -> None:
    """Raise what a process' exit code says, with the last line of its log."""
    if code == NO_ROOM:
        raise Unwritable(request.parents[1], "", "cannot be written to", TEMPORARY)
    if code:
        lines = request.with_suffix(".log").read_text().splitlines() or [f"code {code}"]
        raise RuntimeError(f"a process of {module} has failed: {lines[-1]}")
