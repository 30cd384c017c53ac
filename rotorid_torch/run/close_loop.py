"""Closing the loop: identify, trace what the model lacks, add it, identify again, before and after."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import msgspec

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument, enumerated
from rotorid_torch.consistency.sensor_errors.clocks import sensor_findings
from rotorid_torch.core.processes.forks import forked
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.data.velocities.source import with_velocities
from rotorid_torch.effects.families.neural import NeuralForces
from rotorid_torch.effects.registry import of_others
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.errors import InputError
from rotorid_torch.identification.gusts import Weather
from rotorid_torch.learning.accelerations import learn_at_states
from rotorid_torch.learning.network import Learnt
from rotorid_torch.learning.trajectories import learn
from rotorid_torch.model.gusts import without_gust_inputs
from rotorid_torch.model.model import Model
from rotorid_torch.model.modes import gust_response
from rotorid_torch.model.nominal import build
from rotorid_torch.report.records import FitRecord, ParameterRecord, UnknownRecord, VerdictRecord
from rotorid_torch.report.short_horizon import short_horizon
from rotorid_torch.report.summary import failing
from rotorid_torch.report.words.effects import words_of
from rotorid_torch.run.fit_record import fit_record, judge
from rotorid_torch.run.free_runs import before_and_after, score_of
from rotorid_torch.run.loop_record import as_fitted, effect_record, of_sensors
from rotorid_torch.run.output.arguments import refuse_arguments
from rotorid_torch.run.output.checkpoint import Checkpoint, Steps
from rotorid_torch.run.output.folder import run_folder
from rotorid_torch.run.output.monitor import Monitor, peak_memory_mb
from rotorid_torch.run.pipeline import estimated, identified, on_velocities, pictured, refuse, with_remarks
from rotorid_torch.run.result import Run
from rotorid_torch.run.turbulence import (
    in_turbulence,
    smoothed_gusts,
    without_clean_bill,
    without_what_gusts_leave,
)
from rotorid_torch.trace.air import in_moving_air
from rotorid_torch.trace.clean_aircraft import MULTIROTOR, Request, clean_draws
from rotorid_torch.trace.evidence.critical_values import Draws, Null
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.evidence.fits import Flights, refit
from rotorid_torch.trace.loop import Tracing, trace
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.search.decide import Reason, Row
from rotorid_torch.trace.search.eligible import judging
from rotorid_torch.trace.search.forward_selection import of_effects
from rotorid_torch.trace.search.words import finding
from rotorid_torch.trace.stochastic import TURBULENCE, stochastic_findings
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.verdict import statement
from rotorid_torch.validate.rotor_moments import with_moments


@dataclass(frozen=True, eq=False, repr=False)
class Loop(Run):
    """A run whose loop was closed: model and fit are those after, or where nothing was added, those before."""

    tracing: Tracing | None = None


def _refuse_a_single_flight(dataset: Dataset) -> None:
    """Evidence is how well flights are predicted with estimates of other flights; of a multirotor's halves of one."""
    first, *others = (*dataset.identify, *dataset.validate)
    if not others and dataset.kind != MULTIROTOR:
        wrong = f"there is one flight to judge effects by, {first}"
        expected = "two at least in identify and validate: fly another, or cut a long one (rotorid import --split)"
        raise InputError(dataset.file(first), "flights", wrong, expected)


def close_loop(
    dataset: Dataset,
    *,
    out: str | Path | None = None,
    hybrid: bool = False,
    seed: int = 0,
    device: str = "cpu",
    monitor: Monitor | None = None,
    ranks: Ranks = ALONE,
) -> Loop:
    """Identify, find what the model cannot explain, trace it to named effects, add them, identify again.

    Parameters
    ----------
    out : folder of the run; an earlier RUN there is replaced when the new one is whole.
    hybrid : let a small network learn what no named effect explains; it stays where unseen flights gain by it.
    seed : of the clean aircraft, of residuals turned in time (multirotors: shuffled) and of a network's starts.
    ranks : processes that share the work, each of which calls this; the first one alone writes.

    Raises
    ------
    InputError, LostRank : as `identify`.

    Examples
    --------
    >>> import rotorid_torch as rotorid
    >>> loop = rotorid.close_loop(rotorid.load("DATASET"))  # doctest: +SKIP
    >>> print(loop.verdict.sentence)  # doctest: +SKIP
    """
    seed = arguments.seed(Argument("close_loop", "seed"), seed)
    refuse_arguments("close_loop", dataset=dataset, out=out, hybrid=hybrid, device=device)
    refuse_arguments("close_loop", monitor=monitor, ranks=ranks)
    monitor = monitor or Monitor()
    refuse(dataset, of_others(), device)
    _refuse_a_single_flight(dataset)
    ranks.refuse_more_than(len(dataset.identify))
    steps = Steps(monitor, ranks, Checkpoint(), device)
    if out is None or not ranks.first:
        return _closed(dataset, seed, steps, hybrid)[1]
    with run_folder(out, "close-loop") as folder, monitor.recording(folder):
        dataset, run = _closed(dataset, seed, steps, hybrid)
        pictured(run, dataset).write(folder, monitor)
    return run


def _closed(dataset: Dataset, seed: int, steps: Steps, hybrid: bool) -> tuple[Dataset, Loop]:
    """Sensors against each other first, then what acts on the vehicle, on records without the sensors' errors.

    Behind the data set, with the velocities that the models have.
    """
    monitor = steps.monitor
    whole = partial(identified, effects=(), seed=seed)
    recorded = at_one_rate(dataset)
    compared = forked(partial(sensor_findings, recorded))
    dataset, first = on_velocities(dataset, steps, whole)
    with monitor.step("trace"):
        sensors = compared()
    right = at_one_rate(dataset)
    if sensors.effects:
        right = sensors.corrected(recorded)
        right = with_velocities(right) if dataset.derived else right
    for name, value in sensors.values.items():
        monitor.say(f"sensors: {name} = {value:.4g}")
    base = whole(right, steps=steps) if sensors.effects else first
    steps = replace(steps, method=base.estimate.method, why=base.estimate.why)
    if first.estimate.method != base.estimate.method:
        first = whole(dataset, steps=steps)
    with monitor.step("trace"):
        shaken = _shaken(right, base)
    judged, notes = judging(right, base.model.body.states)
    flights = Flights(judged, base.reconstruction)
    with monitor.step("trace"):
        tracing = _traced(base, flights, seed, steps)
    tracing = replace(tracing, notes=(*notes, *tracing.notes))
    if base.estimate.air is None:
        tracing = without_what_gusts_leave(tracing, shaken)
    again = partial(_again, recorded=dataset, steps=steps)
    wrong = partial(again, _Basis(first, at_one_rate(dataset), {}))
    rerun = partial(again, _Basis(base, right, sensors.values))
    before, after, tracing = before_and_after(first, tracing, bool(sensors.effects), wrong, rerun)
    stays = after is not None and set(tracing.structure) <= set(after.spec.effects)
    tracing = tracing if stays else _bare(tracing)
    air = {f.id for f in shaken}
    findings = [*map(of_sensors, sensors.findings), *(f for f in tracing.findings if f.id not in air), *shaken]
    if hybrid:
        learning = partial(_learning, tracing.final, flights, base.regressions.held, seed, monitor)
        richer, learnt = _with_network(tracing.final.spec, learning, after or before, rerun, monitor)
        findings.append(learnt)
        after = richer or after
    if after is not None:
        traced = of_effects(tracing.final.values, tracing.accepted)
        after = replace(after, fit=_with_spread(after.fit, tracing.spread, traced))
    return dataset, _loop(before, after, findings, monitor, tracing)


def _shaken(dataset: Dataset, base: Run) -> list[EffectFinding]:
    """Gusts and vibration in records; of gusts the intensity and length where step 3 found these."""
    findings = stochastic_findings(dataset, base.spec, gust_response(base.model))
    air, why = base.estimate.air, base.estimate.why
    return [in_turbulence(f, air, why) if f.id == TURBULENCE else f for f in findings]


def _traced(base: Run, flights: Flights, seed: int, steps: Steps) -> Tracing:
    """By trajectories over segments, p by clean aircraft; where the air moves, its gusts fed into all of them.

    Of a multirotor by accelerations at measured states.
    """

    def draw(null: Null, effects: Sequence[str], observed: Family) -> Draws | str:
        return clean_draws(Request(flights.dataset, null, effects, seed, steps.monitor.tell, steps.ranks), observed)

    spec, values, air = base.spec, base.model.named_values, base.estimate.air
    if air is not None and not spec.motors:
        spec, flights = in_moving_air(spec, values, flights, Weather.of(air, base.model))
    start = Null(spec, values, base.regressions.held)
    traced = trace(start, flights, draw, steps.monitor.say, seed, steps.ranks)
    null, final = (Null(without_gust_inputs(one.spec), one.values) for one in (traced.null, traced.final))
    return replace(traced, null=null, final=final)


def _learning(final: Null, flights: Flights, held: Sequence[str], seed: int, monitor: Monitor) -> Learnt:
    """A network beside a traced model; of a multirotor by accelerations at measured states."""
    if final.spec.motors:
        spec = msgspec.structs.replace(final.spec, values=dict(final.values))
        return learn_at_states(FittedAtStates.of(spec, flights), seed, monitor.say)
    return learn(refit(final.spec, flights, final.values, held), held, seed, monitor.say)


def _with_network(
    spec: ModelSpec, learning: Callable[[], Learnt], best: Run, rerun: Callable[..., Run], monitor: Monitor
) -> tuple[Run | None, EffectFinding]:
    """The run with a network beside what was traced, and what is told of it; None where it does not stay."""
    why = NeuralForces.untestable(spec)
    if why is not None:
        return None, finding(NeuralForces.id, Row(testable=False), lacking=why)
    with monitor.step("trace"):
        learnt = learning()
    stays = learnt.finding()
    if stays.verdict != "accepted":
        return None, stays
    run = rerun(learnt.spec, learnt.values)
    if spec.motors or score_of(run) < score_of(best):  # a multirotor's runs mean nothing
        return run, stays
    said = "segments of flights that no fit has seen are better described by it, their free runs are not"
    worse = finding(NeuralForces.id, Row(unseen_better=False), said)
    return None, replace(worse, statistic=stays.statistic, critical_value=stays.critical_value)


def _bare(tracing: Tracing) -> Tracing:
    """The tracing without the structure that was traced beside other effects, where that does not stay in the model."""
    said = "it describes the motion that was fitted, but free runs of flights that no fit has seen are worse with it"
    return tracing.without(Reason.UNSEEN_WORSE, dict.fromkeys(tracing.structure, said))


@dataclass(frozen=True, eq=False)
class _Basis:
    """What the steps run on again: a run, and its flights free of the errors of `sensors` that kinematics showed."""

    run: Run
    dataset: Dataset
    sensors: Mapping[str, float]


def _again(basis: _Basis, spec: ModelSpec, values: Mapping[str, float], recorded: Dataset, steps: Steps) -> Run:
    """The steps again for a traced model, from its traced parameters; sensor errors act on the output that is judged.

    recorded : the flights that are judged.
    """
    base, dataset = basis.run, basis.dataset
    traced = {n: v for n, v in values.items() if any(n.startswith(f"{e}.") for e in spec.effects)}
    more = [words_of(e).noun for e in spec.effects if e not in base.spec.effects]
    steps.monitor.tell(f"the model again, {f'with {enumerated(more)}' if more else 'to compare'}")
    spec, model, regressions, estimate = estimated(
        with_moments(msgspec.structs.replace(spec, values=traced)),
        dataset,
        base.reconstruction,
        replace(steps, method=base.estimate.method, why=base.estimate.why),
    )
    clean = model
    if basis.sensors:
        spec, model = _with_sensors(spec, model, basis.sensors)
    with steps.monitor.step("validate"):
        gusts = smoothed_gusts(clean, estimate, dataset, base.reconstruction, steps.ranks)
        judged = judge(model, recorded, steps.ranks, gusts)
    fit = fit_record(model, spec, estimate, judged)
    of_steps = (base.reconstruction, regressions, estimate)
    return with_remarks(Run(model, spec, fit, base.record, *of_steps, judged.overlays, base.of_flights), dataset)


def _with_spread(fit: FitRecord, spread: Mapping[str, float], traced: Mapping[str, float]) -> FitRecord:
    """The fit with standard errors that hold errors of the model too.

    None is smaller than the scatter of a parameter over flights, controls and clean aircraft. The size of a named
    effect differs between the model that it was traced with and the model of the report, which differ in structure and
    care, by an error of its own: se^2 = max(se, scatter)^2 + (value - traced)^2.
    """

    def error(p: ParameterRecord) -> float | None:
        if p.se is None:  # on a bound, or not told by the data
            return None
        other = 0.0 if p.value is None else p.value - traced.get(p.name, p.value)
        return math.hypot(max(p.se, spread.get(p.name, 0.0)), other)

    wider = {*spread, *traced}
    parameters = tuple(msgspec.structs.replace(p, se=error(p)) if p.name in wider else p for p in fit.parameters)
    return msgspec.structs.replace(fit, parameters=parameters)


def _with_sensors(spec: ModelSpec, model: Model, sensors: Mapping[str, float]) -> tuple[ModelSpec, Model]:
    """The model with the sensors' errors on its outputs; those of channels that are no outputs are none of its own."""
    effects = dict.fromkeys(".".join(n.split(".")[:2]) for n in sensors)
    richer = msgspec.structs.replace(spec, effects=(*spec.effects, *effects))
    sensed = {n: v for n, v in sensors.items() if n in build(richer).parameter_set}
    richer = msgspec.structs.replace(richer, values={**spec.values, **sensed})
    sensing = build(richer, model.named_values)
    return richer, sensing


def _loop(
    before: Run, after: Run | None, findings: Sequence[EffectFinding], monitor: Monitor, tracing: Tracing
) -> Loop:
    run = after or before
    missing, poor = tracing.unknown, failing(run.fit)
    if missing is not None and not missing.judged and (not poor or short_horizon(run.fit)):
        missing = None  # any model of other people's aircraft lacks something
    verdict = without_clean_bill(statement([as_fitted(f, run.fit) for f in findings], missing, poor), run.fit)
    record = msgspec.structs.replace(
        run.record,
        command="close-loop",
        time_s=monitor.time_record(),
        peak_memory_mb=peak_memory_mb(),
        before=before.fit,
        after=None if after is None else after.fit,
        verdict=msgspec.convert(verdict, VerdictRecord, from_attributes=True),
        effects=tuple(effect_record(f, run.model, run.fit) for f in findings),
        unknown=None if missing is None else msgspec.convert(missing, UnknownRecord, from_attributes=True),
        warnings=(*run.record.warnings, *tracing.notes),
    )
    fields = {name: getattr(run, name) for name in Run.__dataclass_fields__}
    fields |= {"record": record, "earlier": before.overlays if after else ()}
    return Loop(**fields, tracing=tracing)
