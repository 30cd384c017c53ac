"""The house stays as it was left: small folders that say what they hold, imports that point down, short signatures."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "rotorid_torch"
MOST_FILES = 12
"""Python files of a folder, its `__init__` included."""
MOST_PARAMETERS = 6
PUBLIC = {
    "Dataset.from_arrays",
    "close_loop",
    "filter_error",
    "fly",
    "identify",
    "output_error",
    "regress",
    "simulate",
    "unscented_filter",
}
"""What users call, with an option a keyword."""

FOLDERS = sorted(file.parent for file in PACKAGE.rglob("__init__.py"))


def module(file: Path) -> str:
    """Dotted name of a file of the package."""
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module(file): file for file in PACKAGE.rglob("*.py")}


def imported(file: Path) -> Iterator[str]:
    """Modules of the package that a file imports anywhere, inside functions and for types too."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield from (name for name in (full if full in MODULES else node.module,) if name in MODULES)


IMPORTS = {name: {*imported(file)} - {name} for name, file in MODULES.items()}


def circles(arrows: dict[str, set[str]]) -> set[str]:
    """Nodes from which a way leads back to themselves."""

    def beyond(start: str) -> set[str]:
        reached, ahead = set[str](), [start]
        while ahead:
            for name in arrows.get(ahead.pop(), set()) - reached:
                reached.add(name)
                ahead.append(name)
        return reached

    return {name for name in arrows if name in beyond(name)}


@pytest.mark.parametrize("folder", FOLDERS, ids=module)
def test_a_folder_is_small_and_says_what_it_holds(folder: Path):
    files = sorted(folder.glob("*.py"))
    assert len(files) <= MOST_FILES
    if folder == PACKAGE:
        return
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
    chapters = [f"`{sub.name}/`" for sub in folder.iterdir() if sub in FOLDERS]
    named = [f"`{file.stem}`" for file in files if file.stem != "__init__"]
    assert [name for name in (*named, *chapters) if name not in text] == []


def test_no_module_imports_what_imports_it():
    assert circles(IMPORTS) == set()


@pytest.mark.parametrize("folder", FOLDERS, ids=module)
def test_rooms_of_a_folder_stand_above_each_other(folder: Path):
    """What lies in a folder, files and chapters, imports in one direction only."""
    prefix = f"{module(folder)}."
    arrows: dict[str, set[str]] = {}
    for name, others in IMPORTS.items():
        if name.startswith(prefix):
            room = name.removeprefix(prefix).split(".")[0]
            inside = {other.removeprefix(prefix).split(".")[0] for other in others if other.startswith(prefix)}
            arrows[room] = arrows.get(room, set()) | (inside - {room})
    assert circles(arrows) == set()


def signatures(node: ast.AST, owner: str = "") -> Iterator[tuple[str, int]]:
    """Functions below a node by name, with the number of their parameters."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef):
            yield from signatures(child, f"{child.name}.")
        elif isinstance(child, ast.FunctionDef):
            arguments = [*child.args.posonlyargs, *child.args.args, *child.args.kwonlyargs]
            yield f"{owner}{child.name}", sum(a.arg not in ("self", "cls") for a in arguments)
            yield from signatures(child)


def test_functions_take_few_parameters():
    """No function but those that users call."""
    trees = {name.removeprefix("rotorid_torch."): ast.parse(file.read_text("utf-8")) for name, file in MODULES.items()}
    long = {f"{name}:{f}" for name, tree in trees.items() for f, count in signatures(tree) if count > MOST_PARAMETERS}
    assert not {name for name in long if name.partition(":")[2] not in PUBLIC and not name.endswith("__init__")}
