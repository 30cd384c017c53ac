"""Lines of a study in a file, one JSON object each, and the version of the package that they come of."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path

import rotorid_torch


def failure(error: Exception) -> dict:
    """A run that ended with an error."""
    return {"failed": f"{type(error).__name__}: {error}"}


def read_lines(file: Path) -> list[dict]:
    """Lines that are there, the last one of each case; a line that a killed run left half is not."""
    last: dict[str, dict] = {}
    for text in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        last[line["case"]] = line
    return list(last.values())


@cache
def version() -> str:
    """Of the package's code, eight digits: runs with the same came of the same code."""
    digest, root = hashlib.sha256(), Path(rotorid_torch.__file__).parent
    for file in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".h", ".toml")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:8]


def append_line(file: Path, line: dict) -> None:
    """Add a line, behind a half one on a line of its own."""
    text = json.dumps(line) + "\n"
    with file.open("a+b") as stream:
        if stream.tell():
            stream.seek(-1, 2)
            text = text if stream.read(1) == b"\n" else "\n" + text
        stream.write(text.encode())
