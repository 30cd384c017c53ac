"""The one statement of a run about undeclared effects, from all findings: pure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rotorid_torch.core.names import RECIPROCALS, Kind, reciprocal
from rotorid_torch.printable import significant
from rotorid_torch.trace.terms.finding import LISTED, EffectFinding, Unknown

NAMELESS = "Something is missing from it that no effect which was tested explains"
"""In place of "nothing undeclared" where the model fails."""


@dataclass(frozen=True)
class Statement:
    """Kind, the effects it names, one sentence of plain words."""

    kind: Kind
    effects: tuple[str, ...]
    sentence: str


def statement(findings: Sequence[EffectFinding], unknown: Unknown | None, failing: str = "") -> Statement:
    """What the findings come to.

    An effect is named where it is accepted; a group where only its members fit and the data cannot tell which.
    failing : how badly the model does, where it does: said first, and nothing found is no clean bill then.
    """
    said = _stated(findings, unknown, bool(failing))
    network = any(f.role == "learnt" and f.verdict == "accepted" for f in findings)
    parts = [
        f"{failing[:1].upper()}{failing[1:]}." if failing else "",
        said.sentence,
        "A network takes what is left; it is no name for it." if network else "",
    ]
    return replace(said, sentence=" ".join(part for part in parts if part))


def _stated(findings: Sequence[EffectFinding], unknown: Unknown | None, failing: bool) -> Statement:
    """The same without the model's failure and without a network, which is no undeclared effect.

    Of what is indistinguishable only what joined the model accuses, and has values: `Reason.GROUP`.
    """
    named = [f for f in findings if f.role == "undeclared" and f.verdict == "accepted"]
    grouped = [f for f in findings if f.role == "undeclared" and f.verdict == "indistinguishable" and f.values]
    structure = [f for f in findings if f.role == "structure" and f.verdict == "accepted" and not f.part]
    more = f" {unknown.sentence.replace('Something is', 'Something more is')}" if unknown else ""
    members = tuple(dict.fromkeys(n for f in grouped for n in (f.id, *f.group)))
    if grouped:
        either = " or ".join(members)
        sure = f"; {_listed(named)} besides" if named else ""
        said = f"Something undeclared acts on this vehicle, {either}: these flights cannot tell which{sure}.{more}"
        return Statement("group", (*(f.id for f in named), *members), said)
    if named:
        return Statement("undeclared", tuple(f.id for f in named), f"Undeclared: {_listed(named)}.{more}")
    suspected = [f for f in findings if f.role == "undeclared" and f.verdict == "suspected"]
    if unknown or suspected:
        missing = unknown.sentence if unknown else "Something is missing that these flights do not name."
        part = f" Suspected, for it explains a part: {_listed(suspected)}." if suspected else ""
        return Statement("unknown", (), missing + part)
    nothing = NAMELESS if failing else "Nothing undeclared was found"
    if structure:
        said = f"{nothing}; ordinary physics joins the model: {_listed(structure)}."
        return Statement("structure", tuple(f.id for f in structure), said)
    visible = [f for f in findings if f.smallest_visible is not None]
    tested = f" ({len(visible)} effects were tested; the table tells how small each could have been seen)"
    return Statement("nothing undeclared", (), f"{nothing}{tested if visible else ''}.")


def _listed(findings: Sequence[EffectFinding]) -> str:
    return " and ".join(f"{f.id}{_sizes(f)}" for f in findings)


def _sizes(finding: EffectFinding) -> str:
    """The surest parameters with their errors, where they were fitted."""
    sizes = [(n, v, e) for n, (v, e) in finding.values.items() if e > 0.0 and abs(v) > 2.0 * e]
    sizes = sorted(sizes, key=lambda one: abs(one[1]) / one[2], reverse=True) if len(sizes) > LISTED else sizes
    if not sizes:
        return ""
    return f" ({', '.join(_size(finding, *one) for one in sizes[:LISTED])})"


def _size(finding: EffectFinding, name: str, value: float, error: float | None) -> str:
    """A parameter with its error and unit; one over it where that is what people measure, a rate limit."""
    said, unit = name.removeprefix(finding.id + "."), finding.units.get(name, "")
    if unit in RECIPROCALS:
        said, (value, error, unit) = f"1/{said}", reciprocal(value, error, unit)
    return f"{said} {value:.3g} ± {significant(error or 0.0)}{'' if unit in ('', '1') else f' {unit}'}"
