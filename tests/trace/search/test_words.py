"""Every reason has words, the documentation shows the table that decides, and few numbers are set by hand."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from rotorid_torch.trace.search.decide import TABLE, Reason, Row
from rotorid_torch.trace.search.words import NOT_OBSERVED, OBSERVED, REASONS, table_of_decisions
from rotorid_torch.trace.terms.settings import Settings

PAGE = Path(__file__).parents[3] / "docs" / "closed-loop.md"


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
