"""Steps 2 and 3 of one structure: regression, then maximum likelihood."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.names import MOMENTS
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.model_estimation import Means, ModelEstimate, estimate_model
from rotorid_torch.identification.model_regression import ModelRegression, regress_model
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.identification.rotor_regression import regress_rotors
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.rotors import beyond_belief
from rotorid_torch.report import remarks
from rotorid_torch.run.output.checkpoint import Steps
from rotorid_torch.run.output.curves import Curves
from rotorid_torch.trace.multirotor import Identified
from rotorid_torch.validate.predictions import unexplained_moments

EXPLAINED = 0.3
"""R² of an angular acceleration at measured states below which the rotors do not explain it."""
PREDICTED = 6
"""Identify flights on which body rates are predicted, at most."""


def regressed(
    spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction, begun: bool = False
) -> tuple[ModelSpec, ModelRegression]:
    """Step 2 of one structure, behind the structure.

    Of a multirotor once more, with less of it, where the first says that a moment is not explained.

    begun : whether the spec's values are those of a fit without some of its effects.
    """
    if not spec.motors:
        return spec, regress_model(build(spec), dataset, reconstruction)
    spec = _open(spec)
    model = build(spec)
    regressions = regress_rotors(model, dataset, reconstruction, begun)
    reduced = _reduced(spec, model, regressions, dataset)
    if reduced == spec:
        return spec, regressions
    values, model = model.named_values, build(reduced)
    model.start_from({n: v for n, v in values.items() if n not in reduced.values})
    return reduced, regress_rotors(model, dataset, reconstruction, begun)


def at_measured_states(spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction) -> Identified:
    """A multirotor's model by step 2 alone, which is least squares of what its effects are judged by."""
    begun = any(name.startswith("rotors.thrust.") for name in spec.values)
    spec, regressions = regressed(spec, dataset, reconstruction, begun)
    model = build(spec)
    with torch.no_grad():
        model.theta.copy_(regressions.theta)
    return Identified(spec, model, regressions.errors, regressions.without)


def estimated(
    spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction, steps: Steps
) -> tuple[ModelSpec, Model, ModelRegression, ModelEstimate]:
    """Steps 2 and 3 of one structure."""
    monitor = steps.monitor
    spec, regressions = steps.do("ftr", f"ftr-{spec.flapping}", lambda: regressed(spec, dataset, reconstruction))
    model = build(spec)
    monitor.scalars({f"ftr/R2/{row}": float(r.r2) for row, r in regressions.regressions.items()}, 0)
    for line in remarks.regression_table(regressions):
        monitor.log(line)

    names = [n for n in model.parameter_set.free if n not in regressions.held]

    def third() -> ModelEstimate:
        with monitor.fit("-".join((spec.flapping or "fit", *spec.effects))[:80]) as record:
            curves = Curves(record, build(spec), dataset, names)

            def watch(iteration: int, cost: float, theta: Tensor) -> None:
                monitor.scalars({"ml/cost": cost}, iteration)
                if monitor.recorded:
                    curves(iteration, cost, theta)

            means = Means(watch, steps.ranks, steps.device, steps.method)
            estimate = estimate_model(model, dataset, reconstruction, regressions, means)
            curves.end(estimate.fit.uncertainty.standard_errors)
            return estimate

    estimate = steps.do("ml", f"ml-{spec.flapping}", third)
    with torch.no_grad():
        model.theta.copy_(estimate.theta_of(model, regressions))
    monitor.say(f"flapping {spec.flapping}: Akaike's criterion {estimate.criterion:.6g}")
    return spec, model, regressions, estimate


def _held(spec: ModelSpec, rows: Iterable[str]) -> list[str]:
    """Parameters of moments that are not explained."""
    own = [f"rotors.{kind}.{row}" for row in rows for kind in ("power", "trim")]
    return [*own, *(f"surfaces.{row}.{control}" for row in rows for control in spec.surfaces)]


def _open(spec: ModelSpec) -> ModelSpec:
    """The structure with every moment free: what a poorer model does not explain this one may."""
    free = {n: value for n, value in spec.free.items() if n not in _held(spec, MOMENTS)}
    values = {n: value for n, value in spec.values.items() if n not in _held(spec, MOMENTS) or value != 0.0}
    return msgspec.structs.replace(spec, free=free, values=values)


def _reduced(spec: ModelSpec, model: Model, regressions: ModelRegression, dataset: Dataset) -> ModelSpec:
    """A multirotor's structure with those control powers held at zero which explain little of the moments.

    That is of the angular accelerations, or of the rates, which are better held than predicted then; or they are so far
    from the declared that commands which answer the rates must be the reason.
    """
    r2 = dict(zip(MOMENTS, (regressions.explained[a] for a in ANGULAR_ACCELERATIONS), strict=True))
    with torch.no_grad():
        model.theta.copy_(regressions.theta)
    wrong = beyond_belief(spec, model.named_values)
    little = [row for row in MOMENTS if r2[row] < EXPLAINED or row in wrong]
    ahead = little if len(little) == len(MOMENTS) else unexplained_moments(model, _first(dataset))
    rows = [row for row in MOMENTS if row in {*little, *ahead}]
    held = _held(spec, rows)
    return msgspec.structs.replace(
        spec, free={**spec.free, **dict.fromkeys(held, False)}, values={**spec.values, **dict.fromkeys(held, 0.0)}
    )


def _first(dataset: Dataset) -> Iterator[Flight]:
    """The first identify flights, on which rates are predicted."""
    return (dataset.flights[name] for name in dataset.identify[:PREDICTED])
