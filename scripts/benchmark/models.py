"""The product's own model of the data set: an iteration of the fit, its engine, and step 1 whole."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import torch
from torch import Tensor

from benchmark.clock import interleaved, process, profile
from benchmark.problems import on_threads
from benchmark.rows import Figure
from benchmark.setting import Measured, Setting
from rotorid_torch.core.gauss_newton import Linear
from rotorid_torch.data.dataset import Dataset, load
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification import model_estimation
from rotorid_torch.identification.estimate.engine import engine_for
from rotorid_torch.identification.estimate.likelihood import Likelihood, Place
from rotorid_torch.identification.estimate.residuals import Noise
from rotorid_torch.identification.estimate.segments import cut
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction, reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import save

EFFECTS = ("control.delay",)
"""Joined to the nominal model; the first that exists."""
SECONDS = 5.0
"""Length of the segments, as in the fit's last stage."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A data set after step 1, and the model that would be fitted to it."""

    dataset: Dataset
    reconstruction: Reconstruction
    spec: ModelSpec

    @property
    def model(self) -> Model:
        """At its prior mean."""
        return build(self.spec)


@lru_cache(maxsize=1)
def prepared(data: Path) -> Prepared:
    """Read, reconstruct, propose."""
    dataset = at_one_rate(load(data))
    found = reconstruct(dataset)
    return Prepared(dataset, found, propose(dataset, found, EFFECTS))


def likelihood(given: Prepared, engine: str) -> Likelihood:
    """That of the fit's last stage, from the prior mean, initial states free."""
    model = given.model
    system = System(model, tuple(model.parameter_set.free))
    places = [model.parameter_set.index(name) for name in system.names]
    records = model_estimation.records(model, given.dataset, given.reconstruction)
    noise = torch.tensor([given.dataset.noise(c) for c in model.body.outputs], dtype=torch.float64)
    segments = cut(records, min(round(SECONDS / records.dt), int(records.lengths.max())))
    x0 = segments.take(records.states)[:, 0].nan_to_num(0.0)
    return Likelihood(
        system=system,
        engine=engine_for(system, records, "rk4", engine),
        records=records,
        segments=segments,
        states=records.states,
        noise=Noise("diagonal", noise),
        x0=x0,
        x0_mean=x0,
        x0_sd=torch.full_like(x0, math.inf),
        prior_mean=model.parameter_set.values[places],
        prior_sd=model.parameter_set.prior_sd[places],
    )


def step1(setting: Setting) -> Measured:
    """`reconstruct` in this process, warm."""
    dataset = prepared(setting.dataset()).dataset
    program = partial(reconstruct, dataset)
    if setting.profile:
        setting.tell(profile("reconstruct", program))
    return {"reconstruct": Figure(interleaved({"": program}, min(setting.repeats, 3))[""], "s")}


def engine(setting: Setting) -> Measured:
    """The fit's engine for the model in fresh processes: with an empty cache, and with what the first one built."""
    given, file = prepared(setting.dataset()), setting.folder / "model.pt"
    save(given.model, given.spec, file)
    found: Measured = {}
    for name in ("engine-new", "engine-cached"):
        _, said = process("-m", "benchmark.engine", str(file), ROTORID_CACHE=str(setting.folder / "engine"))
        found[name] = Figure(float(said), "s")
    return found


def gauss_newton(setting: Setting) -> Measured:
    """Trajectories and linear model once, by both engines, from a place that has been linearised before."""
    given = prepared(setting.dataset())
    programs, linear = {}, {}
    for engine in ("native", "reference"):
        problem = likelihood(given, engine)
        theta = problem.system.theta
        base = problem.evaluate(theta)
        linear[engine] = problem.linearise(base)
        programs[engine] = partial(on_threads, 2, partial(iteration, problem, base, theta))
    seconds = interleaved(programs, min(setting.repeats, 3))
    if setting.profile:
        setting.tell(profile("Gauss-Newton iteration, native", programs["native"]))
    fast, slow = seconds["native"], seconds["reference"]
    return {
        "gauss-newton": Figure(fast, "s", f"reference engine, {slow:.3g} s", slow / fast),
        "accuracy-gauss-newton": Figure(_difference(**linear), "relative", "reference engine"),
    }


def iteration(problem: Likelihood, base: Place, theta: Tensor) -> Linear:
    """What one iteration asks of the likelihood: trajectories at a new place and the linear model there."""
    return problem.linearise(problem.evaluate(theta, base))


def _difference(native: Linear, reference: Linear) -> float:
    """Largest one of the normal equations' entries A'A and A'b, relative to their columns' sizes."""
    products = []
    for A, b, _ in (native, reference):
        whole = torch.cat([A, b.unsqueeze(-1)], dim=-1)
        products.append(whole.mT @ whole)
    size = products[1].diagonal().sqrt().clamp_min(1e-100)  # of a parameter that nothing depends on
    difference = (products[0] - products[1]).abs() / (size[:, None] * size)
    return float(difference[:-1].max())  # b'b, which is left of the cost, is no equation
