"""Paths that commands write to: where they lie, which files are the same, and what no command wrote there."""

import os
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path

from rotorid_torch.errors import InputError

COMPARED = 10_000
"""Names of a folder that a misspelt one is compared with, at most."""


def absolute(out: str | Path) -> Path:
    """The path from the root; a last ".." is resolved, so that it has a name of its own."""
    path = Path(out).absolute()
    return path.resolve() if path.name == ".." else path


def nearest_path(path: str | Path) -> str:
    """Hint for a path that is not there, " (did you mean '...'?)" or an empty string: a like name in its folder."""
    missing = absolute(path)
    try:
        while not missing.parent.is_dir():
            missing = missing.parent
        with os.scandir(missing.parent) as entries:
            names = [entry.name for entry in islice(entries, COMPARED)]
    except (OSError, ValueError):
        return ""
    near = get_close_matches(missing.name, [name for name in names if not missing.suffix or "." in name], n=1)
    if not near or near[0] == missing.name:
        return ""
    like = Path(path).with_name(near[0]) if missing == absolute(path) else missing.parent / near[0]
    return f" (did you mean '{like}'?)"


def refuse_foreign(folder: Path, patterns: Sequence[str], kind: str) -> None:
    """Raise InputError where a folder that is to be replaced holds files that no command writes there.

    patterns : of the files of such a folder, by their path in it; `*` stands for any characters.
    kind : what the folder is, for the message.
    """
    for name in _entries(folder):
        if not is_part(name, patterns):
            expected = f"a folder with nothing but {kind}: move the file away, or write to a new name"
            raise InputError(folder, name, f"would be deleted, and is no part of {kind}", expected)


def is_part(name: str, patterns: Sequence[str]) -> bool:
    """Whether a path in a folder is one of those that a command writes there."""
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _entries(folder: Path) -> Iterable[str]:
    """Files and links below a folder, by their path in it, in order."""
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if os.path.islink(os.path.join(place, name))]
        for name in sorted([*files, *links]):
            yield os.path.relpath(os.path.join(place, name), folder)


def same_file(path: Path, others: Iterable[Path]) -> Path | None:
    """The first of other files that `path` is too, by whatever name, link or hard link; None where it is none."""
    if not os.path.exists(path):
        return None
    return next((other for other in others if os.path.exists(other) and os.path.samefile(path, other)), None)
