"""A network on what the named effects leave over of a multirotor's specific force, at measured states.

Nothing is integrated. The physics stands still while the weights are trained, and the weights while the steps run
again. Whether the network stays, blocks of the validate flights say, beside networks that were trained on a residual
that means nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.names import FORCES, SPECIFIC_FORCES
from rotorid_torch.effects.base import Frame
from rotorid_torch.effects.families.neural import TRUST, NeuralForces
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.measured_states import MeasuredStates, centred, shapes
from rotorid_torch.identification.rotor_equations import seen_flights
from rotorid_torch.learning import network
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.measured.fitted import FittedAtStates, log_ratios


@dataclass(frozen=True, eq=False)
class _LeftOver:
    """What a model leaves over of one flight's specific force [T, rows], and what its network sees [T, inputs]."""

    residual: Tensor
    inputs: Tensor


def learn_at_states(
    null: FittedAtStates, seed: int = 0, say: Callable[[str], None] = lambda line: None
) -> network.Learnt:
    """A network trained on what a multirotor's traced model leaves over, and what it is worth on validate flights.

    seed : of the hidden layers that training begins from, and of the turned residuals. say : told what happens.
    """
    dataset = null.flights.dataset
    if not dataset.validate:
        return network.Learnt(null.spec, null.values, torch.zeros(0, dtype=torch.float64), ())
    bare = build(_with_network(null.spec, null.values, {}))
    over = dict(_left_over(bare, null, (*dataset.identify, *dataset.validate)))
    fitted = [over[name] for name in dataset.identify]
    trust = network.correlated(one.residual for one in fitted) ** -0.5
    spec = _with_network(null.spec, null.values, {TRUST: trust})
    effect = network.network_of(build(spec))

    def trained(flights: Mapping[str, _LeftOver]) -> tuple[dict[str, float], Tensor]:
        """Weights by the identify flights, and log ratios of errors without and with them on blocks of the others."""
        weights = _misfit(effect, [flights[name] for name in dataset.identify]).minimised(seed)
        return weights, _better(effect, weights, [flights[name] for name in dataset.validate], null.block)

    weights, better = trained(over)
    say(f"network: errors of unseen flights fall by {network.percent(better)}")
    chance = torch.Generator().manual_seed(seed)
    gains = network.by_chance(better, lambda: trained(_turned(over, network.turns(null.flights, chance)))[1], say)
    return network.Learnt(spec, {**null.values, **weights}, better, gains)


def _with_network(spec: ModelSpec, values: Mapping[str, float], sizes: Mapping[str, float]) -> ModelSpec:
    """The spec with a network whose weights no fit moves."""
    sizes, spec = {**spec.sizes, **sizes}, spec.with_effects(NeuralForces.id)
    spec = msgspec.structs.replace(spec, values=dict(values), sizes=sizes)
    weights = [f"{NeuralForces.id}.{p.name}" for p in NeuralForces.from_spec(spec).declared]
    return msgspec.structs.replace(spec, free={**spec.free, **dict.fromkeys(weights, False)})


@torch.no_grad()
def _left_over(model: Model, null: FittedAtStates, listed: Sequence[str]) -> list[tuple[str, _LeftOver]]:
    """Of each flight, by a model whose network is silent."""
    effect, flights = network.network_of(model), []
    rows = [SPECIFIC_FORCES[FORCES.index(row)] for row in effect.rows]
    for name, one in zip(listed, seen_flights(model, null.flights.records(model, listed)), strict=True):
        states, theta = MeasuredStates.of(model, [one]), model.theta.detach()
        (left,), (flight,) = states.remainders(theta), states.equations.flights
        taped = flight.means(model.tape(flight.controls, flight.dt))
        inside = states.equations.accelerations.inside(flight.states, taped, flight.step)
        inputs = model.frame(theta, inside, taped, flight.step)[0].stack(effect.inputs)
        length = len(inputs)
        residual = [left[row] if row in left else torch.zeros(length, dtype=torch.float64) for row in rows]
        flights.append((name, _LeftOver(torch.stack(residual, -1).nan_to_num(0.0), inputs)))
    return flights


def _frame(effect: NeuralForces, flights: Sequence[_LeftOver]) -> Frame:
    inputs = torch.cat([one.inputs for one in flights])
    return Frame(dict(zip(effect.inputs, inputs.unbind(-1), strict=True)))


def _misfit(effect: NeuralForces, flights: Sequence[_LeftOver]) -> network.Misfit:
    """The constant and trend of each flight are its own."""
    lines = torch.block_diag(*(shapes(torch.ones(len(one.residual), dtype=torch.bool)).mT for one in flights))
    return network.Misfit.of(effect, _frame(effect, flights), lines, torch.cat([one.residual for one in flights]), 1.0)


def _better(effect: NeuralForces, weights: Mapping[str, float], flights: Sequence[_LeftOver], block: int) -> Tensor:
    """Mean over the rows of log(rms without / rms with the network) of blocks of flights [B]."""
    theta = torch.tensor([weights[f"{effect.id}.{p.name}"] for p in effect.declared], dtype=torch.float64)
    before, after = [], []
    for one in flights:
        with torch.no_grad():
            left = one.residual - _misfit(effect, [one]).forces(theta)
        for errors, record in ((before, one.residual), (after, left)):
            errors.append(dict(zip(effect.rows, centred(record.mT), strict=True)))
    return log_ratios(before, after, block)


def _turned(flights: Mapping[str, _LeftOver], turn: network.Turn) -> dict[str, _LeftOver]:
    """The flights with their residuals turned in time: nothing in these goes with any motion."""
    residuals = {name: centred(one.residual.mT).mT for name, one in flights.items()}
    return {name: _LeftOver(network.rolled(residuals[name], turn[name]), one.inputs) for name, one in flights.items()}
