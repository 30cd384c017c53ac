"""The output-error likelihood of segments: residuals, linear model, initial states eliminated.

Flights are taken in parts that fit the memory, each rank its own; what belongs to all of them are sums in a fixed
order (see `core.processes.ranks`), so that every rank knows cost, noise and linear model of all flights.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Linear
from rotorid_torch.core.processes.ranks import ALONE, BLOCKS, Ranks
from rotorid_torch.core.storage import mapped_arrays
from rotorid_torch.identification.estimate.engine import Engine, Part, Unknowns
from rotorid_torch.identification.estimate.residuals import Moments, Noise, Whitener, products
from rotorid_torch.identification.estimate.segments import Records, Segments
from rotorid_torch.identification.estimate.sensitivity import Run
from rotorid_torch.identification.estimate.system import System

HELD = 1e-12
"""Prior's standard deviation of an initial state that is held: no data move it by more than rounding."""
SOLVED = 256
"""Triangles that are solved at once."""
PART_NUMBERS = 4_000_000
"""Numbers that a part of the segments may need at once."""
KEPT_NUMBERS = 4_000_000
"""Numbers of runs and residuals that a place keeps; beyond, they are made again when asked for."""


@dataclass(frozen=True)
class Locals:
    """How initial states follow a step of the shared parameters: triangles of the elimination."""

    segment: Tensor  # [S, nx, nx + P + 1]

    def move(self, step: Tensor, share: float) -> Tensor:
        """Steps of the initial states [S, nx], `share` of their own."""
        return self.carry(step, share * self.segment[:, :, -1])

    def carry(self, step: Tensor, state: Tensor) -> Tensor:
        """The same for any steps of their own, in units of their standard errors."""
        n, solved, later = state.shape[1], [], step.expand(len(state), -1).contiguous()
        parts = (part.split(SOLVED) for part in (self.segment, state, later))
        for triangle, one, step_part in zip(*parts, strict=True):
            remainder = one.unsqueeze(-1) - triangle[:, :, n:-1] @ step_part.unsqueeze(-1)
            solved.append(torch.linalg.solve_triangular(triangle[:, :, :n], remainder, upper=True).squeeze(-1))
        return torch.cat(solved)

    def alone(self) -> Tensor:
        """Decrease of the cost by each segment's initial states alone [S]."""
        return 0.5 * self.segment[:, :, -1].square().sum(dim=1)


@dataclass
class Place:
    """A place in the space of parameters and initial states, with all that is known of it."""

    theta: Tensor
    x0: Tensor  # [S, nx]
    parts: list[Part] | None = None  # None: too large to be kept
    covariance: Tensor = field(default_factory=lambda: torch.zeros(0))
    moments: Moments | None = None
    cost: float = math.inf
    locals: Locals | None = None
    held: Tensor | None = None  # [S, nx] initial states that rest on a bound
    passage: Tensor | None = None  # [S, nx, nx] last state of each segment by its first
    transitions: list[Tensor | None] = field(default_factory=list)  # part by part
    blocks: list[tuple[Tensor, Tensor]] = field(default_factory=list)  # linear models of blocks of flights


@dataclass(frozen=True)
class Likelihood:
    """Minus log-likelihood of the segments (up to a constant), the noise's covariance being its best value throughout.

    prior_mean, prior_sd : [P] Gaussian prior of the parameters, infinite sd where there is none.
    states : [F, T, nx] trajectories to start from, NaN where nothing is known.
    x0 : [S, nx] where initial states start from; they are held there where `x0_sd` is None.
    x0_mean, x0_sd : [S, nx] prior of the initial states, infinite sd where there is none.
    x0_bounds : [S, nx] within which initial states stay, where there are any.
    ranks : among which the flights are spread; records and segments are those of this rank.

    Source: Morelli and Klein, Aircraft System Identification (2nd ed.), sec. 6.3; Jategaonkar, Flight Vehicle System
    Identification, sec. 4.
    """

    system: System
    engine: Engine
    records: Records
    segments: Segments
    states: Tensor
    noise: Noise
    x0: Tensor
    x0_mean: Tensor
    x0_sd: Tensor | None
    prior_mean: Tensor
    prior_sd: Tensor
    ranks: Ranks = ALONE
    x0_bounds: tuple[Tensor, Tensor] | None = None

    @property
    def locals_per_segment(self) -> int:
        """Initial states estimated per segment."""
        return 0 if self.x0_sd is None else self.x0.shape[-1]

    @cached_property
    def samples(self) -> int:
        """Measured values of all ranks, all outputs together."""
        return self._count(int((~self.segments.outputs.isnan()).sum()))

    @cached_property
    def flights(self) -> int:
        """Flights of all ranks."""
        return self._count(len(self.records.lengths))

    @cached_property
    def pieces(self) -> int:
        """Segments of all ranks."""
        return self._count(len(self.segments))

    @cached_property
    def longest(self) -> int:
        """Samples of the longest segment of all ranks."""
        return int(self.ranks.largest(self.segments.samples))

    def _count(self, local: int) -> int:
        return int(self.ranks.sum(torch.tensor(local)))

    @cached_property
    def blocks(self) -> Tensor:
        """Block of flights [F] that each flight is summed in."""
        return self.ranks.blocks(self.flights)

    def _sum(self, values: Iterable[tuple[Tensor, Tensor]]) -> Tensor:
        """Sum of values (n, ...) over all ranks, each n of the flight [n] beside it; block by block."""
        total: Tensor | None = None
        for flights, value in values:
            total = value.new_zeros(BLOCKS, *value.shape[1:]) if total is None else total
            total.index_add_(0, self.blocks[flights], value)
        assert total is not None
        return self.ranks.sum(total).sum(dim=0)

    @cached_property
    def _groups(self) -> list[Tensor]:
        """Segments of each part, whole flights."""
        per_segment = self.segments.samples * (self.x0.shape[-1] + 3 * self.segments.outputs.shape[-1])
        per_segment += (self.x0.shape[-1] + len(self.prior_mean) + 1) ** 2
        most = max(1, PART_NUMBERS // per_segment)
        groups: list[list[int]] = [[]]
        for f in torch.unique(self.segments.flight).tolist():
            mine = (self.segments.flight == f).nonzero()[:, 0].tolist()
            if groups[-1] and len(groups[-1]) + len(mine) > most:
                groups.append([])
            groups[-1] += mine
        return [torch.tensor(group) for group in groups]

    @property
    def _kept(self) -> bool:
        width = self.x0.shape[-1] + 2 * self.segments.outputs.shape[-1]
        return len(self.segments) * self.segments.samples * width <= KEPT_NUMBERS

    def evaluate(self, theta: Tensor, base: Place | None = None, share: float = 1.0) -> Place:
        """The place at theta: initial states follow from the linear model at `base`."""
        x0 = self.x0
        if base is not None and base.locals is not None:
            x0 = base.x0 + (base.locals.move(theta - base.theta, share) if self.x0_sd is not None else 0.0)
        place = Place(theta, self._within(x0))
        evaluated = self._made(place, base)
        return self.judged(place, list(evaluated) if self._kept else None)

    def _within(self, x0: Tensor) -> Tensor:
        return x0 if self.x0_bounds is None else torch.clamp(x0, *self.x0_bounds)

    def parts(self, place: Place) -> Iterable[Part]:
        """The place's runs and residuals, part by part."""
        return self._made(place, None) if place.parts is None else place.parts

    def _made(self, place: Place, base: Place | None) -> Iterator[Part]:
        """Parts simulated; from what is known of the base's trajectories where that helps."""
        for k, which in enumerate(self._groups):
            segments, steps = self.segments.pick(which), None
            near = segments.take(self.states)
            near = torch.where(near.isnan(), self.x0[which][:, None], near)
            if base is not None and base.parts is not None and base.locals is not None:
                near, steps = base.parts[k].run.states, base.transitions[k]
            run = self.engine.run(place.theta, self.records, segments, place.x0[which], near, steps)
            yield self.part(which, run)
            mapped_arrays.let_go()

    def part(self, which: Tensor, run: Run) -> Part:
        """The run of some segments, with its residual."""
        segments = self.segments.pick(which)
        return Part(which, segments, run, segments.outputs - run.outputs)

    def place(self, theta: Tensor, x0: Tensor, run: Run) -> Place:
        """What a run of all segments says."""
        return self.judged(Place(theta, x0), [self.part(torch.arange(len(self.segments)), run)])

    def judged(self, place: Place, parts: list[Part] | None) -> Place:
        """The place with the noise that its residuals show, and its cost; infinite where a run has diverged."""
        place.parts = parts
        ny = self.segments.outputs.shape[-1]
        place.moments = self.moments(place, lambda part: part.residual.detach().masked_fill(~part.valid, math.nan))
        finite = torch.isfinite(place.moments.products).all()
        if not bool(finite) or int(place.moments.count.diagonal().sum()) != self.samples:
            place.covariance = torch.eye(ny, dtype=torch.float64)
            return place
        place.covariance = self.noise.covariance(place.moments)
        with torch.no_grad():
            cost = float(self._sum(self._misfits(place)) + self._prior(place))
        place.cost = cost if math.isfinite(cost) else math.inf
        return place

    def moments(self, place: Place, of: Callable[[Part], Tensor]) -> Moments:
        """Sums over what is made of each part's residuals, [S, T, ny] with NaN = missing."""
        sums = self._sum((part.segments.flight, products(of(part))) for part in self.parts(place))
        return Moments(sums[0], sums[1])

    def mean_square_state(self, place: Place) -> Tensor:
        """[nx] over all samples of the place's runs, where they are inside their segments."""
        inside = ((part, part.segments.inside[..., None]) for part in self.parts(place))
        sums = ((p.segments.flight, torch.where(here, p.run.states, 0.0).square().sum(1)) for p, here in inside)
        return self._sum(sums) / self._count(int(self.segments.inside.sum()))

    def total(self, place: Place) -> Tensor:
        """Minus log-likelihood and priors of one rank alone; its gradient is right although the covariance is held."""
        return sum((misfits.sum() for _, misfits in self._misfits(place)), self._prior(place))

    def _prior(self, place: Place) -> Tensor:
        return 0.5 * self.prior_rows(place)[1].square().sum()

    def _misfits(self, place: Place) -> Iterator[tuple[Tensor, Tensor]]:
        """Minus log-likelihood of segments, and of what is beyond the parameters' prior, with the flight of each."""
        if self.x0_sd is not None:
            yield self.segments.flight, 0.5 * self.x0_rows(place).square().sum(dim=1)
        for part in self.parts(place):
            whitener = Whitener.of(place.covariance, part.valid)
            misfit = 0.5 * whitener.apply(part.residual.unsqueeze(-1)).square().flatten(1).sum(dim=1)
            if self.noise.matrix is None:
                misfit = misfit + 0.5 * whitener.log_determinants()
            yield part.segments.flight, misfit

    def prior_rows(self, place: Place) -> tuple[Tensor, Tensor]:
        """Rows of the parameters' prior."""
        informed = torch.isfinite(self.prior_sd)
        rows = torch.diag(1.0 / self.prior_sd)[informed]
        return rows, (self.prior_mean - place.theta)[informed] / self.prior_sd[informed]

    def x0_rows(self, place: Place) -> Tensor:
        """Rows [S, nx] of the initial states' prior."""
        if self.x0_sd is None:
            return self.x0.new_zeros(0)
        rows = (self.x0_mean - place.x0) / self.x0_sd
        return rows if place.held is None else torch.where(place.held, 0.0, rows)

    def unknowns(self, place: Place, which: Tensor) -> Unknowns:
        """The columns of the linear model of some segments."""
        if self.x0_sd is None:
            return Unknowns(None, self.x0.new_zeros(0))
        sd = self.x0_sd if place.held is None else torch.where(place.held, HELD, self.x0_sd)
        return Unknowns(sd[which], self.x0_rows(place)[which])

    def linearise(self, place: Place) -> Linear:
        """Linear model of the whitened residual in the shared parameters; the place remembers the elimination.

        Initial states on a bound that pull beyond it are held there.
        """
        linear = self._linearised(place)
        if self.x0_bounds is None:
            return linear
        assert place.locals is not None
        step = place.locals.move(torch.zeros_like(place.theta), 1.0)
        low, high = self.x0_bounds
        place.held = ((place.x0 <= low) & (step < 0.0)) | ((place.x0 >= high) & (step > 0.0))
        return self._linearised(place) if bool(place.held.any()) else linear

    @torch.no_grad()
    def _linearised(self, place: Place) -> Linear:
        local, globals_count = self.locals_per_segment, len(place.theta) + 1
        starts = mapped_arrays.empty(len(self.segments), local, local + globals_count)
        passage = self.x0.new_empty(len(self.segments), self.x0.shape[-1], self.x0.shape[-1])
        blocks = self.x0.new_zeros(min(BLOCKS, self.flights), globals_count, globals_count)
        begun, place.transitions = set[int](), []
        none = blocks.new_zeros(0, globals_count)
        for part in self.parts(place):
            whitener = Whitener.of(place.covariance, part.valid)
            eliminated = self.engine.eliminate(self.records, part, whitener, self.unknowns(place, part.which))
            starts[part.which] = eliminated.starts
            passage[part.which] = eliminated.passage
            place.transitions.append(eliminated.transitions)
            for f in torch.unique(part.segments.flight).tolist():
                flight = self.engine.joined(eliminated.joined[part.segments.flight == f], none)
                block = int(self.blocks[f])
                both = torch.stack([blocks[block], flight])
                blocks[block] = self.engine.joined(both, none) if block in begun else flight
                begun.add(block)
        place.locals, place.passage = Locals(starts), passage
        blocks = self.ranks.sum(blocks)
        place.blocks = [self._linear(block) for block in blocks]
        prior = torch.cat([part if part.dim() == 2 else part[:, None] for part in self.prior_rows(place)], dim=1)
        alone = self._sum([(self.segments.flight, place.locals.alone())])
        mapped_arrays.let_go()
        return Linear(*self._linear(self.engine.joined(blocks, prior)), float(alone))

    def _linear(self, left: Tensor) -> tuple[Tensor, Tensor]:
        """Linear model A [P, P], b [P] of the parameters."""
        triangle = self.engine.triangle(left)
        return triangle[:, :-1], triangle[:, -1]

    def by_flight(self, place: Place) -> Iterator[tuple[Part, Whitener, Tensor]]:
        """Each flight with its whitened rows [S, T ny, nx + P + 1]."""
        for part in self.parts(place):
            for f in torch.unique(part.segments.flight).tolist():
                mine = (part.segments.flight == f).nonzero()[:, 0]
                run = part.run
                run = Run(run.theta, run.controls[mine], run.states[mine], run.outputs[mine])
                flight = Part(part.which[mine], part.segments.pick(mine), run, part.residual[mine])
                whitener, unknowns = Whitener.of(place.covariance, flight.valid), self.unknowns(place, flight.which)
                yield flight, whitener, self.engine.rows(self.records, flight, whitener, unknowns)

    def states_at(self, place: Place, record: Tensor) -> Tensor:
        """A copy of a record of states [F, T, nx] with the place's trajectories written where they belong."""
        record = mapped_arrays.copied(record)
        for part in self.parts(place):
            part.segments.write(part.run.states, record)
        return record
