"""Tables of a page: derivatives as textbooks print them, modes, parameters, evidence for and against each effect."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rotorid_torch.core.names import FORCES, MOMENTS, RECIPROCALS, reciprocal
from rotorid_torch.printable import significant
from rotorid_torch.report.page.facts import ModelFacts
from rotorid_torch.report.page.pictures import SIGNS
from rotorid_torch.report.records import EffectRecord, FitRecord, ModeRecord, ParameterRecord
from rotorid_torch.report.summary import shortened
from rotorid_torch.report.words.sizes import roughly, size, sizes_of, smallest_size

STATES = {
    "wa1": "inflow, fore and aft",
    "wb1": "inflow, side to side",
    "vi": "inflow",
    "rotor.lead_lag.x": "lead-lag, regressing",
    "rotor.lead_lag.y": "lead-lag, regressing",
    "rotor.lead_lag.x_rate": "lead-lag, advancing",
    "rotor.lead_lag.y_rate": "lead-lag, advancing",
    "rotor.lead_lag.z": "lead-lag, collective",
    "rotor.lead_lag.z_rate": "lead-lag, collective",
    "rotor.flap_second_order.a1_rate": "flapping, advancing",
    "rotor.flap_second_order.b1_rate": "flapping, advancing",
    "rotor.flap_second_order.a0_rate": "coning",
}
"""What a mode is called whose largest share is in a state of this name."""


@dataclass(frozen=True)
class Cell:
    """A derivative: its value and error as text, and whether it could as well be zero."""

    value: str
    error: str
    vague: bool


@dataclass(frozen=True)
class ModeRow:
    """A mode as people read it: times in s, frequency in Hz; empty where there is none."""

    name: str
    eigenvalue: str
    frequency: str
    damping: str
    halves: str
    doubles: str


@dataclass(frozen=True)
class EvidenceRow:
    """An effect with what speaks for it and what against it."""

    effect: EffectRecord
    sign: str
    size: str
    speaks_for: str
    against: str


@dataclass(frozen=True)
class Derivatives:
    """Rows by what they are derivatives of, columns X Y Z L M N."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell | None, ...]], ...]


def derivatives(fit: FitRecord) -> Derivatives | None:
    """Derivatives of forces and moments with the rotor settled; None for a model that has none."""
    values = {p.name: p for p in fit.derivatives}
    columns = tuple(c for c in (*FORCES, *MOMENTS) if any(name.startswith(f"{c}.") for name in values))
    inputs = dict.fromkeys(name.partition(".")[2] for name in values)
    rows = tuple((name, tuple(_cell(values.get(f"{column}.{name}")) for column in columns)) for name in inputs)
    return Derivatives(columns, rows) if rows else None


def mode_rows(modes: Sequence[ModeRecord]) -> Iterator[ModeRow]:
    """Modes, slowest first; where two have one name they are numbered."""
    labels = [STATES.get(mode.name, mode.name) for mode in modes]
    number, repeated = Counter[str](), Counter(labels)
    for mode, label in zip(modes, labels, strict=True):
        number[label] += 1
        name = f"{label} {number[label]}" if repeated[label] > 1 else label
        real, imaginary = mode.eigenvalue
        if real is None or imaginary is None:
            yield ModeRow(name, "–", "", "", "", "")
            continue
        pair = f" ± {abs(imaginary):.3g} i" if imaginary else ""
        length, time = math.hypot(real, imaginary), f"{math.log(2) / abs(real):.2g}" if real else ""
        frequency = f"{length / (2.0 * math.pi):.2g}" if imaginary else ""
        damping = f"{-real / length:.2f}" if imaginary else ""
        yield ModeRow(name, f"{real:.3g}{pair}", frequency, damping, *((time, "") if real < 0.0 else ("", time)))


def evidence_rows(effects: Sequence[EffectRecord]) -> list[EvidenceRow]:
    """Effects that were tested: what evidence names, then parts of the nominal model, then by evidence over floor."""
    tested = [e for e in effects if e.verdict != "not testable"]
    order = list(SIGNS)
    named = lambda e: e.shown in ("accepted", "indistinguishable") and e.ratio > 1.0  # noqa: E731
    ranked = sorted(tested, key=lambda e: (not named(e), order.index(e.shown), -e.ratio))
    sized = {e.id: "" if e.verdict == "rejected" else sizes_of(e) or roughly(e) for e in ranked}
    return [EvidenceRow(e, SIGNS[e.shown], sized[e.id], *_for_and_against(e)) for e in ranked]


def meaning_of(parameter: ParameterRecord, facts: ModelFacts) -> str:
    """What a parameter is, in words."""
    meaning = facts.meanings.get(parameter.name)
    if meaning and parameter.value and parameter.unit in RECIPROCALS:
        return f"{meaning}: {size(*reciprocal(parameter.value, None, parameter.unit))}"
    if meaning:
        return meaning
    parts = parameter.name.split(".")
    return f"{parts[-2]} by {parts[-1]}" if len(parts) > 2 and parts[0] in ("forces", "rotor") else ""


def _cell(p: ParameterRecord | None) -> Cell | None:
    if p is None or p.value is None:
        return None
    return Cell(f"{p.value:.3g}", f"± {significant(p.se)}" if p.se else "", bool(p.se and p.se > abs(p.value)))


def _for_and_against(effect: EffectRecord) -> tuple[str, str]:
    """The numbers on the side that they speak for, and the reason on the verdict's."""
    speaks_for, against = [], []
    if effect.gain is not None and effect.floor:
        where = speaks_for if effect.ratio > 1.0 else against
        where.append(f"evidence {significant(effect.ratio, 2)} × the floor" if effect.ratio > 0.0 else "no evidence")
    if effect.p is not None:
        (speaks_for if effect.p <= 0.05 else against).append(f"p {effect.p:.2g}")
    if effect.group and effect.group[0] not in effect.reason:
        against.append(f"may be told as {', '.join(effect.group[:3])}{' and more' if len(effect.group) > 3 else ''}")
    (speaks_for if effect.verdict in ("accepted", "suspected") else against).append(shortened(effect.reason))
    return "; ".join(speaks_for), "; ".join(against)


def visible(effect: EffectRecord) -> str:
    """The smallest size that these flights would show."""
    smallest = effect.smallest_visible
    return "–" if smallest is None or smallest.value is None else smallest_size(smallest.value, smallest.unit)
