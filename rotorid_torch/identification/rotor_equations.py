"""The equations of a multirotor at measured states, and the regression of what they are linear in, one after the other.

Every equation compares what the model gives at measured states with what was measured: specific force, the rate of a
body rate, rotor speed. Parameters that an equation is linear in come from finite transforms in a band.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import torch
from torch import Tensor

from rotorid_torch.core.integrate import integral
from rotorid_torch.core.names import RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.core.rigid import cross, gravity_in_body
from rotorid_torch.data.flight import bridged, bridged_but_gaps
from rotorid_torch.effects.base import Stage
from rotorid_torch.effects.signal_operations import averaged, half_of
from rotorid_torch.identification.estimate.segments import Records
from rotorid_torch.identification.regress.equation import Equation, fit_equation
from rotorid_torch.identification.regress.ftr import Regression
from rotorid_torch.identification.structure import ATTITUDE
from rotorid_torch.model.accelerations import Accelerations, Record
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model

BAND = (0.3, 10.0)
"""Hz: where commands move a small vehicle and its sensors still see it; less where a flight is short or slow."""
STEP = 1e-3
"""Of a parameter for a column, over its prior's standard deviation or its size; the equations are linear in it."""
ROUNDING = 1e-11
"""Share of a row's size by which it changes at least where a parameter reaches it."""
SMOOTHED_S = 0.03
"""Length of the centred mean that measurement and model both pass before rates are differentiated."""
STILL = 1e-6
"""Share of its mean by which a column moves at least if it is not constant."""


@dataclass(frozen=True, eq=False)
class LinearRows:
    """Rows of one flight [n, T] in the order of `names`, and their derivatives by parameters [P, n, T]."""

    names: tuple[str, ...]
    values: Tensor
    slopes: Tensor

    def of(self, rows: Iterable[str]) -> tuple[Tensor, Tensor]:
        """Some rows [R, T], and their derivatives [P, R, T]."""
        places = [self.names.index(row) for row in rows]
        return self.values[places], self.slopes[:, places]

    def value(self, row: str) -> Tensor:
        """A row [T]."""
        return self.values[self.names.index(row)]

    def columns(self, row: str) -> Tensor:
        """Derivatives of a row [P, T]."""
        return self.slopes[:, self.names.index(row)]


@dataclass(frozen=True, eq=False)
class Seen:
    """One flight: inputs (T, nu) as recorded, states (T, nx) and outputs (T, ny) as measured.

    Step 1 bridges gaps of states; in outputs gaps are missing (`bridged_but_gaps`).

    condensed : of states and inputs behind the control path, half the samples of a centred mean, and how many samples
    lie between two of them; the states are those means.
    """

    dt: float
    controls: Tensor
    states: Tensor
    outputs: Tensor
    condensed: tuple[int, int] = (0, 1)

    @property
    def step(self) -> float:
        """S between two states."""
        return self.dt * self.condensed[1]

    def means(self, record: Tensor) -> Tensor:
        """Means of a record [..., T, n] where the states are [..., T', n]."""
        half, every = self.condensed
        if self.condensed == (0, 1):
            return record
        whole = averaged(record.mT, half)
        return whole[..., half + 1 : whole.shape[-1] - half - 1 : every].mT

    def condense(self, half: int, every: int) -> Seen:
        """The flight with means of its states."""
        fewer = replace(self, condensed=(half, every))
        return replace(fewer, states=fewer.means(self.states))

    def middle(self, most: int) -> Seen:
        """At most so many samples about the flight's middle."""
        first = max(0, (len(self.controls) - most) // 2)
        inner = slice(first, first + most)
        return Seen(self.dt, self.controls[inner], self.states[inner], self.outputs[inner])


@dataclass(frozen=True, eq=False)
class RotorEquations:
    """The equations of a model on its identify flights."""

    model: Model
    flights: tuple[Seen, ...]
    _path_records: dict[tuple[float, ...], list[Record]] = field(default_factory=dict, repr=False)

    @cached_property
    def accelerations(self) -> Accelerations:
        """The model without integration."""
        return _accelerations(self.model)

    @cached_property
    def band(self) -> tuple[float, float]:
        """Hz."""
        longest = max(len(f.controls) * f.dt for f in self.flights)
        low = max(BAND[0], 2.0 / longest)
        return low, max(min(BAND[1], 0.4 / max(f.dt for f in self.flights)), 4.0 * low)

    @cached_property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Names of the rows; what a later group is linear in holds parameters of an earlier one."""
        outputs, moving = self.model.body.outputs, self.model.layout.has(*VELOCITIES)
        forces = tuple(a for a in SPECIFIC_FORCES if a in outputs or moving)
        return (*forces, *(o for o in outputs if o.startswith("omega"))), ANGULAR_ACCELERATIONS

    def kind(self, row: str) -> str:
        """Whether the response is regressed or its rate."""
        return "value" if row in self.model.body.outputs else "derivative"

    def response(self, row: str, flight: Seen) -> Tensor:
        """What was measured (T,), gaps bridged: the row, or what it is the rate of."""
        outputs, pick = self.model.body.outputs, self.model.layout.pick
        if row in outputs or row in ANGULAR_ACCELERATIONS:
            channel = row if row in outputs else RATES[ANGULAR_ACCELERATIONS.index(row)]
            return bridged(flight.outputs[:, [outputs.index(channel)]])[:, 0]
        velocity, rates, attitude = (pick(flight.states, *g) for g in (VELOCITIES, RATES, ATTITUDE))
        other = gravity_in_body(attitude, self.model.body.gravity) - cross(rates, velocity)
        axis = SPECIFIC_FORCES.index(row)
        return velocity[:, axis] - integral(other[:, axis], flight.dt)

    @torch.no_grad()
    def at(self, theta: Tensor) -> list[dict[str, Tensor]]:
        """Rows [T] of every flight at theta [P]."""
        every = self._behind_path(theta, [], theta[:0])
        return [dict(zip(self.accelerations.names, values, strict=True)) for values, _ in every]

    @torch.no_grad()
    def at_each(self, thetas: Tensor) -> list[Tensor]:
        """Rows [S, n, T] of every flight at each of many thetas [S, P]; those of one control path at once."""
        paths: dict[tuple[float, ...], list[int]] = {}
        for k, path in enumerate(thetas[:, self._path].tolist()):
            paths.setdefault(tuple(path), []).append(k)
        records = (self._records(thetas[places[0]]) for places in paths.values())
        pairs = zip(paths.values(), records, strict=True)
        parts = [self.accelerations.at_each(thetas[places], record) for places, record in pairs]
        order = torch.tensor([k for places in paths.values() for k in places]).argsort()
        return [torch.cat(flight)[order] for flight in zip(*parts, strict=True)]

    @torch.no_grad()
    def linear(self, theta: Tensor, names: Sequence[str]) -> list[LinearRows]:
        """Rows of every flight at theta [P], and their derivatives by each of the parameters."""
        places = [self.model.parameter_set.index(name) for name in names]
        steps = theta.new_tensor([self._step(theta, i) for i in places])
        rows = self._behind_path(theta, places, steps)  # first: the path at theta is the one that was asked last
        moved = {
            k: self.at(with_values(self.model, theta, {names[k]: float(theta[i] + steps[k])}))
            for k, i in enumerate(places)
            if i in self._path
        }
        every = []
        for flight, (values, slopes) in enumerate(rows):
            for k, later in moved.items():
                slopes[k] = (torch.stack(list(later[flight].values())) - values) / steps[k]
            most = slopes.abs().amax(dim=-1) * steps.abs()[:, None]
            reached = most > ROUNDING * values.abs().amax(dim=-1)
            every.append(LinearRows(self.accelerations.names, values, torch.where(reached[..., None], slopes, 0.0)))
        return every

    def _behind_path(self, theta: Tensor, places: list[int], steps: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Rows of every flight [n, T], and their derivatives [len(places), n, T] where the control path stays.

        Exact ones where the model is compiled, differences where it is not.
        """
        if self.accelerations.compiled:
            return self.accelerations.linear(theta, self._records(theta), places)
        thetas = theta.repeat(1 + len(places), 1)
        thetas[range(1, 1 + len(places)), places] += steps
        every = self.accelerations.at_each(thetas, self._records(theta))
        return [(rows[0], (rows[1:] - rows[0]) / steps[:, None, None]) for rows in every]

    def _records(self, theta: Tensor) -> list[Record]:
        """States and inputs of every flight behind the control path; those of the last path are kept."""
        key = tuple(theta[self._path].tolist())
        if key not in self._path_records:
            self._path_records.clear()
            with self.model.restored(), torch.no_grad():
                self.model.theta.copy_(theta)
                inputs = self._inputs()
            self._path_records[key] = [(f.states, taped, f.step) for f, taped in zip(self.flights, inputs, strict=True)]
        return self._path_records[key]

    def _inputs(self) -> list[Tensor]:
        """Of every flight behind the model's control path; flights of one length side by side."""
        alike, inputs = dict[tuple[int, float], list[int]](), dict[int, Tensor]()
        for k, flight in enumerate(self.flights):
            alike.setdefault((len(flight.controls), flight.dt), []).append(k)
        for (_, dt), places in alike.items():
            taped = self.model.tape(torch.stack([self.flights[k].controls for k in places]), dt)
            inputs |= zip(places, self.flights[places[0]].means(taped), strict=True)
        return [inputs[k] for k in range(len(self.flights))]

    @cached_property
    def _path(self) -> list[int]:
        """Places of the control path's parameters."""
        path = [effect for effect in self.model.chain if effect.stage is Stage.CONTROL]
        return [self.model.parameter_set.index(f"{effect.id}.{p.name}") for effect in path for p in effect.declared]

    @torch.no_grad()
    def fitted(self, theta: Tensor, names: Sequence[str]) -> tuple[Tensor, dict[str, Regression]]:
        """Theta with these parameters regressed, each in the first row that it reaches; regressions by row."""
        left, regressions = list(names), dict[str, Regression]()
        for group in self.groups:
            asked, linear = list(left), self.linear(theta, left)
            for row in group:
                mine = {n: [one.columns(row)[k] for one in linear] for k, n in enumerate(asked) if n in left}
                mine = {n: c for n, c in mine.items() if any(bool((part != 0.0).any()) for part in c)}
                moving = {n: c for n, c in mine.items() if any(_moves(part) for part in c)}
                remainders = [one.value(row) for one in linear]
                if moving:
                    regressions[row] = self._regress(row, theta, remainders, moving)
                    change = self._stored(theta, moving, regressions[row].coefficients)
                    theta = theta + change
                    remainders = _moved(remainders, moving, change[[self.model.parameter_set.index(n) for n in moving]])
                for name in [n for n in mine if n not in moving][:1]:  # a second constant could not be told from it
                    more = self._mean_error(row, remainders) / float(mine[name][0].mean())
                    moved = float(theta[self.model.parameter_set.index(name)]) + more
                    theta = with_values(self.model, theta, {name: moved})
                left = [n for n in left if n not in mine]
        return theta, regressions

    def _step(self, theta: Tensor, i: int) -> float:
        declared = self.model.parameter_set.parameters[i]
        size = declared.prior_sd if declared.prior_sd < torch.inf else max(1.0, abs(float(theta[i])))
        return STEP * size if float(theta[i]) + STEP * size <= declared.bounds[1] else -STEP * size

    def _regress(
        self, row: str, theta: Tensor, base: Sequence[Tensor], columns: Mapping[str, Sequence[Tensor]]
    ) -> Regression:
        parameter_set = self.model.parameter_set
        places = [parameter_set.index(name) for name in columns]
        regressors = [torch.stack(parts, dim=-1) for parts in zip(*columns.values(), strict=True)]
        answers = []
        for flight, one, z in zip(self.flights, base, regressors, strict=True):
            remainder = one - z @ theta[places]
            response = remainder if self.kind(row) == "value" else integral(remainder, flight.dt)
            measured = self.response(row, flight)
            if not bool(measured.isnan().any()):  # gaps are bridged: the flight has no such channel
                answers.append((measured - response, z, flight.dt))
        return fit_equation(
            Equation(
                name=row,
                response=[response for response, _, _ in answers],
                regressors=[z for _, z, _ in answers],
                names=tuple(columns),
                dt=[dt for _, _, dt in answers],
                kind=self.kind(row),
                regressor_noise=[0.0] * len(columns),
                prior=(parameter_set.values[places], parameter_set.prior_sd[places]),
                band=self.band,
            )
        )

    def _stored(self, theta: Tensor, names: Mapping[str, Sequence[Tensor]], values: Tensor) -> Tensor:
        """Change of theta to these values inside their bounds."""
        wanted = theta.clone()
        wanted[[self.model.parameter_set.index(name) for name in names]] = values
        return self.model.parameter_set.clamp(wanted) - theta

    def _mean_error(self, row: str, remainders: Sequence[Tensor]) -> float:
        """Measured less the model's row on average over the flights."""
        more, weight = 0.0, 0.0
        for flight, one in zip(self.flights, remainders, strict=True):
            measured = self.response(row, flight)
            if bool(measured.isnan().any()):
                continue
            if self.kind(row) == "value":
                more += float((measured - one).sum()) * flight.dt
            else:
                more += float(measured[-1] - measured[0] - integral(one, flight.dt)[-1])
            weight += (len(one) - (self.kind(row) != "value")) * flight.dt
        return more / weight


@lru_cache(maxsize=4)
def _accelerations(model: Model) -> Accelerations:
    """Of a model, traced once for all its flights."""
    return Accelerations(model)


def seen_flights(model: Model, data: Records) -> Iterator[Seen]:
    """The flights of a batch of records; measured values in place of smoothed ones where there are any."""
    body, mean = model.body, 2 * half_of(SMOOTHED_S, data.dt) + 1
    places = [(body.outputs.index(s), i) for i, s in enumerate(body.states) if s in body.outputs]
    for k, samples in enumerate(data.lengths.tolist()):
        states, recorded = bridged(data.states[k, :samples]).nan_to_num(0.0), data.outputs[k, :samples]
        outputs = bridged_but_gaps(recorded, mean)
        for o, s in places:
            gap = outputs[:, o].isnan() & bool(outputs[:, o].isfinite().any())
            if body.outputs[o] not in RATES:  # those are smoothed anyway, and whole
                states[:, s] = torch.where(recorded[:, o].isnan(), states[:, s], recorded[:, o])
            outputs[:, o] = states[:, s].masked_fill(gap, torch.nan)
        yield Seen(data.dt, data.controls[k, :samples], states, outputs)


def with_values(model: Model, theta: Tensor, values: Mapping[str, float]) -> Tensor:
    """Theta with some parameters at other values."""
    theta = theta.clone()
    for name, value in values.items():
        theta[model.parameter_set.index(name)] = value
    return theta


def _moved(rows: Sequence[Tensor], columns: Mapping[str, Sequence[Tensor]], change: Tensor) -> list[Tensor]:
    """Rows of every flight after a change of the parameters that they are linear in."""
    per_flight = zip(*columns.values(), strict=True)
    return [one + torch.stack(parts, -1) @ change for one, parts in zip(rows, per_flight, strict=True)]


def _moves(column: Tensor) -> bool:
    return float(column.std()) > STILL * float(column.abs().mean())
