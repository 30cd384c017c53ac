"""A network beside a helicopter's physics, trained on equations first, then over trajectories together with it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Options
from rotorid_torch.effects.base import Frame
from rotorid_torch.effects.families.neural import TRUST, NeuralForces
from rotorid_torch.identification.estimate.segments import Records, cut
from rotorid_torch.learning import network
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import Care, Fitted, Flights, Residual, refit
from rotorid_torch.trace.evidence.residual import ALIKE_S, LeftOver, left_over
from rotorid_torch.trace.search.decide import likelihood_gain
from rotorid_torch.trace.terms.settings import SETTINGS

LEARNING = Options(max_iterations=15, tolerance=1e-6, absolute=0.5)
"""Over trajectories: weights go on moving long after the residual has stopped to."""


def learn(
    null: Fitted, held: Sequence[str] = (), seed: int = 0, say: Callable[[str], None] = lambda line: None
) -> network.Learnt:
    """A network trained on what a traced model leaves over, and what it is worth.

    null : the model with everything that was traced. held : parameters that no fit moves.
    seed : of the hidden layers that training begins from, and of the turned residuals.
    say : told what happens, a line at a time.
    """
    chance = torch.Generator().manual_seed(seed)
    fitted = trained(null, held, seed)
    better = null.unseen_log_ratios(fitted)
    gained = f"log-likelihood gain {likelihood_gain(null, fitted):.3g} per sample"
    say(f"network: {gained}, errors of unseen flights fall by {network.percent(better)}")

    def meaningless() -> Tensor:
        turn = network.turns(null.flights, chance)
        base = refit(null.spec, turned(null, turn), null.values, held)
        return base.unseen_log_ratios(trained(base, held, seed, turn))

    return network.Learnt(fitted.spec, fitted.values, better, network.by_chance(better, meaningless, say))


def trained(null: Fitted, held: Sequence[str] = (), seed: int = 0, turn: network.Turn | None = None) -> Fitted:
    """A fitted model with a network beside its physics: trained on equations first, then over trajectories with them.

    turn : of the equations' residual, where it is to mean nothing.
    """
    dataset, reconstruction = null.flights.dataset, null.flights.reconstruction
    over = left_over(null.model, dataset, reconstruction, dataset.identify)
    if turn is not None:
        over = with_turned_residual(over, [turn[name] for name in dataset.identify])
    sizes = {**null.spec.sizes, TRUST: memory(null) ** -0.5}
    spec = msgspec.structs.replace(null.spec, effects=(*null.spec.effects, NeuralForces.id), sizes=sizes)
    weights = regressed(build(spec), over, seed)
    return refit(spec, null.flights, {**null.values, **weights}, held, care=Care(LEARNING))


def memory(fitted: Fitted) -> float:
    """Samples for which the residual of a fit stays what it is.

    So many together tell as much as one would beside white noise, and the prior of a network's weights has to know.
    """
    return network.correlated(_residuals(fitted, fitted.identified).values())


def regressed(model: Model, over: LeftOver, seed: int = 0, linear: bool = False) -> dict[str, float]:
    """Weights of a model's network by their full names, from what the equations leave over on the measured motion.

    linear : let the network have what linear terms could take up as well, all but trims.
    """
    effect = network.network_of(model)
    signals = {n: over.signals[:, i] + model.reference.get(n, 0.0) for i, n in enumerate(over.names)}
    linear_terms = [] if linear else [over.signals]
    basis = torch.cat([*linear_terms, over.constants, over.tilts], dim=1)
    rows = [over.rows.index(r) for r in effect.rows]
    misfit = network.Misfit.of(effect, Frame(signals), basis, over.residual[:, rows], ALIKE_S * over.rate)
    return misfit.minimised(seed)


@dataclass(frozen=True)
class _Turned(Flights):
    """Flights as a model flew them, and its residual turned in time added: nothing in it goes with any motion."""

    outputs: Mapping[str, Tensor] = field(default_factory=dict)

    def records(self, model: Model, listed: Sequence[str]) -> Records:
        """These flights as the fits see them."""
        measured = super().records(model, listed)
        outputs = torch.full_like(measured.outputs, torch.nan)
        for f, name in enumerate(listed):
            outputs[f, : len(self.outputs[name])] = self.outputs[name]
        return replace(measured, outputs=outputs)


def turned(fitted: Fitted, turn: network.Turn) -> Flights:
    """The flights of a fit, with a residual that means nothing."""
    outputs: dict[str, Tensor] = {}
    for part in (fitted.identified, fitted.unseen):
        records = fitted.flights.records(fitted.model, part.names)
        for f, (name, over) in enumerate(_residuals(fitted, part).items()):
            outputs[name] = records.outputs[f, : len(over)] - over + network.rolled(over, turn[name])
    flights = fitted.flights
    return _Turned(flights.dataset, flights.reconstruction, flights.weather, outputs)


def _residuals(fitted: Fitted, part: Residual) -> dict[str, Tensor]:
    """Each flight's residual as one record [T, ny], zero where nothing was measured."""
    records = fitted.flights.records(fitted.model, part.names)
    over = torch.zeros_like(records.outputs)
    cut(records, round(SETTINGS.segment_s / records.dt)).write(part.residual.nan_to_num(0.0), over)
    return {name: over[f, : int(records.lengths[f])] for f, name in enumerate(part.names)}


def with_turned_residual(over: LeftOver, by_flight: Sequence[tuple[float, float]]) -> LeftOver:
    """The equations' residual turned flight by flight."""
    residual = over.residual.clone()
    for f, turn in enumerate(by_flight):
        mine = over.flight == f
        residual[mine] = network.rolled(over.residual[mine], turn)
    return replace(over, residual=residual)
