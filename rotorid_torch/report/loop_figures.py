"""Pictures of a closed loop: evidence of candidates over critical values; the error before and after by frequency."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rotorid_torch.core import names
from rotorid_torch.report.figures import (
    LETTER,
    LIST_COLOURS,
    MEASURED,
    MODEL,
    QUIET,
    WIDTH,
    Overlay,
    draw,
    grid_of,
    leave,
)
from rotorid_torch.report.records import EffectRecord, Report

COLOURS = {"accepted": MODEL, "indistinguishable": LIST_COLOURS["acid"], "rejected": MEASURED}
LEAST, MOST = 1e-2, 1e4
"""Ratios of statistics and critical values beyond these are drawn there."""


def draw_run(report: Report, before: Sequence[Overlay], after: Sequence[Overlay]) -> dict[str, Figure]:
    """Every picture of a run that there is something to show in, by the name of its file."""
    pictures: dict[str, Figure] = {}
    if ranked := over_floor(report.effects):
        pictures["evidence"] = evidence(ranked)
    pairs = [(b, a) for b in before for a in after if a.flight == b.flight and a.list != "identify"]
    pairs = [(b, a) for b, a in pairs if set(b.common(names.BODY)) & set(a.common(names.BODY))]
    if pairs:
        pictures["residual_spectrum"] = spectra(pairs)
    return {**pictures, **draw(after, report.fit)}


def over_floor(effects: Sequence[EffectRecord]) -> list[tuple[EffectRecord, float]]:
    """Candidates that were tested, with statistic over critical value, largest first."""
    tested = [e for e in effects if e.gain is not None and e.floor and e.verdict != "not testable"]
    ranked = [(e, min(max(e.ratio, LEAST), MOST)) for e in tested]
    return sorted(ranked, key=lambda pair: -pair[1])


def evidence(ranked: Sequence[tuple[EffectRecord, float]]) -> Figure:
    """Statistic of each candidate over its critical value; right of the line p is below 0.05."""
    figure = Figure(figsize=(WIDTH, 0.9 + 0.24 * len(ranked)))
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    leave(figure, left=min(0.2 + LETTER * max(len(e.id) for e, _ in ranked), 0.6 * WIDTH), below=0.6, above=0.15)
    for row, (effect, ratio) in enumerate(ranked):
        colour = COLOURS.get(effect.shown, QUIET)
        axes.plot([LEAST, ratio], [row, row], color=colour, linewidth=5, solid_capstyle="butt")
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xlim(LEAST, 2.0 * max(ranked[0][1], 1.0))
    axes.set_yticks(range(len(ranked)), [e.id for e, _ in ranked], fontsize=9)
    axes.set_ylim(len(ranked) - 0.4, -0.6)
    axes.set_xlabel("statistic over critical value", fontsize=9)
    axes.grid(axis="x", alpha=0.3)
    return figure


def spectra(pairs: Sequence[tuple[Overlay, Overlay]]) -> Figure:
    """Amplitude spectrum of measured minus model before (grey) and after (blue), mean over flights not fitted."""
    before, after = (mean_spectra([pair[which] for pair in pairs]) for which in (0, 1))
    rows = [name for name in names.BODY if name in before and name in after]
    figure, grid = grid_of(rows, 1, WIDTH, height=1.1)
    for axes, name in zip((row[0] for row in grid), rows, strict=True):
        axes.loglog(*before[name], color=QUIET, linewidth=1.2)
        axes.loglog(*after[name], color=MODEL, linewidth=1.2)
        axes.minorticks_off()  # hundreds, which took as long as all else
    grid[0][0].set_title("measured - model: before (grey), after (blue)", loc="left", fontsize=10, y=1.0)
    grid[-1][0].set_xlabel("frequency, Hz")
    return figure


def mean_spectra(overlays: Sequence[Overlay]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Frequencies in Hz and amplitudes of what is left over, by channel; a mean over flights not used to fit."""
    channels = dict.fromkeys(c for _, c in unseen_channels(overlays))
    chosen = [c for c in names.BODY if c in channels] or list(channels)[:6]
    means = {channel: _mean_spectrum(overlays, channel) for channel in chosen}
    return {channel: mean for channel, mean in means.items() if mean is not None}


def _mean_spectrum(overlays: Sequence[Overlay], channel: str) -> tuple[np.ndarray, np.ndarray] | None:
    each = [spectrum(o, channel) for o, c in unseen_channels(overlays) if c == channel]
    if not each:
        return None
    length = min(len(power) for _, power in each)
    mean = np.sqrt(np.mean([power[:length] for _, power in each], axis=0))
    hertz = each[0][0][:length]
    edges = np.unique(np.geomspace(1, max(length, 2), 120).astype(int))
    groups = [slice(a, b) for a, b in pairwise(edges)]
    return np.array([hertz[g].mean() for g in groups]), np.array([mean[g].mean() for g in groups])


def spectrum(overlay: Overlay, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz, and power of the error per line."""
    error = (overlay.measured[name] - overlay.model[name]).nan_to_num(0.0).numpy()
    window = np.hanning(len(error) + 1)[:-1]
    step = float(overlay.time[1] - overlay.time[0])
    power = np.abs(np.fft.rfft(error * window)) ** 2 * 2.0 / (window.sum() ** 2)
    return np.fft.rfftfreq(len(error), step), power


def unseen_channels(overlays: Sequence[Overlay]) -> Iterator[tuple[Overlay, str]]:
    """Flights that no fit has seen with their channels."""
    return scored_channels(overlay for overlay in overlays if overlay.list != "identify")


def scored_channels(overlays: Iterable[Overlay]) -> Iterator[tuple[Overlay, str]]:
    """Flights with their channels: those that are scored, or accelerations."""
    for overlay in overlays:
        for channel in overlay.common(names.BODY if overlay.integrated else tuple(overlay.measured)):
            yield overlay, channel
