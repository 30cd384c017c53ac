"""Pictures of a closed loop: evidence of candidates over critical values; the error before and after by frequency."""

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rotorid_torch.core import names
from rotorid_torch.report.figures import LETTER, LIST_COLOURS, MEASURED, MODEL, QUIET, WIDTH, Overlay, grid_of, leave
from rotorid_torch.report.records import EffectRecord

COLOURS = {"accepted": MODEL, "indistinguishable": LIST_COLOURS["acid"], "rejected": MEASURED}
LEAST, MOST = 1e-2, 1e4
"""Ratios of statistics and critical values beyond these are drawn there."""


def draw_loop(
    effects: Sequence[EffectRecord], before: Sequence[Overlay], after: Sequence[Overlay]
) -> dict[str, Figure]:
    """Every picture of the loop that there is something to show in, by the name of its file."""
    pictures: dict[str, Figure] = {}
    if ranked := over_floor(effects):
        pictures["evidence"] = evidence(ranked)
    pairs = [(b, a) for b in before for a in after if a.flight == b.flight and a.list != "identify"]
    pairs = [(b, a) for b, a in pairs if set(b.common(names.BODY)) & set(a.common(names.BODY))]
    if pairs:
        pictures["residual_spectrum"] = spectra(pairs)
    return pictures


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
    rows = [n for n in names.BODY if any(b.common([n]) and a.common([n]) for b, a in pairs)]
    figure, grid = grid_of(rows, 1, WIDTH, height=1.1)
    for axes, name in zip((row[0] for row in grid), rows, strict=True):
        for which, colour, label in ((0, QUIET, "before"), (1, MODEL, "after")):
            spectra_of = [spectrum(pair[which], name) for pair in pairs if pair[which].common([name])]
            length = min(len(power) for _, power in spectra_of)
            mean = np.sqrt(np.mean([power[:length] for _, power in spectra_of], axis=0))
            axes.loglog(spectra_of[0][0][1:length], mean[1:], color=colour, linewidth=1.2, label=label)
        axes.minorticks_off()  # hundreds, which took as long as all else
    grid[0][0].set_title("measured - model: before (grey), after (blue)", loc="left", fontsize=10, y=1.0)
    grid[-1][0].set_xlabel("frequency, Hz")
    return figure


def spectrum(overlay: Overlay, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz, and power of the error per line."""
    error = (overlay.measured[name] - overlay.model[name]).nan_to_num(0.0).numpy()
    window = np.hanning(len(error) + 1)[:-1]
    step = float(overlay.time[1] - overlay.time[0])
    power = np.abs(np.fft.rfft(error * window)) ** 2 * 2.0 / (window.sum() ** 2)
    return np.fft.rfftfreq(len(error), step), power
