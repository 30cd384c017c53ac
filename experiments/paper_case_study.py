"""Does the three-step identification do what the paper's sections 4 and 5 show? Its figures 4 to 9 and their tables.

Flown by the built-in aircraft, or any data set with `truth/`. Step 1 against the true forces (figure 4), the rotor of
step 2 driven by the flown motion (figure 5), the moments of step 3 against the true ones (figure 6), and free runs on
flights that were not used (figures 7 to 9), with the scores and their yardsticks: holding trim, noise alone.

Expected: truth within 3 sigma at 97 % of samples and within 1 sigma at 55-80 %; errors below 2 Hz under 7 % of all
flights' signal, and of a flight's own signal near the least that is possible (a table tells how much that is); flapping
and on-axis moments of unseen flights explained above 95 %; the acid flight followed for 8 s.
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
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from studies.reconstruction_errors import least_slow_error, share_within, slow_error
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.names import ATTITUDES, FLAPPING, FORCES, MOMENTS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data import Dataset, load
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.model.model import Model
from rotorid_torch.model.training.equilibrium import equilibrium
from rotorid_torch.report.figures import side_by_side
from rotorid_torch.report.overlay import Overlay
from rotorid_torch.report.scorecard import scorecard
from rotorid_torch.run.pipeline import identify
from rotorid_torch.run.result import Run
from rotorid_torch.simulation import fly
from rotorid_torch.validate.scores import r2

AXES = (*FORCES, *MOMENTS)
QUICK = ("f321_lon", "f321_lat", "dbl_col_p", "dbl_lon_n", "sweep_col")
Truth = Mapping[str, Mapping[str, np.ndarray]]


@dataclass
class Args:
    """Settings of the case study."""

    dataset: Path | None = None
    """Folder of a data set with truth/; without one the built-in aircraft flies."""
    quick: bool = False
    """Five short flights, to see that it works."""
    speed: float = 0.0
    """m/s, of the built-in aircraft's trim."""
    seed: int = 0
    out: Path = Path("runs/paper_case_study")
    """Where figures and TensorBoard records go."""


def flown(args: Args) -> tuple[Dataset, Truth]:
    """The flights and what is true about them."""
    if args.dataset is not None:
        data, folder = load(args.dataset), args.dataset / "truth"
        return data, {name: dict(np.load(folder / f"{name}.npz")) for name in data.flights}
    some, seconds = (QUICK, 8.0) if args.quick else (None, 15.0)
    test = fly(None, speed=args.speed, flights=some, seed=args.seed, seconds=seconds)
    return test.dataset(), test.truth


def true(truth: Truth, dataset: Dataset, name: str, channels: tuple[str, ...]) -> Tensor:
    """True channels of a flight at its samples, (T, n)."""
    values, time = truth[name], dataset.flights[name].time.numpy()
    clock = np.asarray(values["time"], dtype=float)
    return torch.tensor(np.stack([np.interp(time, clock - clock[0], values[c]) for c in channels], axis=-1))


def sensed(dataset: Dataset, hertz: Tensor) -> Tensor:
    """Variance per sample with which accelerometers, gyros, velocity and attitude show X ... N: [m, 6]."""
    vehicle, omega = dataset.vehicle, 2.0 * torch.pi * hertz[:, None]

    def variances(names: tuple[str, ...]) -> Tensor:
        return torch.tensor([dataset.noise(name) for name in names], dtype=torch.float64).square()

    tilt = vehicle.gravity**2 * variances(("theta", "phi", "phi"))
    push = 1.0 / (1.0 / variances(SPECIFIC_FORCES) + 1.0 / (omega.square() * variances(VELOCITIES) + tilt))
    turn = 1.0 / (1.0 / (omega**2 * variances(RATES)) + 1.0 / (omega**4 * variances(ATTITUDES)))
    mass, inertia = vehicle.mass or 1.0, torch.eye(3, dtype=torch.float64)
    inertia = inertia if vehicle.inertia is None else torch.tensor(vehicle.inertia, dtype=torch.float64)
    return torch.cat([mass**2 * push, turn @ inertia.square().mT], dim=-1)


Tables = dict[str, dict[str, dict[str, float]]]
"""By title, flight and component."""


def step1_tables(dataset: Dataset, reconstruction: Reconstruction, truth: Truth) -> Tables:
    """Shares of the truth within the error bars, and the errors below 2 Hz; per flight and component."""
    truths = {name: true(truth, dataset, name, AXES) for name in reconstruction.flights}
    every, tables = torch.cat([k - k.mean(0) for k in truths.values()]), {}
    for name, flight in reconstruction.flights.items():
        error, dt = flight.loads - truths[name], dataset.flights[name].dt
        rows = {
            "truth within 3 sigma": share_within(error, flight.loads_sd, 3.0),
            "truth within 1 sigma": share_within(error, flight.loads_sd, 1.0),
            "error below 2 Hz over the flight's signal": slow_error(error, truths[name], dt),
            "error below 2 Hz over all flights' signal": slow_error(error, every, dt),
            "least possible over the flight's signal": least_slow_error(
                truths[name], lambda hertz: sensed(dataset, hertz), dt
            ),
        }
        for key, row in rows.items():
            tables.setdefault(f"step 1: {key}", {})[name] = dict(zip(AXES, row.tolist(), strict=True))
    return tables


def figure4(dataset: Dataset, reconstruction: Reconstruction, truth: Truth, name: str) -> Figure:
    """Estimated (blue) and true (red) forces; right their difference within three standard deviations."""
    figure = Figure(figsize=(9.6, 6.0), layout="constrained")
    flight, true_forces = reconstruction.flights[name], true(truth, dataset, name, FORCES) / 1e3
    estimate, band, time = flight.forces / 1e3, 3.0 * flight.loads_sd / 1e3, flight.time
    for k, (left, right) in enumerate(figure.subplots(3, 2, sharex=True)):
        left.plot(time, true_forces[:, k], "#c0392b", linewidth=1.0, label="true")
        left.plot(time, estimate[:, k], "#1f4e9c", linewidth=1.0, linestyle="--", label="estimated")
        right.plot(time, estimate[:, k] - true_forces[:, k], "#1f4e9c", linewidth=0.7, label="error")
        right.plot(time, band[:, k], "black", linewidth=0.8, label="3 sigma")
        right.plot(time, -band[:, k], "black", linewidth=0.8)
        left.set_ylabel(f"{FORCES[k]}, kN")
        right.set_ylabel(f"error of {FORCES[k]}, kN")
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    for axes in figure.axes[:2]:
        axes.legend(fontsize=8, loc="lower right", framealpha=0.4)
    figure.suptitle(name, fontsize=10)
    figure.supxlabel("time, s", fontsize=10)
    return figure


@torch.no_grad()
def along(model: Model, dataset: Dataset, reconstruction: Reconstruction, name: str) -> dict[str, Tensor]:
    """Flapping (rad) and moments (N m, or per inertia) of the model along a flight's motion and controls, (T,) each.

    The body moves as step 1 saw it; the rotor's own states are integrated from rest and see no measurement.
    """
    flight, states = dataset.flights[name], model.body.states
    body = torch.stack([reconstruction.flights[name].channels[c] for c in states], dim=-1)
    controls, n = flight.bridged(model.body.controls), len(states)

    def rates(t: Tensor, rotor: Tensor, u: Tensor) -> Tensor:
        return model.frame(model.theta, torch.cat([u[..., :n], rotor], dim=-1), u[..., n:])[1]

    start = equilibrium(model, body[0], controls[0])[n:]
    rotor = simulate(rates, start, torch.cat([body, controls], dim=-1), flight.dt)
    frame, _ = model.frame(model.theta, torch.cat([body, rotor], dim=-1), controls)
    assert frame.moment is not None
    rows = dict(zip(MOMENTS, (frame.moment @ model.inertia.mT).unbind(-1), strict=True))
    return rows | {c: frame.signals[c] for c in FLAPPING if c in frame.signals}


def unseen(model: Model, run: Run, dataset: Dataset, truth: Truth) -> list[Overlay]:
    """Flapping and moments of the validate flights: measured flapping and true moments beside the driven model's."""
    overlays = []
    for name in dataset.validate:
        flight, driven = dataset.flights[name], along(model, dataset, run.reconstruction, name)
        flown = dict(zip(MOMENTS, true(truth, dataset, name, MOMENTS).unbind(-1), strict=True))
        flown |= {c: flight.channels[c] for c in FLAPPING if flight.has(c)}
        overlays.append(Overlay(name, "validate", flight.time, flown, driven))
    return overlays


def explained(overlays: list[Overlay], channels: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """R2 per flight and channel."""
    table = {}
    for o in overlays:
        pairs = [(c, o.model[c][:, None], o.measured[c][:, None]) for c in o.common(channels)]
        table[o.flight] = {c: float(r2(modelled - measured, measured)) for c, modelled, measured in pairs}
    return table


def pictures(run: Run, dataset: Dataset, truth: Truth, driven: Mapping[str, list[Overlay]]) -> dict[str, Figure]:
    """All figures by the name of their file."""
    lateral = "f321_lat" if "f321_lat" in dataset.flights else dataset.identify[0]
    moments = side_by_side(driven["step 3"], MOMENTS)
    moments.legends[0].get_texts()[0].set_text("true")
    for axes in moments.axes:
        if axis := axes.get_ylabel():
            axes.set_ylabel(f"{axis}, {run.reconstruction.units[axis]}")
    figures = {"figure4_forces": figure4(dataset, run.reconstruction, truth, lateral), "figure6_moments": moments}
    return figures | {"figure5_flapping_driven": side_by_side(driven["step 2"], FLAPPING)} | run.plot()


def main(args: Args) -> None:
    """Fly, identify, compare with the truth, draw, and end with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    console, writer = Console(stderr=True), SummaryWriter(str(args.out / "tensorboard"))
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    dataset, truth = flown(args)
    run = identify(dataset, seed=args.seed)

    after_step2 = copy.deepcopy(run.model)
    after_step2.theta.data.copy_(run.regressions.theta)
    driven = {"step 2": unseen(after_step2, run, dataset, truth), "step 3": unseen(run.model, run, dataset, truth)}
    tables = step1_tables(dataset, run.reconstruction, truth)
    tables["step 2: R2 of flapping along the flown motion"] = explained(driven["step 2"], FLAPPING)
    tables["step 3: R2 of moments along the flown motion"] = explained(driven["step 3"], MOMENTS)
    for title, rows in tables.items():
        table = Table("flight", *next(iter(rows.values())), title=title)
        for name, row in rows.items():
            table.add_row(name, *(f"{value:.3f}" for value in row.values()))
        console.print(table)
    console.print(scorecard(run.record))
    for name, figure in pictures(run, dataset, truth, driven).items():
        figure.savefig(args.out / f"{name}.png", dpi=110)
        writer.add_figure(name, figure)
    writer.close()
    print(json.dumps({"dataset": dataset.name, **tables, "J": run.scores, "seconds": run.record.time_s.total}))


if __name__ == "__main__":
    main(tyro.cli(Args))
