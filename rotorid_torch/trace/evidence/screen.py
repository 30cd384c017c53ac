"""All candidates at once: what each would do to the residual, and how much of that the fitted model can do itself.

Every candidate is simulated at its typical size around the fitted model; the change of the outputs is its signature
(in proportion from a smaller size, where with the typical one a trajectory leaves all that was measured).
What initial states, trims and derivatives can imitate is projected out of signature and residual. What is left tells
the gain that the candidate would bring, its size, and the smallest size that the flights would show.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.least_squares import bounded_least_squares
from rotorid_torch.core.native.side_by_side import side_by_side
from rotorid_torch.effects.base import Stage
from rotorid_torch.effects.signal_operations import smoothed
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.estimate.likelihood import Likelihood, Place
from rotorid_torch.identification.estimate.residuals import Whitener
from rotorid_torch.identification.estimate.segments import Records, Segments
from rotorid_torch.model.gusts import GUSTS
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.training.equilibrium import rates_of, settled
from rotorid_torch.trace.evidence.fits import Fitted
from rotorid_torch.trace.evidence.held_out import FlightEquations
from rotorid_torch.trace.terms.candidate import UNATTRIBUTED, Candidate
from rotorid_torch.trace.terms.finding import LISTED
from rotorid_torch.trace.terms.significance import turned
from rotorid_torch.validate.free_run import Runs

HALVINGS = 6
"""Times that a typical size is halved, at most, where a trajectory with it leaves all that was measured."""
LARGEST = 1e3
"""Times its typical size at which an effect is looked for, at most."""
ABOVE_NOISE = 20.0
"""Times its noise that an output must range over to say what is large; noise alone ranges over 6 to 10 times."""


@dataclass(frozen=True)
class Signature:
    """One direction of one candidate: its parameter's full name, null, the size it was simulated at, and its bounds.

    others : other parameters of the effect, and where they were; and of the null, where these follow. size : which of
    the sizes it is met at this one is, negative where the null's parameters follow.
    order : of the derivative of the controls that a pseudo-effect of the control path adds to the controls; else zero.
    """

    effect: str
    parameter: str
    null: float
    typical: float
    bounds: tuple[float, float]
    unit: str
    others: tuple[tuple[str, float], ...] = ()
    size: int = 0
    order: int = 0
    each_control: bool = False

    @property
    def candidate(self) -> Candidate:
        """What it is a direction of."""
        return Candidate(self.effect, self.each_control)

    @property
    def step(self) -> float:
        """From null to typical size."""
        return self.typical - self.null

    @property
    def reach(self) -> tuple[float, float]:
        """Bounds in units of the step."""
        low, high = sorted((b - self.null) / self.step for b in self.bounds)
        return low, high


PATH = f"{UNATTRIBUTED}control path"
"""The pseudo-effect of whatever filter lies between recorded controls and rotor, u + a du/dt + b d2u/dt2."""
PATH_S = 0.1
"""s: time constant at which the pseudo-effect is simulated, and over which controls are smoothed before they are
differentiated, for their noise is not what acts."""
PSEUDO = tuple(
    Signature(PATH, f"{PATH}.{order}", 0.0, PATH_S**order, (-math.inf, math.inf), unit, order=order)
    for order, unit in ((1, "s"), (2, "s2"))
)


def together(signatures: Sequence[Signature]) -> list[list[int]]:
    """Places of signatures of one candidate at one size, and with the same other parameters."""
    kinds: dict[object, list[int]] = {}
    for place, one in enumerate(signatures):
        kinds.setdefault((one.candidate, one.others, one.size), []).append(place)
    return [*kinds.values()]


@dataclass(frozen=True, eq=False)
class Screen:
    """Signatures of candidates, and the normal equations of these, of a fitted model, and of its residual.

    names : parameters of the fitted model, the first columns of the equations.
    """

    signatures: tuple[Signature, ...]
    names: tuple[str, ...]
    equations: FlightEquations

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Those that have signatures."""
        return tuple(dict.fromkeys(s.candidate for s in self.signatures))

    @cached_property
    def _together(self) -> list[list[int]]:
        return together(self.signatures)

    def _variants(self, candidate: str) -> list[list[int]]:
        """Signatures of a candidate, by its name, that go together."""
        return [which for which in self._together if self.signatures[which[0]].candidate.name == candidate]

    def evidence(self, effect: str, residual: int = 0) -> Tensor:
        """How much better flights are predicted with the effect than without, estimated from other flights [F + V].

        At the size and with the other parameters where that is largest over all flights. residual : which of them.
        """
        return self._shown(effect, residual)[1]

    def shown(self, effect: str) -> dict[str, float]:
        """Values of the effect's parameters there."""
        return self._values(self._shown(effect)[0])

    def _shown(self, effect: str, residual: int = 0) -> tuple[list[int], Tensor]:
        """Signatures of an effect that show most evidence together, and that."""
        shown = []
        for which in self._variants(effect):
            low, high = torch.tensor([self.signatures[i].reach for i in which], dtype=torch.float64).mT
            shown.append((which, self.equations.held_out(which, low, high, residual)))
        return max(shown, key=lambda one: float(one[1].sum()))

    def expected(self, effect: str, share: float = 1.0) -> float:
        """The statistic T that the effect gives at a share of its typical size, in its least visible direction."""
        return min((self.equations.expected(i, share) for i in self._best(effect, typical=True)), default=0.0)

    def visible(self, effect: str, statistic: float) -> tuple[float, str] | None:
        """Size at which the effect is expected to give a statistic T, and its unit: of its first parameter.

        None where no size within its bounds does.
        """
        from scipy.optimize import root_scalar  # slow to import

        which = self._best(effect, typical=True)
        if not which:
            return None
        first = self.signatures[which[0]]
        largest = min(max(first.reach), LARGEST)
        if self.expected(effect, largest) < statistic:
            return None
        target = max(statistic, 0.0)
        share = root_scalar(lambda share: self.expected(effect, share) - target, bracket=(0.0, largest)).root
        return abs(first.step) * share, first.unit

    def sizes(self, effects: Sequence[str]) -> dict[str, float]:
        """Best value of each parameter of these effects, by the straight line through null and typical size."""
        return self._values([i for e in dict.fromkeys(effects) for i in self._best(e, typical=False)])

    def _values(self, which: list[int]) -> dict[str, float]:
        """Best value of each parameter of these signatures together, and the others where these have them."""
        return {name: value for i in which for name, value in self.signatures[i].others} | self._solved(which)[1]

    def unbounded(self, effect: str) -> dict[str, float]:
        """Sizes of an effect beyond nothing by the same straight line, whatever its bounds: below nothing too."""
        which = self._best(effect, typical=True)
        values = self._solved(which, bounded=False)[1]
        return {s.parameter: values[s.parameter] - s.null for s in (self.signatures[i] for i in which)}

    def starts(self, effect: str) -> list[dict[str, float]]:
        """Values from which a full fit of an effect may begin.

        The best by the straight line; and where its other parameters are tried at several values, or itself at several
        sizes, its typical size at each, for there a line from nothing says little of what lies beyond.
        """
        variants = self._variants(effect)
        chosen = [[self.signatures[i] for i in which] for which in variants] if len(variants) > 1 else []
        typical = [{**dict(one[0].others), **{s.parameter: s.typical for s in one}} for one in chosen]
        return [self.sizes([effect]), *typical]

    def _best(self, candidate: str, typical: bool) -> list[int]:
        """Signatures of a candidate at the size and with its other parameters where they explain most.

        typical : at its typical size, for what flights show of it does not hang on what they hold.
        """
        variants = self._variants(candidate)
        some = [which for which in variants if self.signatures[which[0]].size == 0] if typical else variants
        return max(some, key=lambda which: self._solved(which)[0], default=[])

    def imitators(self, effect: str) -> tuple[str, ...]:
        """Parameters of the fitted model that take the effect's place, those of the largest part in each direction."""
        parts = [self.equations.imitating(i).abs() for i in self._best(effect, typical=True)]
        largest = [(part, part.argsort(descending=True)[:LISTED].tolist()) for part in parts]
        return tuple(dict.fromkeys(self.names[k] for part, places in largest for k in places if float(part[k]) > 0.0))

    def _solved(self, which: list[int], bounded: bool = True) -> tuple[float, dict[str, float]]:
        """Fall of half the square of the residual by these signatures together, and the best value of each parameter.

        A copy of other signatures gets nothing.
        """
        if not which:
            return 0.0, {}
        chosen, total = [self.signatures[i] for i in which], self.equations.total
        low, high = torch.tensor(
            [s.reach if bounded else (-math.inf, math.inf) for s in chosen], dtype=torch.float64
        ).mT
        G, d = total[which][:, which], total[which, len(self.signatures)]
        a = bounded_least_squares(G, d, low, high)
        values = {s.parameter: s.null + size * s.step for s, size in zip(chosen, a.tolist(), strict=True)}
        return float(a @ d - 0.5 * a @ G @ a), values


def signatures(model: Model, effects: Sequence[str]) -> tuple[Signature, ...]:
    """Free parameters of these effects that have sizes to be met with, at each and at each start of the others.

    A size that is itself to be tried at several values is met at these, where the effect has no other size.
    """
    results = []
    for effect in effects:
        parameters = [p for p in model.parameter_set.sizes(effect) if p.free]
        usual = [p for p in parameters if p.typical not in (0.0, p.value)]
        met = {p: (p.typical, *p.met) for p in usual if not p.tried} or {p: p.tried for p in usual}
        shapes = [p for p in parameters if p.tried and p not in met]
        starts = [
            tuple((p.name, value) for p, value in zip(shapes, values, strict=True))
            for values in product(*(p.tried for p in shapes))
        ]
        results += [
            Signature(effect, p.name, p.value, met[p][min(size, len(met[p]) - 1)], p.bounds, p.unit, others, size)
            for others in starts
            for size in range(max(map(len, met.values()), default=0))
            for p in met
        ]
    return tuple(results)


@torch.no_grad()
def screen(null: Fitted, effects: Sequence[str], each: Sequence[str] = (), shuffles: int = 0, seed: int = 0) -> Screen:
    """Signatures of effects that the null does not have, against its residual.

    each : effects that are asked with a size of each control as well. shuffles : residuals made by turning each
    flight's residual in time by a random stretch, with a random sign. Sizes never ask flights that no fit has seen.
    """
    richer = msgspec.structs.replace(null.spec, each_control=(*null.spec.each_control, *each))
    probes = [_Probe.of(null, null.spec, effects), _Probe.of(null, richer, each, each_control=True)]
    chosen = tuple(one for probe in probes for one in probe.chosen)
    keep = null.fit.minimum.determined
    names = tuple(n for n, keeps in zip(null.names, keep.tolist(), strict=True) if keeps)
    problem, place = null.fit.likelihood, null.fit.minimum.point
    chance = torch.Generator().manual_seed(seed)
    products = _products(probes, (problem, place), null.flights.dataset.identify, shuffles, chance)
    listed = null.flights.dataset.validate
    unseen = products.new_zeros(len(listed), *products.shape[1:])  # no evidence where the null flies away
    if listed and math.isfinite(null.on_unseen[1].cost):
        unseen = _products(probes, null.on_unseen, listed, shuffles, chance)
    rows, remainder = problem.prior_rows(place)
    equations = FlightEquations.of(products[:, None], unseen[:, None], (rows[:, keep], remainder), 1 + shuffles)
    return Screen(chosen, names, equations)


def _products(
    probes: Sequence[_Probe],
    flown: tuple[Likelihood, Place],
    listed: Sequence[str],
    shuffles: int,
    chance: torch.Generator,
) -> Tensor:
    """Products [F, n, n] of each flight by name, initial states projected out.

    Columns: the null's parameters that were estimated, signatures, residual, residuals turned in time.
    """
    (problem, place), keep = flown, probes[0].null.fit.minimum.determined
    first = problem.locals_per_segment
    tapes = [_tapes(probe.model, problem.records, probe.chosen) for probe in probes]

    def parts() -> Iterator[tuple[Whitener, Tensor, list[Tensor], Tensor]]:
        for part, whitener, rows in problem.by_flight(place):
            changes = [
                change
                for probe, taped in zip(probes, tapes, strict=True)
                for change in probe.changes(problem.records, listed, taped, part.segments, part.run.states[:, 0])
            ]
            record = rows[..., -1].unflatten(-1, (-1, part.residual.shape[-1])).flatten(0, 1)
            by_chance = turned(record, shuffles, chance).unflatten(0, (len(rows), -1)).flatten(1, 2)
            yield whitener, rows, changes, by_chance

    def product(part: tuple[Whitener, Tensor, list[Tensor], Tensor]) -> Tensor:
        whitener, rows, changes, by_chance = part
        signature = rows[..., :0]
        if changes:
            signature = whitener.apply(torch.stack(changes, dim=-1).nan_to_num(0.0)).flatten(1, 2)
        matrix = torch.cat([rows[..., first:-1][..., keep], signature, rows[..., -1:], by_chance], dim=-1)
        basis = torch.linalg.qr(rows[..., :first]).Q
        matrix = matrix - basis @ (basis.mT @ matrix)
        return (matrix.mT @ matrix).sum(0)

    return torch.stack([*side_by_side(product, parts())])


@dataclass(frozen=True, eq=False)
class _Probe:
    """Simulates signatures around a fitted null, which `model` holds with all candidates at their nulls."""

    null: Fitted
    model: Model
    chosen: tuple[Signature, ...]

    @cached_property
    def run(self) -> Runs:
        """What simulates the model."""
        return Runs.of(self.model)

    @classmethod
    def of(cls, null: Fitted, spec: ModelSpec, effects: Sequence[str], each_control: bool = False) -> _Probe:
        """Of effects that join a spec."""
        library = [e for e in effects if e != PATH]
        model = build(spec.with_effects(*library), null.values)
        chosen = (replace(one, each_control=each_control) for one in signatures(model, library))
        return cls(null, model, (*chosen, *(PSEUDO if PATH in effects else ())))

    def changes(
        self, records: Records, names: Sequence[str], tapes: _Tapes, segments: Segments, states: Tensor
    ) -> list[Tensor]:
        """Of the outputs [S, T, ny] by each signature, from the null's initial states [S, nx].

        Beyond all that was measured nothing is in proportion, so a smaller size speaks for it.
        """
        if not self.chosen:
            return []
        noise = [self.null.flights.dataset.noise(c) for c in self.null.spec.outputs]
        most = output_ranges(records.outputs.flatten(0, 1), torch.tensor(noise, dtype=torch.float64))
        start = _starts(self.model, self.null, records, names, segments, states)
        base = self.run(start, segments.take(tapes[None]), segments.dt)[1]

        def changed(one: Signature, k: int = 0) -> Tensor:
            with sized(self.model, replace(one, typical=one.null + 0.5**k * one.step) if k else one):
                tape = tapes.get(one, tapes[None])
                if k and one.order:
                    tape = tapes[None] + 0.5**k * (tape - tapes[None])
                elif k and one in tapes:
                    tape = self.model.tape(records.controls, records.dt)
                change = self.run(start, segments.take(tape), segments.dt)[1] - base
            inside = k == HALVINGS or bool((change.abs() <= most).all())
            return 2.0**k * change if inside else changed(one, k + 1)

        return [changed(one) for one in self.chosen]


_Tapes = Mapping[Signature | None, Tensor]
"""Control records [F, T, nu] behind the control path with each signature that acts there, and without any."""


@contextmanager
def sized(model: Model, one: Signature) -> Iterator[None]:
    """The model with one signature at its typical size, and back again."""
    with model.restored():
        if not one.order:
            model.start_from(dict((*one.others, (one.parameter, one.typical))))
        yield


def _tapes(model: Model, records: Records, chosen: Sequence[Signature]) -> _Tapes:
    """Once for all segments: rate limits and plays go through a record sample by sample."""
    paths, none = [e.id for e in model.chain if e.stage is Stage.CONTROL], model.tape(records.controls, records.dt)
    tapes: dict[Signature | None, Tensor] = {None: none}
    moved, acts = none, torch.tensor([float(n not in GUSTS) for n in model.body.controls], dtype=torch.float64)
    for one in (s for s in chosen if s.order):
        moved = torch.gradient(smoothed(moved, max(1, round(PATH_S / records.dt))), spacing=records.dt, dim=-2)[0]
        tapes[one] = none + one.step * acts * moved
    for one in chosen:
        if one.effect in paths:
            with sized(model, one):
                tapes[one] = model.tape(records.controls, records.dt)
    return tapes


def output_ranges(outputs: Tensor, noise: Tensor) -> Tensor:
    """From least to largest of each output [n, ny]; infinite for one that never moved beyond its noise [ny]."""
    missing = outputs.isnan()
    low, high = outputs.masked_fill(missing, math.inf).amin(0), outputs.masked_fill(missing, -math.inf).amax(0)
    return torch.where(high - low > ABOVE_NOISE * noise, high - low, math.inf)


def _starts(
    model: Model, null: Fitted, records: Records, listed: Sequence[str], segments: Segments, states: Tensor
) -> Tensor:
    """Initial states [S, nx] of the richer model: the null's own, measured ones, and the rest in equilibrium."""
    names, theirs = model.layout.names, null.model.layout.names
    x = torch.tensor([model.reference.get(n, 0.0) for n in names], dtype=torch.float64).repeat(len(segments), 1)
    x[:, model.layout.places(theirs)] = states
    channels = {i: state.channel for i, state in enumerate(model.layout.states) if state.name not in theirs}
    for i, channel in channels.items():
        if channel is not None:
            x[:, i] = _measured(null, listed, segments, channel)
    remaining = [i for i, channel in channels.items() if channel is None]
    # linear in these states, or nearly
    return settled(rates_of(model, segments.first(records.controls)), x, remaining, steps=2)


def _measured(null: Fitted, listed: Sequence[str], segments: Segments, channel: str) -> Tensor:
    """A channel where each segment begins [S]."""
    dataset, dt = null.flights.dataset, null.fit.likelihood.records.dt
    measured = []
    for flight, place in zip(segments.flight.tolist(), segments.place[:, 0].tolist(), strict=True):
        record = dataset.flights[listed[int(flight)]]
        first, every = round(place * dt / record.dt), max(1, round(dt / record.dt))
        measured.append(record.bridged([channel])[first : first + every, 0].mean())
    return torch.stack(measured)
