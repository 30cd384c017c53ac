"""Pictures of a run: the paper's figures 5, 7, 8 and 9 for these flights, the error over time, and the scores.

Drawn with matplotlib's object interface, so that no display, no global state and no backend setting is touched.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from matplotlib.transforms import blended_transform_factory
from torch import Tensor

from rotorid_torch.core import names
from rotorid_torch.core.statistics import autocorrelation
from rotorid_torch.report.overlay import Overlay
from rotorid_torch.report.records import FitRecord
from rotorid_torch.report.summary import shown_flights

MEASURED, MODEL, QUIET = "#c0392b", "#1f4e9c", "#b8bcc4"
LIST_COLOURS = {"identify": "#7f8c8d", "validate": "#1f4e9c", "acid": "#8e2f8f"}
ROTOR = (*names.FLAPPING, "omega")
ANGULAR_ACCELERATIONS = tuple(f"{rate}dot" for rate in names.RATES)
SHOWN_FLIGHTS = 4
WIDTH = 4.8  # inches: on a phone the letters stay readable
LETTER = 0.075  # inches, of size 9
LAGS = 50


def shown(picture: Path) -> Figure:
    """A picture of a file as a figure of its size."""
    pixels = imread(picture)
    figure = Figure(figsize=(pixels.shape[1] / 100, pixels.shape[0] / 100), dpi=100)
    FigureCanvasAgg(figure)
    figure.figimage(pixels)
    return figure


Drawing = Callable[[], Figure]
"""A picture that is not drawn yet."""


def drawings(overlays: Sequence[Overlay], fit: FitRecord | None) -> dict[str, Drawing]:
    """Every picture that these free runs and scores allow, by the name of its file."""
    pictures: dict[str, Drawing] = {}
    if fit is not None and fit.flights and not any(flight.responses for flight in fit.flights.values()):
        pictures["scores"] = partial(scores, fit)
    judged = [overlay for overlay in overlays if overlay.list == "validate"]
    acid = [overlay for overlay in overlays if overlay.list == "acid"] or judged
    flapping = [overlay for overlay in judged if overlay.common(names.FLAPPING)]
    if flapping:
        pictures["figure5_flapping"] = partial(side_by_side, flapping[:SHOWN_FLIGHTS], names.FLAPPING)
    for overlay in acid[:SHOWN_FLIGHTS]:
        pictures.update(_of_one_flight(overlay))
    unseen = [overlay for overlay in overlays if overlay.list != "identify" and overlay.common(names.BODY)]
    if unseen:
        pictures["residual"] = partial(residuals, unseen)
    return pictures


def _of_one_flight(overlay: Overlay) -> Iterator[tuple[str, Drawing]]:
    groups = {
        "figure7_velocities": names.VELOCITIES,
        "figure8_rates": names.RATES,
        "figure9_rotor": ROTOR,
        "attitude": names.ATTITUDES,
        "accelerations": names.SPECIFIC_FORCES,
        "turning": ANGULAR_ACCELERATIONS,
    }
    for name, channels in groups.items():
        if overlay.common(channels):
            yield f"{name}_{overlay.flight}", partial(side_by_side, [overlay], channels)


def side_by_side(overlays: Sequence[Overlay], channels: Sequence[str]) -> Figure:
    """Measured (red) and model (blue) over time: one row per channel, one column per flight."""
    rows = [name for name in channels if any(name in overlay.common(channels) for overlay in overlays)]
    width = WIDTH if len(overlays) == 1 else 2.8 * len(overlays)
    figure, grid = grid_of(rows, len(overlays), width, below=0.85)
    for column, overlay in enumerate(overlays):
        grid[0][column].set_title(f"{overlay.flight} ({overlay.list})", fontsize=10, y=1.0)
        grid[-1][column].set_xlabel("time, s")
        for row, name in enumerate(rows):
            if name in overlay.common(channels):
                _pair(grid[row][column], overlay, name)
    _legend(figure)
    return figure


def residuals(overlays: Sequence[Overlay]) -> Figure:
    """Measured minus model over time, all given flights in one axis per channel.

    Above each axis: the share of the first 50 lags at which the error's autocorrelation lies in white noise's band.
    """
    rows = [name for name in names.BODY if any(overlay.common([name]) for overlay in overlays)]
    figure, grid = grid_of(rows, 1, WIDTH, height=1.1)
    for axes, name in zip((row[0] for row in grid), rows, strict=True):
        white = []
        for overlay in overlays:
            if overlay.common([name]):
                error = overlay.measured[name] - overlay.model[name]
                axes.plot(overlay.time, error, color=LIST_COLOURS[overlay.list], linewidth=0.8, alpha=0.7)
                white.append(_white_share(error))
        axes.axhline(0.0, color="black", linewidth=0.5)
        axes.set_title(f"white at {100 * np.mean(white):.0f} % of lags", loc="right", fontsize=8, y=1.0)
    grid[0][0].set_title("measured - model", loc="left", fontsize=10, y=1.0)
    grid[-1][0].set_xlabel("time, s")
    return figure


def scores(fit: FitRecord) -> Figure:
    """J of every flight shown on the scale from the sensor noise alone to holding trim; logarithmic."""
    flights = list(shown_flights(fit).items())
    labels = [f"{name} ({flight.list})" for name, flight in flights]
    figure = Figure(figsize=(WIDTH, 1.0 + 0.25 * len(flights)))
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    leave(figure, left=min(0.2 + LETTER * max(map(len, labels)), 0.6 * WIDTH), below=0.75, above=0.1)
    for row, (_, flight) in enumerate(flights):
        if flight.J_noise and flight.J_trim:
            axes.plot([flight.J_noise, flight.J_trim], [row, row], color=QUIET, linewidth=5, solid_capstyle="butt")
        if flight.J:
            axes.plot(flight.J, row, "o", color=LIST_COLOURS[flight.list])
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(-0.6, len(flights) - 0.4)
    axes.set_yticks(range(len(flights)), labels, fontsize=9)
    axes.invert_yaxis()
    figure.supxlabel("J over 8 s. Dot: the model.\nBar: noise alone to holding trim", fontsize=9, y=0.01)
    axes.grid(axis="x", alpha=0.3)
    return figure


def grid_of(
    rows: Sequence[str], columns: int, width: float, height: float = 1.3, below: float = 0.5
) -> tuple[Figure, list[list[Axes]]]:
    """A figure with one row of axes for each channel; titles that are set later take `y=1.0` too."""
    figure = Figure(figsize=(width, 0.3 + below + height * len(rows)))
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), columns, sharex="col", sharey="row", squeeze=False).tolist()
    leave(figure, left=0.85, below=below, above=0.3)
    for axes, name in zip((row[0] for row in grid), rows, strict=True):
        unit = names.unit(name)
        axes.set_ylabel(f"{name}, {unit}" if unit else name)
        edge = blended_transform_factory(figure.transFigure, axes.transAxes)
        axes.yaxis.set_label_coords(0.2 / width, 0.5, transform=edge)
    for row in grid:
        for axes in row:
            axes.set_title("", y=1.0)  # set, not searched for: ticks would be measured twice
            axes.grid(alpha=0.3)
            axes.tick_params(labelsize=8)
    return figure, grid


def leave(figure: Figure, left: float, below: float, above: float) -> None:
    """Margins in inches; matplotlib's own layout measures every letter twice, half of the time of a picture."""
    width, height = figure.get_size_inches()
    edges = {"left": left / width, "right": 1.0 - 0.15 / width, "bottom": below / height, "top": 1.0 - above / height}
    figure.subplots_adjust(**edges, wspace=0.1, hspace=0.25)


def _pair(axes: Axes, overlay: Overlay, name: str) -> None:
    axes.plot(overlay.time, overlay.measured[name], color=MEASURED, linewidth=1.0)
    axes.plot(overlay.time, overlay.model[name], color=MODEL, linewidth=1.2)


def _legend(figure: Figure) -> None:
    handles = [Line2D([], [], color=MEASURED), Line2D([], [], color=MODEL)]
    figure.legend(handles, ["measured", "model"], loc="lower center", ncols=2, frameon=False, fontsize=9)


def _white_share(error: Tensor) -> float:
    """Share of the first lags at which the error's autocorrelation lies within the 95 % band of white noise."""
    lags = min(LAGS, error.shape[0] - 1)
    inside = autocorrelation(error[:, None], lags).abs() <= 1.96 / math.sqrt(error.shape[0])
    return inside.double().mean().item()
