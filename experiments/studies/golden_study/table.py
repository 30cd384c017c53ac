"""Rates of the golden study with Wilson intervals, one column for each half and version of the package."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from statistics import median

from hidden.outside_causes import CAUSES
from recorded.tables import markdown, number, share

from golden_study.cases import ABSORBED, SIZES, Kind

Column = tuple[str, str]
UNNAMED = "unattributed"
"""Ids of pseudo-effects begin so: a group with one of them is a verdict without a name."""
ONSET_S = 0.5
"""A right onset is this near the true one."""


def outcome(line: dict) -> str:
    """What a verdict is worth, all that it names taken together: one of `recorded.tables.OUTCOMES`."""
    removed = line["kind"] == Kind.REMOVED
    hidden, also = set(() if removed else line["hidden"]), set(line["also"])
    named, group = set(line["named"]), set(line["group"])
    nameless = any(member.startswith(UNNAMED) for member in group)
    if named - hidden - also or (group and not nameless and not group & (hidden | also)):
        return "false name"
    if group:
        return "in a group"
    right = hidden & (named | set(line["structure"]))
    if right:
        return "named" if right == hidden else "in part"
    return "no name" if line["verdict"] == "unknown" else "silent"


def alarm(line: dict) -> bool:
    """Whether anything undeclared is named or suspected."""
    return line["verdict"] not in ("nothing undeclared", "structure") or bool(line["suspected"])


def localised(line: dict) -> bool:
    """Whether a cause outside the library was localised: right equation, right signal, onset in time."""
    unknown, cause = line["unknown"], CAUSES[line["hidden"][0]]
    if unknown is None:
        return False
    factors = set((unknown["goes_with"] or "nothing").split())
    if unknown["where"] not in cause.where(line["aircraft"]) or factors != {*cause.goes_with(line["aircraft"])}:
        return False
    since = unknown["since_s"]
    return cause.since_s is None or (since is not None and abs(since - cause.since_s) <= ONSET_S)


def golden_table(lines: Sequence[dict]) -> str:
    """The study as Markdown: rates; outcomes by what was hidden; sets of other people."""
    whole = [line for line in lines if "failed" not in line]
    columns = list(dict.fromkeys((line["half"], line["code"]) for line in lines))
    parts = [_rates(lines, columns)]
    answered = [line for line in whole if line["hidden"] is not None]
    parts += [f"**{half}, {code}**\n\n{_confusion(_of(answered, (half, code)))}" for half, code in columns]
    sets = [line for line in lines if line["dataset"]]
    return "\n\n".join([*parts, _sets(sets)] if sets else parts)


def _of(lines: Iterable[dict], column: Column) -> list[dict]:
    return [line for line in lines if (line["half"], line["code"]) == column]


def _rates(lines: Sequence[dict], columns: Sequence[Column]) -> str:
    """A row for each question."""
    cells = [_column(_of(lines, column)) for column in columns]
    names = {line["code"]: line["git"] for line in lines}
    head = ("what", *(f"{half}, {names[code]} ({code})" for half, code in columns))
    return markdown(head, [(what, *(cell[what] for cell in cells)) for what in (cells[0] if cells else ())])


def _column(lines: Sequence[dict]) -> dict[str, str]:
    """Answers to all questions, from the lines of one half and version."""
    whole = [line for line in lines if "failed" not in line]
    answered = [line for line in whole if line["hidden"] is not None and line["kind"] != Kind.QUICK]

    def rate(these: Iterable[dict], hit: Callable[[dict], bool]) -> str:
        runs = list(these)
        return share(sum(map(hit, runs)), len(runs))

    def of(kind: Kind) -> list[dict]:
        return [line for line in answered if line["kind"] == kind]

    def of_class(absorbed: bool, *sizes: float) -> list[dict]:
        return [e for e in of(Kind.EFFECT) if (e["hidden"][0] in ABSORBED) is absorbed and e["size"] in sizes]

    def named(line: dict) -> bool:
        return outcome(line) == "named"

    def wrong(line: dict) -> bool:
        return outcome(line) == "false name"

    outside = [line for line in answered if line["hidden"] and line["hidden"][0] in CAUSES]
    records = [line for line in of(Kind.RECORDS) if line not in outside]
    clean = [line for line in answered if not line["hidden"]]
    rows = {"nothing hidden: something is named or suspected": rate(clean, alarm)}
    for size in SIZES:
        rows[f"identifiable, size {size:g}: named, nothing false beside"] = rate(of_class(False, size), named)
    rows["pairs: both named"] = rate(of(Kind.PAIR), named)
    rows["in gusts: all named"] = rate(of(Kind.GUSTS), named)
    rows["in gusts: misnamed"] = rate(of(Kind.GUSTS), wrong)
    rows["records of others, a cause put into them: named"] = rate(records, named)
    rows["absorbed: misnamed"] = rate(of_class(True, *SIZES), wrong)
    rows["outside causes: misnamed"] = rate(outside, wrong)
    rows["outside causes: localised"] = rate(outside, localised)
    rows["entry taken out of the library: misnamed"] = rate(of(Kind.REMOVED), wrong)
    rows["all wrong names"] = rate(answered, wrong)
    held = [s["holds"] for line in whole for s in line["sizes"].values() if s["holds"] is not None]
    rows["95 % intervals of named sizes that hold the truth"] = share(sum(held), len(held))
    for text, cold in (("clean aircraft to be flown", True), ("clean aircraft kept", False)):
        rows[f"seconds of a case (of its processors), {text}: median"] = _times([e for e in whole if e["cold"] == cold])
    rows["ended with an error"] = str(len(lines) - len(whole))
    return rows


def _times(lines: Sequence[dict]) -> str:
    if not lines:
        return "no runs"
    return f"{median(e['seconds'] for e in lines):.0f} ({median(e['cpu_s'] for e in lines):.0f}), {len(lines)} runs"


def _confusion(lines: Sequence[dict]) -> str:
    """Outcomes by kind, what was hidden, and size; the wrong names by name."""
    table: dict[tuple[str, str, float], list[dict]] = {}
    for line in sorted(lines, key=lambda e: (e["kind"], e["hidden"], -e["size"])):
        table.setdefault((line["kind"], " + ".join(line["hidden"]) or "nothing", line["size"]), []).append(line)
    rows = []
    for (kind, hidden, size), runs in table.items():
        counts = Counter(map(outcome, runs))
        names = Counter(e for line in runs if outcome(line) == "false name" for e in (*line["named"], *line["group"]))
        said = ", ".join(f"{count} {text}" for text, count in counts.most_common())
        false = ", ".join(f"{name} {count}" for name, count in names.items())
        rows.append((kind, hidden, f"{size:g}", said, false, _times(runs)))
    return markdown(("kind", "hidden", "size", "outcomes", "names where one is false", "s (of processors)"), rows)


def _sets(lines: Sequence[dict]) -> str:
    """Each set of other people, one row for each version."""
    rows = []
    for line in sorted(lines, key=lambda e: (e["kind"] != Kind.SHARED, e["dataset"], e["kind"], e["hidden"] or ())):
        hidden = "not stated" if line["hidden"] is None else ", ".join(line["hidden"]) or "nothing"
        head = (line["kind"], line["dataset"], hidden, line["code"])
        if "failed" in line:
            rows.append((*head, line["failed"], "", "", f"{line['seconds']:.0f}"))
            continue
        scores = (" → ".join(number(line["J"][when][n]) for when in ("before", "after")) for n in ("validate", "acid"))
        rows.append((*head, line["sentence"], *scores, f"{line['seconds']:.0f}"))
    return markdown(("kind", "set", "hides", "version", "what the loop says", "J validate", "J acid", "s"), rows)
