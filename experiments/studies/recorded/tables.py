"""Tables of closed loops: what a verdict can be worth, shares of runs with their intervals, Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

OUTCOMES = ("named", "in a group", "in part", "silent", "no name", "false name")
"""named: all that was hidden, and nothing else. in a group: among effects that cannot be told apart. in part: one of
two. silent: nothing was said. no name: something is missing, and it is not named. false name: any name or group that is
not what was hidden."""


def wilson(hits: int, runs: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share of runs.

    Source: Wilson, Journal of the American Statistical Association 22 (1927), p. 209.
    """
    if not runs:
        return 0.0, 1.0
    share, spread = hits / runs, z * z / runs
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = z / (1.0 + spread) * math.sqrt(share * (1.0 - share) / runs + 0.25 * spread / runs)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def share(hits: int, runs: int) -> str:
    """A share of runs in words, with its interval."""
    if not runs:
        return "no runs"
    low, high = wilson(hits, runs)
    return f"{hits} of {runs} ({100 * hits / runs:.0f} %; {100 * low:.0f} to {100 * high:.0f} %)"


def number(value: float | None) -> str:
    """An error with three decimals; nothing for none."""
    return "" if value is None else f"{value:.3f}"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_between(page: Path, name: str, text: str) -> None:
    """Replace what stands between a page's markers `<!-- NAME: begin -->` and `<!-- NAME: end -->`."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    whole = page.read_text(encoding="utf-8")
    if begin not in whole or end not in whole:
        raise SystemExit(f"{page} has no markers {begin} and {end}")
    before, behind = whole.split(begin, 1)
    after = behind.split(end, 1)[1]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")
