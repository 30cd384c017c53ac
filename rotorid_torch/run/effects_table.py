"""The table of effects, read from the registry: what a model can hold and what each effect is."""

from __future__ import annotations

import inspect
from collections.abc import Iterable

import msgspec
from rich.table import Table

from rotorid_torch.effects.base import Effect


class EffectRow(msgspec.Struct, frozen=True):
    """One effect: id, role, stage of the chain, and its docstring's first line."""

    id: str
    role: str
    stage: str
    what: str


def effect_rows(effects: Iterable[type[Effect]]) -> list[EffectRow]:
    """One row per effect class, in the order given."""
    return [EffectRow(e.id, e.role.value, e.stage.name.lower(), _first_line(e)) for e in effects]


def effects_table(rows: Iterable[EffectRow]) -> Table:
    """The rows for people."""
    table = Table("id", "role", "stage", "what")
    for row in rows:
        table.add_row(row.id, row.role, row.stage, row.what)
    return table


def _first_line(effect: type[Effect]) -> str:
    return (inspect.getdoc(effect) or "").partition("\n")[0]
