"""What the package is held against, and the table of it that docs/validated.md and the README hold.

Each row names a test; `test_pages` looks that the test is there and that the figure of the row stands in its file.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEADING = "| what | against | within | shown by |\n|---|---|---|---|"


@dataclass(frozen=True)
class Row:
    """One claim. within : in words; figure : as it stands in the test's file; short : in the README too."""

    what: str
    against: str
    within: str
    test: str
    figure: str = ""
    short: bool = False

    @property
    def file(self) -> Path:
        return ROOT / self.test.partition("::")[0]

    @property
    def name(self) -> str:
        return self.test.partition("::")[2]


def table(rows: list[Row]) -> str:
    """Rows as Markdown."""
    lines = (f"| {r.what} | {r.against} | {r.within} | `{r.test.replace('::', ' ')}` |" for r in rows)
    return "\n".join((HEADING, *lines))


ROWS = [Row(**row) for row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["row"]]
"""All claims."""
