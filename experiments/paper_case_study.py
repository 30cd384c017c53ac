"""Does the three-step identification do what the paper's sections 4 and 5 show? Its figures 4 to 9 and their tables.

Flown by the built-in flight-test aircraft, or any data set with `truth/`. Step 1 against the true forces (figure 4), the
rotor of step 2 driven by the flown motion (figure 5), the moments of step 3 against the true ones (figure 6), and free
runs on flights that were not used (figures 7 to 9), with the scores and their yardsticks: holding trim, noise alone.

Expected: truth inside 3 sigma at 97 % of samples and inside 1 sigma at 55-80 %, errors below 2 Hz under 7 % of the
signal; flapping and moments of unseen flights explained above 95 %; the acid flight followed for 8 s without divergence.
"""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS
from rotorid_torch.data import Dataset, load
from rotorid_torch.fly import fly
from rotorid_torch.identification.reconstruct import Reconstruction
from rotorid_torch.model.model import Model
from rotorid_torch.run.figures import Overlay, side_by_side
from rotorid_torch.run.pipeline import Run, identify
from rotorid_torch.run.scorecard import scorecard
from rotorid_torch.validate.free_run import equilibrium
from rotorid_torch.validate.scores import r2

AXES = (*FORCES, *MOMENTS)
LOW = 2.0  # Hz
Truth = Mapping[str, Mapping[str, np.ndarray]]


@dataclass
class Args:
    """Settings of the case study."""

    dataset: Path | None = None
    """Folder of a data set with truth/; without one the built-in aircraft flies."""
    quick: bool = False
    """Three short flights, to see that it works."""
    speed: float = 0.0
    """m/s, of the built-in aircraft's trim."""
    seed: int = 0
    out: Path = Path("runs/paper_case_study")
    """Where the figures and the TensorBoard records go."""


def flown(args: Args) -> tuple[Dataset, Truth]:
    """The flights and what is true about them."""
    if args.dataset is not None:
        data, folder = load(args.dataset), args.dataset / "truth"
        return data, {name: dict(np.load(folder / f"{name}.npz")) for name in data.flights}
    some, seconds = (["f321_lon", "f321_lat", "dbl_col_p", "dbl_lon_n", "sweep_col"], 8.0) if args.quick else (None, 15.0)
    test = fly(None, speed=args.speed, flights=some, seed=args.seed, seconds=seconds)
    return test.dataset(), test.truth


def true(truth: Truth, dataset: Dataset, name: str, channels: tuple[str, ...]) -> Tensor:
    """True channels of a flight at its samples, (T, n)."""
    known, time = truth[name], dataset.flights[name].time.numpy()
    clock = np.asarray(known["time"], dtype=float)
    return torch.tensor(np.stack([np.interp(time, clock - clock[0], known[c]) for c in channels], axis=-1))


def below(signal: Tensor, dt: float, hertz: float = LOW) -> Tensor:
    """What a signal (T, n) holds below a frequency; mirrored at its end, so that the ends do not leak."""
    spectrum = torch.fft.rfft(torch.cat([signal, signal.flip(0)]), dim=0)
    spectrum[torch.fft.rfftfreq(2 * len(signal), dt) > hertz] = 0.0
    return torch.fft.irfft(spectrum, n=2 * len(signal), dim=0)[: len(signal)]


def step1_table(dataset: Dataset, found: Reconstruction, truth: Truth) -> dict[str, dict[str, list[float]]]:
    """Per flight and component: share of samples inside 3 and 1 sigma, and rms error below 2 Hz over the signal's."""
    table = {}
    for name, flight in found.flights.items():
        known = true(truth, dataset, name, AXES)
        error, size = flight.loads - known, (known - known.mean(0)).square().mean(0).sqrt()
        slow = below(error, dataset.flights[name].dt).square().mean(0).sqrt() / size
        inside = [(error.abs() < k * flight.loads_sd).double().mean(0).tolist() for k in (3.0, 1.0)]
        table[name] = {"3 sigma": inside[0], "1 sigma": inside[1], "slow error": slow.tolist()}
    return table


def figure4(dataset: Dataset, found: Reconstruction, truth: Truth, name: str) -> Figure:
    """Estimated (blue) and true (red) forces; right their difference within three standard deviations."""
    figure = Figure(figsize=(9.6, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid, flight, known = figure.subplots(3, 2, sharex=True), found.flights[name], true(truth, dataset, name, FORCES)
    for k, (left, right) in enumerate(grid):
        left.plot(flight.time, known[:, k] / 1e3, "#c0392b", linewidth=1.0, label="true")
        left.plot(flight.time, flight.forces[:, k] / 1e3, "#1f4e9c", linewidth=1.0, linestyle="--", label="estimated")
        left.set_ylabel(f"{FORCES[k]}, kN")
        right.plot(flight.time, (flight.forces[:, k] - known[:, k]) / 1e3, "#1f4e9c", linewidth=0.7, label="error")
        for sign in (-3.0, 3.0):
            band = sign * flight.loads_sd[:, k] / 1e3
            right.plot(flight.time, band, "black", linewidth=0.8, label="3 sigma" if sign > 0 else None)
        right.set_ylabel(f"error of {FORCES[k]}, kN")
    grid[0][0].set_title(f"{name}: forces", fontsize=10)
    for axes in grid.flat:
        axes.grid(alpha=0.3)
    for axes in grid[0]:
        axes.legend(fontsize=8, loc="upper right")
    for axes in grid[-1]:
        axes.set_xlabel("time, s")
    return figure


@torch.no_grad()
def driven(model: Model, dataset: Dataset, found: Reconstruction, name: str) -> dict[str, Tensor]:
    """Flapping (rad) and moments (N m, or per inertia) of the model along a flight's motion and controls, (T,) each.

    The body moves as step 1 saw it; the rotor's own states are integrated from rest and see no measurement.
    """
    flight, states = dataset.flights[name], model.body.states
    body = torch.stack([found.flights[name].channels[c] for c in states], dim=-1)
    controls, n = flight.bridged(model.body.controls), len(states)

    def rates(t: Tensor, own: Tensor, u: Tensor) -> Tensor:
        return model.frame(model.theta, torch.cat([u[..., :n], own], dim=-1), u[..., n:])[1]

    start = equilibrium(model, body[0], controls[0])[n:]
    own = simulate(rates, start, torch.cat([body, controls], dim=-1), flight.dt)
    frame, _ = model.frame(model.theta, torch.cat([body, own], dim=-1), controls)
    assert frame.moment is not None
    rows = dict(zip(MOMENTS, (frame.moment @ model.inertia.mT).unbind(-1), strict=True))
    return rows | {c: frame.signals[c] for c in FLAPPING if c in frame.signals}


def unseen(model: Model, run: Run, dataset: Dataset, truth: Truth) -> list[Overlay]:
    """Flapping and moments of the validate flights: measured flapping and true moments beside the driven model's."""
    made = []
    for name in dataset.validate:
        flight, found = dataset.flights[name], driven(model, dataset, run.reconstruction, name)
        known = dict(zip(MOMENTS, true(truth, dataset, name, MOMENTS).unbind(-1), strict=True))
        known |= {c: flight.channels[c] for c in FLAPPING if flight.has(c)}
        made.append(Overlay(name, "validate", flight.time, known, found))
    return made


def explained(overlays: list[Overlay], channels: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """R2 per flight and channel."""
    table = {}
    for o in overlays:
        shown = o.common(channels)
        pairs = torch.stack([o.model[c] - o.measured[c] for c in shown], -1), torch.stack([o.measured[c] for c in shown], -1)
        table[o.flight] = {c: round(float(v), 4) for c, v in zip(shown, r2(*pairs), strict=True)}
    return table


def pictures(run: Run, dataset: Dataset, truth: Truth, overlays: dict[str, list[Overlay]]) -> dict[str, Figure]:
    """All figures by the name of their file."""
    lateral = next((n for n in dataset.identify if n == "f321_lat"), dataset.identify[0])
    made = {"figure4_forces": figure4(dataset, run.reconstruction, truth, lateral)}
    made["figure5_flapping_driven"] = side_by_side(overlays["step 2"], FLAPPING)
    made["figure6_moments"] = side_by_side(overlays["step 3"], MOMENTS)
    made["figure6_moments"].legends[0].get_texts()[0].set_text("true")
    return made | run.plot()


def show(console: Console, title: str, rows: Mapping[str, Mapping[str, float] | list[float]]) -> None:
    """One table: a row per flight, a column per component."""
    table = Table("flight", title=title)
    first = next(iter(rows.values()))
    for column in first if isinstance(first, Mapping) else AXES:
        table.add_column(column, justify="right")
    for name, row in rows.items():
        table.add_row(name, *(f"{v:.3f}" for v in (row.values() if isinstance(row, Mapping) else row)))
    console.print(table)


def main(args: Args) -> None:
    """Fly, identify, compare with the truth, draw, and end with one JSON line."""
    random.seed(args.seed)
    np.random.seed(args.seed)  # noqa: NPY002 (the global state of whoever uses it)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    console, writer = Console(stderr=True), SummaryWriter(str(args.out / "tensorboard"))
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    dataset, truth = flown(args)
    run = identify(dataset, seed=args.seed)

    step1 = step1_table(dataset, run.reconstruction, truth)
    first = copy.deepcopy(run.model)
    first.theta.data.copy_(run.regressions.theta)
    overlays = {"step 2": unseen(first, run, dataset, truth), "step 3": unseen(run.model, run, dataset, truth)}
    for key in ("3 sigma", "1 sigma", "slow error"):
        show(console, f"step 1: {key}", {name: row[key] for name, row in step1.items()})
    flapping, moments = explained(overlays["step 2"], FLAPPING), explained(overlays["step 3"], MOMENTS)
    show(console, "step 2: R2 of the flapping, rotor driven by the flown motion", flapping)
    show(console, "step 3: R2 of the moments, driven", moments)
    console.print(scorecard(run.record))
    for name, figure in pictures(run, dataset, truth, overlays).items():
        figure.savefig(args.out / f"{name}.png", dpi=110)
        writer.add_figure(name, figure)
    writer.close()
    rows = {key: np.array([row[key] for row in step1.values()]) for key in ("3 sigma", "1 sigma", "slow error")}
    result = {
        "dataset": dataset.name,
        "step1_least_within_3_sigma": dict(zip(AXES, rows["3 sigma"].min(0).round(4).tolist(), strict=True)),
        "step1_within_1_sigma": dict(zip(AXES, rows["1 sigma"].mean(0).round(3).tolist(), strict=True)),
        "step1_slow_error": dict(zip(AXES, rows["slow error"].mean(0).round(4).tolist(), strict=True)),
        "step2_flapping_r2": flapping,
        "step3_moment_r2": moments,
        "J": run.scores,
        "seconds": round(run.record.time_s.total, 1),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main(tyro.cli(Args))
