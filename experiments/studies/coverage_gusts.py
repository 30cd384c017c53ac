"""Do 95 % intervals of the filter error method hold the truth in 95 of 100 runs? Flights in moving air, known exactly.

Roll and yaw of a transport by aileron, rudder and lateral velocity, three flights of 16 s at 20 Hz; white noise in the
angular accelerations (process noise F, each axis) and on five outputs (R). New noise of both kinds in every run.
Counted are the intervals of the 20 parameters, of F and of R, and where output error ends on the same flights.

Expected: pooled 0.93-0.97 for each of the three kinds, each number above 0.90.
"""

from __future__ import annotations

import json
import random
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from torch.utils.tensorboard import SummaryWriter

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from rotorid_torch.identification.estimate.output_error import ParameterEstimate, output_error
from rotorid_torch.identification.filter_error.method import filter_error
from rotorid_torch.identification.filter_error.result import FilterError
from tests.identification.filter_error.gust_cases import (
    BIASES,
    LATERAL,
    LATERAL_GUSTS,
    LATERAL_NOISE,
    lateral_flight,
    lateral_model,
)

TRUTH = {"parameters": list((LATERAL | BIASES).values()), "F": list(LATERAL_GUSTS), "R": list(LATERAL_NOISE)}


@dataclass
class Args:
    """Settings of the Monte Carlo."""

    runs: int = 2000
    flights: int = 3
    calm_runs: int = 100
    """Runs that output error looks at too."""
    quick: bool = False
    """400 runs; output error 20."""
    seed: int = 0
    logdir: str = "runs/coverage_gusts"


def estimates(estimate: FilterError) -> dict[str, list[ParameterEstimate]]:
    """What is counted, by kind."""
    return {"parameters": estimate.parameters, "F": estimate.process_noise, "R": estimate.measurement_noise}


def summary(kind: str, values: np.ndarray, errors: np.ndarray, names: list[str]) -> dict:
    """Shares of the runs [n, k] whose interval holds the truth."""
    truth = np.asarray(TRUTH[kind])
    held = np.abs(values - truth) < 1.96 * errors
    return {
        "pooled": round(float(held.mean()), 4),
        "each": {n: round(float(h), 3) for n, h in zip(names, held.mean(axis=0), strict=True)},
        "bias_over_scatter": [round(float(b), 2) for b in (values.mean(axis=0) - truth) / values.std(axis=0)],
        "error_over_scatter": [round(float(b), 2) for b in errors.mean(axis=0) / values.std(axis=0)],
    }


def main(args: Args) -> None:
    """Run all and end with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    if args.quick:
        args.runs, args.calm_runs = 400, 20
    writer = SummaryWriter(args.logdir)
    writer.add_text("settings", json.dumps(asdict(args)))
    values: dict[str, list] = {kind: [] for kind in TRUTH}
    errors: dict[str, list] = {kind: [] for kind in TRUTH}
    names: dict[str, list[str]] = {}
    calm, converged, began = [], 0, time.perf_counter()
    for run in range(args.runs):
        flights = [lateral_flight(np.random.default_rng([args.seed, run, k])) for k in range(args.flights)]
        estimate = filter_error(lateral_model(0.7), flights)
        converged += estimate.converged
        for kind, estimated in estimates(estimate).items():
            values[kind].append([p.value for p in estimated])
            errors[kind].append([p.se for p in estimated])
            names[kind] = [p.name for p in estimated]
        if run < args.calm_runs:
            calm.append([p.value for p in output_error(lateral_model(0.7), flights).parameters])
        if run % 50 == 49:
            wrong = np.abs(np.asarray(values["parameters"]) - TRUTH["parameters"])
            writer.add_scalar("pooled", (wrong < 1.96 * np.asarray(errors["parameters"])).mean(), run + 1)
    result: dict = {k: summary(k, np.asarray(values[k]), np.asarray(errors[k]), names[k]) for k in TRUTH}
    at = [names["parameters"].index(name) for name in ("Lp", "Lda", "Nr")]
    spread = np.quantile(np.asarray(calm)[:, at], [0.1, 0.5, 0.9], axis=0)
    result["output_error_p10_p50_p90"] = {
        n: c.round(2).tolist() for n, c in zip(("Lp", "Lda", "Nr"), spread.T, strict=True)
    }
    result |= {"runs": args.runs, "converged": converged, "seconds": round(time.perf_counter() - began, 1)}
    writer.close()
    print(json.dumps(result))


if __name__ == "__main__":
    main(tyro.cli(Args))
