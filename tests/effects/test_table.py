"""The table of effects: what the command prints and what the page says are the same effects."""

from __future__ import annotations

import re

import msgspec

from rotorid_torch.commands.effects_table import effect_rows
from rotorid_torch.effects.registry import registered
from tests.helpers import ROOT


def test_the_page_lists_the_library_s_effects():
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    own = {name for name, e in registered().items() if e.__module__.startswith("rotorid_torch.")}
    assert set(re.findall(r"^\| `([a-z_.]+)` \|", page, flags=re.MULTILINE)) == own


def test_rows_tell_class_and_parameters():
    rows = {r["id"]: r for r in msgspec.to_builtins(effect_rows(registered().values()))}
    delay = rows["control.delay"]
    assert delay["class"] == "trajectories"
    assert delay["parameters"][0]["name"] == "common"
    assert delay["parameters"][0]["typical"] > 0.0
    assert rows["mass.payload"]["class"] == "absorbed"
    assert all(r["parameters"] for r in rows.values())
