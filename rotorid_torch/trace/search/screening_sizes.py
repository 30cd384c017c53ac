"""Sizes at which effects that declare no typical size are tried first: from their bounds and the flights.

A parameter moves from its declared value towards the farther bound until the model's outputs on the identify flights
change by a small share of their range. A parameter that changes nothing there is a shape, not a size.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import of_others, registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.training.equilibrium import equilibrium
from rotorid_torch.trace.evidence.screen import output_ranges, signatures
from rotorid_torch.trace.search.decide import Row
from rotorid_torch.trace.search.words import finding
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.validate.free_run import Runs, Windows, free_run, windows

MOST = 0.1
"""Rms of an output's change over its range that a size may make: visible, and still nearly in proportion."""
NOTHING = torch.finfo(torch.float64).eps ** 0.5
"""The same of rounding."""
FACTOR = 4.0
"""From one trial of a size to the next."""
UNMOVED = "no size of it within its bounds moves what these flights measured"


def with_screening_sizes(
    spec: ModelSpec, values: Mapping[str, float], dataset: Dataset, effects: Sequence[str]
) -> tuple[ModelSpec, list[str], list[EffectFinding]]:
    """The spec with sizes for users' effects that declare none, the effects that can be tested, findings of the others.

    Networks have weights and no size.

    values : parameters of the fitted model that the effects join.
    """
    sized = [e for e in of_others() if e in effects and registered()[e].role is not Role.LEARNT]
    asked = without_sizes(spec, sized)
    if not asked:
        return spec, [*effects], []
    sizes = screening_sizes(spec, values, dataset, asked)
    richer = msgspec.structs.replace(spec, screening_sizes=spec.screening_sizes | sizes)
    unmoved = without_sizes(richer, asked)
    findings = [finding(e, Row(testable=False), lacking=UNMOVED) for e in unmoved]
    return richer, [e for e in effects if e not in unmoved], findings


def without_sizes(spec: ModelSpec, effects: Sequence[str]) -> list[str]:
    """Those of these effects that declare no size to be tried at."""
    return [e for e in effects if not signatures(build(spec.with_effects(e)), [e])]


@torch.no_grad()
def screening_sizes(
    spec: ModelSpec, values: Mapping[str, float], dataset: Dataset, effects: Sequence[str]
) -> dict[str, float]:
    """Size of each parameter of these effects that changes the outputs, by full name.

    values : parameters of the fitted model that the effects join, each at its null.
    """
    by_name = {}
    for effect in effects:
        model = build(spec.with_effects(effect), {n: v for n, v in values.items() if not n.startswith(f"{effect}.")})
        change = _changes(model, dataset)
        for parameter in model.parameter_set.sizes(effect):
            size = _size(parameter, change) if parameter.free and not parameter.tried else None
            by_name |= {} if size is None else {parameter.name: size}
    return by_name


def _changes(model: Model, dataset: Dataset) -> Callable[[str, float], float]:
    """Largest relative change of an output by a parameter's value: rms over all free runs, over the output's range."""
    dt = dataset.facts[dataset.identify[0]].dt
    samples = round(SETTINGS.segment_s / dt) + 1
    places = [(n, k) for n in dataset.identify for k in range(0, dataset.facts[n].samples, samples)]
    run = Runs.of(model)

    def outputs(pieces: Windows, start: Tensor) -> Tensor:
        return model.recorded(run(start, pieces.controls, pieces.dt)[1], pieces.dt)

    usual = windows(model, dataset, places, samples)
    start = free_run(model, usual, run)[0][:, 0]
    before = outputs(usual, start)
    ranges = output_ranges(usual.measured.flatten(0, 1), usual.noise)
    body = start[:, : len(model.body.states)]

    def change(name: str, value: float) -> float:
        with model.restored():
            model.start_from({name: value})
            pieces = windows(model, dataset, places, samples)
            now = outputs(pieces, equilibrium(model, body, pieces.controls[:, 0], pieces.starts_at))
        changed = torch.where(usual.measured.isnan(), 0.0, now - before)
        largest = float((changed.square().mean(dim=(0, 1)).sqrt() / ranges).max())
        return largest if math.isfinite(largest) else math.inf

    return change


def _size(parameter: Parameter, change: Callable[[str, float], float]) -> float | None:
    """The largest value, from half-way to the farther bound on, that changes the outputs by MOST; None: by nothing.

    Where a threshold lies between that value and the one before, the one before.
    """
    low, high = (bound - parameter.value for bound in parameter.bounds)
    reach = high if high >= -low else low
    far = math.copysign(max(abs(parameter.value), 1.0) / NOTHING, reach)
    first = step = 0.5 * reach if math.isfinite(reach) else far
    while (moved := change(parameter.name, parameter.value + step)) > MOST:
        step /= FACTOR
    if moved <= NOTHING:
        return None if step == first else parameter.value + FACTOR * step
    return parameter.value + step
