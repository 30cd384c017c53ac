"""Which effects a multirotor's model lacks: each identified in full, judged by accelerations at measured states.

Free runs of a vehicle that was flown in closed loop mean little, and no clean multirotor is drawn: a candidate counts
above what its own signature would gain on the model's residual with its blocks in another order, and where flights
that no fit has seen gain too: validate flights, and each identify flight by a fit of all others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.names import MOMENTS, SPECIFIC_FORCES
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.rotors import beyond_belief
from rotorid_torch.trace.balance import out_of_balance
from rotorid_torch.trace.evidence.critical_values import adjusted_p, critical_values
from rotorid_torch.trace.loop import Tracing
from rotorid_torch.trace.search.decide import Reason, Row, decide, estimate
from rotorid_torch.trace.search.screening_sizes import with_screening_sizes
from rotorid_torch.trace.search.words import explained_by, reason
from rotorid_torch.trace.terms.eligible import ELSEWHERE, NOT_IN_TRAJECTORIES, candidates, untried
from rotorid_torch.trace.terms.finding import Finding
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.significance import exceeds
from rotorid_torch.validate.responses import compared

BLOCK_S = 1.0
"""Blocks of the residual that are put in another order: longer than what a motor or a stream is late by."""
PAIRED_S = 5.0
"""s: blocks that are compared as pairs."""
UNSEEN_STATE = "it has a motion of its own, which no channel tells; accelerations at measured states show nothing of it"
LEFT_OUT = "without "
"""Before the name of a flight: its responses by a fit of all others."""
SHUFFLES = 200
"""Orders of the blocks: enough for a quantile of 5 %."""


@dataclass(frozen=True, eq=False)
class Identified:
    """A model that was identified.

    errors : standard errors of the estimated parameters by full name. without : theta of all identify flights but one,
    by that one's name: to it, that flight is unseen.
    """

    spec: ModelSpec
    model: Model
    errors: Mapping[str, float]
    without: Mapping[str, Tensor] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by its full name."""
        return self.model.named_values

    def started(self, spec: ModelSpec) -> ModelSpec:
        """A spec that begins with the values that parameters have here, but for moments that are not explained here."""
        effects = {e: f"{e}." for e in (*self.spec.effects, *spec.effects)}
        others = {n: v for n, v in spec.values.items() if not any(n.startswith(b) for b in effects.values())}
        silent = [row for row in MOMENTS if self.values.get(f"rotors.power.{row}") == 0.0]
        untold = [f"rotors.{kind}.{row}" for kind in ("power", "trim") for row in silent]
        kept = (*(effects[e] for e in spec.effects), "rotors.", "speed.")
        known = {n: v for n, v in self.values.items() if n.startswith(kept) and n not in untold}
        return msgspec.structs.replace(spec, values={**others, **known})


Fit = Callable[[ModelSpec], Identified]
Compared = Mapping[str, Mapping[str, tuple[Tensor, Tensor]]]
"""By flight and response: measured and modelled."""


def trace_rotors(
    spec: ModelSpec,
    dataset: Dataset,
    fit: Fit,
    say: Callable[[str], None] = lambda line: None,
    seed: int = 0,
    ranks: Ranks = ALONE,
) -> Tracing:
    """Which undeclared effects the model of a multirotor lacks, by forward selection.

    Parameters
    ----------
    fit : identifies a structure by the three steps. say : told what happens, a line at a time.
    seed : of the order of the residual's blocks. ranks : processes that share the candidates; each calls this.
    """
    testable, findings = candidates(spec)
    blind = [e for e in testable if registered()[e].swings]
    findings += [Finding(e, registered()[e].role.value, "not testable", UNSEEN_STATE) for e in blind]
    undeclared = [e for e in testable if registered()[e].role is Role.UNDECLARED and e not in blind]
    search, null = _Search(dataset, fit, say, seed), fit(spec)
    sized, undeclared, unmoved = with_screening_sizes(null.spec, null.values, dataset, undeclared)
    findings += unmoved
    null = now = replace(null, spec=sized)
    tried = [e for e in undeclared if not registered()[e].absorbed_by(spec)]
    while (joined := search.joined(now, tried, ranks)) is not None:
        now = joined
    final = search.confirmed(now)
    alike = {e: search.in_place_of(final, e, search.near[e]) for e in search.accepted}
    search.groups = {e: others for e, others in alike.items() if others}
    balanced = bool(spec.motors) and spec.found_places is None  # of arms that are not known nothing balances
    centre, missing = out_of_balance(final.model, final.spec, dataset, dataset.unseen) if balanced else (None, None)
    note = "critical values come from residuals whose blocks stand in another order: no clean multirotor is drawn"
    findings += [search.finding(final, e) for e in undeclared]
    centred = tuple(centre if centre and f.id == centre.id else f for f in findings)
    return Tracing(null, final, (), tuple(search.accepted), search.groups, centred, (note, *untried(dataset)), missing)


def rotors_earned(
    whole: Identified, dataset: Dataset, fit: Fit, effects: Sequence[str], seed: int = 0
) -> list[Finding]:
    """A finding for each of these effects of a multirotor's model: whether it earns its place beside the others.

    whole : the model with all of them. fit, seed : as in `trace_rotors`.
    """
    search, findings = _Search(dataset, fit, lambda line: None, seed), []
    for effect in effects:
        role = registered()[effect].role.value
        if registered()[effect].showing in ELSEWHERE:
            findings.append(Finding(effect, role, "not testable", NOT_IN_TRAJECTORIES))
            continue
        without = fit(whole.started(whole.spec.without([effect])))
        search.rows = believed([without, whole])
        search.observe(without, {effect: whole})
        trial = search.trials[effect]
        verdict, why = decide(trial.row)
        why = Reason.HELPS if verdict == "accepted" else why
        said = reason(why, **trial.details)
        findings.append(
            Finding(effect, role, verdict, said, trial.gain, trial.floor, values=_errors(whole, effect), p=trial.p)
        )
    return findings


def believed(models: Sequence[Identified]) -> tuple[str, ...]:
    """Responses to compare: angular accelerations only where one of the models gives a control power that can be.

    Commands that answer the rates are found to move the vehicle by a fraction of what its inertia allows; what
    describes such a response better describes the controller.
    """
    wrong = set.intersection(*(set(beyond_belief(m.spec, m.values)) for m in models))
    turns = [a for a, row in zip(ANGULAR_ACCELERATIONS, MOMENTS, strict=True) if row not in wrong]
    return (*SPECIFIC_FORCES, *turns)


Message = tuple[dict[str, Any], Tensor, dict[str, float], dict[str, Tensor]]
"""What travels between ranks."""


def _told(identified: Identified) -> Message:
    theta = identified.model.theta.detach().clone()
    return identified.spec.plain(), theta, dict(identified.errors), dict(identified.without)


def _again(_: ModelSpec, message: Message) -> Identified:
    spec = ModelSpec.from_plain(message[0])
    model = build(spec)
    with torch.no_grad():
        model.theta.copy_(message[1])
    return Identified(spec, model, message[2], message[3])


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate identified in full: mean log ratio of errors, its critical value, p, and what was observed."""

    fitted: Identified
    gain: float
    floor: float
    p: float
    row: Row
    details: Mapping[str, object]


class _Search:
    """What was found on the way."""

    def __init__(self, dataset: Dataset, fit: Fit, say: Callable[[str], None], seed: int) -> None:
        self.dataset, self.fit, self.say = dataset, fit, say
        self.chance = torch.Generator().manual_seed(seed)
        self.accepted: list[str] = []
        self.companions: list[str] = []
        self.groups: dict[str, tuple[str, ...]] = {}
        self.near: dict[str, tuple[str, ...]] = {}
        self.trials: dict[str, Trial] = {}
        self.rows: tuple[str, ...] = ()
        self._kept: dict[int, tuple[Identified, Compared]] = {}

    def compared(self, model: Identified) -> Compared:
        """Responses of a model on all flights that may be looked at."""
        if id(model) not in self._kept:
            names = (*self.dataset.identify, *self.dataset.validate)
            records = {n: compared(model.model, self.dataset.flights[n]) for n in names}
            for flight, theta in model.without.items():
                with model.model.restored(), torch.no_grad():
                    model.model.theta.copy_(theta)
                    records[LEFT_OUT + flight] = compared(model.model, self.dataset.flights[flight])
            self._kept[id(model)] = (model, {n: _about_means(pairs) for n, pairs in records.items()})
        whole = self._kept[id(model)][1]
        counts = lambda name: name in self.rows or name.startswith("omega")  # noqa: E731
        return {flight: {c: pair for c, pair in pairs.items() if counts(c)} for flight, pairs in whole.items()}

    def unseen(self, *models: Identified) -> tuple[str, ...]:
        """Flights that no fit has seen: validate flights, and identify flights to models fitted without them."""
        left_out = [n for n in self.dataset.identify if all(n in m.without for m in models)]
        return (*self.dataset.validate, *(LEFT_OUT + n for n in left_out)) or tuple(self.dataset.unseen)

    def by_flight(self, null: Identified, other: Identified, flights: Sequence[str]) -> Tensor:
        """Mean over the responses of log(rms without / rms with) on each flight [F]; an axis left alone counts little.

        Both squares have what the richer model leaves over on the identify flights added for that.
        """
        return torch.stack([self._log_ratios(null, other, name, None).mean() for name in flights])

    def by_block(self, null: Identified, other: Identified, flights: Sequence[str]) -> Tensor:
        """The same of blocks of the flights [B], longer than what couples errors: flights are few and long."""
        blocks = [self._log_ratios(null, other, name, PAIRED_S) for name in flights]
        return torch.cat(blocks)

    def _log_ratios(self, null: Identified, other: Identified, flight: str, block_s: float | None) -> Tensor:
        """Of the blocks of a flight [B], or of all of the flight [1]."""
        before, after, usual = self.compared(null)[flight], self.compared(other)[flight], self.sigma(other)
        dt = self.dataset.facts[flight.removeprefix(LEFT_OUT)].dt

        def squares(pair: tuple[Tensor, Tensor]) -> Tensor:
            error = (pair[0] - pair[1]).square()
            count = len(error) if block_s is None else round(block_s / dt)
            whole = max(len(error) // count, 1) * count
            return error[:whole].unflatten(0, (-1, min(count, len(error)))).mean(dim=1)

        ratios = [
            0.5 * ((squares(before[c]) + usual[c] ** 2) / (squares(after[c]) + usual[c] ** 2)).log()
            for c in before
            if c in usual
        ]
        return torch.stack(ratios).mean(dim=0) if ratios else torch.zeros(1, dtype=torch.float64)

    def sigma(self, null: Identified) -> dict[str, float]:
        """Rms of what a model leaves over in each response on the identify flights."""
        pairs = self.compared(null)
        left: dict[str, list[Tensor]] = {}
        for name in self.dataset.identify:
            for channel, (measured, modelled) in pairs[name].items():
                left.setdefault(channel, []).append(measured - modelled)
        return {c: max(float(torch.cat(r).square().mean().sqrt()), 1e-300) for c, r in left.items()}

    def gain(self, null: Identified, other: Identified) -> float:
        """Mean over the identify flights."""
        return float(self.by_flight(null, other, self.dataset.identify).mean())

    def observe(self, null: Identified, fitted: Mapping[str, Identified]) -> None:
        """A trial of each candidate: p by its signature on residuals whose blocks stand in another order."""
        drawn = {e: self._by_chance(null, f) for e, f in fitted.items()}
        gains = {e: self.gain(null, f) for e, f in fitted.items()}
        p, floors = adjusted_p(gains, drawn), critical_values(gains, drawn)
        for effect, one in fitted.items():
            size = estimate(one.model, one.errors, effect, len(fitted))
            better = self.by_flight(null, one, self.unseen(null, one))
            row = Row(
                significant=p[effect] <= SETTINGS.level,
                estimate=size.estimate,
                unseen_better=self.unseen_gain(null, one) > 0.0,
            )
            details = {
                "parameter": size.parameter,
                "value": size.value,
                "error": size.error,
                "better": int((better > 0).sum()),
                "count": len(better),
                "explained_by": "another effect explains",
            }
            self.trials[effect] = Trial(one, gains[effect], floors[effect], p[effect], row, details)
            if row.significant:
                self.say(f"{effect}: gain {gains[effect]:.3g}, p {p[effect]:.3g}: {decide(row)[1].name.lower()}")

    def unseen_gain(self, null: Identified, other: Identified) -> float:
        """Mean over the responses of log(rms without / rms with) on all flights that no fit has seen, added up first.

        So an axis that a flight leaves alone counts for little.
        """
        totals: dict[str, Tensor] = {}
        for flight in self.unseen(null, other):
            before, after = self.compared(null)[flight], self.compared(other)[flight]
            for c in before:
                errors = torch.stack([(m - f).square().sum() for m, f in (before[c], after[c])])
                totals[c] = totals.get(c, torch.zeros(2, dtype=torch.float64)) + errors
        ratios = [0.5 * float((both[0] / both[1].clamp(min=1e-300)).log()) for both in totals.values() if both[0] > 0.0]
        return sum(ratios) / len(ratios) if ratios else 0.0

    def _by_chance(self, null: Identified, other: Identified) -> Tensor:
        before, after, sigma = self.compared(null), self.compared(other), self.sigma(null)
        product = torch.zeros(SHUFFLES, dtype=torch.float64)
        size, count = 0.0, 0
        for name in self.dataset.identify:
            for channel, (measured, modelled) in before[name].items():
                if channel not in after[name]:
                    continue
                residual = (measured - modelled) / sigma[channel]
                signature = (after[name][channel][1] - modelled) / sigma[channel]
                block = max(1, round(BLOCK_S / self.dataset.facts[name].dt))
                product += _shuffled(residual, block, self.chance) @ signature
                size, count = size + float(signature.square().sum()), count + len(residual)
        return 0.5 * product.square() / max(size, 1e-300) / max(count, 1)

    def accompanied(self, effect: str, fitted: Identified) -> Identified:
        """The fit with the effect's companion as well, where that gains more than by chance and on unseen flights.

        No accusation, for every rotor has it: unseen flights alone decide, however few of them tell its size.
        """
        companion = registered()[effect].companion
        both = self.fit(fitted.started(fitted.spec.with_effects(companion)))
        self.observe(fitted, {companion: both})
        row = self.trials[companion].row
        return both if row.significant and row.unseen_better else fitted

    def joined(self, now: Identified, tried: Sequence[str], ranks: Ranks) -> Identified | None:
        """The model with the best of the candidates that stand, and its companion; None where none joins."""
        remaining = [e for e in tried if e not in self.accepted]
        if not remaining or len(self.accepted) - len(self.companions) >= SETTINGS.effects:
            return None
        identified = ranks.carry([now.started(now.spec.with_effects(e)) for e in remaining], self.fit, _told, _again)
        fitted = dict(zip(remaining, identified, strict=True))
        self.rows = believed([now, *fitted.values()])
        trials: dict[str, Trial] = {}
        for effect in [e for e in fitted if registered()[e].companion in fitted]:
            fitted[effect] = self.accompanied(effect, fitted[effect])
            trials[registered()[effect].companion] = self.trials[registered()[effect].companion]
        self.observe(now, fitted)
        standing = [e for e in fitted if decide(self.trials[e].row)[0] == "accepted"]
        if not standing:
            return None
        best = max(standing, key=lambda e: self.gain(now, fitted[e]))
        joining = [e for e in fitted[best].spec.effects if e not in now.spec.effects]
        self.say(f"{' and '.join(joining)} join{'s' if len(joining) == 1 else ''}")
        self.accepted += joining
        self.companions += joining[1:]
        self.trials |= {e: trials[e] for e in joining[1:]}  # a companion counts by what it gained beside the first
        self.near |= {e: self.not_told_from(fitted, best, standing) if e == best else () for e in joining}
        return fitted[best]

    def not_told_from(self, fitted: Mapping[str, Identified], best: str, standing: Sequence[str]) -> tuple[str, ...]:
        """Candidates that flights which no fit has seen do not tell from the best."""
        others, chosen = [e for e in standing if e != best], fitted[best]
        unseen = self.unseen(*fitted.values())
        distinct = {e: exceeds(self.by_block(fitted[e], chosen, unseen)) for e in others}
        return tuple(e for e, better in distinct.items() if not better)

    def explains_beside(self, final: Identified, effect: str) -> bool:
        """Whether a candidate explains something beside all that joined: a cause of its own then, and no rival."""
        self.observe(final, {effect: self.fit(final.started(final.spec.with_effects(effect)))})
        return decide(self.trials[effect].row)[0] == "accepted"

    def in_place_of(self, final: Identified, effect: str, others: Sequence[str]) -> tuple[str, ...]:
        """Those of the others that in an accepted effect's place, beside all that joined later, do as well."""
        rivals = [e for e in others if e not in self.accepted and not self.explains_beside(final, e)]
        swapped = {e: tuple(e if listed == effect else listed for listed in final.spec.effects) for e in rivals}
        specs = {e: msgspec.structs.replace(final.spec, effects=them) for e, them in swapped.items()}
        fitted = {e: self.fit(final.started(spec)) for e, spec in specs.items()}
        return tuple(e for e, f in fitted.items() if not exceeds(self.by_block(f, final, self.unseen(f, final))))

    def confirmed(self, final: Identified) -> Identified:
        """Each accepted effect tested again beside the others; those that explain nothing more are taken out."""
        for effect in list(self.accepted) if len(self.accepted) > 1 else []:
            without = self.fit(final.started(final.spec.without([effect])))
            joined = self.trials[effect]
            self.observe(without, {effect: final})
            trial = self.trials[effect]
            if trial.row.significant:
                self.trials[effect] = joined
            else:
                self.accepted.remove(effect)
                self.trials[effect] = replace(
                    trial, row=replace(trial.row, significant=True, still=False, in_set=False)
                )
                final = without
        return final

    def finding(self, final: Identified, effect: str) -> Finding:
        """What came of a candidate."""
        absorbed = registered()[effect].absorbed_by(final.spec)
        if absorbed:
            said = f"{absorbed} stand for it in these flights; weigh the vehicle, or swing it, to tell"
            return Finding(effect, "undeclared", "indistinguishable", said, group=(absorbed,))
        within = {e: best for best, others in self.groups.items() for e in others}
        trial, group = self.trials[effect], self.groups.get(effect, ())
        finding = Finding(effect, "undeclared", "accepted", "", trial.gain, trial.floor, p=trial.p)
        if effect in within:
            best = within[effect]
            said = reason(Reason.OTHER_NAMED, others=best)
            return replace(finding, verdict="indistinguishable", reason=said, group=(best,))
        joined = effect in self.accepted
        stands = decide(trial.row)[0] == "accepted"
        # what joined as a companion is known by what it gained beside the first, however well its size is
        row = Row(alone=not group) if joined else replace(trial.row, in_set=not stands)
        verdict, why = decide(row)
        why = Reason.HELPS if verdict == "accepted" else why
        details = {**trial.details, "others": " or ".join(group), "explained_by": explained_by(self.accepted)}
        said = reason(why, **details)
        values = _errors(final if joined else trial.fitted, effect)
        return replace(finding, verdict=verdict, reason=said, group=group, values=values)


def _about_means(pairs: Mapping[str, tuple[Tensor, Tensor]]) -> dict[str, tuple[Tensor, Tensor]]:
    """Responses of a flight, measured and modelled, less a constant each.

    It differs from flight to flight by the attitude's tilt, the accelerometers' bias, battery and mass.
    """
    return {c: (measured - (measured - modelled).mean(), modelled) for c, (measured, modelled) in pairs.items()}


def _errors(model: Identified, effect: str) -> dict[str, tuple[float, float]]:
    errors = {n: e for n, e in model.errors.items() if n.startswith(f"{effect}.")}
    return {n: (model.values[n], e) for n, e in errors.items()}


def _shuffled(record: Tensor, block: int, chance: torch.Generator) -> Tensor:
    """A record (T,) with its blocks in another order and turned to and fro [SHUFFLES, T]."""
    count = max(1, len(record) // block)
    pieces = record[: count * block].reshape(count, block)
    orders = torch.stack([torch.randperm(count, generator=chance) for _ in range(SHUFFLES)])
    signs = torch.randint(0, 2, (SHUFFLES, count, 1), generator=chance) * 2.0 - 1.0
    return torch.cat([(pieces[orders] * signs).flatten(1), record[count * block :].expand(SHUFFLES, -1)], dim=1)
