"""Neighbours of a model beside it: drawn from the errors of its parameters, and without one of its effects."""

from collections.abc import Sequence

import torch
from torch import Tensor

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.model.model import Model
from rotorid_torch.validate.free_run import Runs, Windows, free_run, windows
from rotorid_torch.validate.responses import compared
from rotorid_torch.validate.scores import horizon_samples

DRAWS = 12
"""Models that are drawn: a standard deviation of so many is right within 20 %."""
CENTRAL = 0.6827
"""Share of a normal distribution within one standard deviation; half of that range counts, for a run may fly away."""


def free_run_bands(
    model: Model, dataset: Dataset, flights: Sequence[str], names: Sequence[str], covariance: Tensor
) -> dict[str, dict[str, Tensor]]:
    """Standard deviation of the free runs of flights from their start on, by flight and channel [T].

    The body's initial state is that of the model itself, for all draws. All flights have one sample interval.

    names, covariance : parameters of the model that were estimated, and their covariance [P, P].

    Returns Nothing where the model cannot be compiled: a picture is not worth the time.
    """
    run = Runs.of(model)
    if run.compiled is None:
        return {}
    pieces = _pieces(model, dataset, flights)
    starts, theta = free_run(model, pieces, run)[0][:, 0], model.theta.detach().clone()
    places = torch.tensor([model.parameter_set.index(name) for name in names])
    outputs = []
    for step in _steps(covariance):
        with model.restored(), torch.no_grad():
            model.put(model.parameter_set.clamp(theta.index_add(0, places, step)))
            controls = _pieces(model, dataset, flights).controls  # behind the control path of this draw
            outputs.append(model.recorded(run(starts, controls, pieces.dt)[1], pieces.dt))
    edges = torch.tensor([0.5 - CENTRAL / 2.0, 0.5 + CENTRAL / 2.0], dtype=torch.float64)
    low, high = torch.quantile(torch.stack(outputs), edges, dim=0)
    deviation = 0.5 * (high - low)
    return _by_flight(model, dataset, flights, deviation)


def without(model: Model, dataset: Dataset, flights: Sequence[str], effect: str) -> dict[str, dict[str, Tensor]]:
    """What the model does on flights where an effect of it does nothing, by flight and channel [T].

    Free runs from the start on; of multirotors accelerations at measured states, less a constant. Other parameters
    stay as they are.
    """
    sizes = model.parameter_set.sizes(effect)
    places = [model.parameter_set.index(p.name) for p in sizes]
    theta = model.theta.detach().clone()
    theta[places] = torch.tensor([p.value for p in sizes], dtype=torch.float64)
    with model.restored(), torch.no_grad():
        model.put(theta)
        if dataset.kind == "multirotor":
            pairs = {name: compared(model, dataset.flights[name]) for name in flights}
            return {name: {c: m + (z - m).nanmean() for c, (z, m) in of.items()} for name, of in pairs.items()}
        outputs = free_run(model, _pieces(model, dataset, flights))[1]
    return _by_flight(model, dataset, flights, outputs)


def _pieces(model: Model, dataset: Dataset, flights: Sequence[str]) -> Windows:
    """The starts of these flights, with controls behind the model's control path."""
    return windows(model, dataset, [(name, 0) for name in flights], horizon_samples(dataset.facts[flights[0]].dt))


def _by_flight(model: Model, dataset: Dataset, flights: Sequence[str], records: Tensor) -> dict[str, dict[str, Tensor]]:
    """Records [F, T, ny] by flight and channel; of a flight that is shorter than the others as long as the flight."""
    cut = {name: records[k, : dataset.facts[name].samples] for k, name in enumerate(flights)}
    return {name: dict(zip(model.body.outputs, one.unbind(-1), strict=True)) for name, one in cut.items()}


def _steps(covariance: Tensor) -> Tensor:
    """Draws [DRAWS, P] about zero of this covariance, the same for every call."""
    values, vectors = torch.linalg.eigh(0.5 * (covariance + covariance.mT))
    normal = torch.randn(DRAWS, len(values), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return (normal * values.clamp(min=0.0).sqrt()) @ vectors.mT
