"""The table of effects: what the command prints and what the page says are the same effects."""

from __future__ import annotations

import io
import re

import msgspec
from rich.console import Console

from rotorid_torch.commands.effects_table import effect_rows, effects_table
from rotorid_torch.effects.registry import registered
from tests.helpers import ROOT


def test_the_page_says_of_the_library_s_effects_what_the_code_says():
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8").replace(r"\|", "|")
    lines = {line.split("`")[1]: line for line in page.splitlines() if re.match(r"\| `[a-z_.]+` \|", line)}
    own = [e for e in registered().values() if e.__module__.startswith("rotorid_torch.")]
    assert set(lines) == {e.id for e in own}
    for row in effect_rows(own):
        said = f"| `{row.id}` | {row.role}, {row.stage} | {row.showing} | {row.what}"
        assert lines[row.id].startswith(said)


def test_rows_tell_class_and_parameters():
    rows = {r["id"]: r for r in msgspec.to_builtins(effect_rows(registered().values()))}
    delay = rows["control.delay"]
    assert delay["class"] == "trajectories"
    assert delay["parameters"][0]["name"] == "common"
    assert delay["parameters"][0]["typical"] > 0.0
    assert rows["mass.payload"]["class"] == "absorbed"
    assert all(r["parameters"] for r in rows.values())


def test_every_id_is_whole_in_a_terminal_of_80_columns():
    """It is what `--effect` asks for."""
    written, every = io.StringIO(), registered()
    Console(file=written, width=80).print(effects_table(effect_rows(every.values())))
    assert set(every) <= set(written.getvalue().split())
