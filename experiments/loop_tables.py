"""Tables of closed loops for the docs: what was hidden against what was said, and errors before and after."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import median

from outside_causes import CAUSES

from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import registered
from rotorid_torch.fly.effects import EFFECT_CLASSES

Outcome = str
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


def outcome(line: dict) -> Outcome:
    """What a run's verdict is worth, all that it names taken together."""
    hidden, said, group = set(line["hidden"]), set(line["named"]), set(line["group"])
    structural = {e for e in hidden if e in registered() and registered()[e].role is Role.STRUCTURE}
    if said - hidden or (group and not group & hidden):
        return "false name"
    if group:
        return "in a group"
    found = said | (structural & set(line["structure"]))
    if found:
        return "named" if hidden <= found else "in part"
    return "no name" if line["verdict"] == "unknown" else "silent"


def localised(line: dict) -> bool:
    """Whether a cause outside the library was localised: right equation, right signal, onset within 0.5 s."""
    found, cause = line["unknown"], CAUSES[line["hidden"][0]]
    if found is None:
        return False
    factors = set((found["goes_with"] or "nothing").split())
    right = found["where"] in cause.where(line["aircraft"]) and factors == {*cause.goes_with(line["aircraft"])}
    since = found["since_s"]
    return right and (cause.since_s is None or (since is not None and abs(since - cause.since_s) <= 0.5))


def undeclared_tables(lines: Sequence[dict]) -> tuple[str, dict]:
    """The tables of the study with hidden effects as Markdown, and the shares that they come to."""
    whole = [line for line in lines if "failed" not in line]
    if not whole:
        return "No runs yet.", {"whole": 0, "failed": len(lines)}
    sizes = sorted({line["size"] for line in whole if line["hidden"]})
    parts = [_bars(whole, sizes)]
    for size in sizes or [0.0]:
        these = [line for line in whole if line["size"] == size or not line["hidden"]]
        parts += [f"**Hidden at {size:g} times the typical size**" if size else "**Nothing hidden**", _confusion(these)]
        parts.append(_before_after(these))
    failed = len(lines) - len(whole)
    if failed:
        parts.append(f"{failed} further runs ended with an error.")
    counts = Counter(outcome(line) for line in whole)
    return "\n\n".join(parts), {"whole": len(whole), "failed": failed, "outcomes": dict(counts)}


def _hiding(lines: Iterable[dict], kind: str, size: float | None = None) -> list[dict]:
    """Runs that hide one effect of a class, a pair, an outside cause, or nothing."""

    def fits(hidden: Sequence[str]) -> bool:
        if kind == "nothing":
            return not hidden
        if kind == "pair":
            return len(hidden) == 2
        if kind == "outside":
            return len(hidden) == 1 and hidden[0] in CAUSES
        return len(hidden) == 1 and EFFECT_CLASSES.get(hidden[0]) == kind

    return [line for line in lines if fits(line["hidden"]) and (size is None or line["size"] == size)]


def _count(lines: Iterable[dict], *wanted: Outcome) -> int:
    return sum(outcome(line) in wanted for line in lines)


def _bars(lines: Sequence[dict], sizes: Sequence[float]) -> str:
    """Shares over all runs, with intervals."""
    rows: list[tuple[str, str]] = []
    clean = _hiding(lines, "nothing")
    said = len(clean) - _count(clean, "silent")
    rows.append(("nothing hidden: something undeclared was named or suspected", share(said, len(clean))))
    for size in sizes:
        at = f" at size {size:g}"
        known, taken = _hiding(lines, "identifiable", size), _hiding(lines, "absorbed", size)
        pairs, outside = _hiding(lines, "pair", size), _hiding(lines, "outside", size)
        honest = len(known) - _count(known, "false name")
        rows += [
            (f"identifiable effects{at}: named, nothing false beside", share(_count(known, "named"), len(known))),
            ("the same, in a group with others", share(_count(known, "in a group"), len(known))),
            ("the same, right or honestly silent", share(honest, len(known))),
            (f"effects that derivatives absorb{at}: misnamed", share(_count(taken, "false name"), len(taken))),
            (f"two at once{at}: both named", share(_count(pairs, "named"), len(pairs))),
            (f"causes outside the library{at}: misnamed", share(_count(outside, "false name"), len(outside))),
            ("the same, localised", share(sum(map(localised, outside)), len(outside))),
        ]
    ratios = [r for r in map(against_told, lines) if r is not None]
    if ratios:
        rows.append(("noise-removed error after, over that of a fit that was told: median", f"{median(ratios):.2f}"))
    versions = Counter(line.get("code", "") for line in lines)
    rows.append(("runs by version of the code", ", ".join(f"{code} {n}" for code, n in sorted(versions.items()))))
    return markdown(("what", "runs (95 % interval)"), rows)


def against_told(line: dict) -> float | None:
    """Noise-removed error on validate flights over that of the fit that was told; None where either is missing."""
    told = line.get("told", {}).get("noise_removed", {}).get("validate")
    found = line["noise_removed"]["after"]["validate"]
    return found / told if told and found is not None else None


def _by_hidden(lines: Sequence[dict]) -> dict[str, list[dict]]:
    """Runs by what was hidden: nothing first, then effects by id."""
    table: dict[str, list[dict]] = {}
    for line in sorted(lines, key=lambda one: (len(one["hidden"]), one["hidden"])):
        table.setdefault(" + ".join(line["hidden"]) or "nothing", []).append(line)
    return table


def _confusion(lines: Sequence[dict]) -> str:
    """Counts by what was hidden and what was said, the false names by name."""
    rows = []
    for hidden, runs in _by_hidden(lines).items():
        counts = Counter(map(outcome, runs))
        false = Counter(e for line in runs for e in (*line["named"], *line["group"]) if e not in line["hidden"])
        names = ", ".join(f"{name} {count}" for name, count in false.most_common())
        kind = EFFECT_CLASSES.get(hidden, "")
        rows.append((hidden, kind, str(len(runs)), *(str(counts[o] or "") for o in OUTCOMES), names))
    return markdown(("hidden", "class", "runs", *OUTCOMES, "names that were not hidden"), rows)


def _before_after(lines: Sequence[dict]) -> str:
    """Medians of errors before and after, over a fit that was told, and of parameters over their true values."""

    def middle(runs: Sequence[dict], value: Callable[[dict], float | None], form: str = ".3f") -> str:
        known = [v for v in map(value, runs) if v is not None]
        return format(median(known), form) if known else ""

    rows = []
    for hidden, runs in _by_hidden(lines).items():
        errors = [
            middle(runs, lambda line, w=when, n=flights: line["noise_removed"][w][n])
            for flights in ("validate", "acid")
            for when in ("before", "after")
        ]
        told = middle(runs, against_told, ".2f")
        rows.append((hidden, str(len(runs)), *errors, told, _recovered(runs), middle(runs, _seconds, ".0f")))
    head = ("validate before", "after", "acid before", "after", "after / told")
    table = markdown(("hidden", "runs", *head, "found / true (in its standard errors off)", "s"), rows)
    return "Noise-removed errors, sqrt(J² - J_noise²), medians over the runs:\n\n" + table


def _seconds(line: dict) -> float | None:
    return line["seconds"]


def _recovered(runs: Sequence[dict]) -> str:
    """Of each parameter that has a true value: median ratio to it, and distance in standard errors."""
    told: dict[str, list[tuple[float, float]]] = {}
    for name, p in (item for line in runs for item in line["parameters"].items()):
        if p["true"] and p["se"]:
            told.setdefault(name, []).append((p["value"] / p["true"], abs(p["value"] - p["true"]) / p["se"]))
    return ", ".join(
        f"{name.split('.', 2)[2]} {median(r for r, _ in each):.2f} ({median(s for _, s in each):.1f})"
        for name, each in told.items()
    )


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
    before, rest = whole.split(begin, 1)
    after = rest.split(end, 1)[1]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")
