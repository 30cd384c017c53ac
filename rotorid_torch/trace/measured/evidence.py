"""Evidence for candidates in accelerations at measured states: all at once, in closed form about a fitted model.

The change of the modelled accelerations by a candidate at its usual size is its signature. From the normal equations
of the flights follows how much better the flights are explained whose equations did not give the signature's size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rotorid_torch.identification.measured_states import MeasuredStates
from rotorid_torch.identification.rotor_equations import Seen, seen_flights
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.evidence.held_out import FlightEquations
from rotorid_torch.trace.evidence.screen import Screen, Signature, signatures, sized
from rotorid_torch.trace.measured.fitted import FittedAtStates

BLOCK_S = 1.0
"""s: blocks of the residual that are put in another order, longer than what a motor or a stream is late by."""
SHUFFLED = "critical values come from the data's own residuals, whose blocks of a second stand in another order"


@torch.no_grad()
def measured_family(
    null: FittedAtStates, effects: Sequence[str], accepted: Sequence[str] = (), turns: int = 0, seed: int = 0
) -> Family[FittedAtStates]:
    """The family of these effects beside a fitted model.

    accepted : effects of the model that have a name. turns : residuals of the same colour that know nothing of the
    motion, made of the model's own, blocks of it in another order.
    """
    probe = _Probe.of(null, effects)
    dataset, chance = null.flights.dataset, torch.Generator().manual_seed(seed)
    fitted = [_matrix(probe, *pieces) for pieces in probe.pieces(dataset.identify)]
    unseen = [_matrix(probe, *pieces) for pieces in probe.pieces(dataset.validate)]
    prior, count = probe.prior, len(probe.names)
    theta = torch.linalg.lstsq(*_estimating(fitted, prior, count)).solution
    fitted, unseen = ([_with_shuffled(one, theta, turns, chance) for one in side] for side in (fitted, unseen))
    products = torch.stack([_products(one) for one in fitted])
    none = products.new_zeros(0, *products.shape[1:])
    before = torch.cat([prior[:, :-1], prior.new_zeros(len(prior), len(probe.chosen)), prior[:, -1:]], dim=1)
    before = torch.cat([before, before.new_zeros(len(before), turns)], dim=1)
    others = torch.stack([_products(one) for one in unseen]) if unseen else none
    equations = FlightEquations(products, others, before.mT @ before, count, 1 + turns)
    raw = products.sum(0).diagonal()[count : count + len(probe.chosen)]
    common = Screen.of(probe.chosen, probe.names, equations, raw, null.per_sample)
    each = replace(common, signatures=(), absorbed=())
    return Family(null, tuple(accepted), common, each)


@dataclass(frozen=True, eq=False)
class _Probe:
    """Simulates signatures about a fitted null, which `model` holds with all candidates at their nulls.

    names : the null's free parameters, moments that it holds at zero among them, for with a candidate they may explain.
    """

    null: FittedAtStates
    model: Model
    names: tuple[str, ...]
    chosen: tuple[Signature, ...]

    @classmethod
    def of(cls, null: FittedAtStates, effects: Sequence[str]) -> _Probe:
        """Of effects that join the null's spec."""
        spec = null.started(null.spec)
        model = build(spec.with_effects(*effects))
        return cls(null, model, build(spec).parameter_set.free, signatures(model, effects))

    @property
    def prior(self) -> Tensor:
        """Rows of the prior of the null's parameters, and what is left of them [P, P + 1]."""
        parameters = self.model.parameter_set
        places = [parameters.index(name) for name in self.names]
        weight = (1.0 / parameters.prior_sd[places]).nan_to_num(0.0)
        left = weight * (parameters.values[places] - self.model.theta.detach()[places])
        return torch.cat([weight.diag(), left[:, None]], dim=1)

    def pieces(self, listed: Sequence[str]) -> Iterator[tuple[MeasuredStates, Tensor]]:
        """Each flight's equations, and theta; one flight alone in halves, each of which tests what the other says."""
        seen = list(seen_flights(self.model, self.null.flights.records(self.model, listed))) if listed else []
        for one in _halves(seen[0]) if len(seen) == 1 else seen:
            yield MeasuredStates.of(self.model, [one]), self.model.theta.detach().clone()


def _halves(flight: Seen) -> list[Seen]:
    middle = len(flight.controls) // 2
    parts = (slice(None, middle), slice(middle, None))
    names = ("controls", "states", "outputs")
    return [replace(flight, **{name: getattr(flight, name)[part] for name in names}) for part in parts]


@dataclass(frozen=True, eq=False)
class _Matrix:
    """Rows of one flight in units of what is left: responses about their lines [rows, T', n], and lines [2 rows, n].

    Columns are the null's parameters, the signatures, and the residual. block : samples of a block.
    """

    values: Tensor
    lines: Tensor
    block: int


def _matrix(probe: _Probe, states: MeasuredStates, theta: Tensor) -> _Matrix:
    base, columns = states.equations.columns(theta, probe.names)
    changes = []
    for one in probe.chosen:
        with sized(probe.model, one):
            moved = states.equations.at(probe.model.theta.detach()[None])[0]
        changes.append({row: moved[row][0] - base[0][row] for row in states.measured[0]})
    values, lines = [], []
    for row, measured in states.measured[0].items():
        parts = [*(columns[n][0][row] for n in probe.names), *(c[row] for c in changes), measured - base[0][row]]
        weighed = states.weighed(torch.stack(parts).nan_to_num(0.0), row, probe.null.sigma[row]).mT
        values.append(weighed[:-2])
        lines.append(weighed[-2:])
    step = states.equations.flights[0].step
    return _Matrix(torch.stack(values), torch.cat(lines), max(1, round(BLOCK_S / step)))


def _estimating(matrices: Sequence[_Matrix], prior: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Triangle of the null's columns of all flights, and of the residual."""
    whole = [part for matrix in matrices for part in (matrix.values.flatten(0, 1), matrix.lines)]
    rows = [torch.cat([part[..., :count], part[..., -1:]], dim=-1) for part in whole]
    triangle = torch.linalg.qr(torch.cat([prior, *rows]), mode="r").R
    return triangle[:, :-1], triangle[:, -1:]


def _with_shuffled(matrix: _Matrix, theta: Tensor, count: int, chance: torch.Generator) -> _Matrix:
    """With so many residuals by chance behind the residual: what the null leaves over, its blocks in another order.

    Residuals turned in time would go with the motion of a periodic flight.
    """
    if not count:
        return matrix
    left = matrix.values[..., -1] - (matrix.values[..., : len(theta)] @ theta[:, 0])
    others = _shuffled(left, matrix.block, count, chance).movedim(0, -1)
    lines = matrix.lines.new_zeros(*matrix.lines.shape[:-1], count)
    joined = (torch.cat([matrix.values, others], dim=-1), torch.cat([matrix.lines, lines], dim=-1))
    return _Matrix(*joined, matrix.block)


def _shuffled(records: Tensor, block: int, count: int, chance: torch.Generator) -> Tensor:
    """Records [rows, T] with their blocks in another order and turned to and fro, all rows alike [count, rows, T]."""
    blocks = max(1, records.shape[-1] // block)
    whole = min(blocks * block, records.shape[-1])
    pieces = records[:, :whole].unflatten(-1, (blocks, -1))
    orders = torch.stack([torch.randperm(blocks, generator=chance) for _ in range(count)])
    signs = torch.randint(0, 2, (count, 1, blocks, 1), generator=chance) * 2.0 - 1.0
    mixed = (pieces[:, orders].movedim(1, 0) * signs).flatten(-2)
    return torch.cat([mixed, records[:, whole:].expand(count, -1, -1)], dim=-1)


def _products(matrix: _Matrix) -> Tensor:
    rows = matrix.values.flatten(0, 1)
    return rows.mT @ rows + matrix.lines.mT @ matrix.lines
