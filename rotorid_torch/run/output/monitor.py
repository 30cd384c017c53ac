"""What a long command tells while it works: progress on the console, scalars and overlays for TensorBoard, log.txt.

A Monitor without a console and without a folder tells nothing; steps call it all the same.
"""

from __future__ import annotations

import re
import resource
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from rotorid_torch.printable import printable
from rotorid_torch.report.records import TimeRecord

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from rotorid_torch.run.output.board import Board


SHORT_S = 0.5
"""Steps shorter than this are not told to people."""
STEPS = {
    "fly": "flying the built-in aircraft",
    "reconstruct": "motion, forces and moments from the sensors",
    "ftr": "first values of the parameters, by regression",
    "ml": "all parameters together, by maximum likelihood",
    "validate": "free runs of every flight",
    "trace": "what the model lacks",
}
"""What a step does, for people."""


class Monitor:
    """Progress, scalars, figures, a log and the clock of a run; a subclass may do something else with any of them.

    `identify`, `close_loop` and `reconstruct` call `step(name)` around each of their steps, `progress(done, total)`
    inside, `say(text)` for what people read, `log(text)` for the log alone, `scalars(values, iteration)` and
    `picture(name, png, iteration)` for TensorBoard, whose `board` is None where no folder is written. Progress is drawn
    in terminals and in notebooks.

    Parameters
    ----------
    console : where people read; None tells nobody (`--quiet`, `--json`, and the Python surface).
    verbose : show people the log's lines too.
    """

    def __init__(self, console: Console | None = None, *, verbose: bool = False) -> None:
        self.console, self.verbose = console, verbose
        self.seconds: dict[str, float] = {}
        self._start = time.perf_counter()
        self._log: TextIO | None = None
        self.board: Board | None = None
        self._boards: Path | None = None
        self._fits = 0
        self._progress: Progress | None = None

    @contextmanager
    def recording(self, folder: Path) -> Iterator[None]:
        """Write `folder`/log.txt and `folder`/tensorboard until the block ends; Python's warnings go to the log."""
        with ExitStack() as stack:
            self._log = stack.enter_context((folder / "log.txt").open("w", encoding="utf-8"))
            stack.enter_context(warnings.catch_warnings())
            warnings.showwarning = self._warning
            from rotorid_torch.run.output.board import Board

            self._boards, self._fits = folder / "tensorboard", 0
            self.board = stack.enter_context(closing(Board(self._boards)))
            try:
                yield
            finally:
                self._log, self.board, self._boards = None, None, None

    @contextmanager
    def fit(self, name: str) -> Iterator[Callable[[Mapping[str, float], int], None]]:
        """A fit with a folder of its own in TensorBoard; gives what records numbers of an iteration there, not logged.

        Parameters
        ----------
        name : of the fit, for people; fits are numbered in the order in which they begin.
        """
        if self._boards is None:
            yield lambda values, iteration: None
            return
        from rotorid_torch.run.output.board import Board

        self._fits += 1
        with closing(Board(self._boards / f"{self._fits:02d}-{name}")) as board:
            yield board.scalars

    @property
    def recorded(self) -> bool:
        """Whether fits are recorded for TensorBoard."""
        return self._boards is not None

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Time a step under `name` (`reconstruct`, `ftr`, `ml`, `trace`) and show its progress, in plain words."""
        begin = time.perf_counter()
        try:
            with self._bar(name):
                yield
        finally:
            spent = time.perf_counter() - begin
            self.seconds[name] = self.seconds.get(name, 0.0) + spent
        self.log(f"{name}: {spent:.1f} s")
        if self.console and (spent >= SHORT_S or self.verbose):
            self.console.print(f"{spent:7.1f} s  {STEPS.get(name, name)}")

    def progress(self, done: int, total: int) -> None:
        """Show that `done` of `total` parts of the present step are done."""
        if self._progress:
            self._progress.update(self._progress.task_ids[0], completed=done, total=total)

    def say(self, text: str) -> None:
        """One line for developers: to the log, and with `verbose` to the console."""
        self.log(text)
        if self.console and self.verbose:
            self.console.print(text)

    def tell(self, text: str) -> None:
        """One line for people, of how far a long step is: beside its bar, where there is one."""
        self.log(text)
        if self._progress:
            self._progress.update(self._progress.task_ids[0], description=text)
        elif self.console:
            self.console.print(f"{'':9}  {text}")

    def log(self, text: str) -> None:
        """Tell one line to the log only."""
        if self._log:
            self._log.write(f"{time.perf_counter() - self._start:9.2f} s  {printable(text, layout=False)}\n")
            self._log.flush()

    def scalars(self, values: Mapping[str, float], iteration: int) -> None:
        """Record numbers of one iteration, by name (`ml/cost`)."""
        if self.board:
            self.board.scalars(values, iteration)
        self.log(f"{iteration}: " + ", ".join(f"{name} {value:.6g}" for name, value in values.items()))

    def picture(self, name: str, png: bytes, iteration: int = 0) -> None:
        """Record a picture for TensorBoard, as it is."""
        if self.board:
            self.board.picture(name, png, iteration)

    def time_record(self) -> TimeRecord:
        """Seconds per step so far, and in all since the monitor was made."""
        steps = {name: self.seconds[name] for name in TimeRecord.__struct_fields__ if name in self.seconds}
        return TimeRecord(**steps, total=time.perf_counter() - self._start)

    @contextmanager
    def _bar(self, name: str) -> Iterator[None]:
        if self.console is None or not (self.console.is_terminal or self.console.is_jupyter):
            yield
            return
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn()
        with Progress(*columns, console=self.console, transient=True) as self._progress:
            self._progress.add_task(STEPS.get(name, name), total=None)
            try:
                yield
            finally:
                self._progress = None

    def _warning(
        self,
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        self.log(f"{category.__name__} at {filename}:{lineno}: {message}")


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, MB; not that of the program that started it, as Linux counts."""
    status = Path("/proc/self/status")
    line = re.search(r"^VmHWM:\s+(\d+) kB", status.read_text(), re.MULTILINE) if status.exists() else None
    if line:
        return int(line[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1024**2 if sys.platform == "darwin" else peak / 1024
