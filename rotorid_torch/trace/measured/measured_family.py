"""Evidence for candidates in accelerations at measured states: all at once, in closed form about a fitted model.

The change of the modelled accelerations by a candidate at its usual size is its signature, once with the null's
parameters as they are, and once where they follow. From the normal equations
of the flights follows how much better the flights are explained whose equations did not give the signature's size. A
moment that the null holds at zero counts where a candidate lets the rotors explain that moment.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rotorid_torch.core.names import MOMENTS
from rotorid_torch.identification.measured_states import MeasuredStates, prior_rows
from rotorid_torch.identification.rotor_equations import Seen, seen_flights
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.rotors import believable
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.evidence.held_out import FlightEquations
from rotorid_torch.trace.evidence.screen import Screen, Signature, signatures, sized, together
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.measured.left_over import residuals_at_states
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.validate.rotor_moments import EXPLAINED, of_moments

SHUFFLED = "critical values come from the data's own residuals, whose blocks of a second stand in another order"


@torch.no_grad()
def measured_family(
    null: FittedAtStates,
    effects: Sequence[str],
    accepted: Sequence[str] = (),
    turned: int = 0,
    seed: int = 0,
    ends: Sequence[FittedAtStates] = (),
) -> Family[FittedAtStates]:
    """The family of these effects beside a fitted model.

    accepted : effects of the model that have a name. turned : residuals made of the model's own, blocks of it in
    another order. ends : fits with one effect more, the ways to which are signatures.
    """
    probes = _probes(null, effects, ends)
    base, chosen = probes[0], tuple(one for probe in probes for one in probe.chosen)
    dataset, chance = null.flights.dataset, torch.Generator().manual_seed(seed)
    rows, prior, count = tuple(null.sigma), base.prior, len(base.names)
    lists = dataset.identify, dataset.validate
    pieces = [zip(*(probe.pieces(listed) for probe in probes), strict=True) for listed in lists]
    sides = [[_matrix(probes, flight) for flight in side] for side in pieces]
    theta = torch.linalg.lstsq(*_estimating(sides[0], prior, count)).solution
    fitted, unseen = ([_with_shuffled(one, theta, turned, chance) for one in side] for side in sides)
    by_row = torch.stack([_products(one, rows) for one in fitted])
    unexplained = _unexplained(base, chosen, dict(zip(rows, by_row.sum(0), strict=True)), 1 + turned)
    counted = [k for k, row in enumerate(rows) if row not in unexplained or len(unexplained) == len(rows)]
    products = by_row[:, counted]
    others = torch.stack([_products(one, rows)[counted] for one in unseen]) if unseen else products[:0]
    usual = products.new_tensor([[float(one.values.shape[1])] for one in (*fitted, *unseen)])  # in units of the rms
    equations = FlightEquations.of(products, others, (prior[:, :-1], prior[:, -1]), 1 + turned, usual)
    residuals = residuals_at_states(null)
    descriptions = {} if residuals is None else residuals.descriptions()
    screened = Screen(chosen, base.names, equations)
    return Family(null, tuple(accepted), screened, residuals=residuals, descriptions=descriptions)


@dataclass(frozen=True, eq=False)
class _Probe:
    """Simulates signatures about a fitted null, which `model` holds with some candidates at their nulls, or none.

    names : the null's free parameters, moments that it holds at zero among them, for with a candidate they may explain.
    """

    null: FittedAtStates
    model: Model
    names: tuple[str, ...]
    chosen: tuple[Signature, ...]

    @classmethod
    def of(cls, null: FittedAtStates, effects: Sequence[str], ends: Sequence[FittedAtStates]) -> _Probe:
        """Of effects that join the null's spec, and ways to fits in full."""
        spec = null.started(null.spec)
        model = build(spec.with_effects(*effects))
        probe = cls(null, model, build(spec).parameter_set.free, signatures(model, effects))
        more = probe._followed([*ends, *([] if null.origin is None else [null.origin])])
        return replace(probe, chosen=(*probe.chosen, *more))

    @property
    def prior(self) -> Tensor:
        """Rows of the prior of the null's parameters [P, P + 1]."""
        parameters = self.model.parameter_set
        places = [parameters.index(name) for name in self.names]
        return prior_rows(self.model.theta.detach()[places], parameters.values[places], parameters.prior_sd[places])

    def pieces(self, listed: Sequence[str]) -> Iterator[MeasuredStates]:
        """Each flight's equations; one flight alone in halves, each of which tests what the other says."""
        flights = list(seen_flights(self.model, self.null.flights.records(self.model, listed))) if listed else []
        for one in _halves(flights[0]) if len(flights) == 1 else flights:
            yield MeasuredStates.of(self.model, [one])

    def _followed(self, ends: Sequence[FittedAtStates]) -> list[Signature]:
        """Signatures that the null follows.

        What makes controls later takes the place of what does so in the null. And the ways to fits that have an effect
        more, or from which the null began: all values go to what they are there.
        """
        single = [self.chosen[places[0]] for places in together(self.chosen) if len(places) == 1]
        chosen = [replace(one, others=(*one.others, *e)) for one in single if (e := self._earlier(one))]
        for end in ends:
            for effect in dict.fromkeys(one.effect for one in self.chosen):
                moved = [one for one in self.chosen if one.effect == effect and self._moved(one, end) > 0.0]
                if moved:
                    first = max(moved, key=lambda one: self._moved(one, end))
                    mine = [n for n in end.values if n not in self.null.values and n != first.parameter]
                    names = [*mine, *(n for n in self.names if n in end.values)]
                    values = tuple((n, end.values[n]) for n in names)
                    chosen.append(replace(first, typical=end.values[first.parameter], others=values))
        return [replace(one, size=-1 - k) for k, one in enumerate(chosen)]

    @staticmethod
    def _moved(one: Signature, end: FittedAtStates) -> float:
        """How far a signature's parameter lies from its null in a fit, over its typical size."""
        return abs((end.values.get(one.parameter, one.null) - one.null) / one.step)

    def _earlier(self, one: Signature) -> tuple[tuple[str, float], ...]:
        """By what controls are late in the null, less by as much as the signature makes them later."""
        late = [f"{effect.id}.{effect.delays}" for effect in self.model.chain if effect.delays]
        usual = {name: value for name, value in self.null.values.items() if name in late and value > 0.0}
        return tuple((name, max(value - one.step, 0.0)) for name, value in usual.items() if one.parameter in late)

    def changes(self, states: MeasuredStates) -> Tensor:
        """Of a flight's measured rows by each signature [S, R, T]."""
        thetas = [self.model.theta.detach().clone()]
        for one in self.chosen:
            with sized(self.model, one):
                thetas.append(self.model.theta.detach().clone())
        (rows,) = states.equations.at_each(torch.stack(thetas))
        places = [states.equations.accelerations.names.index(row) for row in states.measured[0]]
        return rows[1:, places] - rows[0, places]


def _probes(null: FittedAtStates, effects: Sequence[str], ends: Sequence[FittedAtStates]) -> list[_Probe]:
    """The null by itself, and beside effects; in native code but for effects whose states follow the motion."""
    chain = build(null.spec.with_effects(*effects)).chain
    following = [effect.id for effect in chain if effect.id in effects and Model.follows(effect)]
    parts = ([e for e in effects if e not in following], following)
    return [_Probe.of(null, (), ()), *(_Probe.of(null, part, ends) for part in parts if part)]


def _halves(flight: Seen) -> list[Seen]:
    middle = len(flight.controls) // 2
    parts = (slice(None, middle), slice(middle, None))
    names = ("controls", "states", "outputs")
    return [replace(flight, **{name: getattr(flight, name)[part] for name in names}) for part in parts]


@dataclass(frozen=True, eq=False)
class _Matrix:
    """Rows of one flight in units of what is left: responses about their lines [rows, T', n], and lines [rows, 2, n].

    Columns are the null's parameters, the signatures, and the residual. rows : their names. block : samples of a block.
    """

    rows: tuple[str, ...]
    values: Tensor
    lines: Tensor
    block: int


def _matrix(probes: Sequence[_Probe], flight: Sequence[MeasuredStates]) -> _Matrix:
    """By the equations of a flight under the model of each probe."""
    base, states = probes[0], flight[0]
    (linear,) = states.equations.linear(base.model.theta.detach().clone(), base.names)
    changes = [probe.changes(one) for probe, one in zip(probes[1:], flight[1:], strict=True)]
    rows, measured = tuple(states.measured[0]), torch.stack([*states.measured[0].values()])
    values, slopes = linear.of(rows)
    parts = torch.cat([slopes, *changes, (measured - values)[None]])
    weighed = states.weighed(parts.nan_to_num(0.0), rows, base.null.sigma, ~measured.isnan()).movedim(0, -1)
    block = max(1, round(SETTINGS.settled_s / states.equations.flights[0].step))
    return _Matrix(rows, weighed[:, :-2], weighed[:, -2:], block)


def _estimating(matrices: Sequence[_Matrix], prior: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Triangle of the null's columns of all flights, and of the residual."""
    whole = [part.flatten(0, 1) for matrix in matrices for part in (matrix.values, matrix.lines)]
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
    return _Matrix(matrix.rows, *joined, matrix.block)


def _shuffled(records: Tensor, block: int, count: int, chance: torch.Generator) -> Tensor:
    """Records [rows, T] with their blocks in another order and turned to and fro, all rows alike [count, rows, T]."""
    blocks = max(1, records.shape[-1] // block)
    whole = min(blocks * block, records.shape[-1])
    pieces = records[:, :whole].unflatten(-1, (blocks, -1))
    orders = torch.stack([torch.randperm(blocks, generator=chance) for _ in range(count)])
    signs = torch.randint(0, 2, (count, 1, blocks, 1), generator=chance) * 2.0 - 1.0
    mixed = (pieces[:, orders].movedim(1, 0) * signs).flatten(-2)
    return torch.cat([mixed, records[:, whole:].expand(count, -1, -1)], dim=-1)


def _products(matrix: _Matrix, rows: Sequence[str]) -> Tensor:
    """Normal equations by row [rows, n, n], zeros of a row that the flight has not measured."""
    squares = matrix.values.mT @ matrix.values + matrix.lines.mT @ matrix.lines
    products = squares.new_zeros(len(rows), *squares.shape[1:])
    products[[rows.index(row) for row in matrix.rows]] = squares
    return products


def _unexplained(base: _Probe, chosen: Sequence[Signature], products: Mapping[str, Tensor], residuals: int) -> set[str]:
    """Angular accelerations whose moments the null holds at zero, and which no candidate lets the rotors explain.

    The rotors explain a row where R2 reaches `EXPLAINED` at a control power that can be believed.

    products : of the identify flights by row [n, n], residuals in the last columns.
    """
    certain = {row: one[: len(one) - residuals + 1, : len(one) - residuals + 1] for row, one in products.items()}
    moments = {ANGULAR_ACCELERATIONS[MOMENTS.index(moment)]: moment for moment in base.null.silent}
    others = sum((one for row, one in certain.items() if row not in moments), torch.zeros(()))
    return {row for row, one in moments.items() if not _explained(base, chosen, one, certain[row], others)}


def _explained(base: _Probe, chosen: Sequence[Signature], moment: str, products: Tensor, others: Tensor) -> bool:
    """Whether a candidate lets the rotors explain a moment's row, of which these are the products [n, n].

    others : products of the rows that the null explains. A moment is control power times thrust: only with these does
    its row tell the control power.
    """
    values, count, power = base.model.named_values, len(base.names), f"rotors.power.{moment}"
    silent = torch.zeros(len(products), dtype=products.dtype)
    silent[-1] = 1.0
    for name in of_moments(base.null.spec, [moment]):
        silent[base.names.index(name)] = values[name]
    moved, both = float(silent @ products @ silent), products + others
    for places in together(chosen):
        columns = [*range(count), *(count + k for k in places)]
        size = torch.linalg.pinv(both[columns][:, columns], hermitian=True) @ both[columns, -1]
        left = torch.zeros_like(silent)
        left[columns], left[-1] = -size, 1.0
        believed = believable(base.null.spec, moment, values[power] + float(size[base.names.index(power)]))
        if believed and float(left @ products @ left) <= (1.0 - EXPLAINED) * moved:
            return True
    return False
