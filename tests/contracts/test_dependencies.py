"""What the package imports of others is declared, and an installation without extras has it."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def imported(tree: ast.Module) -> set[str]:
    """Top names of the packages that a module imports when it is imported itself."""
    absolute = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    plain = [alias.name for node in absolute if isinstance(node, ast.Import) for alias in node.names]
    parts = [node.module or "" for node in absolute if isinstance(node, ast.ImportFrom) and node.level == 0]
    return {name.split(".")[0] for name in (*plain, *parts)}


def test_packages_that_are_imported_are_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {re.split(r"[^\w-]", line)[0] for line in project["dependencies"]}
    files = (ROOT / "rotorid_torch").rglob("*.py")
    names = set().union(*(imported(ast.parse(file.read_text(encoding="utf-8"))) for file in files))
    assert names - set(sys.stdlib_module_names) - {"rotorid_torch"} <= declared
