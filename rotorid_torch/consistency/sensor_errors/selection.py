"""Which sensor errors the data need: forward by what each explains, backward by what holds, rivals in their place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rotorid_torch.consistency.equations import GRAVITY_RANGE, null
from rotorid_torch.consistency.pairs.alignment import Alignment
from rotorid_torch.consistency.sensor_errors import sensor_words
from rotorid_torch.consistency.sensor_errors.normal_equations import Point, Search, limits
from rotorid_torch.core.names import RATES, SPECIFIC_FORCES, Verdict
from rotorid_torch.core.statistics import student_quantile
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.families.sensors import DAMPED, PERIOD, SMOOTHED

MOST = 6
"""Errors that are accepted, at most."""
TRIED = 4
"""Candidates that are fitted in full at each step, best first."""
NEAR = 0.2
"""Share of the best candidate's linear gain from which on another one is fitted in full too."""
STEADY = 3.0
"""Standard errors, spread between flights included, by which a value must differ from zero."""
RESOLUTION = {"scale": GRAVITY_RANGE, "misalignment": 0.002, "lever_arm": 0.03}
"""What local gravity, mounting and the rounding of a declaration leave open: 1, rad, m."""
GROSS = 10.0
"""Level of misfit, in powers of the noise, above which channels disagree in ways that no sensor error here makes."""
SHARE = 0.1
"""Part of such a misfit that an error must explain, or it is made up from what the equations lack."""
VECTORS = ("misalignment", "lever_arm")
"""Errors with a direction: a vector is seldom along an axis, so the other axes come along."""


@dataclass
class Case:
    """What is being decided: the candidates, those accepted, and what was learnt about each on the way.

    critical_value : statistic that chance alone does not give. by : large errors; the search begins at that turn of the
    IMU, and with those clocks set right. fitted : errors that the data need, `named` those among them that are
    sensor errors; the rest, too small or not the same in all flights, only stands aside so that nothing else takes its
    place. rejections : reasons by name. statistics : of the fitted ones beside the others, falls of the cost. rivals :
    for a named one, the values of others that explain as much in its place.
    """

    dataset: Dataset
    search: Search
    candidates: tuple[str, ...]
    critical_value: float
    by: Alignment = field(default_factory=Alignment)
    fitted: list[str] = field(default_factory=list)
    rejections: dict[str, tuple[Verdict, str]] = field(default_factory=dict)
    statistics: dict[str, float] = field(default_factory=dict)
    rivals: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def named(self) -> list[str]:
        """Those fitted that are not rejected."""
        return [name for name in self.fitted if name not in self.rejections]


def kind_of(name: str) -> str:
    """Kind of an error by name: "delay" of "delay.attitude"."""
    return name.partition(".")[0]


def select(case: Case, largest: float) -> Point | None:
    """Decide which candidates are accepted; the normal equations in all candidates at their common fit.

    None where they all leave more than this level of misfit.
    """
    point = _begun(case)
    if case.search.misfit > largest:
        return None
    point = _forward(case, point)
    if case.search.raised(point.errors):
        point = _refit(case, point, case.fitted)
    point = _keep_what_holds(case, point)
    point = _weigh_rivals(case, point)
    return case.search.at(point.errors, case.candidates)


def _begun(case: Case) -> Point:
    """Where the search begins: at a large turn of the IMU, where there is one."""
    begin = case.by.misalignment
    case.fitted += [*begin] if set(begin) <= set(case.candidates) else []
    return case.search.measure(begin if case.fitted else {}, case.candidates)


def _forward(case: Case, point: Point) -> Point:
    """The error that explains most joins, the others are weighed again beside it."""
    if case.fitted:
        point = case.search.measure(case.search.fit(point.errors, case.fitted).errors, case.candidates)
    while True:
        base = case.search.fit(point.errors, case.fitted)
        at_base = point if base.errors == point.errors else case.search.at(base.errors, case.candidates)
        best = _best(case, base, at_base) if len(case.fitted) < MOST else None
        if best is None:
            return base
        name, fit = best
        companions = [n for n in _companions(case, name) if not n.endswith(DAMPED) or n in fit.names]
        case.fitted += [name, *(n for n in companions if n not in case.fitted)]
        errors = case.search.fit(fit.errors, case.fitted).errors if companions else fit.errors
        point = case.search.measure(errors, case.candidates)


def _ranked(case: Case, point: Point, held: Sequence[str]) -> list[tuple[float, str]]:
    """Candidates that can have this sign, by what each would gain beside those held."""
    ranked = []
    for name in case.candidates:
        if name not in held and not name.endswith(DAMPED):
            step, information = point.joining(name, held)
            if kind_of(name) != "filter" or step > 0.0:
                ranked.append((step * step * information, name))
    return sorted(ranked, reverse=True)


def _best(case: Case, base: Point, at_base: Point) -> tuple[str, Point] | None:
    """The candidate whose full fit explains most, more than chance; one too small to be named only if it must be."""
    ranked = _ranked(case, at_base, case.fitted)
    near = _near([name for gain, name in ranked if gain > max(case.critical_value, NEAR * ranked[0][0])])
    fits = [(name, joined(case, base, case.fitted, name)) for name in near]
    paid = {name: case.critical_value if name.endswith(PERIOD) else 0.0 for name in near}  # for the damping
    gained = [(base.cost - fit.cost - paid[name], name, fit) for name, fit in fits if inside(name, fit)]
    most = max((gain for gain, _, _ in gained), default=0.0)
    if most < case.critical_value:
        return None
    equal = [g for g in gained if g[0] > most - case.critical_value]
    large = [g for g in equal if _large(case, g[1], g[2])]
    _, name, fit = max(large or equal, key=lambda g: g[0])
    return name, fit


def _near(ranked: Sequence[str]) -> list[str]:
    """The best candidates, and the best filter of second order, which begins as one of first order does."""
    plain, second = ([n for n in ranked if n.endswith(PERIOD) == of_second] for of_second in (False, True))
    return [*plain[:TRIED], *second[:1]]


def joined(case: Case, base: Point, held: Sequence[str], name: str) -> Point:
    """Fit of one more error; of a filter's damping too, once its frequency is about known, where the data tell it."""
    fit = case.search.fit(base.errors, (*held, name))
    if not name.endswith(PERIOD) or not inside(name, fit):
        return fit
    damped = case.search.fit(fit.errors, (*held, name, *_companions(case, name)))
    return damped if inside(name, damped) else fit


def inside(name: str, point: Point) -> bool:
    """Whether an error has a value that a sensor can have; a filter's damping too."""
    both = (name, name.removesuffix(PERIOD) + DAMPED) if name.endswith(PERIOD) else (name,)
    return all(limits(n)[0] < point.errors.get(n, null(n)) < limits(n)[1] for n in both)


def _large(case: Case, name: str, point: Point) -> bool:
    return size(name, point.errors) > least(case.dataset, kind_of(name))


def size(name: str, errors: Mapping[str, float]) -> float:
    """Size of an error; of filters the time, s, by which they are late at low frequencies, or the window's half."""
    value = abs(errors[name])
    if name.endswith(PERIOD):
        damped = name.removesuffix(PERIOD) + DAMPED
        return 2.0 * errors.get(damped, null(damped)) * value
    return value**0.5 if name.endswith(SMOOTHED) else value


def least(dataset: Dataset, kind: str) -> float:
    """Smallest size that means something: one sample interval for clocks and filters, else `RESOLUTION`."""
    if kind in ("delay", "filter"):
        return max(dataset.facts[name].dt for name in dataset.identify)
    return RESOLUTION.get(kind, 0.0)


def _without(case: Case, name: str) -> list[str]:
    """The accepted errors less this one; less its whole vector where it led one, less its damping where it has one."""
    gone = _companions(case, name) if _leads(case, name) else ()
    return [n for n in case.fitted if n != name and n not in gone]


def _companions(case: Case, name: str) -> list[str]:
    """Errors that come along with this one: the other axes of a vector, the damping of a filter of second order."""
    if name.endswith(PERIOD):
        return [name.removesuffix(PERIOD) + DAMPED]
    return [n for n in case.candidates if kind_of(n) == kind_of(name) in VECTORS and n != name]


def _leads(case: Case, name: str) -> bool:
    """Whether an accepted error stands for itself: an axis of a vector came along with the vector's first one."""
    if name.endswith(DAMPED):
        return False
    return kind_of(name) not in VECTORS or name == next(n for n in case.fitted if kind_of(n) == kind_of(name))


def _refit(case: Case, point: Point, names: Sequence[str]) -> Point:
    """Fit of these accepted errors alone, from where they are."""
    return case.search.fit({n: v for n, v in point.errors.items() if n in names}, names)


def _keep_what_holds(case: Case, point: Point) -> Point:
    """What the others explain leaves again, weakest first; what is too small or not steady loses its name."""
    while case.named:
        doubts: list[tuple[float, str, tuple[Verdict, str]]] = []
        for name in filter(lambda n: _leads(case, n), case.named):
            case.statistics[name] = _refit(case, point, _without(case, name)).cost - point.cost
            why = _doubt(case, point, name)
            doubts += [(case.statistics[name], name, why)] if why else []
        if not doubts:
            break
        _, name, why = min(doubts)
        vector = [n for n in case.fitted if n not in _without(case, name)]
        case.rejections |= dict.fromkeys(vector, why)
        if case.statistics[name] < case.critical_value:
            case.fitted = _without(case, name)
            point = _refit(case, point, case.fitted)
    return point


def _doubt(case: Case, point: Point, name: str) -> tuple[Verdict, str] | None:
    """Why a fitted error is not named; None where it holds."""
    smallest = least(case.dataset, kind_of(name))
    if case.statistics[name] < case.critical_value:
        return "rejected", "the other errors explain it"
    if not _large(case, name, point):
        return "below floor", sensor_words.too_small(kind_of(name), smallest)
    if case.search.misfit > GROSS and case.statistics[name] < SHARE * point.cost:
        return "rejected", "the channels disagree far beyond noise, and it explains less than a tenth of that"
    fits = [(point, case.fitted)]
    if len(case.named) < len(case.fitted):  # what stands aside without a name is no reason for a name
        fits.append((_refit(case, point, case.named), case.named))
    for fit, held in fits:
        error = spread(case.search.at(fit.errors, held), name, held)
        value = error.mean if drifts(case.dataset, name) else fit.errors[name]
        clear = size(name, fit.errors) * (1.0 - 2.0 * error.value / max(abs(value), 1e-300))
        if abs(value) < significant(case.dataset, name, error) or clear < smallest:
            return "rejected", sensor_words.unsteady(error.flights if drifts(case.dataset, name) else None)
    return None


def significant(dataset: Dataset, name: str, error: Spread) -> float:
    """Size from which on an error differs from none.

    Tilts and offsets that nothing declares differ from flight to flight, and few flights do not tell by how much.
    """
    freedom = max(error.flights - 1.0, 1.0)
    return (student_quantile(STEADY, freedom) if drifts(dataset, name) else STEADY) * error.value


def drifts(dataset: Dataset, name: str) -> bool:
    """Whether an error is one that each flight may have of its own."""
    kind, _, member = name.partition(".")
    declared = dataset.channel_specs.get(member)
    return kind == "bias" and (declared is None or declared.bias != "none")


@dataclass(frozen=True)
class Spread:
    """Mean over flights of an error, its standard error, and from how many flights it comes."""

    mean: float
    value: float
    flights: float


def spread(point: Point, name: str, held: Sequence[str]) -> Spread:
    """Of an error that has a value of its own in each flight, beside those held, which all flights share.

    Each flight's value differs from the mean by its error and by a variance between flights. Pieces of one flight share
    what differs between flights, such as a tilt of the attitude; of one flight alone the pieces stand for flights. With
    weights w of flights in the mean their number is (sum w)^2 / sum w^2, for flights that hardly tell the value count
    little (Kish, Survey Sampling, 1965, sec. 11.7). The variance between flights is that of `variance_between` where
    the flights' values have errors in common: Q and its expectation by their information matrix.

    Source: DerSimonian and Laird (1986), eq. 8; Jackson, White and Riley (2013), Biometrical Journal 55, sec. 3.
    """
    information, slope = point.by_flight(name, held)
    total, row = information.sum(), information.sum(0)
    if total <= 1e-9 * np.diag(information).sum():
        return Spread(point.errors.get(name, null(name)), float("inf"), 1.0)
    sizes, ways = np.linalg.eigh(information)
    certain = sizes > 1e-9 * sizes.max()
    excess = ((ways.T @ slope)[certain] ** 2 / sizes[certain]).sum() - slope.sum() ** 2 / total - (certain.sum() - 1)
    spare = np.trace(information) - row @ row / total
    between = max(0.0, float(excess / spare)) if spare > 1e-9 * total else 0.0
    apart = np.linalg.inv(np.eye(len(slope)) + between * information)
    weights = apart @ row
    mean = point.errors.get(name, null(name)) + float((apart @ slope).sum() / weights.sum())
    return Spread(mean, float(weights.sum() ** -0.5), float(weights.sum() ** 2 / (weights @ weights)))


def _weigh_rivals(case: Case, point: Point) -> Point:
    """For each accepted error, single others that explain as much in its place; the likelier sensor is taken."""
    for name in [n for n in case.named if _leads(case, n)]:
        held = _without(case, name)
        base = _refit(case, point, held)
        ranked = _ranked(case, case.search.at(base.errors, case.candidates), held)
        gone = {n for n in case.fitted if n not in held}
        near = _near([n for gain, n in ranked if n not in gone and gain > NEAR * ranked[0][0]])
        fits = {n: joined(case, base, held, n) for n in near}
        equal = {
            n: fit
            for n, fit in fits.items()
            if fit.cost - point.cost < case.critical_value and inside(n, fit) and _large(case, n, fit)
        }
        case.rivals[name] = {n: fit.errors[n] for n, fit in equal.items()}
        better = [n for n in equal if kind_of(n) == kind_of(name) and _unlikely(n, equal[n]) < _unlikely(name, point)]
        if better:
            case.fitted = [better[0] if n == name else n for n in case.fitted]
            case.rivals[better[0]] = {name: point.errors[name], **case.rivals.pop(name)}
            case.rivals[better[0]].pop(better[0])
            case.statistics[better[0]] = case.statistics[name]
            point = equal[better[0]]
    return point


def _unlikely(name: str, point: Point) -> int:
    """Sensors are late rather than early, and gyros and accelerometers err before what is aligned with their help."""
    kind, _, member = name.partition(".")
    return int(point.errors[name] < 0.0 if kind == "delay" else member not in (*RATES, *SPECIFIC_FORCES))
