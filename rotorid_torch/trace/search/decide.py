"""The table that decides on effects: from what was observed of a candidate to a verdict and its reason. Pure functions.

Errors of sensors alone are decided elsewhere, by `verdict` of `consistency/sensor_errors/sensor_words.py`: they need no
model of the vehicle. After the search `run/free_runs.py` asks the table again of the model that is reported, by
intervals and free runs (`runs_worse`); `Tracing.without` takes back what falls.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from types import MappingProxyType

from torch import Tensor

from rotorid_torch.core.names import Verdict
from rotorid_torch.core.statistics import normal_quantile
from rotorid_torch.effects.registry import registered
from rotorid_torch.model.model import Model
from rotorid_torch.trace.evidence.fits import FittedModel
from rotorid_torch.trace.evidence.screen import signatures
from rotorid_torch.trace.terms.settings import SETTINGS


class Reason(Enum):
    """Why a verdict is what it is."""

    NOT_TESTABLE = auto()
    PART = auto()
    TAKEN_UP = auto()
    BELOW_LEVEL = auto()
    ABSORBED = auto()
    BETTER_EXPLAINED = auto()
    NO_BETTER_FIT = auto()
    ACTIVE_BOUND = auto()
    WITHIN_ERROR = auto()
    UNSEEN_WORSE = auto()
    FREE_RUNS_WORSE = auto()
    NO_MODEL = auto()
    NOT_ADEQUATE = auto()
    GROUP = auto()
    OTHER_NAMED = auto()
    NAMED = auto()
    HELPS = auto()


class Interval(Enum):
    """What the interval of an effect's size says."""

    SIZE = auto()
    """A size: the interval excludes nothing, and no bound is active."""
    ACTIVE_BOUND = auto()
    WITHIN_ERROR = auto()


@dataclass(frozen=True)
class Row:
    """What was observed of a candidate; a row of the table of decisions.

    testable : whether data and declaration let it be tested. part : whether the nominal model has it from the start.
    taken_up : whether a part of the nominal model takes up all of it.
    observable : whether its smallest visible size is at most its usual one. significant : p <= level.
    still : significant beside the effects that joined. fitted : whether a full fit explains more than the null.
    estimate : of its size. unseen_better : whether flights that no fit has seen are better described in the mean.
    runs_worse : whether their free runs are worse by more than chance, asked after the search alone.
    useful : whether the model with it does better than holding trim on these flights, asked after the search alone.
    in_set : whether it joined, or flights cannot tell it from the one that did. alone : whether the set holds no other.
    adequate : whether the names explain enough of what stays without a name.
    """

    testable: bool = True
    part: bool = False
    taken_up: bool = False
    observable: bool = True
    significant: bool = True
    still: bool = True
    fitted: bool = True
    estimate: Interval = Interval.SIZE
    unseen_better: bool = True
    runs_worse: bool = False
    useful: bool = True
    in_set: bool = True
    alone: bool = True
    adequate: bool = True


NO_SCATTER: Mapping[str, float] = MappingProxyType({})

TABLE: tuple[tuple[Mapping[str, object], Verdict, Reason], ...] = (
    ({"part": True}, "accepted", Reason.PART),
    ({"testable": False}, "not testable", Reason.NOT_TESTABLE),
    ({"taken_up": True}, "indistinguishable", Reason.TAKEN_UP),
    ({"significant": False, "observable": False}, "indistinguishable", Reason.ABSORBED),
    ({"significant": False}, "below floor", Reason.BELOW_LEVEL),
    ({"still": False, "in_set": False}, "rejected", Reason.BETTER_EXPLAINED),
    ({"fitted": False}, "rejected", Reason.NO_BETTER_FIT),
    ({"estimate": Interval.ACTIVE_BOUND}, "rejected", Reason.ACTIVE_BOUND),
    ({"estimate": Interval.WITHIN_ERROR}, "rejected", Reason.WITHIN_ERROR),
    ({"unseen_better": False}, "rejected", Reason.UNSEEN_WORSE),
    ({"in_set": False}, "rejected", Reason.BETTER_EXPLAINED),
    ({"runs_worse": True}, "suspected", Reason.FREE_RUNS_WORSE),
    ({"useful": False}, "suspected", Reason.NO_MODEL),
    ({"adequate": False}, "suspected", Reason.NOT_ADEQUATE),
    ({"alone": False}, "indistinguishable", Reason.GROUP),
    ({}, "accepted", Reason.NAMED),
)
"""Rows are read from above: the first of which all entries agree decides."""
VERDICTS: Mapping[Reason, Verdict] = {reason: verdict for _, verdict, reason in TABLE}
"""The verdict of each reason."""


def decide(row: Row) -> tuple[Verdict, Reason]:
    """Verdict and reason of a candidate."""
    for asked, verdict, reason in TABLE:
        if all(getattr(row, name) == value for name, value in asked.items()):
            return verdict, reason
    raise AssertionError("the last row of the table asks nothing")


def likelihood_gain(null: FittedModel, candidate: FittedModel) -> float:
    """Fall of minus log-likelihood per sample of the identify flights; minus infinity where the fit failed."""
    improvement = (null.cost - candidate.cost) / null.per_sample
    return improvement if math.isfinite(improvement) else -math.inf


def improves(log_ratios: Tensor) -> bool:
    """Whether the mean of log ratios [F] lies above zero; a flight in which both models fly away tells nothing."""
    log_ratios = log_ratios[~log_ratios.isnan()]
    return len(log_ratios) > 0 and float(log_ratios.mean()) > 0.0


@dataclass(frozen=True)
class Size:
    """What the interval of an effect's size says, and the parameter that says so with its value and error."""

    estimate: Interval
    parameter: str = ""
    value: float = 0.0
    error: float = 0.0


def size_of(fitted: FittedModel, effect: str, tests: int = 1, drawn: Mapping[str, float] = NO_SCATTER) -> Size:
    """The size of an effect in a fit: standard errors, or the scatter over flights or the error there if larger.

    tests : effects whose sizes are looked at. drawn : errors on clean aircraft, by full name.
    """
    errors = {name: error for name, (_, error) in errors_of(fitted, effect, drawn).items()}
    dataset = fitted.flights.dataset  # between samples controls may be held or go straight: half a step
    return size_by(fitted.model, errors, effect, tests, 0.5 * max(dataset.facts[n].dt for n in dataset.identify))


def size_by(model: Model, errors: Mapping[str, float], effect: str, tests: int = 1, between: float = 0.0) -> Size:
    """Whether a bound that is not the null is active; else whether all intervals hold the null.

    Intervals have the level 0.95 together for so many effects (Bonferroni). Zero is a limit of physics, not of a range:
    a pendulum may have no damping. errors : standard errors by full name. between : s by which controls are later or
    earlier by what they do between samples, no size of an effect that makes them later.
    """
    values = model.named_values
    for p in model.parameter_set.sizes(effect):
        on = [b for b in p.bounds if math.isclose(values[p.name], b, rel_tol=1e-9) and b not in (0.0, p.value)]
        if p.free and on:
            return Size(Interval.ACTIVE_BOUND, p.name, values[p.name])
    nulls = {s.parameter: s.null for s in signatures(model, [effect])}
    nulls = nulls or {p.name: p.value for p in model.parameter_set.sizes(effect) if p.free}
    nothing = between if registered()[effect].delays else 0.0
    beyond = {n: max(abs(values[n] - null) - nothing, 0.0) for n, null in nulls.items()}
    away = {n: size / max(errors.get(n, math.inf), 1e-300) for n, size in beyond.items()}
    name = max(away, key=lambda n: away[n], default="")
    inside = bool(name) and away[name] <= normal_quantile(0.5 * SETTINGS.level / tests)
    return Size(Interval.WITHIN_ERROR if inside else Interval.SIZE, name, values.get(name, 0.0), errors.get(name, 0.0))


def errors_of(fitted: FittedModel, effect: str, *spreads: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Estimated sizes of an effect, and standard errors no smaller than the scatter over flights and these spreads."""
    sizes, values, scatter = fitted.model.parameter_set.sizes(effect), fitted.values, fitted.scatter(effect)
    names = [p.name for p in sizes if p.name in fitted.names]
    return {n: (values[n], max(fitted.error(n), *(one.get(n, 0.0) for one in (scatter, *spreads)))) for n in names}
