"""Every reason has words, the documentation shows the table that decides, and few numbers are set by hand."""

from __future__ import annotations

import ast
from dataclasses import fields
from pathlib import Path
from typing import get_args

from rotorid_torch.core.names import Verdict
from rotorid_torch.trace.search.decide import TABLE, Interval, Reason, Row
from rotorid_torch.trace.search.words import REASONS
from rotorid_torch.trace.terms.settings import Settings

PAGE = Path(__file__).parents[3] / "docs" / "closed-loop.md"
ROOT = Path(__file__).parents[3] / "rotorid_torch"
OBSERVED = {
    "part": "a part of the nominal model is the effect",
    "taken_up": "a part of the nominal model takes up the effect",
    "runs_worse": "free runs of unseen flights are worse by more than chance",
}
NOT_OBSERVED = {
    "testable": "data or declaration do not let it be tested",
    "observable": "the usual size would not be visible",
    "significant": "p > 0.05",
    "still": "p > 0.05 beside the names",
    "fitted": "the full fit explains nothing",
    "unseen_better": "unseen flights are not better described",
    "in_set": "not in the set of explanations",
    "useful": "the model with it is worse than holding trim on unseen flights",
    "alone": "others are in the set of explanations",
    "adequate": "the names explain too little of what has no name",
}
"""What the table of decisions asks for, in words."""


def table_of_decisions() -> str:
    """The table of decisions as Markdown."""
    rows = ["| where | verdict | reason |", "|---|---|---|"]
    for asked, verdict, why in TABLE:
        where = ", ".join(_asked(name, value) for name, value in asked.items()) or "otherwise"
        rows.append(f"| {where} | {verdict} | {REASONS[why]} |")
    return "\n".join(rows)


def _asked(name: str, value: object) -> str:
    """One observation in words."""
    if isinstance(value, Interval):
        return {Interval.ACTIVE_BOUND: "a bound is active", Interval.WITHIN_ERROR: "the interval holds the null"}[value]
    return OBSERVED[name] if value else NOT_OBSERVED[name]


def test_no_verdict_is_written_beside_the_table():
    """What a module of the closed loop says of an effect it says of a row; it compares verdicts, and writes none."""
    files = [*(ROOT / "trace").rglob("*.py"), *(ROOT / "run").rglob("*.py")]
    written = {
        file.name
        for file in files
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.Call)
        for argument in (*node.args, *(keyword.value for keyword in node.keywords))
        if isinstance(argument, ast.Constant) and argument.value in get_args(Verdict)
    }
    assert written == set()


def test_every_reason_has_words():
    assert set(REASONS) == set(Reason)


def test_the_page_of_the_closed_loop_shows_the_table_that_decides():
    assert table_of_decisions() in PAGE.read_text()


def test_the_table_asks_for_what_a_row_holds():
    names = {field.name for field in fields(Row)}
    assert {name for asked, _, _ in TABLE for name in asked} == names
    assert OBSERVED.keys() | NOT_OBSERVED.keys() == names - {"estimate"}


def test_at_most_twelve_numbers_are_set_by_hand_each_with_its_reason():
    """Numbers that decide a verdict stand in the settings alone."""
    names = [field.name for field in fields(Settings)]
    assert len(names) <= 12
    assert all(f"    {name} : " in (Settings.__doc__ or "") for name in names)
