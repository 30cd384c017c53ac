"""The scorecard on the console: scores against their yardsticks, warnings, and last the verdict and what to do."""

import math
from collections.abc import Mapping
from pathlib import Path

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from rotorid_torch.printable import percent
from rotorid_torch.report.records import FitRecord, Report
from rotorid_torch.report.short_horizon import BRACKETS, NAMES, cell, predictions_of, responses_of, short_horizon
from rotorid_torch.report.summary import air_of, list_summaries, place_of, shortened
from rotorid_torch.report.words.sizes import plain
from rotorid_torch.report.words.verdict import consequence, opening, steps, with_places, worst_of
from rotorid_torch.validate.free_run import Fidelity

WARNED = 4
"""Warnings on the console, the grade of the data first; the report has all."""


def scorecard(report: Report, dataset: Path | None = None, run: Path | None = None) -> RenderableType:
    """All of a report that fits on a screen; dataset, run : folders, where known, for the command that comes next."""
    parts: list[RenderableType] = []
    for title, fit in (("before", report.before), ("after", report.after)):
        if fit is not None:
            heading = f"{report.dataset.name}, {title}" if report.after else report.dataset.name
            parts.append(_short(heading, fit, fit is report.fit) if short_horizon(fit) else _scores(heading, fit))
            parts += [Text(said) for said in (report.method_of(fit), air_of(fit)) if said]
    parts += [Text(f"warning: {warning}") for warning in report.warnings[:WARNED]]
    if len(report.warnings) > WARNED:
        parts.append(Text(f"more warnings in the report: {len(report.warnings) - WARNED}"))
    if report.verdict is None:
        parts += [Text(f"{e.id} {place_of(e)}: {shortened(e.reason)}") for e in report.effects]
    parts += [Text(""), Text(opening(report), style="bold")]
    worst = worst_of(report.fit) if report.fit else ""
    said = consequence(report), f"Worst channel: {worst}." if worst else ""
    parts += [Text(sentence) for sentence in said if sentence]
    parts.append(Text(f"Next: {with_places(steps(report)[0], dataset, run)}"))
    return Group(*parts)


def fidelity_table(channels: Mapping[str, Fidelity]) -> Table:
    """How a free run follows what was measured, channel by channel."""
    table = Table("channel", title="Free run against measured", title_justify="left")
    table.add_column("rms error", justify="right")
    table.add_column("R²", justify="right")
    for name, one in channels.items():
        table.add_row(name, f"{one.rmse:.3g} {plain(one.unit)}", f"{one.r2:.3f}" if math.isfinite(one.r2) else "-")
    return table


def _scores(title: str, fit: FitRecord) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("flights")
    for name in ("number", "J", "noise alone", "holding trim", "explained"):
        table.add_column(name, justify="right")
    for summary in list_summaries(fit):
        scores = map(_number, (summary.J, summary.J_noise, summary.J_trim))
        table.add_row(summary.name, str(summary.flights), *scores, percent(summary.explained, 1))
    return table


def _short(title: str, fit: FitRecord, explained: bool) -> Table:
    """Responses and predictions of a multirotor, list by list; explained : with what the brackets mean."""
    lists = short_horizon(fit)
    table = Table(title=title, title_justify="left", caption=BRACKETS if explained else None, caption_justify="left")
    table.add_column("")
    for one in lists:
        table.add_column(f"{one.name} ({one.flights})", justify="right")
    for name in responses_of(lists):
        table.add_row(f"R² of {NAMES.get(name, name)}", *(cell(one, name) for one in lists))
    for words, each in predictions_of(lists):
        table.add_row(f"{words} (held)", *("-" if p is None else f"{p.error:.3g} ({p.held:.3g})" for p in each))
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:z.3f}"
