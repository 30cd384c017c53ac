"""Closing the loop: identify, trace what the model lacks, add it, identify again, before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import msgspec

from rotorid_torch.core.names import MOMENTS
from rotorid_torch.core.ranks import ALONE
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.effects.neural import NeuralForces
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.run.checkpoint import Checkpoint, Steps
from rotorid_torch.run.figures import Overlay
from rotorid_torch.run.fit_record import fit_record, judge
from rotorid_torch.run.folder import run_folder
from rotorid_torch.run.monitor import Monitor, peak_memory_mb
from rotorid_torch.run.pipeline import Run, estimated, identified, refuse, write_model
from rotorid_torch.run.records import (
    EffectRecord,
    FitRecord,
    ParameterRecord,
    Report,
    Role,
    UnknownRecord,
    VerdictRecord,
    VisibleRecord,
)
from rotorid_torch.run.write import write_report
from rotorid_torch.trace.clean import clean_floors
from rotorid_torch.trace.finding import Finding, Unknown
from rotorid_torch.trace.fits import Fitted, Flights, refit
from rotorid_torch.trace.kinematic_findings import KinematicFinding
from rotorid_torch.trace.kinematics import kinematic_findings
from rotorid_torch.trace.loop import Tracing, trace
from rotorid_torch.trace.multirotor import Identified, trace_rotors
from rotorid_torch.trace.network import learn
from rotorid_torch.trace.stochastic import stochastic_findings
from rotorid_torch.trace.verdict import Statement, statement


@dataclass(frozen=True, eq=False)
class Loop(Run):
    """A run whose loop was closed: model and fit are those after, or where nothing was added, those before."""

    tracing: Tracing | None = None
    earlier: tuple[Overlay, ...] = field(default=(), repr=False)

    def write(self, folder: Path, monitor: Monitor | None = None) -> None:
        """Write everything but log and TensorBoard records into an open run folder."""
        write_model(self, folder)
        write_report(folder, self.record, self.overlays, monitor, self.earlier)

    @property
    def before(self) -> FitRecord | None:
        """The best model without what was traced."""
        return self.record.before

    @property
    def after(self) -> FitRecord | None:
        """With what was traced; None where nothing was."""
        return self.record.after

    @property
    def verdict(self) -> VerdictRecord | None:
        """The one statement about undeclared effects."""
        return self.record.verdict

    @property
    def effects(self) -> tuple[EffectRecord, ...]:
        """What was found about every effect."""
        return self.record.effects


def close_loop(
    dataset: Dataset,
    *,
    out: str | Path | None = None,
    hybrid: bool = False,
    seed: int = 0,
    device: str = "cpu",
    monitor: Monitor | None = None,
) -> Loop:
    """Identify, find what the model cannot explain, trace it to named effects, add them, identify again.

    Parameters
    ----------
    out : folder of the run; an earlier RUN there is replaced when the new one is whole.
    hybrid : let a small network learn what no named effect explains; it stays where unseen flights gain by it.
    seed : of the drawn clean aircraft and the shuffled residuals.

    Raises
    ------
    InputError : as `identify`.
    """
    monitor = monitor or Monitor()
    refuse(dataset, (), device)
    with ExitStack() as stack:
        folder = None
        if out is not None:
            folder = stack.enter_context(run_folder(out))
            stack.enter_context(monitor.recording(folder))
        run = _closed(dataset, seed, device, monitor, hybrid)
        if folder is not None:
            run.write(folder, monitor)
    return run


def _closed(dataset: Dataset, seed: int, device: str, monitor: Monitor, hybrid: bool) -> Loop:
    """Sensors against each other first, then what acts on the vehicle, on records without the sensors' errors."""
    steps = Steps(monitor, ALONE, Checkpoint(), device)
    first = identified(dataset, (), seed, steps)
    with monitor.step("trace"):
        sensors = kinematic_findings(at_one_rate(dataset))
    right = sensors.corrected(at_one_rate(dataset))
    for name, value in sensors.values.items():
        monitor.say(f"sensors: {name} = {value:.4g}")
    base = identified(right, (), seed, steps) if sensors.effects else first
    flights = Flights(right, base.reconstruction)
    with monitor.step("trace"):
        tracing = (_rotors_traced if base.spec.motors else _traced)(base, flights, seed, monitor)
        shaken = stochastic_findings(right, base.spec, base.model.named_values)
    again = partial(_again, dataset=dataset, steps=steps)
    wrong, named = sensors.values, bool(tracing.accepted or sensors.effects)
    before, after, plain = first, None, _without(tracing.final.spec, tracing.structure)
    if tracing.structure and named:
        null = again(first, tracing.null.spec, tracing.null.values, seen=at_one_rate(dataset), sensors={})
        before = _best([first, null])
    if tracing.structure or named:
        shapes = [tracing.final.spec, *([plain] if tracing.structure and named else [])]
        tried = [again(base, shape, tracing.final.values, seen=right, sensors=wrong) for shape in shapes]
        after = tried[0] if base.spec.motors else _best(tried if named else [first, *tried])
        after = None if after is first else replace(after, fit=_with_spread(after.fit, tracing.spread))
    stays = after is not None and set(tracing.structure) <= set(after.spec.effects)
    traced = tracing.findings if stays else _dropped(tracing)
    findings = (*map(_of_sensors, sensors.findings), *_replaced(traced, shaken))
    if hybrid:
        shape = tracing.final.spec if stays or not tracing.structure else plain
        held = base.regressions.held
        refitted = partial(refit, shape, flights, tracing.final.values, held)
        rerun = partial(again, base, seen=right, sensors=wrong)
        richer, learnt = _with_network(shape, refitted, held, after or before, rerun, seed, monitor)
        findings = (*findings, learnt)
        if richer is not None:
            after = replace(richer, fit=_with_spread(richer.fit, tracing.spread))
    told = statement(findings, tracing.unknown)
    return _loop(after or before, before, after, findings, told, tracing.unknown, monitor, tracing)


def _traced(base: Run, flights: Flights, seed: int, monitor: Monitor) -> Tracing:
    """By trajectories over segments, floors from clean aircraft."""
    return trace(
        base.spec,
        base.model.named_values,
        base.regressions.held,
        flights,
        lambda spec, effects: clean_floors(flights.dataset, spec, effects, seed, monitor.say),
        monitor.say,
        seed,
    )


def _rotors_traced(base: Run, flights: Flights, seed: int, monitor: Monitor) -> Tracing:
    """By accelerations at measured states, each candidate identified in full."""
    quiet = Steps(Monitor(), ALONE, Checkpoint())
    told = [f"rotors.{kind}.{row}" for kind in ("power", "trim") for row in MOMENTS]
    free, values = ({n: v for n, v in known.items() if n not in told} for known in (base.spec.free, base.spec.values))

    def fit(spec: ModelSpec) -> Identified:
        _, model, _, found = estimated(spec, flights.dataset, flights.reconstruction, quiet)
        errors = dict(zip(found.names, found.fit.uncertainty.standard_errors.tolist(), strict=True))
        return Identified(spec, model, errors)

    open_spec = msgspec.structs.replace(
        base.spec, free=free, values=values
    )  # what could not be told may be with an effect
    return trace_rotors(open_spec, flights.dataset, fit, monitor.say, seed)


def _with_network(
    spec: ModelSpec,
    refitted: Callable[[], Fitted],
    held: Sequence[str],
    best: Run,
    rerun: Callable[..., Run],
    seed: int,
    monitor: Monitor,
) -> tuple[Run | None, Finding]:
    """The run with a network beside what was traced, and what is told of it; None where it does not stay."""
    why = NeuralForces.untestable(spec)
    if why is not None:
        return None, Finding(NeuralForces.id, "learnt", "not testable", why)
    with monitor.step("trace"):
        learnt = learn(refitted(), held, seed, monitor.say)
    found = learnt.finding()
    if found.verdict != "accepted":
        return None, found
    run = rerun(learnt.fitted.spec, learnt.fitted.values)
    if _best([best, run]) is run:
        return run, found
    said = "segments of flights that no fit has seen are better described by it, their free runs are not"
    return None, replace(found, verdict="rejected", reason=said)


def _best(runs: Sequence[Run]) -> Run:
    """The run that describes best the flights which no fit has seen; without any, the last."""
    return min(reversed(runs), key=lambda run: run.scores["validate"] or 0.0)


def _without(spec: ModelSpec, effects: Sequence[str]) -> ModelSpec:
    """The spec without these effects."""
    return msgspec.structs.replace(spec, effects=tuple(e for e in spec.effects if e not in effects))


def _dropped(tracing: Tracing) -> list[Finding]:
    """Findings where the structure that was traced beside other effects does not stay in the model."""
    said = "it describes the motion that was fitted, but free runs of flights that no fit has seen are no better by it"
    return [replace(f, verdict="rejected", reason=said) if f.id in tracing.structure else f for f in tracing.findings]


def _of_sensors(found: KinematicFinding) -> Finding:
    """A kinematic finding as one of the loop; its gain is in squares of the noise."""
    values = {p.name: (p.value, p.se) for p in found.parameters if p.accepted}
    return Finding(
        found.id,
        "undeclared",
        found.verdict,
        found.reason,
        found.gain,
        found.floor,
        found.smallest_visible,
        found.group,
        values,
    )


def _replaced(findings: Sequence[Finding], others: Sequence[Finding]) -> list[Finding]:
    """Findings with those of the same ids replaced."""
    ids = {f.id for f in others}
    return [*(f for f in findings if f.id not in ids), *others]


def _again(
    base: Run,
    spec: ModelSpec,
    values: Mapping[str, float],
    dataset: Dataset,
    seen: Dataset,
    steps: Steps,
    sensors: Mapping[str, float],
) -> Run:
    """The steps again for a traced model, from its traced parameters; sensor errors act on the output that is judged.

    dataset : judged, as recorded. seen : what the steps run on, free of the errors `sensors` that kinematics found.
    """
    traced = {n: v for n, v in values.items() if any(n.startswith(f"{e}.") for e in spec.effects)}
    spec, model, regressions, found = estimated(
        msgspec.structs.replace(spec, values=traced), seen, base.reconstruction, steps
    )
    if sensors:
        spec, model = _with_sensors(spec, model, sensors)
    with steps.monitor.step("validate"):
        judged = judge(model, dataset)
    fit = fit_record(model, spec, found, judged)
    return replace(
        base, model=model, spec=spec, fit=fit, regressions=regressions, estimate=found, overlays=judged.overlays
    )


def _with_spread(fit: FitRecord, spread: Mapping[str, float]) -> FitRecord:
    """The fit with standard errors no smaller than the scatter of a parameter from flight to flight."""
    parameters = tuple(
        msgspec.structs.replace(p, se=max(p.se or 0.0, spread[p.name])) if p.name in spread else p
        for p in fit.parameters
    )
    return msgspec.structs.replace(fit, parameters=parameters)


def _with_sensors(spec: ModelSpec, model: Model, sensors: Mapping[str, float]) -> tuple[ModelSpec, Model]:
    """The model with the sensors' errors on its outputs."""
    effects = dict.fromkeys(".".join(n.split(".")[:2]) for n in sensors)
    richer = msgspec.structs.replace(spec, effects=(*spec.effects, *effects), values={**spec.values, **sensors})
    sensing = build(richer)
    sensing.start_from(model.named_values)
    return richer, sensing


def _loop(
    run: Run,
    before: Run,
    after: Run | None,
    findings: Sequence[Finding],
    told: Statement,
    unknown: Unknown | None,
    monitor: Monitor,
    tracing: Tracing,
) -> Loop:
    record = Report(
        command="close-loop",
        dataset=run.record.dataset,
        seed=run.record.seed,
        time_s=monitor.time_record(),
        peak_memory_mb=peak_memory_mb(),
        before=before.fit,
        after=None if after is None else after.fit,
        verdict=VerdictRecord(kind=told.kind, effects=told.effects, sentence=told.sentence),
        effects=tuple(effect_record(f, run.model, after) for f in findings),
        unknown=None if unknown is None else UnknownRecord(**vars(unknown)),
        warnings=(*run.record.warnings, *tracing.notes),
    )
    fields = {name: getattr(run, name) for name in Run.__dataclass_fields__}
    return Loop(**{**fields, "record": record}, tracing=tracing, earlier=before.overlays if after else ())


def effect_record(finding: Finding, model: Model, after: Run | None) -> EffectRecord:
    """A finding for the report; parameters are those of the fit after, where that estimated them."""
    own = f"{finding.id}."
    fitted = [p for p in after.fit.parameters if p.name.startswith(own) and p.se] if after else []
    traced = [
        ParameterRecord(name=n, value=v, se=e, unit=_unit(model, n), status="free" if e > 0.0 else "frozen")
        for n, (v, e) in finding.values.items()
    ]
    visible = finding.smallest_visible
    return EffectRecord(
        id=finding.id,
        role=msgspec.convert(finding.role, Role),  # pyright: ignore[reportArgumentType]
        verdict=finding.verdict,
        reason=finding.reason,
        gain=finding.gain,
        floor=finding.floor,
        smallest_visible=None if visible is None else VisibleRecord(value=visible[0], unit=visible[1]),
        group=finding.group,
        parameters=tuple(fitted or traced),
    )


def _unit(model: Model, name: str) -> str:
    return next((p.unit for p in model.parameter_set.parameters if p.name == name), "")
