"""Share of data sets in which the 95 % intervals of the whole chain (three steps) hold the truth.

The truth is the identification's own linear model of a helicopter in hover with derivatives of a UH-60, unstable and
flown by a feedback controller: 3-2-1-1 inputs and doublets in each control, noise on every channel and control.
With a lag in the controls' path, which the identified model does not have, the intervals are held against pseudo-true
values: the same chain's estimates from the same flights without noise.

Expected: 90-98 % pooled over all derivatives; with model error the intervals are too wide rather than too narrow, for
they count the model error, which is the same in every run, as if it were noise.
"""

from __future__ import annotations

import json
import random
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from rotorid_torch.core.integrate import step
from rotorid_torch.core.names import FORCES, MOMENTS, RATES, STICKS, VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.model_estimation import estimate_model
from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build

DT, SECONDS, QUIET, UNIT, LAG = 0.02, 10.0, 1.0, 0.6, 0.07  # s
ROWS, DRIVERS = (*FORCES, *MOMENTS), (*VELOCITIES, *RATES, *STICKS)
STATES = (*VELOCITIES, *RATES, "phi", "theta")
OUTPUTS = (*STATES, "ax", "ay", "az")
NOISE = dict.fromkeys((*RATES, "phi", "theta"), 0.002) | dict.fromkeys((*VELOCITIES, "ax", "ay", "az"), 0.05)
NOISE |= dict.fromkeys(STICKS, 0.0005)
AMPLITUDE = {"lon": 0.04, "lat": 0.02, "col": 0.02, "ped": 0.04}  # rad
TRIM = {"w": 0.0, "theta": 0.08, "phi": -0.04, "lon": -0.03, "lat": 0.01, "col": 0.3, "ped": 0.25}
# rows X Y Z (m/s2) and L M N (rad/s2), by u v w p q r lon lat col ped in SI
DERIVATIVES = (
    (-0.012, -0.014, 0.021, -0.28, 0.40, -0.10, -9.2, 1.0, 7.7, -0.2),
    (0.001, -0.054, -0.003, -0.04, -0.15, -0.31, -0.7, -4.9, -1.1, 3.2),
    (0.016, 0.015, -0.280, 0.04, 0.60, 0.59, -0.4, 0.0, -82.0, -1.4),
    (0.066, -0.131, -0.003, -4.69, -1.86, 0.05, 0.0, -48.2, -2.7, 6.0),
    (0.007, 0.036, 0.011, 0.23, -0.72, -0.08, 7.1, -0.6, 3.1, -1.6),
    (0.003, 0.008, 0.0, -0.26, -0.12, -0.31, 0.0, -3.1, 6.8, -4.2),
)
# controls by p q r phi theta: rad per rad/s and rad
FEEDBACK = {"lon": {"q": -0.25, "theta": -0.25}, "lat": {"p": 0.03, "phi": 0.06}, "col": {}, "ped": {"r": 0.3}}


@dataclass
class Args:
    """Settings of the Monte Carlo."""

    runs: int = 200
    lag_runs: int = 50
    quick: bool = False
    """One run without model error, to see that it works."""
    seed: int = 0
    out: Path = Path("runs/coverage_chain")
    """Finished runs are kept there, one JSON line each; started again, the rest is computed."""


def true_model() -> Model:
    """The truth, in the form that the identification gives its models."""
    reference = dict.fromkeys((*STATES, *STICKS), 0.0) | TRIM
    phi, theta = torch.tensor(TRIM["phi"]).double(), torch.tensor(TRIM["theta"]).double()
    weight = (-theta.sin(), theta.cos() * phi.sin(), theta.cos() * phi.cos())
    reference |= {f"{row}.trim": -9.80665 * float(g) for row, g in zip(FORCES, weight, strict=True)}
    rows, units = dict.fromkeys(ROWS, DRIVERS), dict.fromkeys(STICKS, "rad")
    names = {"states": STATES, "controls": STICKS, "outputs": OUTPUTS, "patterns": rows, "control_units": units}
    spec = ModelSpec(**names, reference=reference, sizes={}, ranges={})
    model = build(spec)
    with torch.no_grad():
        for name, value in truth().items():
            model.theta[model.parameter_set.index(name)] = value
    return model


def truth() -> dict[str, float]:
    """The derivatives by their parameters' names."""
    return {
        f"forces.{row}.{column}": value
        for row, values in zip(ROWS, DERIVATIVES, strict=True)
        for column, value in zip(DRIVERS, values, strict=True)
    }


def inputs() -> tuple[tuple[str, ...], Tensor]:
    """Names of the flights and what the pilot adds to the controls [F, T, 4]."""
    t = DT * torch.arange(round(SECONDS / DT), dtype=torch.float64) - QUIET
    edges = {"f321": ((0, 3, 1.0), (3, 5, -1.0), (5, 6, 1.0), (6, 7, -1.0)), "dbl": ((0, 2, 1.0), (2, 4, -1.0))}
    names, rows = [], []
    for kind, steps in edges.items():
        for k, stick in enumerate(STICKS):
            pilot = torch.zeros(len(t), 4, dtype=torch.float64)
            for begin, end, level in steps:
                pilot[(t >= begin * UNIT) & (t < end * UNIT), k] = level * AMPLITUDE[stick]
            names.append(f"{kind}_{stick}")
            rows.append(pilot)
    return tuple(names), torch.stack(rows)


@torch.no_grad()
def clean_flights(lag: float) -> dict[str, dict[str, Tensor]]:
    """Channels of all flights without noise; `lag` s is between the recorded controls and those that act."""
    model, (names, pilot) = true_model(), inputs()
    trim = torch.tensor([TRIM[c] for c in STICKS], dtype=torch.float64)
    trimmed = torch.tensor([model.reference[s] for s in STATES], dtype=torch.float64)
    gains = torch.tensor([[FEEDBACK[c].get(s, 0.0) for s in STATES] for c in STICKS], dtype=torch.float64)
    x, u = trimmed.repeat(len(names), 1), trim + pilot[:, 0]
    acting, states, controls, effective = u, [x], [u], [u]
    for k in range(1, pilot.shape[1]):
        following = trim + pilot[:, k] + (x - trimmed) @ gains.mT
        after = following if lag == 0.0 else acting + (1.0 - np.exp(-DT / lag)) * (following - acting)
        x = step(model, torch.tensor(0.0), x, acting, after, DT)
        u, acting = following, after
        states.append(x)
        controls.append(u)
        effective.append(acting)
    outputs = model.output(torch.stack(states, 1), torch.stack(effective, 1))
    columns = torch.cat([outputs, torch.stack(controls, 1)], dim=-1)
    time = DT * torch.arange(columns.shape[1], dtype=torch.float64)
    named = [dict(zip((*OUTPUTS, *STICKS), flight.T, strict=True)) for flight in columns]
    return {name: {"time": time} | channels for name, channels in zip(names, named, strict=True)}


def measured(clean: dict[str, dict[str, Tensor]], rng: np.random.Generator | None) -> Dataset:
    """The flights with new noise on every channel, or with none; the noise is declared either way."""
    flights = {
        name: {
            c: v.numpy() + (0.0 if rng is None or c == "time" else NOISE[c] * rng.standard_normal(len(v)))
            for c, v in channels.items()
        }
        for name, channels in clean.items()
    }
    channels = {c: {"noise": NOISE[c], "bias": "none"} for c in OUTPUTS}
    controls = {c: {"unit": "rad", "noise": NOISE[c]} for c in STICKS}
    return Dataset.from_arrays(flights, identify=list(flights), channels=channels, controls=controls)


def identified(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """The whole chain: value and standard error of every derivative that step 3 gives an interval."""
    reconstruction = reconstruct(dataset)
    model = build(propose(dataset, reconstruction))
    estimate = estimate_model(model, dataset, reconstruction, regress_model(model, dataset, reconstruction))
    errors = estimate.fit.uncertainty.standard_errors.tolist()
    rows = zip(estimate.names, estimate.fit.theta.tolist(), errors, strict=True)
    return {name: (value, error) for name, value, error in rows if not name.endswith(".trim") and error > 0.0}


def coverage(name: str, runs: int, lag: float, seed: int, out: Path, writer: SummaryWriter) -> dict:
    """Shares of intervals that hold the truth, or the pseudo-true values where the controls lag."""
    out.mkdir(parents=True, exist_ok=True)
    file, clean, began = out / f"{name}-seed{seed}.jsonl", clean_flights(lag), time.perf_counter()
    wanted = truth() if lag == 0.0 else {n: v for n, (v, _) in identified(measured(clean, None)).items()}
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True) if file.exists() else []
    lines = [line for line in lines if line.endswith("\n")]  # an interruption may have cut off the last one
    file.write_text("".join(lines), encoding="utf-8")
    done = {entry["run"]: entry["found"] for entry in map(json.loads, lines)}
    for run in range(runs):
        if run not in done:
            done[run] = identified(measured(clean, np.random.default_rng([seed, run])))
            with file.open("a", encoding="utf-8") as handle:
                handle.write(json.dumps({"run": run, "found": done[run]}) + "\n")
            writer.add_scalar(f"pooled/{name}", summary(list(done.values()), wanted)["pooled"], run + 1)
    return summary([done[run] for run in range(runs)], wanted) | {"seconds": round(time.perf_counter() - began, 1)}


def summary(runs: list[dict[str, tuple[float, float]]], wanted: dict[str, float]) -> dict:
    """Pooled share with its standard error over runs, the lowest parameters, and errors over standard errors."""
    none = (np.nan, np.nan)
    found = np.array([[run.get(name, none) for name in wanted] for run in runs])
    away = np.abs(found[..., 0] - np.array(list(wanted.values()))) / found[..., 1]
    inside = np.where(np.isnan(away), np.nan, away < 1.96)
    each = sorted(zip(wanted, np.nanmean(inside, axis=0).round(3).tolist(), strict=True), key=lambda item: item[1])
    return {
        "runs": len(runs),
        "parameters": len(wanted),
        "intervals_missing": int(np.isnan(away).sum()),
        "pooled": round(float(np.nanmean(inside)), 4),
        "pooled_standard_error": round(float(np.nanmean(inside, axis=1).std() / len(runs) ** 0.5), 4),
        "lowest": dict(each[:6]),
        "rms_error_over_standard_error": round(float(np.sqrt(np.nanmean(away**2))), 3),
    }


def main(args: Args) -> None:
    """Run what is not done yet and end with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    if args.quick:
        args.runs, args.lag_runs = 1, 0
    writer = SummaryWriter(str(args.out / "tensorboard"))
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    result = {"chain": coverage("chain", args.runs, 0.0, args.seed, args.out, writer)}
    if args.lag_runs:
        result["chain_with_lag"] = coverage("chain_with_lag", args.lag_runs, LAG, args.seed, args.out, writer)
    writer.close()
    print(json.dumps(result))


if __name__ == "__main__":
    main(tyro.cli(Args))
