"""What the package is held against, and the table of it that docs/validated.md and the README hold.

Each row names a test; `test_pages` looks that the test exists and that every number of `within` stands in it.
"""

from __future__ import annotations

import ast
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEADING = "| what | against | within | shown by |\n|---|---|---|---|"


@dataclass(frozen=True)
class Row:
    """One claim. within : in words, with the numbers of the test; short : in the README too."""

    what: str
    against: str
    within: str
    test: str
    short: bool = False

    @property
    def file(self) -> Path:
        return ROOT / self.test.partition("::")[0]

    @property
    def name(self) -> str:
        return self.test.partition("::")[2]

    @property
    def source(self) -> str:
        """Text of the test, its decorators, and the functions, classes and constants of its file that it names."""
        text = self.file.read_text(encoding="utf-8")
        pieces = {name: node for node in ast.parse(text).body for name in _names(node)}
        test = pieces[self.name]
        used = dict.fromkeys(node.id for node in ast.walk(test) if isinstance(node, ast.Name))
        decorators = [ast.get_source_segment(text, d) or "" for d in getattr(test, "decorator_list", [])]
        nodes = [test, *(pieces[name] for name in used if name in pieces)]
        return "\n".join([*decorators, *(ast.get_source_segment(text, node) or "" for node in nodes)])


def _names(node: ast.stmt) -> list[str]:
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def table(rows: list[Row]) -> str:
    """Rows as Markdown."""
    lines = (f"| {r.what} | {r.against} | {r.within} | `{r.test.replace('::', ' ')}` |" for r in rows)
    return "\n".join((HEADING, *lines))


ROWS = [Row(**row) for row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["row"]]
"""All claims."""
