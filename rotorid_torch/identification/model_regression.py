"""Step 2 on the model's own equations: Fourier transform regression of flapping, forces and moments.

Response and regressors are measured quantities; what the declared physics adds beyond the linear terms is computed
from them and from step 1's thrust, and subtracted before.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch.core.integrate import integral
from rotorid_torch.core.names import FLAPPING, FORCES, MOMENTS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.core.rigid import cross, gravity_in_body, gyroscopic
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.effects.base import Effect, Frame, Stage, Values
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.identification.regress.equation import START, Equation, fit_equation, independent_shares
from rotorid_torch.identification.regress.ftr import Regression
from rotorid_torch.identification.structure import ATTITUDE, have
from rotorid_torch.model.derivatives import LinearForces
from rotorid_torch.model.gusts import GUSTS
from rotorid_torch.model.inflow import CYCLIC
from rotorid_torch.model.linear_equations import AlgebraicFlapping, Flapping, LinearBlock
from rotorid_torch.model.model import Model
from rotorid_torch.model.training.equilibrium import PROBE

HIGHEST = {**dict.fromkeys(FLAPPING, 8.0), **dict.fromkeys((*FORCES, *MOMENTS), 4.0)}
"""Hz: highest frequency of each equation, if its data reach it."""

END_S = 0.2
"""s: over which noise is averaged at either end of a record whose mean rate is asked for."""
MIDDLE = 2.0
"""Hz: where the noise of an integrated accelerometer is read."""

FOLLOWING = 10.0
"""1/s: rate at which a body rate follows its controls, or flapping what drives it, where the regression sees no lag."""
SLOWEST = 1.0
"""1/s: no blade flaps with less damping; a regression that says so has lost the lag in the noise."""


TOGETHER = 2**16
"""Samples of flights that go through a model's physics at once: more gain no time, and take memory."""


@dataclass(frozen=True)
class Measured:
    """Flights end to end as step 2 sees them: signals bridged over gaps, step 1's loads, and the physics' known part.

    signals : each (T,). physics : (T, 6) forces m/s2 and moments rad/s2 of the physics beyond the linear terms.
    specific : (T, 6) of step 1. samples : of each flight.
    """

    signals: Mapping[str, Tensor]
    physics: Tensor
    specific: Tensor
    samples: tuple[int, ...]


@dataclass(frozen=True)
class ModelRegression:
    """Regressions by row, the parameter vector that starts step 3, and the parameters that step 3 is to hold.

    Where a regression finds a body rate that its controls drive without lag, and so no damping, the rate follows its
    controls instead: cross-axis rates are held at zero in that row, for they would only imitate the missing lead.
    Flapping that seems undamped follows what drives it in the same way, as a start; step 3 finds its lag.
    """

    by_row: Mapping[str, Regression] = field(repr=False)
    theta: Tensor = field(repr=False)
    held: tuple[str, ...]
    own_share: Mapping[str, float]  # of each control's in-band motion, what body states do not explain (feedback)
    # the others of a multirotor: standard errors by full name, `MeasuredFit.lines` by flight, theta of all flights but
    # one, and R2 by response
    errors: Mapping[str, float] = field(default_factory=dict, repr=False)
    lines: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict, repr=False)
    without: Mapping[str, Tensor] = field(default_factory=dict, repr=False)
    explained: Mapping[str, float] = field(default_factory=dict)

    def doubtful(self, names: Sequence[str]) -> tuple[str, ...]:
        """Those of the model's parameters `names` whose row holds in no band wider than the smallest.

        Gusts do that to a row which they move as much as the pilot does, above all coning: what they do to the response
        is in its regressors too (vertical velocity, induced velocity). The lag of a row is left out.
        """
        rows = {row for row, regression in self.by_row.items() if regression.band[1] <= START}
        lags = {f"{row}.{row}" for row in FLAPPING} | {f"{m}.{r}" for m, r in zip(MOMENTS, RATES, strict=True)}
        split = {n: n.split(".") for n in names}
        return tuple(n for n, s in split.items() if s[1] in rows and s[-1] != "trim" and ".".join(s[1:]) not in lags)


def regress_model(model: Model, dataset: Dataset, reconstruction: Reconstruction) -> ModelRegression:
    """All linear parameters of the model from the identify flights, in closed form; the others keep their prior."""
    theta = model.theta.detach().clone()
    flights = _measured(model, dataset, reconstruction)
    regressions: dict[str, Regression] = {}
    held: list[str] = []
    shares: dict[str, float] = {}
    for effect, equation in _equations(model, dataset, flights):
        row = equation.name
        regressions[row] = fit_equation(equation)
        _store(model, theta, effect, row, regressions[row].selected, regressions[row].coefficients)
        state_name = _own_state(model, row)
        if state_name in equation.names and _undamped(model, theta, f"{effect}.{row}.{state_name}", row):
            held += _follow(model, theta, effect, state_name, equation, flights)
        if row == MOMENTS[0]:
            shares = _own_shares(equation, model)
    return ModelRegression(regressions, model.parameter_set.clamp(theta), tuple(held), shares)


def _measured(model: Model, dataset: Dataset, reconstruction: Reconstruction) -> Mapping[str, Measured]:
    """The identify flights as step 2 sees them, each made when it is asked for."""
    return OnDemand(dataset.identify, lambda name: measured(model, dataset, reconstruction, [name]), costly=True)


def _equations(model: Model, dataset: Dataset, flights: Mapping[str, Measured]) -> Iterator[tuple[str, Equation]]:
    """Each equation of the model that is linear in its derivatives, with the id of the effect that has it."""
    for effect in model.chain:
        if isinstance(effect, LinearForces | Flapping | AlgebraicFlapping):
            for row in effect.block.rows:
                yield effect.id, _equation(row, effect, effect.block, model, dataset, flights)


def trims_of_flights(
    model: Model, theta: Tensor, dataset: Dataset, reconstruction: Reconstruction
) -> tuple[tuple[str, ...], Tensor]:
    """What each equation has as a constant in each identify flight, its derivatives and the physics as in theta.

    Returns names of the equations, and their constants [rows, flights] in the rows' units. The model is set to theta.
    """
    model.put(theta)
    names, trims = [], []
    for effect, equation in _equations(model, dataset, _measured(model, dataset, reconstruction)):
        places = [model.parameter_set.index(f"{effect}.{equation.name}.{c}") for c in equation.names]
        derivatives = theta[places]
        mean = _mean_rate if equation.kind == "derivative" else lambda y, _: y.mean()
        each = zip(equation.response, equation.regressors, equation.dt, strict=True)
        trims.append([float(mean(y, dt) - z.mean(0) @ derivatives) for y, z, dt in each])
        names.append(equation.name)
    return tuple(names), torch.tensor(trims, dtype=torch.float64)


def _mean_rate(signal: Tensor, dt: float) -> Tensor:
    """Mean rate of change, between means over the two ends."""
    ends = max(1, min(round(END_S / dt), len(signal) // 2))
    return (signal[-ends:].mean() - signal[:ends].mean()) / (dt * (len(signal) - ends))


def _own_shares(equation: Equation, model: Model) -> dict[str, float]:
    """Share of each control's motion in the equation's band that is its own and not feedback of the body states."""
    states = [n for n in equation.names if n in model.body.states]
    controls = [n for n in model.body.controls if n not in GUSTS]
    return independent_shares(equation, controls, states) if states else dict.fromkeys(controls, 1.0)


def _own_state(model: Model, row: str) -> str | None:
    """The state whose rate a row is, where it can lose its damping: a body rate, or flapping with a lag."""
    if row in MOMENTS:
        return RATES[MOMENTS.index(row)]
    return row if row in model.layout.names else None


def _undamped(model: Model, theta: Tensor, name: str, row: str) -> bool:
    """Whether a state's own derivative came out beyond its bound, or flapping's slower than any blade's."""
    place = model.parameter_set.index(name)
    return bool(theta[place] > (-SLOWEST if row in FLAPPING else model.parameter_set.upper[place]))


def _follow(
    model: Model, theta: Tensor, effect: str, state_name: str, equation: Equation, flights: Mapping[str, Measured]
) -> list[str]:
    """Let a state follow the other signals at `FOLLOWING`: gains by regression of the state itself; names to hold."""
    row = equation.name
    kin = RATES if row in MOMENTS else (*FLAPPING, *CYCLIC)
    others = [c for c in equation.names if c not in kin]

    def state(name: str, flight: Measured) -> Tensor:
        return flight.signals[state_name]

    gains = fit_equation(replace(equation, response=_each(flights, state), kind="value", prior=None), others)
    kinematic = [c for c in equation.names if c in kin]
    follow = torch.tensor([-FOLLOWING if c == state_name else 0.0 for c in kinematic], dtype=torch.float64)
    _store(model, theta, effect, row, kinematic, follow)
    _store(model, theta, effect, row, others, FOLLOWING * gains.coefficients)
    return [f"{effect}.{row}.{c}" for c in kinematic if c != state_name] if row in MOMENTS else []


def _store(model: Model, theta: Tensor, effect: str, row: str, names: Sequence[str], values: Tensor) -> None:
    """Write derivatives of a row into theta, in place."""
    for name, value in zip(names, values.tolist(), strict=True):
        theta[model.parameter_set.index(f"{effect}.{row}.{name}")] = value


@dataclass(frozen=True)
class Recorded:
    """Flights end to end before the first effect of a model's chain, behind the path of controls and sensors.

    specific : (T, 6) of step 1. dt : s. samples : of each flight.
    """

    frame: Frame
    specific: Tensor
    dt: float
    samples: tuple[int, ...]


@dataclass(frozen=True)
class Before:
    """Signals as they come to one effect of a model's chain, whatever the parameters from that effect on."""

    effect: str
    frame: Frame
    recorded: Recorded


def end_to_end(dataset: Dataset, names: Sequence[str]) -> list[list[str]]:
    """The flights in their order, in groups that `measured` takes: of one sample interval, with the same channels."""
    groups = list[list[str]]()
    kinds = {name: (facts.dt, frozenset(facts.spreads)) for name, facts in dataset.facts.items()}
    for name in names:
        last = groups[-1] if groups else []
        samples = sum(dataset.facts[n].samples for n in (*last, name))
        if last and kinds[last[0]] == kinds[name] and samples <= TOGETHER:
            last.append(name)
        else:
            groups.append([name])
    return groups


def measured(
    model: Model, dataset: Dataset, reconstruction: Reconstruction, names: Sequence[str], before: Before | None = None
) -> Measured:
    """Signals of flights that go `end_to_end`, and what the declared physics beyond the derivatives gives on them.

    Flapping that these flights do not measure stands still where physics asks for it, and is no signal.

    before : where the chain is gone on from; by default its beginning.
    """
    recorded = _as_recorded(model, dataset, reconstruction, names) if before is None else before.recorded
    frame, first = (recorded.frame, 0) if before is None else (before.frame, _place(model, before.effect))
    frame = _passed(model, frame, recorded, range(first, len(model.chain)))
    assert frame.force is not None
    assert frame.moment is not None
    unseen = [n for n in FLAPPING if n in model.layout.names and not dataset.facts[names[0]].has(n)]
    visible = {n: signal for n, signal in frame.signals.items() if n not in unseen}
    physics = torch.cat([frame.force - recorded.specific[:, :3], frame.moment], dim=-1)
    return Measured(visible, physics, recorded.specific, recorded.samples)


def before(
    model: Model, dataset: Dataset, reconstruction: Reconstruction, names: Sequence[str], effect: str
) -> Before | None:
    """Flights before an effect; None for one of the path of controls or sensors, from which all else follows."""
    place = _place(model, effect)
    if model.chain[place].stage in (Stage.CONTROL, Stage.SENSORS):
        return None
    recorded = _as_recorded(model, dataset, reconstruction, names)
    return Before(effect, _passed(model, recorded.frame, recorded, range(place)), recorded)


def _place(model: Model, effect: str) -> int:
    return [e.id for e in model.chain].index(effect)


def _as_recorded(model: Model, dataset: Dataset, reconstruction: Reconstruction, names: Sequence[str]) -> Recorded:
    flights = [dataset.flights[name] for name in names]
    each = [_recorded_signals(model, flight) for flight in flights]
    signals = {n: torch.cat([one[n] for one in each]) for n in each[0]}
    measured_too = [n for n in FLAPPING if flights[0].has(n)]
    rates = {n: torch.cat([torch.gradient(one[n], spacing=flights[0].dt)[0] for one in each]) for n in measured_too}
    specific = torch.cat([reconstruction.flights[name].specific.nan_to_num(0.0) for name in names])
    frame = Frame(signals, force=specific[:, :3], moment=torch.zeros_like(specific[:, 3:]), rates=rates)
    return Recorded(frame, specific, flights[0].dt, tuple(flight.samples for flight in flights))


def _recorded_signals(model: Model, flight: Flight) -> dict[str, Tensor]:
    """A flight's signals by name (T,): channels, those that states stand for, and controls as they act."""
    names = tuple(dict.fromkeys((*(s for s in model.layout.names), *FLAPPING, *model.body.controls)))
    present = [n for n in names if flight.has(n)]
    signals = dict(zip(present, flight.bridged(present).unbind(-1), strict=True))
    with torch.no_grad():
        controls = model.tape(flight.bridged(model.body.controls), flight.dt)
    signals |= zip(model.body.controls, controls.unbind(-1), strict=True)
    channels = {s.name: s.channel for s in model.layout.states if s.channel is not None and flight.has(s.channel)}
    signals |= {name: flight.bridged([channel])[:, 0] for name, channel in channels.items()}
    unseen = [n for n in FLAPPING if n in model.layout.names and n not in present]
    return signals | {n: torch.full_like(flight.time, model.reference.get(n, 0.0)) for n in unseen}


def _passed(model: Model, frame: Frame, recorded: Recorded, places: range) -> Frame:
    """The frame behind effects of the chain, whose states are recorded signals, or followed along the frame's."""
    theta, signals = model.theta.detach(), recorded.frame.signals
    for k in places:
        effect = model.chain[k]
        if isinstance(effect, LinearForces | Flapping | AlgebraicFlapping) or effect.stage is Stage.SENSORS:
            continue
        values = model.values(theta, k)
        followed = _followed(effect, frame, values, recorded)
        for i, name in enumerate(model.state_names(k)):
            followed[:, i] = signals.get(name, followed[:, i])
        frame = frame.with_signals(**dict(zip(model.state_names(k), followed.unbind(-1), strict=True)))
        frame, _ = effect(frame, followed, values)
    return frame


def _followed(effect: Effect, frame: Frame, values: Values, recorded: Recorded) -> Tensor:
    """States of an effect [T, n] integrated along the frame's signals, in each flight from rest; implicit in itself."""
    samples = sum(recorded.samples)
    if not effect.states:
        return torch.empty(samples, 0, dtype=torch.float64)
    # linear in its own state for as long as a sample is short: dx/dt = c + A x with A by differences at the start
    unit = torch.eye(len(effect.states), dtype=torch.float64)
    trials = PROBE * torch.cat([torch.zeros_like(unit[:1]), unit])[:, None].expand(-1, samples, -1)
    constant, *moved = (effect(frame, trial, values)[1].expand_as(trial) for trial in trials)
    slope = (torch.stack(moved, dim=-1) - constant[..., None]) / PROBE
    passed = torch.linalg.inv(unit - recorded.dt * slope)
    steps = torch.nn.functional.pad(passed, (0, 1, 0, 1))  # of [x, 1]
    steps[:, :-1, -1] = (passed @ (recorded.dt * constant).unsqueeze(-1)).squeeze(-1)
    steps[:, -1, -1] = 1.0
    first = torch.tensor([0, *recorded.samples[:-1]]).cumsum(0)
    equilibria = -(torch.linalg.pinv(slope[first]) @ constant[first].unsqueeze(-1)).squeeze(-1)
    flights = pad_sequence(list(steps.split(recorded.samples)), batch_first=True)
    states = chained(flights, torch.nn.functional.pad(equilibria, (0, 1), value=1.0))
    return torch.cat([of[:n, :-1] for of, n in zip(states, recorded.samples, strict=True)])


def chained(steps: Tensor, start: Tensor) -> Tensor:
    """States [..., T, n] before each of the linear steps [..., T, n, n] from start [..., n].

    In blocks, all at once, then over the blocks.
    """
    samples, size = steps.shape[-3], steps.shape[-1]
    blocks = math.isqrt(samples) + 1
    length = -(-samples // blocks)
    still = torch.eye(size, dtype=steps.dtype)
    filled = still.expand(*steps.shape[:-3], blocks * length - samples, size, size)
    padded = torch.cat([steps, filled], dim=-3)
    since, inside = still.expand(*steps.shape[:-3], blocks, size, size), []
    for step in padded.unflatten(-3, (blocks, length)).unbind(-3):
        inside.append(since)
        since = step @ since
    starts = [start]
    for block in since[..., :-1, :, :].unbind(-3):
        starts.append((block @ starts[-1].unsqueeze(-1)).squeeze(-1))
    states = torch.stack(inside, dim=-3) @ torch.stack(starts, dim=-2)[..., None, :, None]
    return states.flatten(-4, -3)[..., :samples, :, 0]


def _each(flights: Mapping[str, Measured], take: Callable[[str, Measured], Tensor]) -> Collection[Tensor]:
    """One record per flight, made when it is asked for."""
    return OnDemand(flights, lambda name: take(name, flights[name]), budget=0).values()


def _equation(
    row: str, effect: Effect, block: LinearBlock, model: Model, dataset: Dataset, flights: Mapping[str, Measured]
) -> Equation:
    declared = {p.name: (p.value, p.prior_sd) for p in effect.declared}
    pattern = tuple(c for c in block.columns if f"{row}.{c}" in declared)
    responses, kind, noise = _responses(row, model, dataset, flights)
    reference = model.reference
    priors = torch.tensor([declared[f"{row}.{c}"] for c in pattern], dtype=torch.float64).view(-1, 2)
    channel_noise = {c: dataset.noise(c) for c in pattern if have(dataset, (c,))}

    def regressors(name: str, flight: Measured) -> Tensor:
        return torch.stack([flight.signals[c] - reference.get(c, 0.0) for c in pattern], dim=-1)

    return Equation(
        name=row,
        response=responses,
        regressors=_each(flights, regressors),
        names=pattern,
        dt=[dataset.facts[f].dt for f in dataset.identify],
        kind=kind,
        response_noise=noise,
        regressor_noise=[channel_noise.get(c, 0.0) for c in pattern],
        prior=(priors[:, 0], priors[:, 1]),
        highest=HIGHEST[row],
    )


def _responses(
    row: str, model: Model, dataset: Dataset, flights: Mapping[str, Measured]
) -> tuple[Collection[Tensor], str, float]:
    """Measured response of a row without its known part, the regression's kind, and the response's noise."""
    if row in FLAPPING:
        kind = "value" if isinstance(model.effect("rotor"), AlgebraicFlapping) else "derivative"
        return _each(flights, lambda name, flight: flight.signals[row]), kind, dataset.noise(row)
    axis = (*FORCES, *MOMENTS).index(row)
    if row in MOMENTS:

        def rate(name: str, flight: Measured) -> Tensor:
            rates, physics = torch.stack([flight.signals[n] for n in RATES], -1), flight.physics[:, axis]
            if model.body.inertia is not None:
                physics = physics + gyroscopic(rates, model.inertia)[:, axis - 3]
            return rates[:, axis - 3] - integral(physics, dataset.facts[name].dt)

        return _each(flights, rate), "derivative", dataset.noise(RATES[axis - 3])
    if have(dataset, SPECIFIC_FORCES):
        return _accelerometer_response(model, dataset, flights, axis)
    response = lambda name, flight: _velocity_response(model, flight, axis, dataset.facts[name].dt)  # noqa: E731
    return _each(flights, response), "derivative", dataset.noise(VELOCITIES[axis])


def _accelerometer_response(
    model: Model, dataset: Dataset, flights: Mapping[str, Measured], axis: int
) -> tuple[Collection[Tensor], str, float]:
    """Specific force at the centre of gravity without its known part, from an IMU that may sit elsewhere.

    There the arm's angular acceleration is the rate of measured rates, so response and arm are integrated and regressed
    by their derivative: step 1's smoothed moments would leave their attenuation in the force.
    """
    channel = SPECIFIC_FORCES[axis]
    noise = dataset.noise(channel)

    def force(name: str, flight: Measured) -> Tensor:
        return dataset.flights[name].bridged([channel])[:, 0] - flight.physics[:, axis]

    if not bool(model.imu.any()):
        return _each(flights, force), "value", noise
    reach = cross(torch.eye(3, dtype=torch.float64), model.imu)[:, axis]  # of each gyro
    gyros = float((reach * torch.tensor([dataset.noise(n) for n in RATES], dtype=torch.float64)).norm())

    def velocity(name: str, flight: Measured) -> Tensor:
        rates = torch.stack([flight.signals[n] for n in RATES], -1)
        speed = cross(rates, model.imu)
        inward = cross(rates, speed)[:, axis]
        return integral(force(name, flight) - inward, dataset.facts[name].dt) - speed[:, axis]

    return _each(flights, velocity), "derivative", math.hypot(gyros, noise / (2.0 * math.pi * MIDDLE))


def _velocity_response(model: Model, flight: Measured, axis: int, dt: float) -> Tensor:
    """Velocity without gravity, turning axes and known force, integrated: its rate is the linear force."""
    rates, attitude = (torch.stack([flight.signals[n] for n in group], -1) for group in (RATES, ATTITUDE))
    velocity = Frame(flight.signals).over_ground()
    other = gravity_in_body(attitude, model.body.gravity) - cross(rates, velocity) + flight.physics[:, :3]
    return velocity[:, axis] - integral(other[:, axis], dt)
