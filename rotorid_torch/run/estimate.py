"""Steps 2 and 3 of one structure: regression, then maximum likelihood."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import torch
from torch import Tensor

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.model_estimation import Step3, estimate_model
from rotorid_torch.identification.model_regression import Step2, regress_model
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.identification.rotor_regression import regress_rotors
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.report import remarks
from rotorid_torch.run.output.checkpoint import Steps
from rotorid_torch.validate.predictions import unexplained_moments


def estimated(
    spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction, steps: Steps
) -> tuple[ModelSpec, Model, Step2, Step3]:
    """Steps 2 and 3 of one structure."""
    model, monitor = build(spec), steps.monitor
    regress = regress_rotors if spec.motors else regress_model
    regressions = steps.do("ftr", f"ftr-{spec.flapping}", lambda: regress(model, dataset, reconstruction))
    if spec.motors:
        spec, model, regressions = _told(spec, model, regressions, dataset)
    monitor.scalars({f"ftr/R2/{row}": float(r.r2) for row, r in regressions.regressions.items()}, 0)
    for line in remarks.regression_table(regressions):
        monitor.log(line)

    def watch(iteration: int, cost: float, theta: Tensor) -> None:
        monitor.scalars({"ml/cost": cost}, iteration)

    def third() -> Step3:
        return estimate_model(
            model, dataset, reconstruction, regressions, watch, steps.ranks, steps.device, steps.method
        )

    estimate = steps.do("ml", f"ml-{spec.flapping}", third)
    with torch.no_grad():
        model.theta.copy_(estimate.theta_of(model, regressions))
    monitor.say(f"flapping {spec.flapping}: Akaike's criterion {estimate.criterion:.6g}")
    return spec, model, regressions, estimate


def _told(spec: ModelSpec, model: Model, regressions: Step2, dataset: Dataset) -> tuple[ModelSpec, Model, Step2]:
    """A multirotor's structure with those control powers held at zero whose rates are better held than predicted."""
    with torch.no_grad():
        model.theta.copy_(regressions.theta)
    rows = unexplained_moments(model, (dataset.flights[name] for name in dataset.identify))
    held = [name for row in rows for name in (f"rotors.power.{row}", f"rotors.trim.{row}")]
    theta = regressions.theta.clone()
    theta[[model.parameter_set.index(name) for name in held]] = 0.0
    spec = msgspec.structs.replace(
        spec, free={**spec.free, **dict.fromkeys(held, False)}, values={**spec.values, **dict.fromkeys(held, 0.0)}
    )
    return spec, build(spec), replace(regressions, theta=theta)
