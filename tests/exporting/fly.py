"""Flies an exported C model: a small program about it, which reads controls and writes what the model says."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core.integrate import simulate
from rotorid_torch.exporting.c_source import ModelSource, c_source
from rotorid_torch.exporting.compiler import c_compiler
from rotorid_torch.model.model import Model
from rotorid_torch.model.training.equilibrium import equilibrium

DT = 0.02
SAMPLES = 40
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-O0")
PROGRAM = """
#include <stdio.h>
#include <stdlib.h>
#include "NAME.h"
int main(int count, char** words) {
  static NAME_model m;
  const double dt = atof(words[1]);
  double u[UPPER_NU];
  int i, first = 1;
  (void)count;
  NAME_defaults(&m);
  m.step = dt;
  for (i = 0; i < UPPER_NX; i++) if (scanf("%lf", &m.start[i]) != 1) return 1;
  for (;;) {
    for (i = 0; i < UPPER_NU; i++) if (scanf("%lf", &u[i]) != 1) return 0;
    if (first) { for (i = 0; i < UPPER_NU; i++) m.u[i] = u[i]; NAME_begin(&m, 0.0); } else NAME_step(&m, u, dt);
    first = 0;
    for (i = 0; i < UPPER_NX; i++) printf("%.17g ", m.x[i]);
    for (i = 0; i < UPPER_NY; i++) printf("%.17g ", m.y[i]);
    printf("\\n");
  }
}
"""


def fly_c(source: ModelSource, folder: Path, start: Sequence[float], controls: Tensor, dt: float) -> np.ndarray:
    """States and outputs [T, nx + ny] of the compiled program under controls [T, nu]; warnings are errors."""
    source.write(folder)
    text = PROGRAM.replace("UPPER", source.name.upper()).replace("NAME", source.name)
    (folder / "main.c").write_text(text)
    program = folder / "fly"
    files = [str(folder / "main.c"), str(folder / f"{source.name}.c")]
    subprocess.run([*c_compiler(), *STRICT, *files, "-o", str(program), "-lm"], check=True)
    lines = [" ".join(map(repr, row)) for row in (start, *controls.tolist())]
    done = subprocess.run([str(program), repr(dt)], input="\n".join(lines), capture_output=True, text=True, check=True)
    return np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])


@torch.no_grad()
def fly_torch(model: Model, start: Sequence[float], controls: Tensor, dt: float) -> np.ndarray:
    """The same by the model itself, in torch."""
    tape = model.tape(controls, dt)
    body = torch.tensor(start[: len(model.body.states)], dtype=torch.float64)
    x0 = equilibrium(model, body, tape[0])
    states = simulate(lambda t, x, u: model.rates(model.theta, x, u), x0, tape, dt)
    outputs = model.recorded(model.outputs_at(model.theta, states, tape), dt)
    return torch.cat([states, outputs], dim=-1).numpy()


def moved(model: Model, size: float = 0.02) -> Tensor:
    """Smooth controls about the reference [T, nu], steps of no more than one rate at a time."""
    time = DT * torch.arange(SAMPLES, dtype=torch.float64)[:, None]
    turns = torch.arange(1.0, len(model.body.controls) + 1.0, dtype=torch.float64)
    at = model.reference_point[1]
    scale = torch.where(at.abs() > 1.0, 0.1 * at.abs(), 1.0)
    return at + size * scale * torch.sin(3.0 * time * turns.sqrt() + turns)


def differs(model: Model, folder: Path) -> float:
    """Largest difference of states and outputs, over what they are at most."""
    x, _ = model.reference_point
    controls = moved(model)
    c = fly_c(c_source(model, "a model", DT), folder, x.tolist(), controls, DT)
    reference = fly_torch(model, x.tolist(), controls, DT)
    assert c.shape == reference.shape
    return float((np.abs(c - reference) / (1.0 + np.abs(reference))).max())
