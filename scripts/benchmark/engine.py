"""Run as a process: how long it takes until the engine of a saved model answers, python -m benchmark.engine MODEL.pt.

The model is read beforehand; what is timed is tracing, emission, the compiler or the cache, loading, and one answer.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import torch
from torch import Tensor

from rotorid_torch.core.native.dynamics import Dynamics, LinearProblem
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.model.save import load


def answer(system: System, nx: int, nu: int, ny: int) -> Tensor:
    """Normal equations of two samples."""
    x0, controls = torch.zeros(1, nx, dtype=torch.float64), torch.zeros(1, 2, nu, dtype=torch.float64)
    now, theta = torch.zeros((), dtype=torch.float64), system.theta
    engine = Dynamics.of(
        lambda x, u, th: system.motion(th, now, x, u),
        x0[0],
        controls[0, 0],
        theta,
    )
    _, outputs = engine.simulate(theta, x0, controls, 0.01)
    length, weight = torch.full((1,), 2, dtype=torch.int32), torch.ones(ny, dtype=torch.float64)
    return engine.normal_equations(LinearProblem(0.01, length, controls, theta[:0], outputs, x0, theta, weight))[0]


if __name__ == "__main__":
    torch.set_num_threads(1)
    model, _ = load(Path(sys.argv[1]))
    parts = System(model, tuple(model.parameter_set.free)), len(model.layout.names), len(model.body.controls)
    begin = time.perf_counter()
    answer(*parts, len(model.body.outputs))
    print(time.perf_counter() - begin)
