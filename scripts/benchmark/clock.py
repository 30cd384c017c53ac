"""Clocks: several programs in turn, whole processes, and where the time of one of them went."""

from __future__ import annotations

import cProfile
import io
import os
import pstats
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from statistics import median
from typing import Any
from unittest.mock import patch

from rotorid_torch.core.native import dynamics, filtering
from rotorid_torch.core.native.build import library
from rotorid_torch.identification.reconstruct import gauss_markov

LINES = 12
"""Lines of a profile that are shown."""


def interleaved(programs: Mapping[str, Callable[[], Any]], repeats: int, budget: float = 90.0) -> dict[str, float]:
    """Medians, s, of programs that run in turn, so that what else the machine does hits all alike.

    Each has been called before. After `budget` seconds no further round begins.
    """
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    end = time.perf_counter() + budget
    for k in range(repeats):
        if k and time.perf_counter() > end:
            break
        for name, program in programs.items():
            begin = time.perf_counter()
            program()
            seconds[name].append(time.perf_counter() - begin)
    return {name: median(values) for name, values in seconds.items()}


def process(*arguments: str, **environment: str) -> tuple[float, str]:
    """Wall time, s, and output of a fresh Python with these arguments; the package is this project's, wherever one is.

    Raises
    ------
    RuntimeError : it fails; with the last line that it said.
    """
    env = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"} | environment
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-P", *arguments], env=env, capture_output=True, text=True, check=False)
    spent = time.perf_counter() - begin
    if done.returncode:
        raise RuntimeError(
            done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"exit code {done.returncode}"
        )
    return spent, done.stdout


def processor_seconds() -> float:
    """Seconds that processors have spent on processes which this one has started and seen end, and on theirs."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


class _Timed:
    """A library whose functions add up the time spent in them."""

    def __init__(self, library: Any, seconds: Counter[str]) -> None:
        self._library, self._seconds = library, seconds

    def __getattr__(self, name: str) -> Callable[..., Any]:
        function = getattr(self._library, name)

        def call(*arguments: Any) -> Any:
            begin = time.perf_counter()
            try:
                return function(*arguments)
            finally:
                self._seconds[name] += time.perf_counter() - begin

        return call


@contextmanager
def native_seconds() -> Iterator[Counter[str]]:
    """Seconds spent in each loop of native code while the block runs."""
    seconds: Counter[str] = Counter()
    with ExitStack() as stack:
        for module in (dynamics, filtering, gauss_markov):
            stack.enter_context(patch.object(module, "library", lambda source: _Timed(library(source), seconds)))
        yield seconds


def profile(title: str, program: Callable[[], Any], once: bool = False) -> str:
    """Where the time of a call goes: loops of native code, and the Python functions that take most themselves.

    once : both from one call, for programs that take long; else the functions come from a second call, so that
        watching them does not lengthen the first.
    """
    recorder = cProfile.Profile()
    with native_seconds() as loops:
        begin = time.perf_counter()
        recorder.runcall(program) if once else program()
        whole = time.perf_counter() - begin
    if not once:
        recorder.runcall(program)
    said = io.StringIO()
    pstats.Stats(recorder, stream=said).strip_dirs().sort_stats("tottime").print_stats(LINES)
    lines = [line for line in said.getvalue().splitlines() if line.strip()]
    first = next(i for i, line in enumerate(lines) if "ncalls" in line)
    native = [f"  native {name}: {seconds:.4f} s, {seconds / whole:.0%}" for name, seconds in loops.most_common()]
    rest = f"  all else: {whole - sum(loops.values()):.4f} s"
    return "\n".join([f"{title}: {whole:.4f} s", *native, rest, *lines[first:]])
