"""A small bounded network for what no effect explains, and whether it stays: only where unseen flights ask for it.

What a network gains by chance is measured: on flights of the same vehicle whose residual has been turned in time, so
that it means nothing, everything is done in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rotorid_torch.core.statistics import autocorrelation, correlation_time
from rotorid_torch.effects.base import Frame, Values
from rotorid_torch.effects.families.neural import NeuralForces
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.search.decide import Row
from rotorid_torch.trace.search.words import finding
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.significance import exceeds

STARTS = 2
"""Draws of the hidden layer that training begins from."""
STEPS = 100
"""Of L-BFGS from each."""
TRIALS = 3
"""Times that a network is trained where nothing is to be learnt, all of which it must exceed."""
EDGE = 0.1
"""Share of a flight by which its residual is turned at least, and at most one less that."""
STAYS = "it takes what is left: flights that no fit has seen are better described, without a name"

Turn = Mapping[str, tuple[float, float]]
"""Of each flight, by which share of its length its residual is turned in time, and with which sign."""


@dataclass(frozen=True, eq=False)
class Learnt:
    """A network beside a traced model.

    spec, values : of the model with it. better : mean log ratio of errors on each flight that no fit has seen,
    or part of one [F]. chance : its mean where nothing was to be learnt, once per trial; none where flights do not gain
    anyway.
    """

    spec: ModelSpec
    values: Mapping[str, float]
    better: Tensor
    chance: tuple[float, ...]

    @property
    def critical_value(self) -> float | None:
        """Most that unseen flights gained where nothing was to be learnt; None where that was not tried."""
        return max(0.0, *self.chance) if self.chance else None

    @property
    def objection(self) -> str | None:
        """Why the network does not stay; None where it does."""
        if self.critical_value is None:
            count = f"{int((self.better > 0).sum())} of {len(self.better)} better"
            return f"a network does not help on flights that no fit has seen ({count})"
        if float(self.better.mean()) <= self.critical_value:
            return "unseen flights gain no more by it than by a network that was trained where nothing is to be learnt"
        return None

    def finding(self) -> EffectFinding:
        """What the report says of it; statistic and critical value are mean log ratios of errors on unseen flights."""
        if not len(self.better):
            return finding(NeuralForces.id, Row(testable=False), lacking="no validate flight judges a network")
        said = finding(NeuralForces.id, Row(unseen_better=self.objection is None), self.objection or STAYS)
        return replace(said, statistic=float(self.better.mean()), critical_value=self.critical_value)


def by_chance(better: Tensor, meaningless: Callable[[], Tensor], say: Callable[[str], None]) -> tuple[float, ...]:
    """Mean gains of networks that are trained where nothing is to be learnt; none where flights do not gain anyway.

    better : log ratios of errors by a network. meaningless : trains another one, gives the same of that.
    """
    gains = []
    for _ in range(TRIALS if exceeds(better) else 0):
        evidence = meaningless()
        gains.append(float(evidence.mean()))
        say(f"network: where nothing is to be learnt they fall by {percent(evidence)}")
    return tuple(gains)


def percent(better: Tensor) -> str:
    """Mean fall of errors whose log ratios are given."""
    return f"{100.0 * float(-torch.expm1(-better.mean())):.2g} %"


def correlated(records: Iterable[Tensor]) -> float:
    """Correlation time in samples of residuals [T, n]: the mean over flights, of the channel where it is longest."""
    times = [correlation_time(autocorrelation(record, len(record) - 1)) for record in records]
    return float(torch.stack(times).mean(dim=0).max())


def network_of(model: Model) -> NeuralForces:
    """The network of a model."""
    return next(e for e in model.chain if isinstance(e, NeuralForces))


@dataclass(frozen=True, eq=False)
class Misfit:
    """Minus log-likelihood of residuals [N, rows] beside a network that sees these signals, and the weights' prior.

    Of residual and network only that counts which a basis cannot take up: it stays with the physics. The noise of each
    row is as it turns out. alike : samples that tell as much as one.
    """

    effect: NeuralForces
    identified: Frame
    basis: Tensor
    residual: Tensor
    alike: float

    @classmethod
    def of(cls, effect: NeuralForces, signals: Frame, basis: Tensor, residual: Tensor, alike: float) -> Misfit:
        """With a basis [N, n] of any columns."""
        return cls(effect, signals, torch.linalg.qr(basis).Q, residual, alike)

    def __call__(self, weights: Tensor) -> Tensor:
        """At weights [P]."""
        left = self.residual - self.forces(weights)
        left = left - self.basis @ (self.basis.mT @ left)
        mean, sd = torch.tensor([(p.value, p.prior_sd) for p in self.effect.declared], dtype=torch.float64).mT
        prior = 0.5 * ((weights - mean) / sd).square().sum()
        return 0.5 * len(left) / self.alike * left.square().mean(dim=0).log().sum() + prior

    def forces(self, weights: Tensor) -> Tensor:
        """What the network adds [N, rows]."""
        values = Values(weights, tuple(p.name for p in self.effect.declared))
        frame, _ = self.effect(self.identified, weights.new_zeros(len(self.residual), 0), values)
        return torch.cat([part for part in (frame.force, frame.moment) if part is not None], dim=-1)

    def minimised(self, seed: int) -> dict[str, float]:
        """Weights of the least of the minima from several starts, by full name."""
        minima = [_minimised(self, start) for start in self._starts(seed)]
        best = min(minima, key=lambda f: f[0])[1].tolist()
        return {f"{self.effect.id}.{p.name}": value for p, value in zip(self.effect.declared, best, strict=True)}

    def _starts(self, seed: int) -> list[Tensor]:
        """Weights to begin from: hidden layers drawn, those of the output zero."""
        mean = torch.tensor([p.value for p in self.effect.declared], dtype=torch.float64)
        chance, hidden = torch.Generator().manual_seed(seed), mean != 0.0
        draws = [torch.randn(len(mean), generator=chance, dtype=torch.float64) for _ in range(STARTS)]
        return [hidden * draw.clamp(-2.0, 2.0) / len(self.effect.inputs) ** 0.5 for draw in draws]


def _minimised(cost: Callable[[Tensor], Tensor], start: Tensor) -> tuple[float, Tensor]:
    """Least cost by L-BFGS, and where it is."""
    weights = start.clone().requires_grad_()
    search = torch.optim.LBFGS([weights], max_iter=STEPS, history_size=20, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        search.zero_grad()
        value = cost(weights)
        value.backward()
        return value

    search.step(closure)
    with torch.no_grad():
        return float(cost(weights)), weights.detach()


def turns(flights: Flights, chance: torch.Generator) -> Turn:
    """A turn for every flight that a fit has seen or will be judged by."""
    names = tuple(dict.fromkeys((*flights.dataset.identify, *flights.dataset.unseen)))
    shares = EDGE + (1.0 - 2.0 * EDGE) * torch.rand(len(names), generator=chance, dtype=torch.float64)
    signs = 2.0 * torch.randint(0, 2, (len(names),), generator=chance) - 1.0
    return {n: (float(share), float(sign)) for n, share, sign in zip(names, shares, signs, strict=True)}


def rolled(record: Tensor, turn: tuple[float, float]) -> Tensor:
    """A flight's record [T, n] turned in time, all channels alike."""
    share, sign = turn
    return sign * record.roll(round(share * len(record)), dims=0)
