"""What turbulence does to a model, and how much of that any method could mend.

The built-in aircraft flies the same test in calm air and in turbulence, seeds that nothing was set on. Models of both
fly the calm validate flights; J in four ways:
  calm      : identified in calm air.
  gusts     : identified in gusts.
  best      : output error with the true gusts fed in but for what all flights have in common. That is a steady wind, by
              Galileo's principle the same as other trims: no method can do better than this but by chance.
  same air  : of the model identified in gusts, flown through the mean air of its flights (the common part of the true
              gusts taken away): what is left are its derivatives' errors.
Also: roll and pitch damping (rotor at equilibrium), on-axis derivatives by their errors, sizes of the gusts, processor
time of `identify`. Expected: "best" far above "calm" with eight flights of 15 s, whose gusts are slower than a flight.

A draw takes a minute of processor time; --quick is one draw.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import torch
import tyro
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import rotorid_torch as rotorid
from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.data import Dataset
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, Values
from rotorid_torch.identification.estimate.progressive_fit import Settings, fit
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.model_estimation import (
    STEP_3,
    averaged,
    initial_spread,
    lengths,
    records,
    sensor_noise,
)
from rotorid_torch.model.gusts import fed
from rotorid_torch.model.model import Model
from rotorid_torch.model.modes import state_matrix
from rotorid_torch.model.nominal import build
from rotorid_torch.report.records import GustRecord
from rotorid_torch.run.fit_record import judge
from rotorid_torch.run.result import Run
from rotorid_torch.simulation.flight.sensors import Channels

ON_AXIS = ("X.u", "Y.v", "Z.w", "L.p", "M.q", "N.r", "X.lon", "Y.lat", "Z.col", "L.lat", "M.lon", "N.ped")
HEIGHT = 27.4  # m, of the flight test
LENGTH = {"u": 144.0, "v": 144.0, "w": 27.4}  # m, Dryden's at that height


@dataclass
class Args:
    """Which draws."""

    draws: int = 10
    intensity: float = 1.0
    """m/s"""
    quick: bool = False
    """One draw."""
    seed: int = 100
    """Of the first draw."""


def dampings(model: Model) -> dict[str, float]:
    """Derivatives of roll by roll and pitch by pitch with the rotor at equilibrium, 1/s."""
    A, body = state_matrix(model), len(model.body.states)
    E = A[:body, :body] - A[:body, body:] @ torch.linalg.pinv(A[body:, body:]) @ A[body:, :body]
    return {n: float(E[i, i]) for n in ("p", "q") for i in [model.layout.names.index(n)]}


def true_gusts(truth: Mapping[str, Channels], data: Dataset) -> Tensor:
    """Gusts of the identify flights as step 3 has them [F, T, 3], m/s."""
    every = max(1, int(1.0 / (data.facts[data.identify[0]].dt * 50.0)))
    each = [torch.stack([torch.as_tensor(truth[f][f"effect_wind_{n}"]) for n in VELOCITIES], -1) for f in data.identify]
    return torch.stack([averaged(g.to(torch.float64), every) for g in each])


def with_true_gusts(run: Run, data: Dataset, gusts: Tensor) -> Model:
    """Step 3 of the run's structure with known gusts fed in."""
    model, names = build(run.spec), run.estimate.names
    with torch.no_grad():
        model.theta.copy_(run.regressions.theta)
    places = [model.parameter_set.index(n) for n in names]
    settings = Settings(
        sensor_noise=sensor_noise(model, data),
        lengths=lengths(model),
        prior_mean=model.parameter_set.values[places],
        prior_sd=model.parameter_set.prior_sd[places],
        x0_sd=initial_spread(model, data),
        options=STEP_3,
    )
    flights = records(model, data, run.reconstruction)
    flights = replace(flights, controls=torch.cat([flights.controls, gusts], dim=-1))
    fitted = fit(System(fed(model), names), flights, settings=settings)
    with torch.no_grad():
        model.theta[places] = fitted.theta
    return model


def on_axis(run: Run) -> tuple[Tensor, Tensor]:
    """On-axis derivatives and their standard errors, infinite where there is none."""
    named = {p.name: p for p in run.fit.parameters}
    each = [named[f"forces.{n}"] for n in ON_AXIS]
    values = torch.tensor([p.value if p.value is not None else math.nan for p in each])
    return values, torch.tensor([p.se or math.inf for p in each])


def sizes_off(gusts: GustRecord, intensity: float) -> tuple[float, float]:
    """Differences from the truth of intensity and of log length, in standard errors."""
    size, length = gusts.intensity or 0.0, gusts.length or 1.0
    share = (gusts.length_se or math.inf) / length
    return abs(size - intensity) / (gusts.intensity_se or math.inf), abs(math.log(length / LENGTH[gusts.axis])) / share


def in_mean_air(model: Model, common: Tensor) -> Model:
    """The model as it was, its reference moved to the air that its flights had in common, m/s [3]."""
    moved = dict(zip(VELOCITIES, common.tolist(), strict=True))
    moving = Model(model.body, [_Steady(moved), *model.chain], model.reference)
    moving.start_from(model.named_values)
    return moving


class _Steady(Effect):
    """Air that moves steadily along the body axes, against what the trims hold."""

    id, stage, role = "gusts", Stage.ENVIRONMENT, Role.NOMINAL

    def __init__(self, air: dict[str, float]) -> None:
        super().__init__(())
        self.air = air

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        """Velocities through the air."""
        return frame.with_air(*(frame.signals[n] + v for n, v in self.air.items())), x


def draw(seed: int, intensity: float) -> dict:
    """One aircraft test at hover, 10 or 20 m/s."""
    speed = (0.0, 10.0, 20.0)[seed % 3]
    calm = rotorid.fly(None, speed=speed, seed=seed).dataset()
    test = rotorid.fly(None, speed=speed, seed=seed, effects=[("environment.turbulence", intensity)])
    rough = test.dataset()
    reference = rotorid.identify(calm)
    before = time.process_time()
    run = rotorid.identify(rough)
    seconds = time.process_time() - before
    gusts = true_gusts(test.truth, rough)
    common = gusts.mean(dim=(0, 1))
    best = with_true_gusts(run, rough, gusts - common)
    value = lambda model: judge(model, calm).scores.validate  # noqa: E731
    (a, a_se), (b, b_se) = on_axis(reference), on_axis(run)
    off = ((b - a).abs() / torch.hypot(a_se, b_se)).tolist()
    first, second = dampings(reference.model), dampings(run.model)
    return {
        "seed": seed,
        "speed": speed,
        "method": run.estimate.method,
        "J": {
            "calm": value(reference.model),
            "gusts": value(run.model),
            "best": value(best),
            "same air": value(in_mean_air(run.model, common)),
        },
        "damping off": {n: second[n] / first[n] - 1.0 for n in first},
        "on axis within 2.5": sum(x < 2.5 for x in off) / len(off),
        "errors off": [x for g in run.fit.gusts for x in sizes_off(g, intensity)],
        "intensity": {g.axis: (g.intensity or 0.0) / intensity for g in run.fit.gusts},
        "length": {g.axis: (g.length or 0.0) / LENGTH[g.axis] for g in run.fit.gusts},
        "processor s": seconds,
    }


def main(args: Args) -> None:
    """All draws, a line each; the last line sums up."""
    torch.set_num_threads(1)
    rows = []
    for k in range(1 if args.quick else args.draws):
        rows.append(draw(args.seed + k, args.intensity))
        print(json.dumps(rows[-1]), flush=True)
    ratio = {n: sum(r["J"][n] / r["J"]["calm"] for r in rows) / len(rows) for n in ("gusts", "best", "same air")}
    sizes = [x for r in rows for x in r["intensity"].values()]
    scales = [x for r in rows for x in r["length"].values()]
    summary = {
        "draws": len(rows),
        "J over calm": ratio,
        "damping off": {n: sum(r["damping off"][n] for r in rows) / len(rows) for n in ("p", "q")},
        "on axis within 2.5": sum(r["on axis within 2.5"] for r in rows) / len(rows),
        "intensity within 15 %": sum(abs(x - 1.0) < 0.15 for x in sizes) / max(len(sizes), 1),
        "length within 40 %": sum(abs(x - 1.0) < 0.4 for x in scales) / max(len(scales), 1),
        "sizes of gusts within 2 errors": sum(x < 2.0 for r in rows for x in r["errors off"]) / max(2 * len(sizes), 1),
        "processor s": sum(r["processor s"] for r in rows) / len(rows),
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main(tyro.cli(Args))
