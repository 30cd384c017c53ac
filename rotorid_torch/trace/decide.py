"""From numbers to verdicts: pure functions of fits, screens and floors, and their reasons in plain words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import registered
from rotorid_torch.model.model import Model
from rotorid_torch.trace.finding import Finding
from rotorid_torch.trace.fits import Fitted, Residual
from rotorid_torch.trace.screen import Screen, signatures
from rotorid_torch.trace.significance import FAR, helps, student_quantile

SURE = 3.0
"""Standard errors from its null beyond which a parameter is believed."""
STEADY = 2.0
"""The same for scatter over flights alone, as a normal deviate: so few flights have Student's quantile of it."""
CLEARLY = 0.05
"""Mean log ratio of J by which free runs must be worse to speak against an effect: they scatter by as much."""
TIMES = frozenset({"control.delay", "control.lag"})
"""Effects that stand in for each other where they are short."""
CLOSE = 0.05
"""Share of the gain of one of them that tells nothing of which it is: what else a model lacks moves both by as much.
Beside any effect of the control path another one is to explain more than that."""


def unseen_gain(null: Fitted, candidate: Fitted) -> Tensor:
    """Mean over the channels of log(rms without / rms with) on each flight that no fit has seen [F]."""
    return _gains(null.unseen, candidate.unseen)


def free_run_gain(null: Fitted, candidate: Fitted) -> Tensor:
    """log(J without / J with) of the free runs of each of these flights that has them [F]."""
    found = (null.free_runs / candidate.free_runs).log()
    return found[~found.isnan()]


def astray(fitted: Fitted) -> bool:
    """Whether free runs of flights that no fit has seen are worse, in the mean of log J, than holding trim."""
    return bool((fitted.free_runs / fitted.trims).log().nanmean() > 0.0)


def gain(null: Fitted, candidate: Fitted) -> float:
    """Fall of minus log-likelihood per sample of the identify flights; minus infinity where the fit failed."""
    found = (null.cost - candidate.cost) / null.per_sample
    return found if math.isfinite(found) else -math.inf


def objection(null: Fitted, candidate: Fitted, effect: str, floor: float, spread: Mapping[str, float]) -> str | None:
    """Why a fitted candidate is not a finding; None where nothing speaks against it.

    spread : standard errors of its parameters by their scatter over flights, zero where there are too few to tell.
    """
    if gain(null, candidate) <= floor:
        usual = "clean aircraft let any candidate explain" if _is_undeclared(effect) else "by chance"
        return f"fitted in full, it explains no more than {usual}"
    doubt = unlikely(candidate, effect, spread)
    if doubt is not None:
        return doubt
    better = unseen_gain(null, candidate)
    if not helps(better):
        return f"it does not help on flights that no fit has seen ({int((better > 0).sum())} of {len(better)} better)"
    runs = free_run_gain(null, candidate)
    if clearly_worse(runs):
        return f"free runs of flights that no fit has seen are worse by it ({int((runs < 0).sum())} of {len(runs)})"
    return None


def unlikely(candidate: Fitted, effect: str, spread: Mapping[str, float]) -> str | None:
    """Why the parameters of an effect are no physics of a vehicle; None where nothing speaks against them.

    spread : standard errors by scatter over flights.
    """
    edge = at_edge(candidate.model, effect)
    if edge is not None:
        return edge
    none = nothing(candidate.model, candidate.error, effect)
    if none is not None:
        return none
    values, nulls = candidate.values, _nulls(candidate.model, effect)
    away = _away(candidate.model, candidate.error, effect)
    few = student_quantile(STEADY, max(len(candidate.flights.dataset.identify) - 1, 1))
    steady = [abs(values[n] - null) > few * spread[n] for n, null in nulls.items() if away[n] >= SURE]
    if not any(steady):
        return "its size differs from flight to flight"
    return too_short(candidate, effect)


def nothing(model: Model, error: Callable[[str], float], effect: str) -> str | None:
    """Why all sizes of an effect are nothing within their standard errors; None where one is something.

    error : standard error of a parameter, infinite where it cannot be told.
    """
    away = _away(model, error, effect)
    if max(away.values(), default=math.inf) >= SURE:
        return None
    name = max(away, key=lambda n: away[n])
    return f"{name} = {model.named_values[name]:.3g} lies within {SURE:g} of its standard errors from nothing"


def _nulls(model: Model, effect: str) -> dict[str, float]:
    """Each parameter by which an effect has a size, and its value where it has none."""
    return {s.parameter: s.null for s in signatures(model, [effect])}


def _away(model: Model, error: Callable[[str], float], effect: str) -> dict[str, float]:
    """Standard errors of each from there."""
    values, nulls = model.named_values, _nulls(model, effect)
    return {n: abs(values[n] - null) / max(error(n), 1e-300) for n, null in nulls.items()}


def clearly_worse(runs: Tensor) -> bool:
    """Whether free runs, by their log ratios of J [F], speak against an effect; none do not.

    They drift, and are less sharp than segments: they may only speak against it, in the mean or by flying away in one.
    """
    if not len(runs):
        return False
    return float(runs.min()) < -FAR or (float(runs.mean()) < -CLEARLY and helps(-runs))


def too_short(candidate: Fitted, effect: str) -> str | None:
    """Why a delay beside a lag, or a lag beside a delay, cannot be told: shorter than what the fits see; else None.

    Both together smooth the noise of the measured controls, and so the shorter stands for nothing that acts.
    """
    if effect not in TIMES or not TIMES <= set(candidate.spec.effects):
        return None
    interval = candidate.fit.likelihood.records.dt
    longest = max(v for n, v in candidate.values.items() if n.startswith(f"{effect}."))
    if longest >= interval:
        return None
    other = next(iter(TIMES - {effect}))
    return (
        f"{longest:.2g} s beside {other} is shorter than the interval of the records that are fitted, {interval:.2g} s"
    )


def at_edge(model: Model, effect: str) -> str | None:
    """Why a fit is no physics: a parameter of the effect on a bound that is not its null; None where none is.

    Zero is a limit of physics, not of a range: a pendulum may have no damping.
    """
    for parameter in model.parameter_set.sizes(effect):
        value = model.named_values[parameter.name]
        on = [b for b in parameter.bounds if math.isclose(value, b, rel_tol=1e-9) and b not in (0.0, parameter.value)]
        if parameter.free and on:
            return f"{parameter.name} = {value:.3g} lies at the edge of its range"
    return None


def rivals(
    null: Fitted, fitted: Mapping[str, Fitted], floors: Mapping[str, float], sane: Sequence[str]
) -> tuple[str, list[str]]:
    """The sane candidate that explains most, and those that cannot be told from it.

    That is where the difference of their gains tells nothing, or is not the same in all flights.
    """
    gains = {e: gain(null, fitted[e]) for e in sane}
    best = max(gains, key=lambda e: gains[e])
    near = [
        e
        for e in sane
        if e != best
        and (
            gains[best] - gains[e] < max(floors[best], telling(e, best, gains[best], floors))
            or not told(fitted[best], fitted[e])
        )
    ]
    return best, near


def telling(effect: str, best: str, gained: float, floors: Mapping[str, float]) -> float:
    """Gain of an effect over another, that alone gained so much, above which the two are told apart."""
    return max(floors[effect], CLOSE * gained if TIMES >= {effect, best} else 0.0)


def told(best: Fitted, other: Fitted) -> bool:
    """Whether flight by flight, fitted or not, the first is better than the other by more than chance."""
    better = torch.cat([_gains(other.seen, best.seen), _gains(other.unseen, best.unseen)])
    return float(better.mean()) > SURE * float(better.std()) / math.sqrt(len(better))


def _gains(before: Residual, after: Residual) -> Tensor:
    """Mean over the channels of log(rms before / rms after) of each flight [F]."""
    return (before.size().log() - after.size().log()).nanmean(dim=1)


def smallest_visible(screened: Screen, effect: str, floor: float) -> tuple[float, str] | None:
    """Size at which the effect would reach its floor, in the unit of its first parameter."""
    own = [s for s in screened.signatures if s.effect == effect]
    shown = screened.shown(effect)
    if not own or shown <= 0.0:
        return None
    return abs(own[0].step) * math.sqrt(floor / shown), own[0].unit


def not_joined(screened: Screen, effect: str, floor: float, explained_by: Sequence[str], hot: bool) -> Finding:
    """Finding of a candidate that did not join."""
    role = registered()[effect].role.value
    found, visible = screened.gain([effect]), smallest_visible(screened, effect, floor)
    keep = {"gain": found, "floor": floor, "smallest_visible": visible}
    if hot and explained_by and found <= floor:
        better = " and ".join(explained_by) + (" explain" if len(explained_by) > 1 else " explains")
        return Finding(effect, role, "rejected", f"what it would explain, {better} better", **keep)
    if screened.shown(effect) < floor:
        absorbed = screened.imitators(effect)
        said = "at its usual size these flights would not show it: "
        said += f"{', '.join(absorbed)} take its place" if absorbed else "it hardly moves what was measured"
        said += f"; {registered()[effect].separated_by} would tell"
        return Finding(effect, role, "indistinguishable", said, **keep, group=absorbed)
    usual = "it would on a clean aircraft" if _is_undeclared(effect) else "by chance"
    return Finding(effect, role, "below floor", f"it explains no more than {usual}", **keep)


def _is_undeclared(effect: str) -> bool:
    """Others are ordinary physics, which clean aircraft have: their floors come from chance."""
    return registered()[effect].role is Role.UNDECLARED


def errors(candidate: Fitted, effect: str, spread: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Sizes of an effect with their standard errors, no smaller than their scatter over flights and controls."""
    own, values = [p.name for p in candidate.model.parameter_set.sizes(effect)], candidate.values
    return {n: (values[n], max(candidate.error(n), spread.get(n, 0.0))) for n in own}
