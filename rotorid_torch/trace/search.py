"""The search for what a model lacks: what trims tell, structure, forward selection of undeclared effects, all again.

Every candidate is screened in one batch; the few that pass their floors are fitted in full; flights that no fit has
seen decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

from torch import Tensor

from rotorid_torch.core.ranks import ALONE, Ranks
from rotorid_torch.trace.by_control import by_control, sizes_of_each
from rotorid_torch.trace.candidates import of_control_path
from rotorid_torch.trace.decide import (
    CLOSE,
    TIMES,
    astray,
    errors,
    gain,
    not_joined,
    objection,
    rivals,
    smallest_visible,
    telling,
    unlikely,
    unseen_gain,
)
from rotorid_torch.trace.finding import Finding
from rotorid_torch.trace.fits import BEGINNING, CAREFUL, Fitted, Flights, control_by_control, refit
from rotorid_torch.trace.floor import Floors, flight_by_flight
from rotorid_torch.trace.forces import derivatives_beside, seen_in_forces
from rotorid_torch.trace.places import explained_trims
from rotorid_torch.trace.screen import Screen, both_screens, screen
from rotorid_torch.trace.significance import helps
from rotorid_torch.trace.spread import Wanted, fits

FEW = 4
"""Candidates that are fitted in full in one round, those that explain most."""
ROUNDS = 4
"""Undeclared effects that may join, at most."""
LONGEST = 4
"""Times that a fit may go on, at most."""
ALIKE = 0.5
"""Share of what controls explain one by one that all of them alike explain at least where they are alike; two late
controls of four like ones explain half of it so, one of four a quarter."""
ROTOR = ("rotor.flap_second_order", "rotor.lead_lag")
"""Structure that every rotor has where it can be tested: in the null of all candidates from the start."""
Say = Callable[[str], None]


@dataclass
class Search:
    """The state of the search: the model so far, and what was found on the way.

    seed : of the shuffled residuals. asked_for : whether flights not fitted gain by the rotor's ordinary physics.
    identified : the parameters' values as the three steps left them; none where nothing begins from there again.
    ranks : among which fits and tests of several candidates are spread; everything else is the same at each.
    apart : for an accepted effect of the control path what it is for each control.
    placed : gain and floor of effects of where the vehicle flies that explain what trims differ by; they join first.
    gained : gain and floor of effects that joined later, fitted in full.
    alone : floors of effects that were tried on each control by itself. each_floor : of those that may be now.
    beside : floors of effects of the control path that are higher, for another one explains much.
    ordinary : what is said of structure that did not join.
    last : the model and the effects that were last screened in both ways, and the screens.
    """

    flights: Flights
    held: tuple[str, ...]
    floors: Floors
    say: Say
    seed: int
    ranks: Ranks = ALONE
    identified: dict[str, float] = field(default_factory=dict)
    asked_for: bool = False
    rejected: dict[str, tuple[str, float, Mapping[str, tuple[float, float]]]] = field(default_factory=dict)
    hot: set[str] = field(default_factory=set)
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    spread: dict[str, float] = field(default_factory=dict)
    apart: dict[str, str] = field(default_factory=dict)
    placed: dict[str, tuple[float, float]] = field(default_factory=dict)
    gained: dict[str, tuple[float, float]] = field(default_factory=dict)
    alone: dict[str, float] = field(default_factory=dict)
    each_floor: dict[str, float] = field(default_factory=dict)
    beside: dict[str, float] = field(default_factory=dict)
    ordinary: dict[str, Finding] = field(default_factory=dict)
    last: tuple[Fitted, tuple[str, ...], tuple[Screen, Screen]] | None = None

    def screened(self, null: Fitted, effects: Sequence[str]) -> Screen:
        """These effects against what a model leaves over."""
        return screen(null, effects, seed=self.seed)

    def screened_both(self, null: Fitted, effects: Sequence[str]) -> tuple[Screen, Screen]:
        """The same, and beside it those of the control path with a size of each control; made once for a model."""
        key = tuple(effects)
        if self.last is None or self.last[0] is not null or self.last[1] != key:
            self.last = null, key, both_screens(null, effects, seed=self.seed)
        return self.last[2]

    def evidence(self, null: Fitted, effects: Sequence[str]) -> dict[str, Tensor]:
        """Evidence of each candidate, flight by flight, beside a model."""
        return flight_by_flight(*self.screened_both(null, effects))

    def with_each(
        self,
        null: Fitted,
        starts: Mapping[str, Sequence[Mapping[str, float]]],
        floors: Mapping[str, float],
        each_control: Sequence[str] = (),
    ) -> dict[str, Fitted]:
        """The null with one more effect, for each of these, fitted in full; of several starts the best goes on.

        A fit that ends worse than the null, which is one of its values, is lost, and begun again over short segments;
        so is one that fails on unseen flights, from the model as identified: the null's derivatives may imitate what
        it lacks, and from there a fit need not find back.

        each_control : those of them that have a size for each control.
        """
        richer = {e: null.spec.with_effects(e, each_control=e in each_control) for e in starts}

        def begun(chosen: Collection[str], short_first: bool) -> dict[str, Fitted]:
            wanted = [
                (e, Wanted(richer[e], {**null.values, **own}, null, short_first)) for e in chosen for own in starts[e]
            ]
            fitted: dict[str, Fitted] = {}
            for (e, _), one in zip(wanted, fits([w for _, w in wanted], self.held, BEGINNING, self.ranks), strict=True):
                fitted[e] = min(fitted.get(e, one), one, key=lambda f: f.cost)
            return self.gone_on(fitted, floors)

        found = begun(starts, short_first=False)
        lost = [e for e, one in found.items() if gain(null, one) < -floors[e]]
        found |= {e: min(found[e], one, key=lambda f: f.cost) for e, one in begun(lost, short_first=True).items()}
        return found | self.gone_on(self._afresh(null, found, floors), floors)

    def _afresh(self, null: Fitted, fitted: Mapping[str, Fitted], floors: Mapping[str, float]) -> dict[str, Fitted]:
        """Fits that explain what was fitted, but not unseen flights: those of them that end better from elsewhere."""
        if not self.identified:
            return {}
        stuck = [e for e, one in fitted.items() if gain(null, one) > floors[e]]
        stuck = [e for e in stuck if not helps(unseen_gain(null, fitted[e]))]
        named = [*self.placed, *self.gained]
        starts = {e: self.identified | _of_effects(fitted[e].values, [*named, e]) for e in stuck}
        wanted = [Wanted(fitted[e].spec, start, null, short_first=True) for e, start in starts.items()]
        again = dict(zip(stuck, fits(wanted, self.held, CAREFUL, self.ranks), strict=True))
        return {e: one for e, one in again.items() if one.cost < fitted[e].cost}

    def gone_on(self, fitted: Mapping[str, Fitted], least: Mapping[str, float]) -> dict[str, Fitted]:
        """Fits gone on with until they have converged, or gain no more than the least that matters to each."""
        now, going = dict(fitted), list(fitted)
        for _ in range(LONGEST):
            going = [name for name in going if not now[name].fit.minimum.converged]
            wanted = [Wanted(now[name].spec, now[name].values, now[name]) for name in going]
            longer = dict(zip(going, fits(wanted, self.held, CAREFUL, self.ranks), strict=True))
            going = [name for name, one in longer.items() if gain(now[name], one) > least[name]]
            now |= {name: one for name, one in longer.items() if gain(now[name], one) > 0.0}
        return now

    def settled(self, fitted: Fitted, least: float) -> Fitted:
        """One fit gone on with."""
        return self.gone_on({"": fitted}, {"": least})[""]

    def why(self, structural: str) -> str:
        """Why a structural effect is in the model."""
        if structural in ROTOR and not self.asked_for:
            return "ordinary physics of every rotor; flights not fitted do not gain by it"
        return "ordinary physics that flights not fitted ask for"

    def improved(self, null: Fitted, fitted: Mapping[str, Fitted], least: float) -> Fitted:
        """The null fitted again from where the best candidate ended: what it gains so is not the candidate's."""
        if not fitted:
            return null
        best = max(fitted.values(), key=lambda f: gain(null, f))
        again = self.settled(refit(null.spec, self.flights, best.values, self.held, near=best), least)
        if gain(null, again) <= 0.0:
            return null
        self.say(f"the model without candidates gains {gain(null, again):.3g} per sample from a better start")
        return again

    def over_short(self, null: Fitted) -> Fitted:
        """The null, or what a fit over short segments first makes of it where that ends better.

        Not where flights that no fit has seen are described worse: what a model lacks may be imitated in the fitted
        ones, better even than the cause describes them, by derivatives that are no vehicle's.
        """
        again = fits([Wanted(null.spec, null.values, null, short_first=True)], self.held, CAREFUL, self.ranks)[0]
        if gain(null, again) <= 0.0:
            return null
        worse = -unseen_gain(null, again)
        if not bool(worse.isfinite().all()) or helps(worse):
            self.say("over short segments first the model without candidates describes unseen flights worse: not kept")
            return null
        self.say(f"the model without candidates gains {gain(null, again):.3g} per sample over short segments first")
        return again

    def place(self, null: Fitted, effects: Sequence[str]) -> Fitted:
        """The null with what explains how trims differ from flight to flight: without that, no fit of it means much."""
        rest = list(effects)
        while found := explained_trims(null.spec, _of_effects(null.values, self.placed), self.flights, rest):
            effect, one = next(iter(found.items()))
            rest = [e for e in found if e != effect]
            said = f"{effect} explains {100.0 * one.share:.0f} % of what trims of unseen flights differ by"
            spec = null.spec.with_effects(effect)
            told = one.start if not self.placed else _of_effects(one.start, [effect])
            start = {n: v for n, v in told.items() if n not in self.held}
            fitted = refit(spec, self.flights, {**null.values, **start}, self.held, near=null)
            screened = self.screened(null, [effect])
            floor = self.floors.chance(screened, [effect])[effect]
            against = objection(null, fitted, effect, floor, one.scatter)
            self.say(f"{said}: gain {gain(null, fitted):.3g}, {against or 'joins'}")
            if against is None:
                self.placed[effect] = gain(null, fitted), floor
                self.spread.update(one.scatter)
                null = fitted
        return null

    def structure(self, null: Fitted, candidates: Sequence[str]) -> Fitted:
        """The null with the rotor's ordinary physics, and what other structure helps flights that no fit has seen."""
        rotor = [e for e in ROTOR if e in candidates]
        if rotor:
            spec = null.spec.with_effects(*rotor)
            sizes = screen(null, rotor, shuffles=0).sizes(rotor)
            richer = refit(spec, self.flights, {**null.values, **sizes}, self.held, near=null)
            self.asked_for = helps(unseen_gain(null, richer))
            if gain(null, richer) > 0.0:
                self.say(f"structure: {' and '.join(rotor)} join, gain {gain(null, richer):.3g} per sample")
                null = richer
            else:
                for e in rotor:
                    self.refuse(e, "fitted in full, it explains nothing more", richer, gained=gain(null, richer))
        null = self.over_short(null)
        rest = [e for e in candidates if e not in rotor]
        while rest:
            screened = self.screened(null, rest)
            floors = self.floors.chance(screened, rest)
            best = max(rest, key=lambda e: screened.gain([e]))
            if screened.gain([best]) <= floors[best]:
                self.ordinary |= {e: not_joined(screened, e, floors[e], (), hot=False) for e in rest}
                break
            fitted = self.with_each(null, {best: screened.starts(best)}, floors)[best]
            null = self.improved(null, {best: fitted}, floors[best])
            rest.remove(best)
            against = objection(null, fitted, best, floors[best], fitted.scatter(best))
            self.say(f"structure: {best}, gain {gain(null, fitted):.3g} per sample: {against or 'joins'}")
            if against is None:
                null = fitted
            else:
                visible = smallest_visible(screened, best, floors[best])
                self.refuse(best, against, fitted, gain(null, fitted), floors[best], visible)
        return null

    def refuse(
        self,
        structural: str,
        why: str,
        fitted: Fitted,
        gained: float | None = None,
        floor: float | None = None,
        visible: tuple[float, str] | None = None,
    ) -> None:
        """Keep what is said of structure that does not join, with its values where it was fitted."""
        values = errors(fitted, structural, fitted.scatter(structural))
        self.ordinary[structural] = Finding(
            structural, "structure", "rejected", why, gained, floor, visible, values=values
        )

    def undeclared(self, null: Fitted, candidates: Sequence[str]) -> tuple[Fitted, list[str]]:
        """The null with the undeclared effects that pass, and their ids in the order in which they joined."""
        accepted: list[str] = []
        for _ in range(ROUNDS):
            rest = [e for e in candidates if e not in accepted]
            screens, floors, each = self._tested(null, accepted, rest)
            by_screen = {e: one.gain([e]) for e, one in screens.items()}
            promising = sorted((e for e in rest if by_screen[e] > floors[e]), key=lambda e: -by_screen[e])
            seen = self.seen_in_forces(null, accepted, rest)
            starts = {e: screens[e].starts(e) for e in promising[:FEW]}
            if TIMES & starts.keys():  # rivals, of which the screen, a straight line, tells too little
                starts |= {e: screens[e].starts(e, whole=True) for e in rest if e in TIMES - starts.keys()}
            starts |= {e: [*starts.get(e, []), start] for e, start in seen.items()}
            self.hot.update((*promising, *starts))
            if starts:  # what the null may still gain by itself is no candidate's
                null = self.settled(null, min(floors[e] for e in starts))
            fitted = self.with_each(null, self._with_derivatives(null, starts, each), floors, each)
            loose = self._loose_or_slow(null, accepted, fitted) if astray(null) else {}
            fitted, floors = fitted | loose, floors | {e: self.each_floor[e] for e in loose}
            least = min(floors.values(), default=0.0)
            better = self.improved(null, fitted, least)
            joined = self._joining(better, fitted, floors)
            if joined is None and gain(null, better) <= least:
                return better, accepted
            null = better
            if joined is not None:
                null = self._each_by_itself(fitted[joined], joined)
                accepted.append(joined)
        return null, accepted

    def _each_by_itself(self, alike: Fitted, effect: str) -> Fitted:
        """The fit with a size of the effect for each control, where that explains more, and unseen flights no worse.

        Play and slew rates are each linkage's own; times are what a model lacks too, early for one, late for another.
        """
        own, declared = self.each_floor.get(effect), sizes_of_each(alike, effect)
        if own is None or declared is None or effect in (*TIMES, *alike.spec.each_control):
            return alike
        common, sizes = declared
        spec = control_by_control(alike, [effect]).spec
        start = {**alike.values, common.name: common.value, **sizes}
        each = self.settled(refit(spec, self.flights, start, self.held, near=alike), own)
        worse = -unseen_gain(alike, each)
        if gain(alike, each) <= own or not bool(worse.isfinite().all()) or helps(worse):
            return alike
        if unlikely(each, effect, each.scatter(effect)) is not None:
            return alike
        self.spread.update(each.scatter(effect))
        self.say(f"{effect} is each control's own: gain {gain(alike, each):.3g} over one size of all")
        return each

    def _tested(
        self, null: Fitted, accepted: Sequence[str], effects: Sequence[str]
    ) -> tuple[dict[str, Screen], dict[str, float], list[str]]:
        """Screen and floor of each effect, and those of the control path that are tried on each control by itself.

        That is where some of them are late, slow or loose and all controls alike are not, or explain little of it.
        Beside another effect of the control path, one of each control would only stand for how controls differ in that.
        """
        path, self.each_floor = of_control_path(effects), {}
        if not path or len(null.spec.controls) < 2 or of_control_path(accepted):
            common = self.screened(null, effects)
            return dict.fromkeys(effects, common), self._beside(accepted, self.floors.of(common, effects)), []
        common, alone = self.screened_both(null, effects)
        screens = dict.fromkeys(effects, common)
        floors, own = self.floors.with_each_control(common, effects, alone, path)
        self.each_floor = own
        gained = {e: alone.gain([e]) for e in path}
        least = {e: max(floors[e], ALIKE * gained[e]) for e in path}
        each = [e for e in path if gained[e] > own[e] and common.gain([e]) < least[e]]
        if TIMES & {*each}:  # a delay of each control is no rival to one lag of all: as many sizes for both
            each += [e for e in path if e in TIMES and e not in each]
        self.alone.update({e: own[e] for e in each})
        return screens | dict.fromkeys(each, alone), floors | {e: own[e] for e in each}, each

    def _beside(self, accepted: Sequence[str], floors: Mapping[str, float]) -> dict[str, float]:
        """Floors beside what is accepted: how sharp a limit or a play is, no one knows.

        What such a one is rounded by looks like another effect of the control path, by a share of what it explains.
        """
        shape = CLOSE * max((self.gained[e][0] for e in of_control_path(accepted) if e in self.gained), default=0.0)
        self.beside.update({e: shape for e in of_control_path(floors) if shape > floors[e]})
        return {**floors, **{e: max(floors[e], shape) for e in of_control_path(floors)}}

    def seen_in_forces(
        self, null: Fitted, accepted: Sequence[str], effects: Sequence[str]
    ) -> dict[str, Mapping[str, float]]:
        """Starts of effects that explain more of forces than by chance, and than on clean aircraft."""
        seen, usual = seen_in_forces(null, accepted, effects, self.seed), self.floors.of_forces()
        return {e: one.start for e, one in seen.items() if one.gain > max(one.chance, usual.get(e, 0.0))}

    def _with_derivatives(
        self, null: Fitted, starts: Mapping[str, Sequence[Mapping[str, float]]], each: Sequence[str]
    ) -> dict[str, list[Mapping[str, float]]]:
        """The starts, those of plays and slew limits once more with derivatives found anew beside them.

        They are far from the straight lines of the screen, and derivatives that imitate them lead astray.
        """
        found = {e: list(own) for e, own in starts.items()}
        for e in of_control_path(e for e in starts if e not in TIMES):
            apart = control_by_control(null, [e] if e in each else [])
            found[e] += [derivatives_beside(apart, e, own, self.held) for own in starts[e]]
        return found

    def _loose_or_slow(self, null: Fitted, accepted: Sequence[str], fitted: Mapping[str, Fitted]) -> dict[str, Fitted]:
        """Fits with plays or slew limits of each control that explain more of forces than by chance.

        Where the model flies astray, the screen, which is about its trajectories, says nothing of them. More sizes
        explain more: beside a fit with one of all controls they are to explain more than on clean aircraft.
        """
        asked = [e for e in self.each_floor if e not in TIMES]
        apart = control_by_control(null, asked)
        seen = seen_in_forces(apart, accepted, asked, self.seed, whole=True)
        starts = {
            e: [derivatives_beside(apart, e, one.start, self.held)] for e, one in seen.items() if one.gain > one.chance
        }
        found = self.with_each(null, starts, self.each_floor, asked)
        least = {
            e: 0.0 if e in one.spec.each_control else self.each_floor[e] for e, one in fitted.items() if e in found
        }
        chosen = {e: one for e, one in found.items() if e not in fitted or gain(fitted[e], one) > least[e]}
        self.hot.update(chosen)
        self.alone.update({e: self.each_floor[e] for e in chosen})
        return chosen

    def _joining(self, null: Fitted, fitted: Mapping[str, Fitted], floors: Mapping[str, float]) -> str | None:
        """The effect that joins in this round, and in its group those that explain as much."""
        against = self.ranks.share(
            list(fitted), lambda e: objection(null, fitted[e], e, floors[e], fitted[e].scatter(e))
        )
        why = dict(zip(fitted, against, strict=True))
        for e, reason in why.items():
            self.say(f"{e}: gain {gain(null, fitted[e]):.3g}, floor {floors[e]:.3g}: {reason or 'stands'}")
            if reason is not None:
                self.rejected[e] = (reason, gain(null, fitted[e]), errors(fitted[e], e, fitted[e].scatter(e)))
        sane = [e for e, reason in why.items() if reason is None]
        if not sane:
            return None
        best, near = rivals(null, fitted, floors, sane)
        alike = self.ranks.share(near, lambda e: self._alike(null, fitted, best, e, floors))
        same = tuple(e for e, one in zip(near, alike, strict=True) if one)
        apart = {one: tuple(e for e in others if e != best) for one, others in self.groups.items()}
        self.groups = {one: others for one, others in (apart | {best: same}).items() if others}
        self.gained[best] = gain(null, fitted[best]), floors[best]
        self.spread.update(fitted[best].scatter(best))
        self.say(f"{best} joins" + (f", in a group with {', '.join(same)}" if same else ""))
        return best

    def _alike(
        self, null: Fitted, fitted: Mapping[str, Fitted], one: str, other: str, floors: Mapping[str, float]
    ) -> bool:
        """Whether either of two effects leaves nothing for the other, which may have a size for each control."""

        def leaves(there: str, asked: str) -> bool:
            apart = [asked] if asked in fitted[asked].spec.each_control else []
            left = self.screened(control_by_control(fitted[there], apart), [asked]).gain([asked])
            return left > telling(asked, there, gain(null, fitted[there]), floors)

        return not leaves(one, other) and not leaves(other, one)

    def confirmed(self, final: Fitted, accepted: list[str], floors: Mapping[str, float]) -> tuple[Fitted, list[str]]:
        """Each accepted effect tested again in the end, where the fit has moved on, and beside the others.

        Those that are no physics any more, or explain nothing more, are taken out.
        """
        for effect in list(accepted):
            why = unlikely(final, effect, final.scatter(effect))
            if why is None and len(accepted) == 1:
                break
            least, spec = floors.get(effect, 0.0), final.spec.without([effect])
            without = self.settled(refit(spec, self.flights, final.values, self.held, near=final), least)
            if gain(without, final) <= least:
                why = "beside the others it explains nothing more"
            if why is not None:
                self.rejected[effect] = (why, gain(without, final), {})
                accepted.remove(effect)
                final = without
        return final, accepted

    def compare_clean(self, final: Fitted, accepted: Sequence[str]) -> None:
        """Errors of delays and lags hold how such a size scatters from one clean aircraft to the next."""
        for name, error in (one for effect in accepted for one in self.floors.scatter(effect).items()):
            if name in final.names:
                self.spread[name] = max(self.spread.get(name, 0.0), error)

    def compare_controls(self, final: Fitted, accepted: Sequence[str]) -> None:
        """Errors of what all controls have in common hold how far the controls agree."""
        for effect in accepted:
            found = by_control(final, effect, self.held)
            if found is None:
                continue
            name = found.parameter
            known = [e for e in (final.error(name), self.spread.get(name, 0.0)) if math.isfinite(e)]
            self.spread[name] = math.hypot(max(known, default=0.0), found.spread)
            self.apart[effect] = f"; {found}"
            self.say(f"{effect}: {found}")


def _of_effects(values: Mapping[str, float], effects: Collection[str]) -> dict[str, float]:
    """The parameters of these effects alone."""
    return {n: v for n, v in values.items() if any(n.startswith(f"{e}.") for e in effects)}
