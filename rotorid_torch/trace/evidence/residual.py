"""What no named effect explains: in which equation, with what it goes, since when, in which band. Never a name.

Forces and moments that step 1 found, and measured flapping's rates, less those of the model on the measured motion.
What linear terms could still take up is projected out of both sides; what is left is compared with products of the
motion and controls, with what grows faster than its channel or levels off, and with everything linear that begins at
some time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import NamedTuple

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import DEPENDENT
from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.base import Frame
from rotorid_torch.effects.families.main_rotor import FlapSecondOrder
from rotorid_torch.effects.signal_operations import smoothed
from rotorid_torch.identification.model_regression import Before, Measured, end_to_end, measured
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.model.gusts import GUSTS
from rotorid_torch.model.linear_equations import Flapping
from rotorid_torch.model.model import Model
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.significance import turned

RATE = 20.0
"""Hz: records are taken at about this; the body moves below a fifth of it."""
ONSET_S = 0.5
"""Steps in which the beginning of something new is looked for, s."""
ONSETS = 60
"""Beginnings that are looked for, at most: their columns are as many."""
EDGE_S = 2.0
"""Something that begins within this of a flight's ends is not told from a manoeuvre, s."""
SMOOTH_S = 0.4
"""Width of the smoothing of all records, s: rates differentiated are noise, and lines of the rotor would fold."""
ALIKE_S = SMOOTH_S / 1.5
"""What smoothing makes one sample of, s: a Hann window's noise bandwidth is 1.5 over its width."""
SECOND_ORDER = f"{FlapSecondOrder.id}.share"
"""Without it flapping's rates are what first-order flapping makes them: second order keeps that for slow motion."""
MOVED = 1e-2
"""By which numbers are moved for what the residuals change by: parameters by this share of their typical size, controls
by so much, rad or as declared."""
AT_ONCE = {f"{name} at once": name for name in FLAPPING}
"""The flapping's equations again, for a disc that follows its controls at once: its own angles, which would take up
whatever else moves it, are no linear terms of these."""
TIME = "time"
"""What a step goes with."""


class Regressor(NamedTuple):
    """What a residual may go with: a signal or two, the form in which, and since when, s into a flight."""

    signal: str
    form: str = ""
    since_s: float | None = None


class Largest(NamedTuple):
    """The largest residual of an equation, SI, when, s into a flight, and in which flight."""

    size: float
    time: float
    flight: str


@dataclass(frozen=True, eq=False)
class LeftOver:
    """Equations' residuals [N, rows] of all flights in one column, and what may go with them [N, k].

    rows : forces and moments, and the rates of the flapping where it is measured and lags, these twice (`AT_ONCE`).
    constants : taken up beside the signals: one of each flight, another one as long as controls are at rest (what grows
        with the square of the motion has a mean in it), and steps at a time.
    derivatives : whether the model has free derivatives, which take up whatever is linear in the signals.
    levels : rms by which the level of each row usually changes within a flight beyond a line [rows], where it may.
    flights : their names.
    tilts : the flapping [N, 0 or 3], linear terms too, but not of a disc that follows at once.
    flight : the flight of each sample [N].
    named : how the residuals change with each parameter of effects that have a name [N, rows, n].
    inertia : about each axis [3], kg m2; None where it is not declared.
    """

    rows: tuple[str, ...]
    residual: Tensor
    names: tuple[str, ...]
    signals: Tensor
    time: Tensor
    constants: Tensor
    tilts: Tensor
    flight: Tensor
    named: Tensor
    inertia: Tensor | None = None
    derivatives: bool = True
    levels: Tensor | None = None
    flights: tuple[str, ...] = ()

    @property
    def rate(self) -> float:
        """Hz of the samples."""
        return 1.0 / float(self.time[1] - self.time[0])

    @property
    def onset_s(self) -> float:
        """Steps in which the beginning of something new is looked for, s; longer ones in flights of minutes."""
        return max(ONSET_S, (float(self.time.max()) - 2.0 * EDGE_S) / ONSETS)

    @property
    def usual(self) -> Tensor:
        """Rms of each signal [k]."""
        return self.signals.square().mean(dim=0).sqrt().clamp_min(1e-300)

    def beyond(self, values: Tensor, row: int) -> Tensor:
        """Columns [N, m] less what linear terms of an equation, and other sizes of named effects, take up."""
        linear = [self.signals] if self.derivatives else []
        tilts = [] if self.rows[row] in AT_ONCE else [self.tilts]
        taken = torch.cat([*linear, self.constants, *tilts, self.named[:, row]], dim=1)
        basis, triangle = torch.linalg.qr(taken)
        spans = triangle.diagonal().square() > DEPENDENT * taken.square().sum(dim=0)
        basis = basis[:, spans]  # the others are arbitrary
        return values - basis @ (basis.mT @ values)

    def less_beginning(self, onset: float, signals: bool) -> LeftOver:
        """The same with steps at an onset among its linear terms, and signals that begin there.

        They begin a step of the search before and behind it too: nothing begins exactly where it is tried.
        """
        onsets = onset + self.onset_s * torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)
        steps = (self.time[:, None] >= onsets).to(torch.float64)
        begun = [(steps[..., None] * self.signals[:, None]).flatten(1)] if signals else []
        return replace(self, constants=torch.cat([self.constants, steps, *begun], dim=1))

    def largest(self, name: str) -> Largest | None:
        """Where an equation leaves most over; None where the flights have no names."""
        if not self.flights:
            return None
        row = self.rows.index(name)
        left = self.beyond(self.residual[:, row, None], row)[:, 0].abs()
        at = int(left.argmax())
        return Largest(float(left[at]), float(self.time[at]), self.flights[int(self.flight[at])])


def left_over(
    model: Model,
    dataset: Dataset,
    reconstruction: Reconstruction,
    flights: Sequence[str],
    effects: Sequence[str] = (),
) -> LeftOver:
    """Residuals of a model's forces, moments and flapping on flights, and the signals they may go with.

    effects : those of the model with a name; what their parameters' errors leave is theirs.
    """
    flapping, listed = compared(model, dataset, flights)
    groups = [Source(dataset, reconstruction, names) for names in end_to_end(dataset, listed)]
    thinned = [_thinned(model, effects, flapping, group) for group in groups]
    parts = [part for _, of_group in thinned for part in of_group]
    whole = _Thinned(*map(torch.cat, zip(*parts, strict=True)))
    samples = torch.tensor([len(part.time) for part in parts])
    constants = torch.nn.functional.one_hot(torch.repeat_interleave(samples)).to(torch.float64)
    rests = [whole.at_rest] if any(part.at_rest.min() < part.at_rest.max() for part in parts) else []
    at_once = [n for n, name in AT_ONCE.items() if name in flapping]
    body = len(FORCES) + len(MOMENTS)
    twice = [*range(whole.residual.shape[1]), *range(body, body + len(at_once))]
    left = LeftOver(
        (*FORCES, *MOMENTS, *flapping, *at_once),
        whole.residual[:, twice],
        thinned[-1][0],
        whole.signals,
        whole.time,
        torch.cat([constants, *rests], dim=1),
        whole.tilts,
        torch.repeat_interleave(torch.tensor([flights.index(name) for name in listed]), samples),
        whole.named[:, twice],
        None if model.body.inertia is None else model.inertia.diagonal(),
        flights=tuple(flights),
    )
    for k in range(body, len(left.rows)):  # fitted as angles: linear terms of the rates are rough
        left.residual[:, k] = left.beyond(left.residual[:, k, None], k)[:, 0]
    return left


class Source(NamedTuple):
    """Flights that go `end_to_end`, in a data set and as step 1 reconstructed them; before : signals at an effect."""

    dataset: Dataset
    reconstruction: Reconstruction
    flights: Sequence[str]
    before: Before | None = None

    @property
    def dt(self) -> float:
        """Of the records, s."""
        return self.dataset.facts[self.flights[0]].dt

    @property
    def every(self) -> int:
        """Samples from one that is taken to the next, at about `RATE`."""
        return max(1, round(1.0 / (self.dt * RATE)))

    def thin(self, record: Tensor) -> Tensor:
        """A flight's record [T, n] smoothed, at about `RATE`."""
        return smoothed(record, max(1, round(SMOOTH_S / self.dt)))[:: self.every]


def compared(model: Model, dataset: Dataset, flights: Sequence[str]) -> tuple[tuple[str, ...], Sequence[str]]:
    """The flapping whose equations are compared beside those of the body, and the flights that tell of all these."""
    with_flapping = [name for name in flights if dataset.facts[name].has(*FLAPPING)]
    if with_flapping and isinstance(model.effect("rotor"), Flapping):
        return FLAPPING, with_flapping  # of the others neither the disc nor what it does to the body is known
    return (), flights


def residuals(model: Model, flapping: Sequence[str], source: Source) -> Tensor:
    """Residuals of flights [N, rows] by forces, moments and flapping, smoothed, at about `RATE`."""
    flights = measured(model, *source)
    each = _residual(model, flights, flapping, source.dt).split(flights.samples)
    return torch.cat([source.thin(one) for one in each])


class _Thinned(NamedTuple):
    """A flight's records at about `RATE`, see `LeftOver`: residual [T, rows], named [T, rows, n], at_rest [T, 1]."""

    signals: Tensor
    residual: Tensor
    named: Tensor
    tilts: Tensor
    time: Tensor
    at_rest: Tensor


def _thinned(
    model: Model, effects: Sequence[str], flapping: Sequence[str], source: Source
) -> tuple[tuple[str, ...], list[_Thinned]]:
    """Names of flights' signals, and each one's records; flapping : angles whose equations are compared."""
    flights = measured(model, *source)
    names = tuple(n for n in (*model.body.states, *model.body.controls) if n not in GUSTS and n in flights.signals)
    signals = torch.stack([flights.signals[n] - model.reference.get(n, 0.0) for n in names], dim=-1)
    residual = _residual(model, flights, flapping, source.dt)
    moved = [residual - _residual(model, measured(model, *source), flapping, source.dt) for _ in _moved(model, effects)]
    tilts = _stacked(flights.signals, flapping).nan_to_num(0.0) if flapping else signals[:, :0]
    time = [source.dt * torch.arange(n, dtype=torch.float64) for n in flights.samples]
    quiet = [torch.arange(len(t)) < source.dataset.quiet(name) for t, name in zip(time, source.flights, strict=True)]
    columns = [signals, residual, *moved, tilts, torch.cat(quiet).to(torch.float64)[:, None]]
    widths = [column.shape[1] for column in columns]
    parts = list[_Thinned]()
    for record, t in zip(torch.cat(columns, dim=1).split(flights.samples), time, strict=True):
        x, left, *changes, discs, at_rest = source.thin(record).split(widths, dim=1)
        named = torch.stack(changes, dim=-1) if changes else left[..., None][..., :0]
        parts.append(_Thinned(x, left, named, discs, t[:: source.every], at_rest))
    return names, parts


def _moved(model: Model, effects: Sequence[str]) -> Iterator[None]:
    """The model with one free parameter of these effects after the other moved a little, and back again."""
    for i, parameter in enumerate(model.parameter_set.parameters):
        if parameter.free and any(parameter.name.startswith(f"{e}.") for e in effects):
            with model.restored():
                with torch.no_grad():
                    model.theta[i] += MOVED * (abs(parameter.typical - parameter.value) or 1.0)
                yield


def _residual(model: Model, flights: Measured, flapping: Sequence[str], dt: float) -> Tensor:
    """Forces and moments that step 1 found, and flapping rates, less the model's [T, rows]; zero where unseen."""
    columns = [flights.specific - loads(on_measured(model, flights.signals))]
    if flapping:
        law = on_measured(model, flights.signals, {SECOND_ORDER: 0.0})  # else rates that are states follow these
        rates = torch.stack([law.rates[n] for n in flapping], dim=-1)
        tilts = _stacked(flights.signals, flapping).split(flights.samples)
        columns.append(torch.cat([torch.gradient(one, spacing=dt, dim=0)[0] for one in tilts]) - rates)
    return torch.cat(columns, dim=-1).nan_to_num(0.0)


def _stacked(signals: Mapping[str, Tensor], names: Sequence[str]) -> Tensor:
    """Signals as columns [T, n]; NaN where a flight has none."""
    return torch.stack([signals.get(n, torch.full_like(signals["p"], torch.nan)) for n in names], dim=-1)


def on_measured(model: Model, signals: Mapping[str, Tensor], other: Mapping[str, float] | None = None) -> Frame:
    """What a model makes of measured signals, its own states being those signals too; with other values of some."""
    names, controls = model.layout.names, model.body.controls
    usual = torch.tensor([model.reference.get(n, 0.0) for n in names], dtype=torch.float64)
    ground = {n: signals[f"ground.{n}"] for n in VELOCITIES if f"ground.{n}" in signals}  # a wind is blown once
    x, u = _stacked({**signals, **ground}, names), _stacked(signals, controls)
    x = torch.where(x.isnan(), usual, x)
    theta = model.theta.detach().clone()
    for name, value in (other or {}).items():
        if name in model.parameter_set.names:
            theta[model.parameter_set.index(name)] = value
    with torch.no_grad():
        return model.frame(theta, x, u)[0]


def loads(frame: Frame) -> Tensor:
    """Specific forces and angular accelerations by the external moment [T, 6]."""
    none = torch.zeros(len(frame.signals["p"]), 3, dtype=torch.float64)
    return torch.cat([none if part is None else part for part in (frame.force, frame.moment)], dim=-1)


def by_chance(left: LeftOver, count: int, seed: int) -> Tensor:
    """So many residuals R of all flights that know nothing of the motion [N, rows, R].

    Turned in time, what linear terms take up is no linear term any more, and would look like chance: as much of it is
    kept as they take of what knows nothing, in 95 % of the turns.
    """
    over = torch.cat([left.beyond(left.residual[:, k, None], k) for k in range(len(left.rows))], dim=1)
    whole, remainder = (_turned(left, values, count, seed) for values in (left.residual, over))
    size = torch.linalg.vector_norm
    beyond = torch.stack([left.beyond(whole[:, k], k) for k in range(len(left.rows))], dim=1)
    shares = 1.0 - (size(beyond, dim=0) / size(whole, dim=0).clamp_min(1e-300)).square()
    most = shares.quantile(1.0 - SETTINGS.level, dim=1).clamp(0.0, 1.0 - 1e-12)
    usual = (most / (1.0 - most)).sqrt() * size(over, dim=0)
    scale = (usual / size(left.residual - over, dim=0).clamp_min(1e-300)).clamp_max(1.0)[:, None]
    return scale * whole + (1.0 - scale) * remainder


def _turned(left: LeftOver, values: Tensor, count: int, seed: int) -> Tensor:
    """Values of all flights [N, rows] turned in time, each flight by itself [N, rows, R]."""
    generator = torch.Generator().manual_seed(seed)
    return torch.cat([turned(values[left.flight == f], count, generator) for f in left.flight.unique()])


def shapes(left: LeftOver, usual: Tensor) -> Iterator[tuple[Regressor, Tensor]]:
    """What the motion and the controls, of usual sizes [k], make beyond what the model takes up."""
    for name, signal in () if left.derivatives else zip(left.names, left.signals.mT, strict=True):
        yield Regressor(name, "in proportion"), signal
    for i, j in combinations_with_replacement(range(len(left.names)), 2):
        a, b = left.signals[:, i], left.signals[:, j]
        if i == j:
            yield Regressor(left.names[i], "by its square"), a * a
            yield Regressor(left.names[i], "growing faster than it"), a * a.abs()
            yield Regressor(left.names[i], "levelling off"), torch.tanh(a / usual[i])
        else:
            yield Regressor(f"{left.names[i]} {left.names[j]}", "by their product"), a * b


def onsets(left: LeftOver, step: float) -> Iterator[tuple[Regressor, Tensor]]:
    """What begins at some time, steps of so many s apart, and goes on linearly; nothing in flights without a middle.

    Without free derivatives whatever goes with a signal from some time on goes with the signal: steps alone begin.
    """
    end = max(float(left.time.max()) - EDGE_S, EDGE_S)
    for onset in torch.arange(EDGE_S, end, step, dtype=torch.float64).tolist():
        after = (left.time >= onset).to(torch.float64)
        for name, signal in zip(left.names, left.signals.mT, strict=True) if left.derivatives else ():
            yield Regressor(name, since_s=onset), signal * after
        yield Regressor(TIME, since_s=onset), after
