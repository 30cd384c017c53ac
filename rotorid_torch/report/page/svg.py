"""Pictures as SVG inside the page: sharp in print, in the reader's colours, and with words for who cannot see them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

WIDTH, LEFT, RIGHT, LETTER = 480, 58, 8, 13
"""Of a picture: width, margins and height of letters, in its own units; a phone shows 3/4 of them."""
GAP, BELOW = 22, 36
MOST_POINTS = 400
"""Of a line; there are no more columns to draw them in."""
TICKS = (1.0, 2.0, 2.5, 5.0, 10.0)
DIGITS = ((1.0, 3.0), (1.0, 2.0, 5.0), range(1, 10))
"""First digits of the numbers on a logarithmic axis that has no two decades: the first of these that show two."""


@dataclass(frozen=True)
class Line:
    """A line of a panel: `kind` is its look (measured, before, after, control, zero), `x` and `y` its points (T,)."""

    kind: str
    x: np.ndarray
    y: np.ndarray


@dataclass(frozen=True)
class Panel:
    """Lines over one axis. log : both axes logarithmic."""

    label: str
    lines: Sequence[Line]
    height: int = 96
    log: bool = False


@dataclass(frozen=True)
class Bar:
    """One row of a chart: a name, its length, a look (the class of its colour), and a word at its end."""

    name: str
    value: float
    kind: str
    word: str


def stacked(panels: Sequence[Panel], x_label: str, alt: str, keys: Sequence[tuple[str, str]]) -> Markup:
    """Panels above each other on one x axis; `keys` are looks and their words, `alt` says what is to be seen."""
    log = panels[0].log
    low, high = _extent([line.x for panel in panels for line in panel.lines], log)
    top, parts = 20.0, [_keys(keys)]
    for panel in panels:
        parts.append(_panel(panel, top, (low, high)))
        top += panel.height + GAP
    bottom = top - GAP
    to_x = _scale(low, high, LEFT, WIDTH - RIGHT, log)
    parts += [_text(to_x(v), bottom + 15, f"{v:g}", "middle") for v in ticks(low, high, 6, log)]
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, bottom + 31, x_label, "middle"))
    return _picture(bottom + BELOW, "".join(parts), alt)


def chart(bars: Sequence[Bar], x_label: str, alt: str) -> Markup:
    """Bars on a logarithmic axis, a line at one, the value that decides."""
    left, row = 190, 21
    values = [bar.value for bar in bars if bar.value > 0.0] or [1.0]
    low, high = 0.5 * min(*values, 1.0), 2.0 * max(*values, 1.0)
    to_x = _scale(low, high, left, WIDTH - 34, True)
    bottom, parts = 4 + row * len(bars), []
    for k, bar in enumerate(bars):
        y, end = 4 + row * k, to_x(max(bar.value, low))
        width = f"{max(end - left, 1.0):.1f}"
        parts.append(_text(left - 6, y + 14, bar.name, "end"))
        parts.append(f'<rect class="{bar.kind}" x="{left}" y="{y + 3}" width="{width}" height="13"/>')
        parts.append(_text(end + 4, y + 14, bar.word, "start"))
    x = to_x(1.0)
    parts.append(f'<path class="limit" d="M{x:.1f} 0V{bottom + 4}"/>')
    parts += [_text(to_x(v), bottom + 18, f"{v:g}", "middle") for v in ticks(low, high, 6, True)]
    parts.append(_text((left + WIDTH) / 2, bottom + 34, x_label, "middle"))
    return _picture(bottom + 40, "".join(parts), alt)


def _picture(height: float, inside: str, alt: str) -> Markup:
    head = f'<svg class="picture" viewBox="0 0 {WIDTH} {height:.0f}" role="img" aria-label="{escape(alt)}">'
    return Markup(f"{head}<title>{escape(alt)}</title>{inside}</svg>")


def _panel(panel: Panel, top: float, span: tuple[float, float]) -> str:
    low, high = _extent([line.y for line in panel.lines], panel.log)
    margin = 0.0 if panel.log else 0.06 * (high - low)
    low, high = low - margin, high + margin
    to_x = _scale(*span, LEFT, WIDTH - RIGHT, panel.log)
    to_y = _scale(low, high, top + panel.height, top, panel.log)
    frame = f'<rect class="frame" x="{LEFT}" y="{top:.0f}" width="{WIDTH - LEFT - RIGHT}" height="{panel.height}"/>'
    parts = [frame, _text(LEFT, top - 5, panel.label, "start")]
    for tick in ticks(low, high, 3, panel.log):
        y = to_y(tick)
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}"/>')
        parts.append(_text(LEFT - 5, y + 4, f"{tick:.3g}", "end"))
    if not panel.log and low < 0.0 < high:
        parts.append(f'<path class="zero" d="M{LEFT} {to_y(0.0):.1f}H{WIDTH - RIGHT}"/>')
    parts += [f'<path class="line {line.kind}" d="{_path(line, to_x, to_y)}"/>' for line in panel.lines]
    return "".join(parts)


def _path(line: Line, to_x, to_y) -> str:
    step = max(1, math.ceil(len(line.x) / MOST_POINTS))
    points, pen = [], "M"
    for x, y in zip(line.x[::step].tolist(), line.y[::step].tolist(), strict=True):
        if math.isfinite(y):
            points.append(f"{pen}{to_x(x):.1f} {to_y(y):.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(points)


def _scale(low: float, high: float, first: float, last: float, log: bool):
    """From values to places between `first` and `last`."""
    if log:
        a, b = math.log10(low), math.log10(max(high, low * 1.01))
        return lambda v: first + (last - first) * (math.log10(max(v, low)) - a) / (b - a)
    return lambda v: first + (last - first) * (v - low) / ((high - low) or 1.0)


def _extent(arrays: Sequence[np.ndarray], log: bool) -> tuple[float, float]:
    values = np.concatenate([a[np.isfinite(a) & (a > 0.0)] if log else a[np.isfinite(a)] for a in arrays])
    if not len(values):
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    return (low, high) if high > low else (low - 0.5, high + 0.5) if not log else (0.5 * low, 2.0 * low)


def ticks(low: float, high: float, wanted: int, log: bool) -> list[float]:
    """Round numbers from low to high, about as many as are wanted and two at least; `log` on a logarithmic axis."""
    if log:
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        every = max(1, math.ceil(len(decades) / wanted))
        choices = [*(((1.0,), k) for k in range(every, 0, -1)), *((steps, 1) for steps in DIGITS)]
        for steps, k in choices[every * (len(decades) < 4) :]:
            marks = [s * 10.0**d for d in decades if d % k == 0 for s in steps if low <= s * 10.0**d <= high]
            if len(marks) > 1:
                return marks
        return [low, high]
    raw = (high - low) / wanted
    power = 10.0 ** math.floor(math.log10(raw))
    for size in (t for t in (*TICKS[::-1], 0.5) if t * power <= 2.0 * raw):
        step = size * power
        ticks = [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
        if len(ticks) >= min(wanted, 2):
            return ticks
    return [low, high]


def _keys(keys: Sequence[tuple[str, str]]) -> str:
    """Samples of the lines with their words, right above the first panel."""
    x, parts = float(WIDTH - RIGHT), []
    for kind, word in reversed(keys):
        x -= 0.55 * LETTER * len(word)
        parts.append(_text(x, 12, word, "start"))
        parts.append(f'<path class="line {kind}" d="M{x - 26:.0f} 8H{x - 5:.0f}"/>')
        x -= 38
    return "".join(parts)


def _text(x: float, y: float, words: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'
