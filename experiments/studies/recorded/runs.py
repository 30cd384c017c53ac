"""Runs of a study, at the same time where wished, each kept as a JSON line as soon as it is there."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from threading import Thread

from rich.console import Console
from torch.utils.tensorboard import SummaryWriter

from recorded.lines import append_line, read_lines


def lines_of(run: Callable[..., dict], arguments: Sequence[tuple], processes: int) -> Iterator[dict]:
    """Lines of runs as they come; in processes of their own, which share the processors, where there are several."""
    if processes == 1:
        yield from (run(*each) for each in arguments)
        return
    share = max(1, len(os.sched_getaffinity(0)) // processes)
    os.environ.update({"OMP_NUM_THREADS": "1", "ROTORID_THREADS": str(share)})
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_end_with_parent) as pool:
        for done in as_completed([pool.submit(run, *each) for each in arguments]):
            yield done.result()


def _end_with_parent() -> None:
    """A study that is killed leaves no worker behind that goes on with what was queued."""

    def watch() -> None:
        parent = parent_process()
        if parent is not None:
            wait([parent.sentinel])
            os._exit(1)

    Thread(target=watch, daemon=True).start()


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


def sets_left(
    data: Path, sets: Sequence[str], quick: bool, file: Path, suffix: str = ""
) -> tuple[list[str], dict[str, str]]:
    """Data sets that are there and have no line yet, of the first one alone where it is quick; why others are not.

    suffix : what stands behind the sets' names in the lines.
    """
    skipped = {n: f"no data set in {data}" for n in sets if not (data / n / "dataset.toml").exists()}
    done = {line["case"] for line in read_lines(file) if "failed" not in line}
    present = [n for n in sets if n not in skipped]
    return [n for n in (present[:1] if quick else present) if f"{n} {suffix}".strip() not in done], skipped


def over_sets(run: Callable[..., dict], arguments: Sequence[tuple], processes: int, file: Path, settings: dict) -> int:
    """Runs of data sets, kept beside TensorBoard records with the settings; returns how many there were."""
    writer = SummaryWriter(str(file.parent / "tensorboard"))
    writer.add_text("settings", json.dumps(settings, default=str))
    runs = keep(lines_of(run, arguments, processes), file, len(arguments), writer)
    writer.close()
    return runs
