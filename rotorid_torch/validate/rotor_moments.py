"""Which moments of a multirotor its rotors explain; the others are held at zero, and step 2 is made once more."""

from collections.abc import Iterable, Mapping

import msgspec

from rotorid_torch.core.names import MOMENTS
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.model_regression import ModelRegression
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.identification.rotor_regression import regress_rotors
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.rotors import beyond_belief
from rotorid_torch.validate.predictions import unexplained_moments

EXPLAINED = 0.3
"""R² of an angular acceleration at measured states below which rotors do not explain it: then commands answer the
rates, and a model of these moments would be one of the controller."""
FLIGHTS = 16
"""Flights that are predicted, at most."""


def regressed_rotors(
    spec: ModelSpec, dataset: Dataset, reconstruction: Reconstruction, begun: bool = False
) -> tuple[ModelSpec, ModelRegression]:
    """A multirotor's structure by what its moments explain, and step 2 of it: once more where a moment is held at zero.

    begun : whether the spec's values are those of a fit without some of its effects.
    """
    model = build(spec)
    regressions = regress_rotors(model, dataset, reconstruction, begun)
    silenced = _silenced(spec, model, regressions, dataset)
    if silenced == spec:
        return spec, regressions
    model, values = build(silenced), model.named_values
    model.start_from({n: v for n, v in values.items() if n not in silenced.values})
    return silenced, regress_rotors(model, dataset, reconstruction, begun)


def within_belief(spec: ModelSpec, values: Mapping[str, float]) -> ModelSpec:
    """The structure with those control powers held at zero that these values put too far from the declared."""
    return _without(spec, beyond_belief(spec, values)) if spec.motors else spec


def silent_moments(spec: ModelSpec) -> tuple[str, ...]:
    """Moments that the structure holds at zero."""
    return tuple(row for row in MOMENTS if spec.free.get(f"rotors.power.{row}") is False)


def _silenced(spec: ModelSpec, model: Model, regressions: ModelRegression, dataset: Dataset) -> ModelSpec:
    """A multirotor's structure with those control powers held at zero which explain little of the moments.

    That is of the angular accelerations, or of the rates, which are better held than predicted then; or they are so far
    from the declared that commands which answer the rates must be the reason.
    """
    r2 = dict(zip(MOMENTS, (regressions.explained[a] for a in ANGULAR_ACCELERATIONS), strict=True))
    model.put(regressions.theta)
    wrong = beyond_belief(spec, model.named_values)
    little = [row for row in MOMENTS if r2[row] < EXPLAINED or row in wrong]
    identify = (dataset.flights[name] for name in dataset.some(FLIGHTS))
    ahead = little if len(little) == len(MOMENTS) else unexplained_moments(model, identify)
    return _without(spec, [row for row in MOMENTS if row in {*little, *ahead}])


def _without(spec: ModelSpec, rows: Iterable[str]) -> ModelSpec:
    """The structure with all that makes these moments held at zero."""
    held = of_moments(spec, rows)
    free, values = spec.free | dict.fromkeys(held, False), spec.values | dict.fromkeys(held, 0.0)
    return msgspec.structs.replace(spec, free=free, values=values)


def of_moments(spec: ModelSpec, rows: Iterable[str]) -> list[str]:
    """Parameters that make these moments; all at zero where a moment is not explained."""
    powers = [f"rotors.{kind}.{row}" for row in rows for kind in ("power", "trim")]
    return [*powers, *(f"surfaces.{row}.{control}" for row in rows for control in spec.surfaces)]


def with_moments(spec: ModelSpec) -> ModelSpec:
    """The structure with every moment free: what a poorer model does not explain this one may."""
    held = of_moments(spec, MOMENTS)
    free = {n: value for n, value in spec.free.items() if n not in held}
    values = {n: value for n, value in spec.values.items() if n not in held or value != 0.0}
    return msgspec.structs.replace(spec, free=free, values=values)
