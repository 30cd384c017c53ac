"""Do 95 % intervals hold the truth in 95 of 100 runs? Each step alone, on a system that is known exactly.

A roll axis (damping, stiffness, control power) flown twice at 20 Hz, with new noise in every run: Fourier regression of
the roll acceleration with white noise on everything measured, output error with white noise, and output error with
first-order autoregressive noise (coefficient 0.95), whose plain Cramer-Rao intervals are three to four times too small.

The whole chain of steps follows, as in `coverage_chain.py`, which also runs alone.

Expected: pooled 0.93-0.97 with white noise and each parameter above 0.90; with coloured noise 0.90-0.98 and 0.86.
"""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import tyro
from coverage_chain import LAG
from coverage_chain import coverage as chain_coverage
from torch import Tensor, nn
from torch.utils.tensorboard import SummaryWriter

from rotorid_torch.core.integrate import simulate
from rotorid_torch.identification.estimate.output_error import output_error
from rotorid_torch.identification.regress.ftr import regress

TRUTH = (-1.2, -2.0, 3.0)  # damping 1/s, stiffness 1/s2, control power 1/s2
NAMES = ("damping", "stiffness", "power")
DT, SECONDS, FLIGHTS = 0.05, 15.0, 2
NOISE = torch.tensor([0.01, 0.02], dtype=torch.float64)  # bank angle rad, roll rate rad/s
COLOUR = 0.95


@dataclass
class Args:
    """Settings of the Monte Carlo."""

    white_runs: int = 1000
    coloured_runs: int = 400
    chain_runs: int = 200
    chain_lag_runs: int = 50
    """Of the whole chain; finished ones are kept beside the TensorBoard records and not run again."""
    quick: bool = False
    """20 runs of each step and one of the chain, to see that it works."""
    seed: int = 0
    logdir: str = "runs/coverage"


class Roll(nn.Module):
    """Bank angle and roll rate by one control."""

    def __init__(self, numbers: tuple[float, ...] = TRUTH) -> None:
        super().__init__()
        self.theta = nn.Parameter(torch.tensor(numbers, dtype=torch.float64))

    def forward(self, t: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """Rates of bank angle and roll rate."""
        phi, p = x.unbind(-1)
        damping, stiffness, power = self.theta.unbind(-1)
        return torch.stack([p, damping * p + stiffness * phi + power * u[..., 0]], dim=-1)

    def output(self, x: Tensor, u: Tensor) -> Tensor:
        """Both states."""
        return x


def clean_flights() -> tuple[Tensor, Tensor]:
    """Controls [F, T, 1] and states [F, T, 2]: a multistep and a later pulse."""
    t = DT * torch.arange(round(SECONDS / DT), dtype=torch.float64)
    rows = []
    for k in range(FLIGHTS):
        late = 6.0 + 0.7 * k
        rows.append(1.0 * ((t > 1) & (t <= 2)) - 1.0 * ((t > 2) & (t <= 3)) + 1.0 * ((t > late) & (t <= late + 1.5)))
    controls = 0.1 * torch.stack(rows).unsqueeze(-1)
    with torch.no_grad():
        return controls, simulate(Roll(), torch.zeros(FLIGHTS, 2, dtype=torch.float64), controls, DT)


def noise(shape: tuple[int, ...], colour: float, rng: torch.Generator) -> Tensor:
    """Unit noise [F, T, n], stationary from the first sample."""
    e = torch.randn(shape, generator=rng, dtype=torch.float64)
    for k in range(1, shape[1]):
        e[:, k] = colour * e[:, k - 1] + (1.0 - colour**2) ** 0.5 * e[:, k]
    return e


def one_fit(controls: Tensor, states: Tensor, colour: float, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Estimates and standard errors by output error from one set of noisy flights."""
    outputs = states + NOISE * noise(tuple(states.shape), colour, rng)
    t = DT * torch.arange(states.shape[1], dtype=torch.float64)
    flights = [
        {"time": t, "controls": u, "outputs": y, "x0": torch.zeros(2)} for u, y in zip(controls, outputs, strict=True)
    ]
    estimate = output_error(Roll((-1.0, -1.5, 2.5)), flights, segment_lengths=[torch.inf])
    return torch.tensor([p.value for p in estimate.parameters]), torch.tensor([p.se for p in estimate.parameters])


def one_regression(controls: Tensor, states: Tensor, colour: float, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """The same by Fourier regression of the roll acceleration on roll rate, bank angle and control."""
    measured = states + NOISE * noise(tuple(states.shape), colour, rng)
    columns = torch.cat([measured.flip(-1), controls], dim=-1)
    declared = torch.tensor([float(NOISE[1]), float(NOISE[0]), 0.0], dtype=torch.float64)
    estimate = regress([m[:, 1] for m in measured], list(columns), DT, band=(0.1, 1.5), noise=declared)
    return estimate.coefficients, estimate.standard_errors


def coverage(
    name: str, one: Callable[..., tuple[Tensor, Tensor]], runs: int, colour: float, args: Args, writer: SummaryWriter
) -> dict:
    """Shares of the runs whose interval holds the truth."""
    rng = torch.Generator().manual_seed(args.seed)
    controls, states = clean_flights()
    truth, began = torch.tensor(TRUTH), time.perf_counter()
    values, errors = [], []
    for run in range(runs):
        value, error = one(controls, states, colour, rng)
        values.append(value)
        errors.append(error)
        if run % 50 == 49:
            held = ((torch.stack(values) - truth).abs() < 1.96 * torch.stack(errors)).double().mean()
            writer.add_scalar(f"pooled/{name}", held, run + 1)
    value, error = torch.stack(values), torch.stack(errors)
    held = ((value - truth).abs() < 1.96 * error).double()
    return {
        "runs": runs,
        "pooled": round(float(held.mean()), 4),
        "each": {n: round(float(h), 4) for n, h in zip(NAMES, held.mean(0), strict=True)},
        "bias_over_scatter": [round(float(b), 3) for b in (value.mean(0) - truth) / value.std(0)],
        "error_over_scatter": [round(float(b), 3) for b in error.mean(0) / value.std(0)],
        "seconds": round(time.perf_counter() - began, 1),
    }


def main(args: Args) -> None:
    """Run all steps and end with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    if args.quick:
        args.white_runs = args.coloured_runs = 20
        args.chain_runs, args.chain_lag_runs = 1, 0
    writer = SummaryWriter(args.logdir)
    writer.add_text("settings", json.dumps(asdict(args)))
    result = {
        "ftr_white": coverage("ftr_white", one_regression, args.white_runs, 0.0, args, writer),
        "ml_white": coverage("ml_white", one_fit, args.white_runs, 0.0, args, writer),
        "ml_coloured": coverage("ml_coloured", one_fit, args.coloured_runs, COLOUR, args, writer),
    }
    for name, runs, lag in (("chain", args.chain_runs, 0.0), ("chain_with_lag", args.chain_lag_runs, LAG)):
        if runs:
            result[name] = chain_coverage(name, runs, lag, args.seed, Path(args.logdir), writer)
    writer.close()
    print(json.dumps(result))


if __name__ == "__main__":
    main(tyro.cli(Args))
