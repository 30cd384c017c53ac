"""The table of effects, read from the registry: what a model can hold and what each effect is."""

import inspect
from collections.abc import Iterable, Sequence

import msgspec
from rich.table import Column, Table

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.effects.base import Effect
from rotorid_torch.effects.examples import example


class ParameterRow(msgspec.Struct, frozen=True):
    """One parameter as an effect declares it for an example vehicle; `value` is where it changes nothing or starts."""

    name: str
    unit: str
    value: float
    bounds: tuple[float, float]
    typical: float
    free: bool
    what: str


class EffectRow(msgspec.Struct, frozen=True, rename={"showing": "class"}):
    """One effect: id, role, stage of the chain, where it shows, its docstring's first line, and its parameters."""

    id: str
    role: str
    stage: str
    showing: str
    what: str
    parameters: tuple[ParameterRow, ...]


def effect_rows(effects: Iterable[type[Effect]]) -> list[EffectRow]:
    """One row per effect class, in the order given."""
    first = {e: (inspect.getdoc(e) or "").partition("\n")[0] for e in effects}
    return [
        EffectRow(e.id, e.role.value, e.stage.name.lower(), e.showing.value, first[e], _parameters(e)) for e in first
    ]


def effects_table(rows: Iterable[EffectRow]) -> Table:
    """The rows for people, ids whole on the narrowest screen; what `--json` has besides is the parameters."""
    table = Table(Column("id", no_wrap=True), "role, stage", "shows in", "what", show_lines=True)
    for row in rows:
        table.add_row(row.id, f"{row.role}, {row.stage}", row.showing, row.what.partition(": ")[0])
    return table


def _parameters(effect: type[Effect]) -> tuple[ParameterRow, ...]:
    declared: Sequence[Parameter] = effect.from_spec(example(effect)).declared
    return tuple(ParameterRow(p.name, p.unit, p.value, p.bounds, p.typical, p.free, p.doc) for p in declared)
