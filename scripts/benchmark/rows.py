"""The rows of the benchmark's table: what each measures, its bar, and how a figure is held against it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

from rich.table import Table

Sense = Literal["ratio at most", "ratio at least", "value at most", "told"]
"""What is held against the bar; `told` has none."""


@dataclass(frozen=True)
class Row:
    """A figure to be measured.

    bar, stretch : what it has to reach and what would be better; None where nothing is asked.
    """

    name: str
    what: str
    sense: Sense
    bar: float | None = None
    stretch: float | None = None


@dataclass(frozen=True)
class Figure:
    """A measured figure: ratio is value over that of `against`, for gains and speed-ups the other way round."""

    value: float
    unit: str
    against: str | None = None
    ratio: float | None = None


@dataclass(frozen=True)
class Result:
    """A row as it was measured; value, ratio and met are None where it was not."""

    name: str
    value: float | None
    unit: str | None
    against: str | None
    ratio: float | None
    bar: float | None
    met: bool | None


class NotMeasured(Exception):
    """Why a figure could not be measured here."""


ROWS = (
    Row("A-1", "filter A, 1 flight, one thread", "ratio at most", 1.5, 1.0),
    Row("A-10", "filter A, 10 flights, one thread", "ratio at most", 1.3, 0.9),
    Row("A-100", "filter A, 100 flights, one thread", "ratio at most", 1.3, 0.9),
    Row("A-10-threads", "filter A, 10 flights, two threads", "ratio at most", 1.2, 0.9),
    Row("A-10-jax", "filter A, 10 flights", "ratio at most", 0.25),
    Row("B-10", "normal equations B, 10 flights, one thread", "ratio at most", 1.2, 0.7),
    Row("B-10-threads", "normal equations B, 10 flights, two threads", "ratio at most", 1.2, 0.9),
    Row("B-10-jax", "normal equations B, 10 flights", "ratio at most", 0.1),
    Row("gauss-newton", "the data set's model, one Gauss-Newton iteration, two threads", "ratio at least", 50.0, 200.0),
    Row("engine-new", "engine of a structure never seen: trace, emit, compile, load", "value at most", 10.0, 3.0),
    Row("engine-cached", "the same from the cache, in a fresh process", "value at most", 0.5, 0.1),
    Row("reconstruct", "step 1 of the data set, whole", "told"),
    Row("identify-first", "identify, whole process, nothing cached", "value at most", 40.0, 15.0),
    Row("identify-warm", "identify, whole process, warm cache", "value at most", 15.0, 5.0),
    Row("close-loop-cold", "close-loop, whole process, clean aircraft to be drawn", "value at most", 480.0),
    Row("close-loop", "close-loop, whole process, draws cached", "value at most", 60.0, 10.0),
    Row("import", "import rotorid_torch", "value at most", 3.0),
    Row("import-identify", "from rotorid_torch import identify", "value at most", 3.0),
    Row("help", "rotorid --help", "value at most", 3.0),
    Row("help-torch", "whether rotorid --help imports torch", "value at most", None, 0.0),
    Row("flights-100-time", "identify of 100 flights: time per flight", "ratio at most", 1.1),
    Row("flights-100-memory", "identify of 100 flights: peak memory", "ratio at most", 2.0),
    Row("flights-1000-time", "identify of 1000 flights: time per flight", "ratio at most", 1.1),
    Row("flights-1000-memory", "identify of 1000 flights: peak memory", "ratio at most", 2.0),
    Row("ranks", "gain of 2 ranks over the gain of two C++ processes", "ratio at least", 0.85, 0.95),
    Row("accuracy-A", "filter A: largest relative difference", "value at most", 1e-9),
    Row("accuracy-A-cpp", "filter A: largest relative difference", "value at most", 1e-9),
    Row("accuracy-B", "normal equations B: largest relative difference", "value at most", 1e-9),
    Row("accuracy-B-cpp", "normal equations B: largest relative difference", "value at most", 1e-9),
    Row("accuracy-gauss-newton", "Gauss-Newton: largest relative difference", "value at most", 1e-9),
)


def judged(row: Row, figure: Figure | None) -> Result:
    """The row with its figure held against the bar."""
    if figure is None:
        return Result(row.name, None, None, None, None, row.bar, None)
    met = None if row.bar is None else _reaches(row.sense, figure, row.bar)
    return Result(row.name, figure.value, figure.unit, figure.against, figure.ratio, row.bar, met)


def _reaches(sense: Sense, figure: Figure, bar: float) -> bool:
    if sense == "value at most":
        return figure.value <= bar
    assert figure.ratio is not None
    return figure.ratio <= bar if sense == "ratio at most" else figure.ratio >= bar


def plain(results: list[Result]) -> list[dict[str, Any]]:
    """For JSON."""
    return [asdict(result) for result in results]


def table(results: list[Result], reasons: dict[str, str], caption: str) -> Table:
    """For people: one line a row, with the reason where it was not measured."""
    shown = Table(title="rotorid-torch: speed", caption=caption)
    for heading in ("row", "what", "value", "against", "ratio", "bar", "stretch", "met"):
        shown.add_column(heading, justify="left" if heading in ("row", "what", "against") else "right", overflow="fold")
    rows = {row.name: row for row in ROWS}
    for result in results:
        row = rows[result.name]
        goal = [_goal(row, row.bar), _goal(row, row.stretch)]
        if result.value is None:
            shown.add_row(row.name, row.what, "", reasons[row.name], "", *goal, "-", style="dim")
            continue
        value = f"{_short(result.value)} {result.unit}"
        met = {True: "[green]yes[/]", False: "[red]NO[/]", None: "-"}[result.met]
        shown.add_row(row.name, row.what, value, result.against or "", _short(result.ratio), *goal, met)
    return shown


def _goal(row: Row, number: float | None) -> str:
    if number is None:
        return ""
    return f"{'≥' if row.sense == 'ratio at least' else '≤'} {number:g}"


def _short(number: float | None) -> str:
    if number is None:
        return ""
    return f"{number:.3g}" if math.isfinite(number) else str(number)
