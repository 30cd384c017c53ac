"""Pictures of a check: stamps, spectra, coherence, what the controls did, kinematics before and after correction."""

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter

from rotorid_torch.consistency import sensor_pairs
from rotorid_torch.consistency.examination.controls import RESPONSES
from rotorid_torch.consistency.imu_place import placed_pairs
from rotorid_torch.consistency.records.coherence import USABLE, coherences
from rotorid_torch.consistency.records.excitation import control_axes, correlations
from rotorid_torch.consistency.records.stamps import intervals
from rotorid_torch.consistency.records.vibration import lines, spectrum
from rotorid_torch.consistency.sensor_pairs import Agreement, agreement
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.report.figures import MEASURED, MODEL, QUIET, WIDTH, grid_of, leave
from rotorid_torch.report.overlay import rms

SHOWN = 8
"""Flights that a picture shows, at most."""
DRAWN = 4000
"""Samples of a line, at most; a picture is no wider."""


def draw_check(dataset: Dataset) -> dict[str, Figure]:
    """Every picture that the data set allows, by the name of its file."""
    drawn = {
        "sampling": sampling(dataset),
        "spectra": spectra(dataset),
        "coherence": coherence(dataset),
        "controls": controls(dataset),
        "correlation": correlation(dataset),
        "kinematics": kinematics(dataset),
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def sampling(dataset: Dataset) -> Figure | None:
    """Intervals between the stamps as recorded, over their median, one flight above the other."""
    if dataset.path is None:
        return None
    flights = list(dataset.flights)[:SHOWN]
    figure, grid = grid_of(["interval"] * len(flights), 1, WIDTH, height=0.7)
    for (axes,), name in zip(grid, flights, strict=True):
        steps = 1e3 * intervals(dataset.path, name)
        time = np.cumsum(steps) / 1e3
        chosen = _thinned(steps)
        axes.plot(time[chosen], steps[chosen], ".", markersize=1.5, color=MODEL)
        axes.axhline(float(np.median(steps)), color="black", linewidth=0.5)
        axes.set_ylabel("")
        axes.set_ylim(0.0, max(1.5 * float(np.median(steps)), 1.05 * float(steps.max())))
        axes.text(0.99, 0.9, name, transform=axes.transAxes, ha="right", va="top", fontsize=8)
    grid[0][0].set_title("interval from stamp to stamp, ms", loc="left", fontsize=10)
    grid[-1][0].set_xlabel("time, s")
    return figure


def _thinned(values: np.ndarray) -> np.ndarray:
    """Indices of samples to draw: evenly spread, and always the extremes of what lies between."""
    if len(values) <= DRAWN:
        return np.arange(len(values))
    parts = np.linspace(0, len(values), DRAWN // 2 + 1).astype(int)
    ends = [(a + int(np.argmin(values[a:b])), a + int(np.argmax(values[a:b]))) for a, b in pairwise(parts.tolist())]
    return np.unique(np.array(ends))


def spectra(dataset: Dataset) -> Figure | None:
    """Power spectral density of rates and specific forces in the identify flights, with the white noise under it."""
    channels = [c for c in (*names.RATES, *names.SPECIFIC_FORCES) if dataset.scales().get(c)]
    if not channels:
        return None
    figure, grid = grid_of(channels, 1, WIDTH, height=1.2)
    dt = dataset.facts[dataset.identify[0]].dt
    for (axes,), channel in zip(grid, channels, strict=True):
        hertz, power = spectrum(dataset.records(channel), dt)
        keep, width = hertz > 0.0, hertz[1]
        axes.loglog(hertz[keep], np.maximum(power[keep] / width, 1e-300), color=MEASURED, linewidth=0.9)
        axes.axhline(2.0 * dt * dataset.noise(channel) ** 2, color=MODEL, linewidth=0.9, linestyle="--")
        for line in lines(hertz, power):
            if line.share > 0.03:
                axes.axvline(line.hertz, color=QUIET, linewidth=3, alpha=0.6, zorder=0)
        top = float(power[keep].max() / width)
        axes.set_ylim(max(1e-9 * top, 0.1 * 2.0 * dt * dataset.noise(channel) ** 2), 3.0 * top)
        unit = names.unit(channel)
        axes.set_ylabel(f"{channel}, ({unit})²/Hz", fontsize=8)
    grid[0][0].set_title("spectra; dashed: white noise; grey: vibration", loc="left", fontsize=10)
    grid[-1][0].set_xlabel("frequency, Hz")
    return figure


def coherence(dataset: Dataset) -> Figure | None:
    """Multiple coherence of every response with all controls, and above which it is usable."""
    measured = coherences(dataset, RESPONSES)
    if not measured or len(measured[0].values) < 2:
        return None
    figure, grid = grid_of([c.channel for c in measured], 1, WIDTH, height=0.65)
    for (axes,), one in zip(grid, measured, strict=True):
        axes.stairs(np.nan_to_num(one.values), one.edges, color=MODEL, linewidth=1.2)
        if one.band:
            axes.axvspan(*one.band, color=QUIET, alpha=0.4, linewidth=0)
        axes.axhline(USABLE, color="black", linewidth=0.5)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.set_ylim(0.0, 1.05)
        axes.set_ylabel(one.channel)
    grid[0][0].set_title("coherence with all controls; grey: usable", loc="left", fontsize=10)
    grid[-1][0].set_xlabel("frequency, Hz")
    return figure


def controls(dataset: Dataset) -> Figure:
    """Every control (of motors: every axis) over time in the identify flights, one after the other."""
    axes_of = control_axes(dataset)
    figure, grid = grid_of([axis.name for axis in axes_of], 1, 1.4 * WIDTH, height=1.0)
    start, middles = 0.0, []
    shown = dataset.some(SHOWN)
    for name in shown:
        flight = dataset.flights[name]
        values = flight.bridged(dataset.controls).numpy()
        for (axes,), axis in zip(grid, axes_of, strict=True):
            column = values @ axis.weights
            chosen = _thinned(column)
            axes.plot(start + chosen * flight.dt, column[chosen], color=MODEL, linewidth=0.8)
            axes.axvline(start, color=QUIET, linewidth=0.8)
        middles.append(start + 0.5 * flight.samples * flight.dt)
        start += flight.samples * flight.dt
    for (axes,), axis in zip(grid, axes_of, strict=True):
        axes.set_ylabel(axis.name)
        axes.set_xlim(0.0, start)
        axes.set_xticks(middles, ["" for _ in shown])
    grid[-1][0].set_xticks(middles, shown, rotation=20, ha="right", fontsize=7)
    grid[0][0].set_title("controls in the identify flights", loc="left", fontsize=10)
    return figure


def correlation(dataset: Dataset) -> Figure:
    """Correlation from 0.2 to 4 Hz of the controls among themselves and with the motion."""
    labels, matrix = correlations(dataset)
    size = 1.2 + 0.42 * len(labels)
    figure = Figure(figsize=(size, size))
    axes: Axes = figure.subplots()
    leave(figure, left=0.75, below=0.75, above=0.35)
    axes.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    for row, column in np.ndindex(*matrix.shape):
        dark = abs(matrix[row, column]) > 0.6
        text = f"{matrix[row, column]:.1f}".replace("-0.0", "0.0")
        axes.text(column, row, text, ha="center", va="center", fontsize=7, color="white" if dark else "black")
    axes.set_xticks(range(len(labels)), labels, rotation=60, fontsize=8)
    axes.set_yticks(range(len(labels)), labels, fontsize=8)
    axes.set_title("correlation, 0.2 to 4 Hz", loc="left", fontsize=10)
    return figure


def kinematics(dataset: Dataset) -> Figure | None:
    """What kinematics leaves over in each pair of sensors, as recorded and with lag, scale and bias taken out."""
    pairs = (*sensor_pairs.attitude_pairs(), *placed_pairs(dataset), *sensor_pairs.position_pairs())
    compared = [a for pair in pairs if (a := agreement(pair, dataset.flights.values())) is not None and a.r2 > 0.3]
    if not compared:
        return None
    figure, grid = grid_of([f"d{a.pair.left_name}/dt" for a in compared], 1, 1.4 * WIDTH, height=1.05)
    for (axes,), a in zip(grid, compared, strict=True):
        name = _liveliest(dataset, a)
        time, left, before, after = sensor_pairs.compared(a, dataset.flights[name])
        chosen = _thinned(left)
        axes.plot(time[chosen], (left - before)[chosen], color=MEASURED, linewidth=0.9)
        axes.plot(time[chosen], (left - after)[chosen], color=MODEL, linewidth=0.9)
        axes.set_ylabel(a.pair.unit, fontsize=8)
        less = f"off by {rms(left - before):.2g}, then {rms(left - after):.2g}, of {rms(left):.2g} rms"
        heading = f"d{a.pair.left_name}/dt, {name}: lag {a.lag_s:+.3f} s, scale {a.scale:.3f}; {less}"
        axes.set_title(heading, loc="left", fontsize=8, y=1.0, pad=3)
    figure.subplots_adjust(hspace=0.45)
    grid[-1][0].set_xlabel("time, s")
    return figure


def _liveliest(dataset: Dataset, a: Agreement) -> str:
    """The flight in which the pair's left side does most."""
    spreads = {n: f.spreads[a.pair.left_name] for n, f in dataset.facts.items() if f.has(*a.pair.channels)}
    return max(spreads, key=lambda n: spreads[n].squares / spreads[n].count)
