"""Fills in the reference pages while mkdocs builds: help of every command, docstring of every public name."""

from __future__ import annotations

import argparse
import inspect
import os
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
WIDTH = "100"


def commands() -> str:
    """Help of every command as Markdown."""
    os.environ["COLUMNS"] = WIDTH
    from rotorid_torch.cli import parser

    top = parser()
    (choices,) = (a.choices for a in top._actions if isinstance(a, argparse._SubParsersAction))
    parts = [_block("rotorid", top.format_help())]
    parts += [_block(f"rotorid {name}", command.format_help()) for name, command in choices.items()]
    return "\n".join(parts)


def api() -> str:
    """Signature and docstring of every public name as Markdown."""
    import rotorid_torch

    return "\n".join(_documented(name, getattr(rotorid_torch, name)) for name in sorted(rotorid_torch.__all__))


def _documented(name: str, thing: Any) -> str:
    text = inspect.getdoc(thing) or ""
    if callable(thing):
        try:
            text = f"{name}{inspect.signature(thing)}\n\n{text}"
        except ValueError:
            pass
    methods = []
    if inspect.isclass(thing):
        for method, function in vars(thing).items():
            if not method.startswith("_") and callable(getattr(thing, method)) and inspect.getdoc(function):
                methods.append(f"{name}.{method}\n    {inspect.getdoc(function)}".replace("\n", "\n    "))
    return _block(f"rotorid.{name}", "\n\n".join([text, *methods]))


def _block(title: str, text: str) -> str:
    return f"## {title}\n\n````text\n{text.rstrip()}\n````\n"


FILLED = {"<!-- commands -->": commands, "<!-- api -->": api}


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with its generated parts; mkdocs calls this."""
    sys.path.insert(0, str(ROOT))
    for mark, text in FILLED.items():
        if mark in markdown:
            markdown = markdown.replace(mark, text())
    return markdown
