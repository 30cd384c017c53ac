"""What `rotorid import` tells: flights and their lists, where each channel came from, warnings."""

import re
from collections.abc import Mapping
from itertools import groupby
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from rotorid_torch.core import names
from rotorid_torch.importing.logs import Imported, Taken


def import_table(done: Imported) -> RenderableType:
    """All of it for people."""
    flights = Table(title=f"{done.folder.name}: {done.kind}, {done.rate:g} Hz", title_justify="left")
    for heading in ("list", "flight", "s", "most moved"):
        flights.add_column(heading, justify="right" if heading == "s" else "left")
    for listed, chosen in done.lists.items():
        for name in chosen:
            seconds, kind = done.flights[name]
            flights.add_row(listed, name, f"{seconds:.1f}", kind or "-")
    channels = Table("channel", "unit")
    channels.add_column("from", overflow="fold")
    channels.add_column("recorded at")
    for (topic, unit, rate), together in groupby(done.channels.items(), lambda one: _alike(done, *one)):
        members = dict(together)
        fields = dict.fromkeys(_split(taken.source)[1] for taken in members.values())
        channels.add_row(" ".join(members), unit, f"{topic}{' '.join(fields)}" or "computed", rate)
    warnings = [Text(f"warning: {sentence}") for sentence in done.warnings]
    where = Text(f"data set: {done.folder}; its lists and its vehicle are yours to edit in dataset.toml")
    if len(done.flights) == 1:
        said = "warning: one flight makes a model, and none is left to judge it: bring another log, or cut this one at"
        warnings.append(Text(f"{said} its rests with --split"))
    return Group(flights, channels, *warnings, where, Text(f"Next: rotorid check {done.folder}"))


def _alike(done: Imported, name: str, taken: Taken) -> tuple[str, str, str]:
    """What channels that stand in one row have in common: topic, unit and rate."""
    return _split(taken.source)[0], _unit(name, done.units), f"{taken.hertz:.3g} Hz" if taken.source else "-"


def _split(source: str) -> tuple[str, str]:
    """Topic and field of a source, without the places of an array; a column of a table is a topic by itself."""
    topic, point, member = re.sub(r"\[\d+\]$", "", source).partition(".")
    return f"{topic}{point}", member


def _unit(name: str, declared: Mapping[str, str]) -> str:
    return "0…1" if names.is_motor(name) else declared.get(name) or names.unit(name) or "-"


def import_record(done: Imported) -> dict[str, Any]:
    """All of it for `--json`."""
    channels = {n: {"source": t.source, "hertz": t.hertz, "because": t.reason} for n, t in done.channels.items()}
    flights = {name: {"seconds": seconds, "kind": kind} for name, (seconds, kind) in done.flights.items()}
    return {
        "dataset": str(done.folder),
        "kind": done.kind,
        "rate_hz": done.rate,
        "flights": flights,
        "lists": done.lists,
        "channels": channels,
        "warnings": done.warnings,
    }
