"""The product's own model of the data set: an iteration of the fit, its engine, and step 1 whole."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import torch
from torch import Tensor

from benchmark.clock import interleaved, process, profile
from benchmark.rows import Figure
from benchmark.setting import Measured, Setting
from rotorid_torch.core.native.dynamics import Dynamics, LinearProblem
from rotorid_torch.data.dataset import Dataset, load
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification import step3
from rotorid_torch.identification.likelihood import Likelihood, Noise, Place
from rotorid_torch.identification.reconstruct import Reconstruction, reconstruct
from rotorid_torch.identification.segments import cut
from rotorid_torch.identification.structure import propose
from rotorid_torch.identification.system import System
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import save

EFFECTS = ("control.delay",)
"""Joined to the nominal model; the first that exists."""
SCRIPTS = Path(__file__).resolve().parents[1]
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


def likelihood(given: Prepared) -> Likelihood:
    """That of the fit's last stage, from the prior mean, initial states free."""
    model = given.model
    system = System(model, tuple(model.parameter_set.free))
    places = [model.parameter_set.index(name) for name in system.names]
    records = step3.records(model, given.dataset, given.reconstruction)
    noise = torch.tensor([given.dataset.noise(c) for c in model.body.outputs], dtype=torch.float64)
    segments = cut(records, min(round(SECONDS / records.dt), int(records.lengths.max())))
    x0 = segments.take(records.states)[:, 0].nan_to_num(0.0)
    return Likelihood(
        system=system,
        records=records,
        segments=segments,
        states=records.states,
        noise=Noise("diagonal", noise),
        x0=x0,
        x0_mean=x0,
        x0_sd=torch.full_like(x0, math.inf),
        prior_mean=model.parameter_set.values[places],
        prior_sd=model.parameter_set.prior_sd[places],
        bias_sd=torch.zeros(len(model.body.outputs), dtype=torch.float64),
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
    places = {"ROTORID_CACHE": str(setting.folder / "engine"), "PYTHONPATH": str(SCRIPTS)}
    found: Measured = {}
    for name in ("engine-new", "engine-cached"):
        _, said = process("-m", "benchmark.engine", str(file), **places)
        found[name] = Figure(float(said), "s")
    return found


def gauss_newton(setting: Setting) -> Measured:
    """Trajectories and linear model once, by both engines, from a place that has been linearised before."""
    problem = likelihood(prepared(setting.dataset()))
    theta = problem.system.theta
    base = problem.evaluate(theta)
    native, rows = native_iteration(problem, base), torch.cat([rows for rows, _ in problem.rows(base)], dim=1)
    products, expected = native(), rows.mT @ rows
    size = expected.diagonal(dim1=-2, dim2=-1).sqrt()
    scale = (size.unsqueeze(-1) * size.unsqueeze(-2)).clamp_min(1e-300)
    difference = float(((products - expected).triu().abs() / scale).max())
    problem.linearise(base)
    programs = {"native": native, "reference": lambda: problem.linearise(problem.evaluate(theta, base))}
    seconds = interleaved(programs, min(setting.repeats, 3))
    if setting.profile:
        setting.tell(profile("Gauss-Newton iteration, native", native))
    fast, slow = seconds["native"], seconds["reference"]
    return {
        "gauss-newton": Figure(fast, "s", f"reference engine, {slow:.3g} s", slow / fast),
        "accuracy-gauss-newton": Figure(difference, "relative", "reference engine"),
    }


def native_iteration(problem: Likelihood, base: Place) -> Callable[[], Tensor]:
    """Products of the whitened derivatives' columns [S, n, n] (upper part): initial states, parameters, residual."""
    system, segments, records = problem.system, problem.segments, problem.records
    theta, now, weight = system.theta, torch.zeros((), dtype=torch.float64), base.whitener.covariance.diagonal().rsqrt()
    length = segments.inside.sum(dim=1).to(torch.int32)
    which, _ = system.tape_jacobian(theta, records.controls, records.dt)
    engine = Dynamics.of(
        lambda x, u, th: system.rates(th, now, x, u),
        lambda x, u, th: system.output(th, x, u),
        problem.x0[0],
        records.controls[0, 0],
        theta,
        path=which.tolist(),
    )

    def program() -> Tensor:
        controls = segments.take(system.tape(theta, records.controls, records.dt))
        path = segments.take(system.tape_jacobian(theta, records.controls, records.dt)[1])
        _, outputs = engine.simulate(theta, problem.x0, controls, records.dt)
        residual = segments.outputs - outputs
        return engine.normal_equations(
            LinearProblem(records.dt, length, controls, path, residual, problem.x0, theta, weight)
        )[0]

    return program
