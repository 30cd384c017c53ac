"""Fits that are compared with each other: the same flights, the same segments, the same care, one effect more or less.

Every model is fitted on the identify flights from the parameters of a model before it. What decides is the misfit on
validate flights: their segments from initial states of their own, parameters held, residuals in units that are the same
for all models.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from typing import Any, Self, TypeVar

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Options
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.estimate import progressive_fit
from rotorid_torch.identification.estimate.initial_states import best_states, filled, fitted_states
from rotorid_torch.identification.estimate.likelihood import Likelihood, Place
from rotorid_torch.identification.estimate.residuals import Noise
from rotorid_torch.identification.estimate.segments import Records, cut
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.gusts import Weather
from rotorid_torch.identification.model_estimation import initial_spread, records, sensor_noise
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.model.gusts import without_gust_inputs
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.terms.settings import SETTINGS

CAREFUL = Options(max_iterations=25, tolerance=1e-6, absolute=0.5)
"""Of every fit that is compared: differences that matter are hundreds of times larger."""
BEGINNING = replace(CAREFUL, max_iterations=4, damping=1e-2)
"""Of fits from several starts, of which the best goes on."""


@dataclass(frozen=True)
class Flights:
    """What all fits of a data set share.

    weather : of flights whose gusts are among their channels.
    """

    dataset: Dataset
    reconstruction: Reconstruction
    weather: Weather | None = None

    def records(self, model: Model, listed: Sequence[str]) -> Records:
        """These flights as the fits see them."""
        return records(model, replace(self.dataset, identify=tuple(listed)), self.reconstruction)


@dataclass(frozen=True, eq=False)
class FittedModel(ABC):
    """A model fitted on the identify flights, by whatever residual it is scored.

    spec : its structure. model : with its parameters. flights : what all fits of the data set share.
    """

    spec: ModelSpec
    model: Model
    flights: Flights

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by its full name."""
        return self.model.named_values

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Free parameters."""

    @property
    @abstractmethod
    def cost(self) -> float:
        """Minus log-likelihood of the identify flights."""

    @property
    @abstractmethod
    def per_sample(self) -> float:
        """Measured values of the identify flights."""

    @abstractmethod
    def error(self, name: str) -> float:
        """Standard error of a parameter, infinite where it was not estimated or cannot be told."""

    @abstractmethod
    def scatter(self, effect: str) -> dict[str, float]:
        """Standard errors of an effect's free parameters by leaving out one flight in turn."""

    @abstractmethod
    def log_ratios(self, other: Any) -> Tensor:
        """Mean over the channels of log(rms of this model / rms of the other) of each flight, fitted or not [F]."""

    @abstractmethod
    def unseen_log_ratios(self, other: Any) -> Tensor:
        """The same of flights that no fit has seen; of the fitted ones where there are no others [F]."""


FittedT = TypeVar("FittedT", bound=FittedModel)


@dataclass(frozen=True, eq=False)
class Fitted(FittedModel):
    """A model fitted to trajectories over segments of the identify flights.

    fit : the estimate with its segments.
    """

    fit: progressive_fit.Fit
    _errors: dict[tuple[str, ...], dict[str, float]] = field(default_factory=dict, init=False, repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, in the order of the fit's theta."""
        return self.fit.likelihood.system.names

    @cached_property
    def in_still_air(self) -> Fitted:
        """The same values without gusts fed in: a smoother takes for gusts what sways for itself."""
        if self.flights.weather is None:
            return self
        spec = without_gust_inputs(self.spec)
        return replace(self, spec=spec, model=build(spec, self.values))

    @property
    def cost(self) -> float:
        """Minus log-likelihood of the identify flights, priors included."""
        return self.fit.minimum.point.cost

    @property
    def per_sample(self) -> float:
        """Measured values of the identify flights."""
        return float(self.fit.likelihood.samples)

    def error(self, name: str) -> float:
        """Standard error of a parameter, infinite where it was not estimated or cannot be told."""
        effects = tuple(f"{e}." for e in self.spec.effects)  # together: the colour of residuals is half of the work
        group = effects if name.startswith(effects) else (f"{name.rpartition('.')[0]}.",)
        if name in self.names and group not in self._errors:
            alike = [n.startswith(group) for n in self.names]
            errors = self.fit.errors_of(torch.tensor(alike)).tolist()
            self._errors[group] = dict(zip(compress(self.names, alike), errors, strict=True))
        return self._errors.get(group, {}).get(name, math.inf)

    def scatter(self, effect: str) -> dict[str, float]:
        """Standard errors of an effect's free parameters by leaving out one flight in turn; zero where none is told."""
        variances = zip(self.names, self.fit.jackknife.nan_to_num(0.0).tolist(), strict=True)
        return {name: math.sqrt(v) for name, v in variances if name.startswith(f"{effect}.")}

    @cached_property
    def unseen(self) -> Residual:
        """The flights that decide, under this model."""
        return Residual.of(self.flights.dataset.unseen, *self.on_unseen)

    def log_ratios(self, other: Self) -> Tensor:
        """Mean over the channels of log(rms of this model / rms of the other) of each flight, fitted or not [F + V]."""
        pairs = [(self.identified, other.identified)]
        pairs += [(self.unseen, other.unseen)] if self.flights.dataset.validate else []
        return torch.cat([_log_ratios(*pair) for pair in pairs])

    def unseen_log_ratios(self, other: Self) -> Tensor:
        """The same of flights that no fit has seen; of the fitted ones where there are no others."""
        return _log_ratios(self.unseen, other.unseen)

    @cached_property
    def on_unseen(self) -> tuple[Likelihood, Place]:
        """The likelihood of these flights' segments, and the place with the best initial states, parameters held."""
        fit, theta, dataset = self.fit.likelihood, self.fit.theta, self.flights.dataset
        records = self.flights.records(self.model, dataset.unseen)
        segments = cut(records, round(SETTINGS.segment_s / records.dt))
        guess = segments.first(records.states)
        problem = Likelihood(
            system=fit.system,
            engine=fit.engine,
            records=records,
            segments=segments,
            states=records.states,
            noise=Noise("held", fit.noise.least, self.fit.minimum.point.covariance),
            x0=filled(guess, records, segments),
            x0_mean=guess.nan_to_num(0.0),
            x0_sd=torch.where(guess.isnan(), math.inf, initial_spread(self.model, dataset)),
            prior_mean=theta,
            prior_sd=torch.full_like(theta, math.inf),
        )
        if bool(guess.isnan().any()):
            problem = replace(problem, x0=torch.where(guess.isnan(), fitted_states(problem, theta), problem.x0))
        return problem, best_states(problem, theta)

    @cached_property
    def identified(self) -> Residual:
        """The identify flights, under this model."""
        return Residual.of(self.flights.dataset.identify, self.fit.likelihood, self.fit.minimum.point)


@dataclass(frozen=True, eq=False)
class Residual:
    """Residuals [S, T, ny] of flights' segments (NaN = missing), and the flight of each."""

    names: Sequence[str]
    flight: Tensor
    residual: Tensor

    @classmethod
    def of(cls, names: Sequence[str], problem: Likelihood, place: Place) -> Self:
        """Of these flights' segments in a likelihood."""
        return cls(names, problem.segments.flight, torch.cat([part.residual for part in problem.parts(place)]))

    def size(self) -> Tensor:
        """Root mean square of each flight's residuals by channel [F, ny]."""
        sizes = [self.residual[self.flight == f].square().nanmean(dim=(0, 1)).sqrt() for f in range(len(self.names))]
        return torch.stack(sizes)


def _log_ratios(before: Residual, after: Residual) -> Tensor:
    return (before.size().log() - after.size().log()).nanmean(dim=1)


def total(log_ratios: Tensor) -> float:
    """Sum over the flights of log ratios [F]; a flight in which a model flies away tells no size."""
    return float(log_ratios[log_ratios.isfinite()].sum())


@dataclass(frozen=True)
class Care:
    """How a fit is carried out: when Gauss-Newton ends, and the lengths of segments, s, stage by stage."""

    options: Options = CAREFUL
    lengths: tuple[float, ...] = (SETTINGS.segment_s,)


def refit(
    spec: ModelSpec,
    flights: Flights,
    start: Mapping[str, float],
    held: Sequence[str] = (),
    near: Fitted | None = None,
    care: Care = Care(),
) -> Fitted:
    """The model of a spec fitted from a start; parameters that the start does not know begin at their declared values.

    held : parameters that keep their start. near : a fit whose trajectories initial states start from. care : how the
    fit is carried out.
    """
    model = build(spec, start)
    numbers = model.parameter_set
    names = tuple(n for n in numbers.free if n not in held)
    places = [numbers.index(n) for n in names]
    settings = progressive_fit.Settings(
        sensor_noise=sensor_noise(model, flights.dataset),
        lengths=care.lengths,
        prior_mean=numbers.values[places],
        prior_sd=numbers.prior_sd[places],
        x0_sd=initial_spread(model, flights.dataset),
        options=care.options,
    )
    records = flights.records(model, flights.dataset.identify)
    states = None if near is None else _followed(near, model, records.states)
    fitted = progressive_fit.fit(System(model, names), records, progressive_fit.Start(states=states), settings)
    with torch.no_grad():
        model.theta[places] = fitted.theta
    return Fitted(spec, model, flights, fitted)


def _followed(near: Fitted, model: Model, states: Tensor) -> Tensor:
    """States [F, T, nx] of a model's records, as a fit of another one follows them where both have them."""
    fit, layout, near_layout = near.fit, model.layout, near.model.layout
    followed = fit.likelihood.states_at(fit.minimum.point, fit.likelihood.records.states)
    shared, states = [name for name in layout.names if near_layout.has(name)], states.clone()
    states[..., layout.places(shared)] = followed[..., near_layout.places(shared)]
    return states
