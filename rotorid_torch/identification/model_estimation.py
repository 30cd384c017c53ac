"""Step 3 on the model: output error over all identify flights, every parameter free within its bounds and prior.

Where the air moves, by the filter error method in two steps: an extended Kalman filter with gusts as states finds the
air of each flight by step 2's derivatives (`gusts`), and output error the parameters with these gusts fed in. Process
noise alone predicts a sample ahead, and what is best there need not be of use over the seconds of a free run.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import InfiniteCost, Options
from rotorid_torch.core.names import RATES, SPECIFIC_FORCES
from rotorid_torch.core.processes.device import moved, working_on
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.core.storage import mapped_arrays
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight, bridged
from rotorid_torch.errors import InputError, Unsupported
from rotorid_torch.identification.estimate.likelihood import Likelihood, Place
from rotorid_torch.identification.estimate.progressive_fit import Estimate, Monitor, Settings, Start, fit
from rotorid_torch.identification.estimate.segments import Records, records_from
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.gusts import Air, fed_in, find_gusts, in_steady_wind, of_all, widened
from rotorid_torch.identification.method_choice import GUSTY, sentence, velocities_colour
from rotorid_torch.identification.model_regression import ModelRegression, measured
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction
from rotorid_torch.identification.regress.fourier import noise_floor, smoothed
from rotorid_torch.model.accelerations import Accelerations
from rotorid_torch.model.gusts import fed, lacks
from rotorid_torch.model.model import Model

RATE = 50.0
"""Hz: records are averaged down to no less than this; body, flapping and inflow are slower than a fifth of it."""
STEP_3 = Options(tolerance=1e-5, absolute=0.05)
"""The search ends where a step could change the log-likelihood by no more than this: less than a standard error."""
CLEARLY_BETTER = 4.5
"""Fall of minus log-likelihood by which a size must be better than none: three standard errors of one number."""
LENGTHS = (2.0, 5.0)
"""s: segments of the two stages; an unstable vehicle's slow modes show in the second, its fast ones set the first."""
ROTORS_RATE, ROTORS_LENGTHS = 200.0, (0.25,)
"""Hz and s for multirotors: motors follow within tens of milliseconds, and chains of integrators drift off at once."""
LOST = "by the derivatives that a regression finds the filter loses these flights, whatever the noise"
"""Why the filter error method cannot be taken where its search has no start."""
FOLDED = 4
"""Recorded samples from one comparison of a multirotor's rates to the next."""


@dataclass(frozen=True)
class ModelEstimate:
    """The estimate, and which parameters of the model it is of (in the order of its theta).

    method : "output-error" or "filter-error". why : how it was chosen, in a sentence. air : what was found of it.
    flights : whose gusts `air` holds, in order.
    """

    fit: Estimate = field(repr=False)
    names: tuple[str, ...] = field(repr=False)
    method: str = "output-error"
    why: str = ""
    air: Air | None = None
    flights: tuple[str, ...] = ()

    def theta_of(self, model: Model, start: ModelRegression) -> Tensor:
        """The model's whole parameter vector: the estimate, and step 2's values of what was held."""
        theta = start.theta.clone()
        theta[[model.parameter_set.index(name) for name in self.names]] = self.fit.theta
        return theta

    @property
    def criterion(self) -> float:
        """Akaike's information criterion; the smaller, the better the structure, on the same records."""
        cost = self.fit.minimum.point.cost
        return 2.0 * (cost + len(self.names)) if math.isfinite(cost) else math.inf


@dataclass(frozen=True)
class Means:
    """What step 3 works with.

    monitor : called after each accepted step with iteration, cost, theta. ranks : among which the flights are spread.
    device : on another than the processor, torch does the work. method : "output-error", "filter-error", or "auto":
    the latter where output error's residuals show moving air. why : how a method was chosen that nobody asked for:
    where it cannot be taken, output error is; one that somebody asked for is refused then.
    """

    monitor: Monitor | None = None
    ranks: Ranks = ALONE
    device: str = "cpu"
    method: str = "auto"
    why: str = ""


def estimate_model(
    model: Model, dataset: Dataset, reconstruction: Reconstruction, start: ModelRegression, means: Means = Means()
) -> ModelEstimate:
    """Maximum likelihood from step 2's values, which only start it; the model's theta is set to the estimate.

    The identify flights are spread over the ranks; each comes to the same estimate.

    Raises InputError: "filter-error" where gusts have nothing to act through, the model cannot be compiled, or the
    filter loses the flights.
    """
    method, ranks, why_not = means.method, means.ranks, lacks(model)
    if method == "filter-error" and why_not:
        raise InputError("--method", method, why_not, "output-error")
    names = tuple(n for n in model.parameter_set.free if n not in start.held)
    if not names:
        wish = "motion that follows the controls: larger inputs, on one at a time; rotorid check says more"
        raise InputError(dataset.path or "arrays", "", "the flights tell no parameter of the model", wish)
    model.put(start.theta)
    flights = _own_lines_taken_off(records(model, dataset, reconstruction, ranks), model, dataset, start, ranks)
    search = _Search(model, names, _settings(model, dataset, names, means.device), means)
    decides = method == "auto" and not why_not
    estimate, colour = (None, math.nan) if method == "filter-error" else search.estimate(model, flights, decides)
    air = None
    if estimate is None:
        try:
            estimate, air = search.in_moving_air(flights, sensor_noise(model, dataset), start)
        except (Unsupported, InfiniteCost) as error:
            lost = isinstance(error, InfiniteCost)
            why_not = LOST if lost else f"no filter can be compiled for this model: {error}"
            if method == "filter-error" and not means.why:
                raise InputError("--method", method, why_not, "output-error") from None
            estimate, _ = search.estimate(model, flights)
    assert estimate is not None
    with torch.no_grad():
        model.theta[[model.parameter_set.index(n) for n in names]] = estimate.theta
    chosen = "output-error" if air is None else "filter-error"
    whose = tuple(name for part in ranks.gather(ranks.mine(dataset.identify)) for name in part)
    why = means.why if method == chosen else ""
    why = why or sentence(method if method == chosen else "auto", chosen, colour, why_not)
    return ModelEstimate(estimate, names, chosen, why, air, whose if air else ())


def _settings(model: Model, dataset: Dataset, names: Sequence[str], device: str) -> Settings:
    """How the named parameters of a model are searched."""
    places = [model.parameter_set.index(n) for n in names]
    return Settings(
        sensor_noise=sensor_noise(model, dataset),
        lengths=lengths(model),
        prior_mean=model.parameter_set.values[places],
        prior_sd=model.parameter_set.prior_sd[places],
        x0_sd=initial_spread(model, dataset),
        options=STEP_3,
        engine=None if device == "cpu" else "reference",
    )


@dataclass(frozen=True)
class _Search:
    """Output error of a model's parameters."""

    model: Model
    names: tuple[str, ...]
    settings: Settings
    means: Means

    def in_moving_air(self, flights: Records, noise: Tensor, start: ModelRegression) -> tuple[Estimate, Air]:
        """The estimate with gusts fed in, which a filter finds by step 2's derivatives, and these; noise : [ny]."""
        model, names, ranks = self.model, self.names, self.means.ranks
        batch = of_all(flights, ranks)
        air = ranks.from_first(find_gusts(model, names, batch, noise, start.doubtful(names)))
        estimate, _ = self.estimate(fed(model), fed_in(flights, air, ranks))
        assert estimate is not None
        wider = widened(estimate, torch.maximum(air.variances.nan_to_num(0.0), _regressed(start, names)))
        values = model.named_values | dict(zip(names, wider.theta.tolist(), strict=True))
        return in_steady_wind(wider, names, values, air), air

    def estimate(self, model: Model, flights: Records, decides: bool = False) -> tuple[Estimate | None, float]:
        """By a model with these parameters; and the colour of the first stage's residuals of velocities.

        decides : then there is no estimate where that says that the air moves.
        """
        colour = 0.0

        def gusty(problem: Likelihood, place: Place) -> bool:
            nonlocal colour
            colour = velocities_colour(model.body.outputs, problem, place)
            return colour > GUSTY

        flights, settings = moved((flights, self.settings), self.means.device)
        with working_on(self.means.device):
            system = System(model, self.names)
            asked = replace(settings, ends=gusty if decides else None)
            fitted = fit(system, flights, Start(), asked, self._watch, self.means.ranks)
            if colour > GUSTY:
                return None, colour
            estimate = self._moved_off_nothing(system, flights, settings, fitted.estimate())
        return moved(estimate, "cpu"), colour

    def _watch(self, iteration: int, cost: float, theta: Tensor) -> None:
        """What watches the fit works on the processor."""
        if self.means.monitor is not None:
            with torch.device("cpu"):
                self.means.monitor(iteration, cost, theta.to("cpu"))

    def _moved_off_nothing(self, system: System, flights: Records, settings: Settings, estimate: Estimate) -> Estimate:
        """The estimate, or that from sizes of effects of which a little does nothing, where it is better."""
        acting = {self.names.index(n): size for n, size in _idle(self.model).items() if n in self.names}
        if not acting:
            return estimate
        place = estimate.theta.clone()
        place[list(acting)] = place.new_tensor(list(acting.values()))
        other = fit(system, flights, Start(place), settings, self._watch, self.means.ranks).estimate()
        return other if other.minimum.point.cost < estimate.minimum.point.cost - CLEARLY_BETTER else estimate


def _regressed(start: ModelRegression, names: Sequence[str]) -> Tensor:
    """Variances [P] by step 2's regressions, which say how strongly gusts act; zero for what none of them tells."""
    variances = {
        f"{row}.{name}": float(se) ** 2
        for row, regression in start.by_row.items()
        for name, se in zip(regression.names, regression.standard_errors, strict=True)
    }
    return torch.tensor([variances.get(n.partition(".")[2], 0.0) for n in names], dtype=torch.float64).nan_to_num(0.0)


def initial_spread(model: Model, dataset: Dataset) -> Tensor:
    """Prior of the initial states about those that are followed [nx], infinite where there is none.

    What a channel tells is known as well as it is measured: more freedom would give each segment a nuisance of its own.
    """
    spreads = [
        s.spread if s.channel is None or math.isinf(s.spread) else min(s.spread, dataset.noise(s.channel))
        for s in model.layout.states
    ]
    return torch.tensor(spreads, dtype=torch.float64)


def sensor_noise(model: Model, dataset: Dataset) -> Tensor:
    """Sensor noise of the outputs after averaging, [ny]."""
    every = _every(model, dataset.facts[dataset.identify[0]].dt)
    return torch.tensor([dataset.noise(c) for c in model.body.outputs], dtype=torch.float64) / math.sqrt(every)


def records(model: Model, dataset: Dataset, reconstruction: Reconstruction, ranks: Ranks = ALONE) -> Records:
    """The rank's identify flights as one batch: measured outputs, and smoothed states to start segments from."""
    batch: Records | None = None
    names = ranks.mine(dataset.identify)
    count = [dataset.facts[name].samples // _every(model, dataset.facts[name].dt) for name in names]
    for i, name in enumerate(names):
        record = _record(model, dataset, reconstruction, name)
        if batch is None:
            batch = _empty(record, len(count), max(count))
        batch.lengths[i], batch.start[i] = record.lengths[0], record.start[0]
        batch.controls[i], batch.outputs[i, : record.samples] = record.controls[0, -1], record.outputs[0]
        batch.controls[i, : record.samples], batch.states[i, : record.samples] = record.controls[0], record.states[0]
    mapped_arrays.let_go()
    assert batch is not None
    return replace(batch, dt=ranks.from_first(batch.dt))  # the first flight's, which is the first rank's


def _own_lines_taken_off(
    flights: Records, model: Model, dataset: Dataset, start: ModelRegression, ranks: Ranks
) -> Records:
    """Records whose specific forces are less what step 2 lets a multirotor's flight have of its own."""
    for k, name in enumerate(ranks.mine(dataset.identify)):
        samples = int(flights.lengths[k])
        time = flights.dt * (torch.arange(samples, dtype=torch.float64) - 0.5 * (samples - 1))
        for row, (level, slope) in start.lines.get(name, {}).items():
            if row in SPECIFIC_FORCES and row in model.body.outputs:
                flights.outputs[k, :samples, model.body.outputs.index(row)] -= level + slope * time
    return flights


def lengths(model: Model) -> tuple[float, ...]:
    """Lengths of the segments that a model's parameters are estimated on, s, stage by stage."""
    return LENGTHS if model.effect("rotors") is None else ROTORS_LENGTHS


def _idle(model: Model) -> dict[str, float]:
    """Free parameters at nothing where a little of them does nothing, with the least of the sizes they are met at.

    Those of effects that act already are left out. From nothing no slope leads to them; from there a smaller size is
    found too.
    """
    parameters, values = model.parameter_set.parameters, model.named_values
    acting = {p.name.rpartition(".")[0] for p in parameters if p.met and values[p.name] != p.value}
    idle = [p for p in parameters if p.met and p.free and values[p.name] == p.value]
    resting = [p for p in idle if p.name.rpartition(".")[0] not in acting]
    return {p.name: min(p.met, key=lambda size: abs(size - p.value)) for p in resting}


def _every(model: Model, dt: float) -> int:
    """Samples that are averaged to one."""
    return max(1, int(1.0 / (dt * (RATE if model.effect("rotors") is None else ROTORS_RATE))))


def _record(model: Model, dataset: Dataset, reconstruction: Reconstruction, name: str) -> Records:
    """One flight alone."""
    flight, reconstructed = dataset.flights[name], reconstruction.flights[name]
    every = _every(model, flight.dt)
    followed = {s.name: reconstructed.channels.get(s.channel or s.name) for s in model.layout.states}
    rotors, unknown = model.effect("rotors") is not None, torch.full_like(flight.time, math.nan)
    # what no channel tells of a multirotor rests, or is driven by the measured motion
    signals = {s.name: torch.zeros_like(unknown) for s in model.layout.states if rotors and s.channel is None}
    if any(v is None and n not in signals for n, v in followed.items()):  # effects have states of their own
        untold = {s.name: unknown for s in model.layout.states if s.channel is not None and not flight.has(s.channel)}
        signals = {**measured(model, dataset, reconstruction, [name]).signals, **untold}
    states = torch.stack([signals.get(n, unknown) if v is None else v for n, v in followed.items()], -1)
    if rotors:
        states = _driven(model, flight, states)
    biases = torch.tensor([reconstructed.biases.get(c, 0.0) for c in model.body.outputs], dtype=torch.float64)
    controls = controls_that_acted(dataset, name, model.body.controls)
    recorded = {"time": flight.time, "controls": controls, "states": states}
    outputs = _compared(model, averaged(flight.stack(model.body.outputs) - biases, every), every)
    return records_from([{**{key: averaged(record, every) for key, record in recorded.items()}, "outputs": outputs}])


def _driven(model: Model, flight: Flight, states: Tensor) -> Tensor:
    """States (T, nx) with those of effects that no channel tells as a multirotor's measured motion drives them."""
    names = [
        name
        for k, effect in enumerate(model.chain)
        for name, state in zip(model.state_names(k), effect.states, strict=True)
        if effect.declared and state.channel is None
    ]
    if not names:
        return states
    places = list(model.layout.places(names))
    with torch.no_grad():
        taped = model.tape(flight.bridged(model.body.controls), flight.dt)
        inside = Accelerations(model).inside(bridged(states).nan_to_num(0.0), taped, flight.dt)
    return states.index_copy(-1, torch.tensor(places), inside[:, places])


def controls_that_acted(dataset: Dataset, name: str, controls: Sequence[str]) -> Tensor:
    """Controls (T, nu) of a flight as they acted: without the noise that their sensors are declared to have.

    Trajectories take them for exact: noise would make delays short, and play in a linkage wide. Where no noise is
    declared nothing tells it from what an autopilot or the motors' controller sent, and all of it acted.
    """
    measured = dataset.flights[name].bridged(controls).mT
    specs = [dataset.control_specs.get(c) or dataset.channel_specs.get(c) for c in controls]  # rotors turn on record
    declared = torch.tensor([(s.noise if s else None) or 0.0 for s in specs], dtype=torch.float64)
    return smoothed(measured, torch.minimum(declared, noise_floor(measured))).mT


def _compared(model: Model, outputs: Tensor, every: int) -> Tensor:
    """Outputs (T, ny) as they count: a multirotor's rates at a quarter of the recorded rate at most.

    Its commands are a rate controller's, which runs faster than most records: what is folded into a record says nothing
    of how the vehicle follows.
    """
    apart = -(-FOLDED // every)
    if model.effect("rotors") is None or apart == 1:
        return outputs
    rates = torch.tensor([name in RATES for name in model.body.outputs])
    skipped = torch.arange(len(outputs)) % apart != 0
    return outputs.masked_fill(skipped[:, None] & rates, math.nan)


def _empty(one: Records, flights: int, samples: int) -> Records:
    """Room for so many flights like this one."""

    def nothing(columns: int) -> Tensor:
        return mapped_arrays.empty(flights, samples, columns).fill_(math.nan)

    controls, outputs, states = (nothing(part.shape[-1]) for part in (one.controls, one.outputs, one.states))
    return Records(one.dt, one.lengths.repeat(flights), one.start.repeat(flights), controls, outputs, states)


def averaged(record: Tensor, every: int) -> Tensor:
    """Means over `every` samples of a record (T, ...), all channels alike; a missing sample counts for nothing."""
    whole = len(record) // every * every
    return record[:whole].unflatten(0, (-1, every)).nanmean(dim=1)
