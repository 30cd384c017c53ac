"""Values with errors as people write them: milliseconds, degrees, per cent, as many digits as the error allows."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rotorid_torch.report.records import EffectRecord, ParameterRecord
from rotorid_torch.report.words.effects import words_of

MOST = 3
"""Sizes of an effect that a sentence names: those that are surest."""
SURE = 2.0
"""Standard errors from zero from which on a size is named."""
READABLE = {"s": ((1.0, 1e3, "ms"),), "rad": ((math.inf, 180.0 / math.pi, "°"),), "1": ((1.0, 100.0, "%"),)}
"""By unit: below which size it is written in another, the factor, and that unit."""
RECIPROCALS = {"s/rad": "rad/s", "s/m": "m/s"}
PLAIN_UNITS = {"m/s2": "m/s²", "rad/s2": "rad/s²", "1": ""}


def size(value: float, error: float | None, unit: str) -> str:
    """A value with its standard error and unit: "57 ± 6 ms"."""
    for limit, factor, readable in READABLE.get(unit, ()):
        if abs(value) < limit:
            value, error, unit = value * factor, None if error is None else error * factor, readable
    unit = PLAIN_UNITS.get(unit, unit)
    gap = "" if unit in ("°", "") else " "
    if not error or not math.isfinite(error):
        return f"{value:.3g}{gap}{unit}"
    digits = max(0, -math.floor(math.log10(error)) if error < 10.0 else 0)
    return f"{value:.{digits}f} ± {error:.{digits}f}{gap}{unit}"


def sizes_of(effect: EffectRecord) -> str:
    """The sizes of an effect that are not zero, the surest first, in words; empty where none was fitted."""
    fitted = [p for p in effect.parameters if p.value is not None and p.se and abs(p.value) > SURE * p.se]
    surest = sorted(fitted, key=_sureness, reverse=True)[:MOST]
    return ", ".join(_size(effect.id, p) for p in fitted if p in surest)


def roughly(effect: EffectRecord) -> str:
    """The surest size of an effect of which none is sure, marked so; empty where none was fitted."""
    fitted = [p for p in effect.parameters if p.value and p.se]
    return f"{_size(effect.id, max(fitted, key=_sureness))}, not sure" if fitted else ""


def sentence_of(effect: EffectRecord) -> str:
    """What an effect means to whoever flies the vehicle, with its sizes."""
    sizes, sentence = sizes_of(effect), words_of(effect.id).sentence
    return (
        sentence.replace("{}", sizes) if sizes else sentence.replace(": {}", "").replace(" {}", "").replace(",.", ".")
    )


def named(nouns: Sequence[str], last: str = "and") -> str:
    """Words with commas, the last one after `last`."""
    return nouns[0] if len(nouns) == 1 else f"{', '.join(nouns[:-1])} {last} {nouns[-1]}" if nouns else ""


def _sureness(p: ParameterRecord) -> float:
    return abs(p.value or 0.0) / (p.se or 1.0)


def _size(effect: str, p: ParameterRecord) -> str:
    label = p.name.removeprefix(f"{effect}.")
    words = words_of(effect).sizes.get(label.rpartition(".")[2]) or f"{label} {{}}"
    unit = "" if label.endswith("exponent") else p.unit  # no share, though it has no unit
    value, error = p.value or 0.0, p.se
    if value and words_of(effect).reciprocal:  # the error of 1/x is that of x over x^2
        value, error, unit = 1.0 / value, error and error / value**2, RECIPROCALS.get(unit, f"1/{unit}")
    return words.replace("{}", size(value, error, unit))
