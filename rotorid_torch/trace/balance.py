"""Where the thrusts of a multirotor balance: beside the declared centre of gravity, in yaw, and with what that goes.

Averaged over a second a vehicle hardly turns faster or slower, so its rotors' moments cancel all others. That shows
moments too slow for accelerations to show, whatever the control power, and with no test input at all.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.names import RATES, VELOCITIES
from rotorid_torch.core.statistics import autocorrelation, correlation_time, normal_quantile, student_quantile
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.base import Role, Stage
from rotorid_torch.effects.families.environment import Wind
from rotorid_torch.effects.families.mass import CentreOfGravity
from rotorid_torch.effects.families.propulsion import Flapping, Unequal
from rotorid_torch.effects.signal_operations import lagged
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.measured_states import SPREAD
from rotorid_torch.model.model import Model
from rotorid_torch.model.rotors import Rotors, hover_thrust
from rotorid_torch.trace.evidence.residual import loads, on_measured
from rotorid_torch.trace.search.decide import Row
from rotorid_torch.trace.search.words import NAMELESS, finding
from rotorid_torch.trace.terms.finding import EffectFinding, Unknown
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.significance import exceeds

ROWS = ("M", "L", "N")
"""Moments that the thrust centre along x and y and the yaw balance belong to."""
AIRBORNE = 0.5
"""Share of the weight that the thrusts must carry: below it the ground holds the vehicle, or motors stand still."""
DRAWS = round(10.0 / SETTINGS.level) - 1
"""Clean vehicles whose balance is drawn: hover alone costs nothing to fly, so p has steps of a tenth of the level."""
LATE_S = [0.0, *(2.0**k * SETTINGS.settled_s for k in range(3))]
"""By how much a moment may be late behind what it goes with (air and heading take their time), first order."""
ALONE = "a centre of gravity elsewhere would leave yaw alone"
LIES_ELSEWHERE = "or the centre of gravity lies there, for rotors that differ as usual may turn yaw so far"
BLOWN = "; every flight is pushed by {push:.1f} m/s² across the rotors' axes, as by a wind, which tilts their discs too"
TILTED = {"M": "u", "L": "v"}
"""What moments go with of blades that flap back: thrusts balance behind, and to the left, in flight ahead and right."""
LIKE_TILTED = (
    f"{Flapping.id}, or drag above the declared centre of gravity, would do that; these flights do not tell which"
)
POSITIONS = {"north": "the velocity north", "east": "the velocity east", "height": "the rate of climb"}


@dataclass(frozen=True, eq=False)
class Balance:
    """Means over a second of one flight, those on the ground left out.

    centre : [B, 3] thrust centre x, y in m from the declared centre of gravity, and yaw balance: the share by which
    thrusts of rotors turning one way exceed those of the others, each beyond what balances the moments that the model
    has beside its rotors', which move it by `others` [B, 3]. turning : [B, 6] angular accelerations and rates of the
    same rows: whatever turns has inertia, and rotors in the air damp. signals : what it may go with, [B] each, by name
    and by how late it follows.
    """

    centre: Tensor
    others: Tensor
    turning: Tensor
    signals: Mapping[tuple[str, float], Tensor]


@dataclass(frozen=True, eq=False)
class Going:
    """What a row goes with, and how late it follows, s.

    evidence : t over the t that chance reaches. without, remaining : rms of the row on unseen flights without and with
    it. slopes : of a constant, `turning` and the signal.
    """

    row: str
    signal: str
    late: float
    evidence: float
    without: float
    remaining: float
    slopes: Tensor

    def explained(self, balance: Balance) -> Tensor:
        """What it explains of the row's means [B]."""
        return _columns(balance, (self.signal, self.late)) @ self.slopes


def balances(model: Model, spec: ModelSpec, dataset: Dataset, flights: Sequence[str]) -> list[Balance]:
    """The balance of flights by a model's thrust curve; those airborne for less than two means are left out."""
    records = [dataset.flights[name] for name in flights]
    measured = [_balance(model, spec, flight) for flight in records if flight.has(*RATES)]
    return [b for b in measured if len(b.centre) > 1]


def _balance(model: Model, spec: ModelSpec, flight: Flight) -> Balance:
    with torch.no_grad():
        taped = model.tape(flight.bridged(model.body.controls), flight.dt)
    s = taped[:, [model.body.controls.index(c) for c in spec.driven]]
    c0, c1, c2 = (model.named_values[f"rotors.thrust.c{k}"] for k in range(3))
    thrust = c0 + s * (c1 + s * c2)
    signals = {c: flight.bridged([c])[:, 0] for c in VELOCITIES if flight.has(c)}
    if "u" not in signals:
        moved = [c for c in POSITIONS if flight.has(c)]
        signals |= {POSITIONS[c]: torch.gradient(flight.bridged([c])[:, 0], spacing=flight.dt)[0] for c in moved}
    rates = flight.bridged(["q", "p", "r"])
    turning = torch.cat([torch.gradient(rates, spacing=flight.dt, dim=0)[0], rates], dim=1)
    every = max(1, round(SETTINGS.settled_s / flight.dt))
    total = _means(thrust, every).sum(dim=1)
    flown = total > AIRBORNE * hover_thrust(spec) * len(spec.motors)
    by_thrust, others = (
        _means(moment, every)[flown] / total[flown, None]
        for moment in (thrust @ _levers(spec), _beside_rotors(model, flight, taped))
    )
    return Balance(
        by_thrust + others,
        others,
        _means(turning, every)[flown],
        {
            (name, late): _means(lagged(record[:, None], record.new_tensor([late]), flight.dt)[:, 0], every)[flown]
            for name, record in signals.items()
            for late in LATE_S
        },
    )


def _beside_rotors(model: Model, flight: Flight, taped: Tensor) -> Tensor:
    """Moments that the model has beside its rotors', at measured states, as thrusts times levers [T, 3].

    None where the model has no such effect, and about axes that the rotors have no power over.
    """
    if all(one.stage is not Stage.FORCES or one.role is Role.NOMINAL for one in model.chain):
        return taped.new_zeros(len(taped), 3)
    rotors, values = model.effect(Rotors.id), model.named_values
    assert isinstance(rotors, Rotors)
    channels = {state.name: state.channel or state.name for state in model.layout.states}
    signals = {n: flight.bridged([c])[:, 0] for n, c in channels.items() if flight.has(c)}
    signals |= dict(zip(model.body.controls, taped.mT, strict=True))
    silenced = {f"rotors.{kind}.{row}": 0.0 for kind in ("power", "trim") for row in ROWS}
    angular = loads(on_measured(model, signals, silenced))[:, 3:]
    moment = torch.linalg.solve(rotors.turning, angular.mT).mT[:, [1, 0, 2]]
    arms = moment.new_tensor([1.0, -1.0, float(rotors.torque.abs().mean())])
    power = moment.new_tensor([values[f"rotors.power.{row}"] for row in ROWS]) * arms
    return torch.where(power != 0.0, moment / torch.where(power != 0.0, power, 1.0), 0.0)


def _levers(spec: ModelSpec) -> Tensor:
    """Place along x and y, m, and sense of rotation of each rotor [motors, 3]."""
    return torch.tensor([[*m.position[:2], m.spin] for m in spec.motors], dtype=torch.float64)


def _means(record: Tensor, every: int) -> Tensor:
    count = len(record) // every
    return record[: count * every].unflatten(0, (count, every)).mean(dim=1)


def going_with(identify: Sequence[Balance], unseen: Sequence[Balance], rows: Sequence[str] = ROWS) -> list[Going]:
    """Those of these rows that go with a signal beyond chance, on flights that no fit has seen too; the surest first.

    Angular accelerations, rates and a constant are taken out of both sides. Means that resemble their neighbours
    count for less (first-order autocorrelation). Beside what effects of the model move the balance by, next to nothing
    is not told.
    """
    names = [n for n in identify[0].signals if all(n in b.signals for b in (*identify, *unseen))]
    places, tests = [k for k, row in enumerate(ROWS) if row in rows], 2 * len(ROWS) * len(names)
    measured = [_going(k, signal, identify, unseen, tests) for k in places for signal in names]
    best = {g.row: g for g in sorted((g for g in measured if g), key=lambda g: g.evidence)}
    return sorted(best.values(), key=lambda g: -g.evidence)


def _going(
    row: int, signal: tuple[str, float], identify: Sequence[Balance], unseen: Sequence[Balance], tests: int
) -> Going | None:
    usual = [_columns(b, None) for b in identify]
    with_it = [_columns(b, signal) for b in identify]
    y = torch.cat([b.centre[:, row] for b in identify])
    short, full = torch.cat(usual), torch.cat(with_it)
    if len(y) <= full.shape[1] + 1:
        return None
    slopes, more = (least_squares(z, y[:, None])[:, 0] for z in (short, full))
    before, after = y - short @ slopes, y - full @ more
    worth = _worth(after, full[:, -1], [len(b.centre) for b in identify]) - full.shape[1]
    if worth < 1.0:
        return None
    left = float(after.square().sum())
    t = math.sqrt(max(float(before.square().sum()) - left, 0.0) * worth / max(left, 1e-300))
    evidence = t / student_quantile(normal_quantile(SETTINGS.level / tests), worth)
    fits = ((None, slopes), (signal, more))
    errors = [[b.centre[:, row] - _columns(b, s) @ z for s, z in fits] for b in unseen]
    sizes = torch.stack([torch.stack(pair, dim=1).square().mean(dim=0).sqrt() for pair in errors])
    if evidence <= 1.0 or not exceeds((sizes[:, 0] / sizes[:, 1]).log()):
        return None
    without, remaining = sizes.square().mean(dim=0).tolist()
    nameless, named = without - remaining, float(torch.cat([b.others[:, row] for b in unseen]).var())
    if nameless < SETTINGS.level * (nameless + named):
        return None
    return Going(ROWS[row], *signal, evidence, math.sqrt(without), math.sqrt(remaining), more)


def _columns(balance: Balance, signal: tuple[str, float] | None) -> Tensor:
    """Constant, accelerations and rates (of all axes: rotors that differ turn about all of them), and the signal."""
    columns = torch.cat([torch.ones(len(balance.centre), 1, dtype=torch.float64), balance.turning], dim=1)
    return columns if signal is None else torch.cat([columns, balance.signals[signal][:, None]], dim=1)


def _worth(residual: Tensor, signal: Tensor, lengths: Sequence[int]) -> float:
    """Independent pairs of residual and signal in flights of these lengths: both resemble their neighbours.

    Source: Bartlett (1935), J. Royal Statistical Society 98 (correlated series); no less than by the residual's first
    autocorrelation alone.
    """
    both = torch.stack([residual, signal - signal.mean()], dim=-1)
    flights = pad_sequence(list(both.split(list(lengths))), batch_first=True, padding_value=torch.nan)
    like = autocorrelation(flights, max(lengths) - 1, centred=False, pooled=True)
    first, alike = max(float(like[0, 0]), 0.0), float(correlation_time(like.prod(dim=1)))
    return len(residual) * min((1.0 - first) / (1.0 + first), 1.0 / alike)


@dataclass(frozen=True)
class Standing:
    """Thrusts that balance further from the declared centre of gravity than those of clean vehicles do.

    centre, errors : [3] thrust centre along x and y, m, and yaw balance. p : probability that a clean vehicle shows as
    much. moved : whether a centre of gravity elsewhere explains it, which leaves yaw alone. rotor : the rotor that
    explains it if it gives `less` of its thrust than its input says; None where no single one does, or another does so
    nearly as well. without, remaining : [3] rms on unseen flights from the declared balance and from this one.
    """

    centre: Tensor
    errors: Tensor
    p: float
    moved: bool
    rotor: int | None
    less: float
    less_error: float
    without: Tensor
    remaining: Tensor


def _full(spec: ModelSpec) -> bool:
    """Whether thrusts make lift and all three moments: not those of two or three rotors."""
    levers = torch.cat([torch.ones(len(spec.motors), 1, dtype=torch.float64), _levers(spec)], dim=1)
    return int(torch.linalg.matrix_rank(levers)) == levers.shape[1]


def standing(
    spec: ModelSpec, identify: Sequence[Balance], unseen: Sequence[Balance], clean: Tensor, seed: int = 0
) -> Standing | None:
    """How balance stands out on flights; None where clean vehicles do that, or unseen flights do not bear it out.

    clean : [D, 3] balance of clean vehicles. seed : of what the mean of the flights is uncertain by.
    """
    flights = torch.stack([b.centre.mean(dim=0) for b in identify])
    centre, levers = flights.mean(dim=0), _levers(spec) / len(spec.motors)
    vehicles = torch.cat([centre[None], _with_scatter(clean, flights, seed)])
    inverse = torch.linalg.inv(vehicles.mT @ vehicles / len(vehicles))
    p = _p(vehicles, inverse)
    unseen_centres = torch.cat([b.centre for b in unseen])
    without, after = (values.square().mean(dim=0).sqrt() for values in (unseen_centres, unseen_centres - centre))
    if p > SETTINGS.level or after @ inverse @ after >= without @ inverse @ without:
        return None
    ordinary = vehicles[1:].mT @ vehicles[1:] / len(clean)
    errors, weighed = ordinary.diagonal().sqrt(), torch.linalg.solve(ordinary, levers.mT)
    information = (levers.mT * weighed).sum(dim=0)
    beyond = centre @ weighed / information  # a rotor that gives less is asked for more
    remainders = torch.cat([_remainders(centre[None], inverse, lever[:, None]) for lever in levers])
    misfits = torch.where(beyond > 0.0, _misfits(remainders, inverse), math.inf)
    rotor = int(misfits.argmin())
    alone = int((misfits - misfits[rotor] < normal_quantile(0.5 * SETTINGS.level) ** 2).sum()) == 1
    explained = _p(_remainders(vehicles, inverse, levers[rotor][:, None]), inverse) > SETTINGS.level
    moved = _p(_remainders(vehicles, inverse, torch.eye(3, 2, dtype=torch.float64)), inverse) > SETTINGS.level
    # its share of all thrusts is larger than the others' by this over their number, and its true thrust is theirs
    less = float(beyond[rotor] / (1.0 + beyond[rotor] * (1.0 - 1.0 / len(levers))))
    one = rotor if explained and alone and less > 0.0 else None
    return Standing(centre, errors, p, moved, one, less, float(information[rotor].rsqrt()), without, after)


def _with_scatter(clean: Tensor, flights: Tensor, seed: int) -> Tensor:
    """Clean vehicles' balance, and by chance what the mean of these flights [F, 3] is uncertain by."""
    if len(flights) < 2:
        return clean
    chance = torch.Generator().manual_seed(seed)
    scatter = torch.randn(clean.shape, generator=chance, dtype=torch.float64)
    return clean + scatter * (flights.var(dim=0) / len(flights)).sqrt()


def _misfits(centres: Tensor, inverse: Tensor) -> Tensor:
    return (centres @ inverse * centres).sum(dim=1)


def _p(vehicles: Tensor, inverse: Tensor) -> float:
    """P = (1 + k) / (1 + n): k of n clean vehicles stand as far off as the first one."""
    misfits = _misfits(vehicles, inverse)
    return float((misfits >= misfits[0]).sum()) / len(misfits)


def _remainders(vehicles: Tensor, inverse: Tensor, causes: Tensor) -> Tensor:
    """What causes [3, C] of any size leave of the balance of vehicles [V, 3]."""
    weighed = inverse @ causes
    return vehicles - torch.linalg.solve(causes.mT @ weighed, (vehicles @ weighed).mT).mT @ causes.mT


def out_of_balance(
    model: Model, spec: ModelSpec, dataset: Dataset, unseen: Sequence[str], seed: int = 0, rows: Sequence[str] = ROWS
) -> tuple[EffectFinding | None, Unknown | None]:
    """A finding about the centre of gravity or a rotor, and what else is missing; None where nothing is.

    Nothing is said where surfaces balance the moments beside the rotors. seed : of clean vehicles and their scatter.
    rows : moments of which is asked with what they go.
    """
    if spec.surfaces:
        return None, None
    identified, new = balances(model, spec, dataset, dataset.identify), balances(model, spec, dataset, unseen)
    if not identified or not new:
        return None, None
    from rotorid_torch.simulation.drawn.multirotors import clean_balances, undrawable_multirotor  # slow to import

    going, off = going_with(identified, new, rows), None
    if _full(spec) and undrawable_multirotor(dataset) is None:
        clean = torch.from_numpy(clean_balances(dataset, seed, range(DRAWS)))
        off = standing(spec, identified, new, clean, seed)
    shown = None if off is None else _beside_wind(_shown(off, spec), model, spec)
    said = [_said(g) for g in going]
    where, signal = [g.row for g in going], " and ".join(dict.fromkeys(g.signal for g in going)) or None
    if off is not None and shown is None:
        whole = f"L, M and N: {_where(off)}; {ALONE}, and no rotor that gives less explains it alone"
        said, where, signal = [whole, *said], [*ROWS], None
    if not said:
        return shown, None
    longest = max(len(b.centre) for b in identified) * SETTINGS.settled_s
    sentence = f"Something is missing in {'; '.join(said)}; {_explained_by(going, spec) if signal else NAMELESS}."
    return shown, Unknown("".join(sorted({*where})), (1.0 / longest, 0.5 / SETTINGS.settled_s), signal, None, sentence)


def _explained_by(going: Sequence[Going], spec: ModelSpec) -> str:
    """Which effects would explain rows, in words, though nothing tells them from each other."""
    tilted = all(g.signal == TILTED.get(g.row) and float(g.slopes[-1]) < 0.0 for g in going)
    return LIKE_TILTED if tilted and Flapping.id not in spec.effects else NAMELESS


def _said(going: Going) -> str:
    scale, unit = (100.0, "% of yaw balance") if going.row == "N" else (1e3, "mm of thrust centre")
    late = f", about {going.late:g} s late" if going.late else ""
    return (
        f"{going.row}: it goes with {going.signal}{late}, which takes unseen flights from"
        f" {scale * going.without:.2g} to {scale * going.remaining:.2g} {unit}"
    )


def _where(off: Standing) -> str:
    x, y, yaw = (float(v) for v in off.centre)
    along, across = "ahead" if x >= 0.0 else "behind", "right" if y >= 0.0 else "left"
    place = f"{1e3 * abs(x):.1f} mm {along} and {1e3 * abs(y):.1f} mm {across} of the declared centre of gravity"
    ways = ("counter-clockwise", "clockwise") if yaw >= 0.0 else ("clockwise", "counter-clockwise")
    turn = f"rotors turning {ways[0]} carry {100 * abs(yaw):.0f} % of all thrust more than those turning {ways[1]}"
    without, after = ([1e3 * math.hypot(*e[:2].tolist()), 100.0 * float(e[2])] for e in (off.without, off.remaining))
    gain = f"unseen flights from {without[0]:.2g} to {after[0]:.2g} mm and from {without[1]:.2g} to {after[1]:.2g} %"
    return f"thrusts balance {place}, and {turn} (p {off.p:.2g} by clean vehicles), which takes {gain}"


def _beside_wind(shown: EffectFinding | None, model: Model, spec: ModelSpec) -> EffectFinding | None:
    """A finding in a group with the wind, where the model has none and all flights are pushed alike.

    Beyond what the attitude's zero and the accelerometers' bias may be off: of two axes by chance, a Rayleigh
    distribution at the level.
    """
    push = math.hypot(*(model.named_values.get(f"rotors.trim.{axis}", 0.0) for axis in "XY"))
    chance = SPREAD * spec.gravity * math.sqrt(-2.0 * math.log(SETTINGS.level))
    if shown is None or Wind.id in spec.effects or push <= chance:
        return shown
    row = finding(shown.id, Row(alone=False), shown.reason + BLOWN.format(push=push))
    return replace(row, group=(*shown.group, Wind.id), values=shown.values, p=shown.p)


def _shown(off: Standing, spec: ModelSpec) -> EffectFinding | None:
    """One rotor gives less; or, where that or yaw leave it open, the centre of gravity lies elsewhere."""
    if off.rotor is not None:
        rotor, effect, group = spec.driven[off.rotor], Unequal.id, (CentreOfGravity.id,) if off.moved else ()
        values = {f"{effect}.{rotor}": (off.less, off.less_error)}
        said = f"as if the rotor of {rotor} gave {100 * off.less:.0f} % less than its input says; "
        said += LIES_ELSEWHERE if off.moved else ALONE
    elif off.moved:
        effect, group = CentreOfGravity.id, (Unequal.id,)
        values = {f"{effect}.{axis}": (float(off.centre[i]), float(off.errors[i])) for i, axis in enumerate("xy")}
        said = "it lies there, or several rotors differ; swing the vehicle to tell"
    else:
        return None
    one = finding(effect, Row(alone=not group), f"{_where(off)}: {said}")
    return replace(one, group=group, values=values, p=off.p)
