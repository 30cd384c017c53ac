"""Whether two cases of textbooks in turbulence are identified within their errors, and how fast.

Roll and yaw of a transport by aileron, rudder and lateral velocity, one flight of 16 s at 20 Hz, 15 derivatives and 5
biases free, noise in both angular accelerations and on five outputs. Truth are derivatives as Jategaonkar gives them
(Flight Vehicle System Identification, ch. 5, Lp = -5.82 1/s); flights are exact, with new noise in every run.

The other is a business jet's pitch plane, one flight of 60 s at 10 Hz: four states, seven outputs, nonlinear, 11
coefficients of the size that flights of such a jet give, from half of the truth, turbulence in three of the states.

Expected: 98.8 % of the parameters within 2.5 of their errors, 95 % within 1.96; output error far outside.
--peer also fits the first flights by aeroid 0.5, where that is installed, with both noises held at their true sizes.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
import tyro

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import rotorid_torch as rotorid
from tests.identification.filter_error.gust_cases import (
    BIASES,
    JET,
    LATERAL,
    LATERAL_GUSTS,
    LATERAL_NOISE,
    Jet,
    jet_flight,
    lateral_flight,
    lateral_model,
)

TRUTH = LATERAL | BIASES
T = TypeVar("T")


@dataclass
class Args:
    """How many flights."""

    runs: int = 40
    quick: bool = False
    """Two flights."""
    jets: int = 12
    """Flights of the jet."""
    peer: int = 0
    """How many of the lateral flights aeroid fits too."""
    seed: int = 0


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """What comes of it, and seconds of processor."""
    began = time.process_time()
    return work(), time.process_time() - began


def by_aeroid(flight: dict[str, Any]) -> dict[str, float]:
    """Parameters by aeroid's filter error method, from 0.7 of the truth, both noises held at the truth."""
    import aeroid  # pyright: ignore[reportMissingImports]  # installed by whoever compares

    def moments(x: Any, u: Any, p: Any) -> list[float]:
        inputs = *x, *u, 1.0
        names = ("p", "r", "da", "dr", "v", "0")
        return [sum(p[f"{row}{n}"] * value for n, value in zip(names, inputs, strict=True)) for row in "LN"]

    def outputs(t: float, x: Any, u: Any, p: Any) -> list[float]:
        pdot, rdot = moments(x, u, p)
        ay = sum(p[f"Y{n}"] * value for n, value in zip(("p", "r", "da", "dr", "v"), (*x, *u), strict=True))
        return [pdot + p["bpdot"], rdot + p["brdot"], ay + p["bay"], *x]

    start = {n: 0.7 * v for n, v in LATERAL.items()} | dict.fromkeys(BIASES, 0.0)
    states, measured = ("p", "r"), ("pdot", "rdot", "ay", "p_measured", "r_measured")
    controls = ("da", "dr", "v")
    model = aeroid.Model(states, controls, start, lambda t, x, u, p: moments(x, u, p), measured, outputs)
    columns = dict(zip((*controls, *measured), [*flight["controls"].T, *flight["outputs"].T], strict=True))
    result = aeroid.identify(
        model,
        aeroid.FlightData(flight["time"], columns),
        list(start),
        method="filter_error",
        initial_guess={n: v or 0.01 for n, v in start.items()},  # its scale is the guess
        x0=flight["x0"],
        process_noise=dict(zip(states, np.square(LATERAL_GUSTS), strict=True)),
        measurement_noise=dict(zip(measured, np.square(LATERAL_NOISE), strict=True)),
        filter_options={"P0": 1e-12 * np.eye(2)},
    )
    return {n: float(result.parameters[n]) for n in TRUTH}


def jets(args: Args) -> dict[str, float]:
    """Differences from the truth of the jet's coefficients, in their errors: rms, and share within 2.5."""
    off = []
    for run in range(1 if args.quick else args.jets):
        start = Jet(**{n: 0.5 * v for n, v in JET.items()})
        fitted = rotorid.filter_error(start, [jet_flight(np.random.default_rng([args.seed, run]))])
        off.append([(p.value - JET[p.name]) / p.se for p in fitted.parameters])
    size = np.abs(np.asarray(off))
    return {"runs": len(off), "rms": float(np.sqrt((size**2).mean())), "within 2.5 errors": float((size < 2.5).mean())}


def main(args: Args) -> None:
    """Fit all and end with one JSON line."""
    torch.set_num_threads(1)
    off, calm_off, seconds, peers, converged = [], [], [], [], 0
    truth = np.asarray(list(TRUTH.values()))
    for run in range(2 if args.quick else args.runs):
        flight = lateral_flight(np.random.default_rng([args.seed, run]))
        fitted, used = timed(lambda flight=flight: rotorid.filter_error(lateral_model(0.7), [flight]))
        calm = rotorid.output_error(lateral_model(0.7), [flight])
        for into, result in ((off, fitted), (calm_off, calm)):
            into.append((np.asarray([p.value for p in result.parameters]) - truth) / [p.se for p in result.parameters])
        seconds.append(used)
        converged += fitted.converged
        if run < args.peer:
            values, other = timed(lambda flight=flight: by_aeroid(flight))
            peers.append({"seconds": round(other, 2), **{n: round(values[n], 3) for n in ("Lp", "Lda", "Nr")}})
            peers[-1]["ours"] = {n: round(fitted[n].value, 3) for n in ("Lp", "Lda", "Nr")}
    size = np.abs(np.asarray(off))
    summary = {
        "runs": len(off),
        "converged": converged,
        "within 2.5 errors": float((size < 2.5).mean()),
        "runs with all within 2.5": float((size < 2.5).all(axis=1).mean()),
        "within 1.96": float((size < 1.96).mean()),
        "worst share within 1.96": float((size < 1.96).mean(axis=0).min()),
        "output error within 2.5": float((np.abs(np.asarray(calm_off)) < 2.5).mean()),
        "processor s, first and median of the others": [seconds[0], float(np.median(seconds[1:]))],
        "jet": jets(args),
        "aeroid": peers,
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main(tyro.cli(Args))
