"""Values with errors as people write them: milliseconds, degrees, per cent, as many digits as the error allows."""

import math
import re

from rotorid_torch.core import names
from rotorid_torch.report.records import EffectRecord, ParameterRecord
from rotorid_torch.report.words.effects import words_of

MOST = 3
"""Sizes of an effect that a sentence names: those that are surest."""
SURE = 2.0
"""Standard errors from zero from which on a size is named."""
READABLE = {
    "s": (1.0, 1e3, "ms"),
    "m": (0.1, 1e3, "mm"),
    "kg": (0.1, 1e3, "g"),
    "rad": (math.inf, 180.0 / math.pi, "°"),
    "1": (1.0, 100.0, "%"),
}
"""By unit: below which size it is written in another, the factor, and that unit."""
BARE = "1"
"""Unit of a number that is no share."""
_PLACE = re.compile(r"\{(.*?)\}")


def size(value: float, error: float | None, unit: str) -> str:
    """A value with its standard error and unit: "57 ± 6 ms"."""
    limit, factor, readable = READABLE.get(unit, (0.0, 1.0, unit))
    if abs(value) < limit:
        value, error, unit = value * factor, error and error * factor, readable
    return _written(value, error, unit)


def smallest_size(value: float, unit: str) -> str:
    """The smallest size of an effect that shows; of a limit, whose parameter is one over it, the greatest that does."""
    if unit in names.RECIPROCALS and value > 0.0:
        return f"≤ {size(*names.reciprocal(value, None, unit))}"
    if unit == "s²":  # variance of a window in time
        return size(math.sqrt(max(value, 0.0)), None, "s")
    if unit == BARE:
        return _written(100.0 * value, None, "%")
    return size(value, None, unit)


def plain(unit: str) -> str:
    """A unit as people write it: "m/s²" for "m/s2", nothing for "1"."""
    return "" if unit == BARE else re.sub("(?<=[a-z])[23]", lambda power: "²" if power[0] == "2" else "³", unit)


def _written(value: float, error: float | None, unit: str) -> str:
    unit = plain(unit)
    gap = "" if unit in ("°", "") else " "
    if not error or not math.isfinite(error):
        return f"{value:.0f}{gap}{unit}" if abs(value) >= 1000.0 else f"{value:.3g}{gap}{unit}"
    digits = max(0, -math.floor(math.log10(error)) if error < 10.0 else 0)
    return f"{value:.{digits}f} ± {error:.{digits}f}{gap}{unit}"


def sizes_of(effect: EffectRecord) -> str:
    """The sizes of an effect that are not zero, the surest first, in words; empty where none was fitted."""
    sure = [p for p in effect.parameters if p.value is not None and p.se and _sureness(p) > SURE]
    fitted = [p for p in sure if _words(effect.id, p)]
    surest = sorted(fitted, key=_sureness, reverse=True)[:MOST]
    return ", ".join(_size(effect.id, p) for p in fitted if p in surest)


def roughly(effect: EffectRecord) -> str:
    """The surest size of an effect whose sizes a sentence leaves out, marked where it is not sure; empty for none."""
    surest = max((p for p in effect.parameters if p.value and p.se), key=_sureness, default=None)
    if surest is None:
        return ""
    return f"{_size(effect.id, surest)}{'' if _sureness(surest) > SURE else ', not sure'}"


def sentence_of(effect: EffectRecord) -> str:
    """What an effect means to whoever flies the vehicle, with its sizes."""
    sizes, sentence = sizes_of(effect), words_of(effect.id).sentence
    return (
        sentence.replace("{}", sizes) if sizes else sentence.replace(": {}", "").replace(" {}", "").replace(",.", ".")
    )


def _sureness(p: ParameterRecord) -> float:
    return abs(p.value or 0.0) / (p.se or 1.0)


def _label(effect: str, p: ParameterRecord) -> str:
    return p.name.removeprefix(f"{effect}.")


def _words(effect: str, p: ParameterRecord) -> str:
    label = _label(effect, p)
    sizes = words_of(effect).sizes if label != p.name else {}  # else of a part of the nominal model that stands for it
    keys = (key for key in (label, label.rpartition(".")[2], "") if key in sizes)
    return sizes.get(next(keys, ""), "{name} {}").replace("{name}", label)


def _size(effect: str, p: ParameterRecord) -> str:
    return _PLACE.sub(lambda place: _filled(p, place[1]), _words(effect, p) or f"{_label(effect, p)} {{}}")


def _filled(p: ParameterRecord, unit: str) -> str:
    """The value of a parameter as its place in the words wants it."""
    value, error = p.value or 0.0, p.se
    if unit.startswith("1/"):
        value, error, per = names.reciprocal(value, error, p.unit)
        return size(value, error, unit.removeprefix("1/") or per)
    if "|" in unit:
        return f"{size(abs(value), error, p.unit)} {unit.split('|')[value < 0.0]}"
    if unit == "%":
        return _written(100.0 * value, error and 100.0 * error, unit)
    return _written(value, error, unit) if unit else size(value, error, p.unit)
