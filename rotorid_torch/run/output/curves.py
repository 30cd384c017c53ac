"""What TensorBoard shows of a fit by iteration: cost, step, parameters, and J of flights that it does not use."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.model.model import Model
from rotorid_torch.validate import scores
from rotorid_torch.validate.free_run import Runs, Windows, free_run, windows
from rotorid_torch.validate.windows import ScoredChannels

FLIGHTS = 4
"""Validate flights that J is of, at most."""
SHARE = 0.02
"""Share of a fit's time that J may take: iterations between have none."""


class Curves:
    """Called after each accepted step of a fit with iteration, cost, theta.

    record : takes numbers of an iteration by name.
    model : a model of the same structure, which takes every theta.
    names : parameters of theta, in order.
    """

    def __init__(
        self, record: Callable[[Mapping[str, float], int], None], model: Model, dataset: Dataset, names: Sequence[str]
    ) -> None:
        self._record, self._model, self._dataset, self._names = record, model, dataset, tuple(names)
        self._places = [model.parameter_set.index(name) for name in names]
        self._begin, self._spent, self._last = time.perf_counter(), 0.0, torch.zeros(0)
        self._iteration = 0

    def __call__(self, iteration: int, cost: float, theta: Tensor) -> None:
        """Record an iteration; where the theta holds more than the model's parameters, its cost and step alone."""
        theta, self._iteration = theta.detach().clone(), iteration
        values = {"ml/cost": cost}
        if len(self._last) == len(theta):
            values["ml/step"] = float((theta - self._last).norm() / theta.norm())
        self._last = theta
        if len(theta) == len(self._names):
            values |= {f"parameters/{name}": value for name, value in zip(self._names, theta.tolist(), strict=True)}
            values |= self._judged(theta)
        self._record(values, iteration)

    def end(self, errors: Tensor, dampings: Sequence[float]) -> None:
        """Record the standard errors [P] of the parameters where the fit ended, and the damping of its last steps."""
        for iteration, damping in enumerate(dampings, self._iteration - len(dampings) + 1):
            self._record({"ml/damping": damping}, iteration)
        pairs = zip(self._names, errors.tolist(), strict=True)
        self._record({f"standard errors/{name}": error for name, error in pairs}, self._iteration)

    def _judged(self, theta: Tensor) -> dict[str, float]:
        """J of validate flights, where the fit has gone on for long enough since the last one."""
        begin = time.perf_counter()
        late = self._spent > SHARE * (begin - self._begin)
        if late or self._dataset.kind == "multirotor" or not self._dataset.validate:
            return {}
        with torch.no_grad():
            self._model.theta[self._places] = theta
        scored, pieces = self._flights
        J = scored.J(pieces, free_run(self._model, pieces, self._runs)[1])
        self._spent += time.perf_counter() - begin
        return {"J/validate": float(scores.list_score(J))}

    @cached_property
    def _runs(self) -> Runs:
        return Runs.of(self._model)

    @cached_property
    def _flights(self) -> tuple[ScoredChannels, Windows]:
        dt = self._dataset.facts[self._dataset.validate[0]].dt
        names = [name for name in self._dataset.validate if self._dataset.facts[name].dt == dt][:FLIGHTS]
        samples = min(scores.horizon_samples(dt), max(self._dataset.facts[name].samples for name in names))
        places = [(name, 0) for name in names]
        return ScoredChannels.of(self._model, self._dataset), windows(self._model, self._dataset, places, samples)
