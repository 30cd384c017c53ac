"""Pictures of a closed loop: evidence of candidates over critical values; the error before and after by frequency."""

from collections.abc import Sequence
from functools import partial

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
    Drawing,
    drawings,
    grid_of,
    leave,
)
from rotorid_torch.report.overlay import LEAST, Overlay, mean_spectra, over_floor
from rotorid_torch.report.records import EffectRecord, Report

COLOURS = {"accepted": MODEL, "indistinguishable": LIST_COLOURS["acid"], "rejected": MEASURED}


def draw_run(report: Report, before: Sequence[Overlay], after: Sequence[Overlay]) -> dict[str, Figure]:
    """Every picture of a run that there is something to show in, by the name of its file."""
    return {name: drawing() for name, drawing in drawings_of_run(report, before, after).items()}


def drawings_of_run(report: Report, before: Sequence[Overlay], after: Sequence[Overlay]) -> dict[str, Drawing]:
    """The same, not drawn yet."""
    pictures: dict[str, Drawing] = {}
    if ranked := over_floor(report.effects):
        pictures["evidence"] = partial(evidence, ranked)
    pairs = [(b, a) for b in before for a in after if a.flight == b.flight and a.list != "identify"]
    pairs = [(b, a) for b, a in pairs if set(b.common(names.BODY)) & set(a.common(names.BODY))]
    if pairs:
        pictures["residual_spectrum"] = partial(spectra, pairs)
    return {**pictures, **drawings(after, report.fit)}


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
