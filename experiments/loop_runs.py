"""Runs of a study, at the same time where wished, each kept as a JSON line as soon as it is there."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from loop_lines import append_line
from rich.console import Console
from torch.utils.tensorboard import SummaryWriter


def lines_of(run: Callable[..., dict], given: Sequence[tuple], processes: int) -> Iterator[dict]:
    """Lines of runs as they come; in processes of their own, which share the processors, where there are several."""
    if processes == 1:
        yield from (run(*each) for each in given)
        return
    share = max(1, len(os.sched_getaffinity(0)) // processes)
    os.environ.update({"OMP_NUM_THREADS": "1", "ROTORID_THREADS": str(share)})
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for done in as_completed([pool.submit(run, *each) for each in given]):
            yield done.result()


def keep(lines: Iterable[dict], file: Path, total: int, writer: SummaryWriter) -> int:
    """Append lines to a file, tell people and TensorBoard; returns how many came."""
    console, done = Console(stderr=True), 0
    for line in lines:
        append_line(file, line)
        for when, scores in line.get("J", {}).items():
            writer.add_scalars(f"J/{when}", {k: v for k, v in scores.items() if v is not None}, done)
        done += 1
        console.print(f"{done}/{total} {line['case']}: {line.get('sentence') or line.get('failed')}")
    return done
