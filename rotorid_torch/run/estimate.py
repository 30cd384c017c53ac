"""Steps 2 and 3 of one structure: regression, then maximum likelihood."""

from __future__ import annotations

from torch import Tensor

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.model_estimation import Means, ModelEstimate, estimate_model
from rotorid_torch.identification.model_regression import ModelRegression, regress_model
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.report import remarks
from rotorid_torch.run.output.checkpoint import Steps
from rotorid_torch.run.output.curves import Curves
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.measured.fitted import regressed_rotors


def regressed(spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction) -> tuple[ModelSpec, ModelRegression]:
    """Step 2 of one structure, behind the structure.

    Of a multirotor once more, with less of it, where the first says that a moment is not explained.
    """
    if spec.motors:
        return regressed_rotors(spec, Flights(dataset, reconstruction))
    return spec, regress_model(build(spec), dataset, reconstruction)


def estimated(
    spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction, steps: Steps
) -> tuple[ModelSpec, Model, ModelRegression, ModelEstimate]:
    """Steps 2 and 3 of one structure."""
    monitor = steps.monitor
    spec, regressions = steps.do("ftr", f"ftr-{spec.flapping}", lambda: regressed(spec, dataset, reconstruction))
    model = build(spec)
    monitor.scalars({f"ftr/R2/{row}": float(r.r2) for row, r in regressions.by_row.items()}, 0)
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

            means = Means(watch, steps.ranks, steps.device, steps.method, steps.why)
            estimate = estimate_model(model, dataset, reconstruction, regressions, means)
            curves.end(estimate.fit.uncertainty.standard_errors, estimate.fit.minimum.dampings)
            return estimate

    estimate = steps.do("ml", f"ml-{spec.flapping}", third)
    model.put(estimate.theta_of(model, regressions))
    monitor.say(f"flapping {spec.flapping}: Akaike's criterion {estimate.criterion:.6g}")
    return spec, model, regressions, estimate
