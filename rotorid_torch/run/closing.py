"""Closing the loop: identify, trace what the model lacks, add it, identify again, before and after."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from rotorid_torch.core.ranks import ALONE
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.model.model import Model
from rotorid_torch.run.checkpoint import Checkpoint, Steps
from rotorid_torch.run.fit_record import fit_record, judge
from rotorid_torch.run.folder import run_folder
from rotorid_torch.run.monitor import Monitor, peak_memory_mb
from rotorid_torch.run.pipeline import Run, estimated, identified, refuse
from rotorid_torch.run.records import (
    EffectRecord,
    FitRecord,
    ParameterRecord,
    Report,
    UnknownRecord,
    VerdictRecord,
    VisibleRecord,
)
from rotorid_torch.trace.clean import clean_floors
from rotorid_torch.trace.finding import Finding, Unknown
from rotorid_torch.trace.fits import Fitted, Flights
from rotorid_torch.trace.loop import Tracing, trace
from rotorid_torch.trace.verdict import Statement, statement


@dataclass(frozen=True, eq=False)
class Loop(Run):
    """A run whose loop was closed: model and fit are those after, or where nothing was added, those before."""

    tracing: Tracing | None = None

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
    hybrid : let a small network learn what no named effect explains.
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
        run = _closed(dataset, seed, monitor)
        if folder is not None:
            run.write(folder, monitor)
    return run


def _closed(dataset: Dataset, seed: int, monitor: Monitor) -> Loop:
    steps = Steps(monitor, ALONE, Checkpoint())
    first = identified(dataset, (), seed, steps)
    flights = Flights(at_one_rate(dataset), first.reconstruction)
    with monitor.step("trace"):
        tracing = trace(
            first.spec,
            dict(zip(first.model.parameter_set.names, first.model.theta.detach().tolist(), strict=True)),
            first.regressions.held,
            flights,
            lambda spec, effects: clean_floors(flights.dataset, spec, effects, seed, monitor.say),
            monitor.say,
        )
    told = statement(tracing.findings, None)
    added = (*tracing.structure, *tracing.accepted)
    if not added:
        return _loop(first, first.fit, None, tracing, told, None, monitor)
    before = first if not (tracing.structure and tracing.accepted) else _again(first, tracing.null, dataset, steps)
    after = _again(first, tracing.final, dataset, steps)
    return _loop(after, before.fit, after.fit, tracing, told, None, monitor)


def _again(first: Run, fitted: Fitted, dataset: Dataset, steps: Steps) -> Run:
    """The steps again for a traced model, from its traced parameters."""
    traced = {n: v for n, v in fitted.values.items() if any(n.startswith(f"{e}.") for e in fitted.spec.effects)}
    spec = msgspec.structs.replace(fitted.spec, values=traced)
    seen = at_one_rate(dataset)
    spec, model, regressions, found = estimated(spec, seen, first.reconstruction, steps)
    with steps.monitor.step("validate"):
        judged = judge(model, dataset)
    fit = fit_record(model, spec, found, judged)
    return replace(
        first, model=model, spec=spec, fit=fit, regressions=regressions, estimate=found, overlays=judged.overlays
    )


def _loop(
    run: Run,
    before: FitRecord,
    after: FitRecord | None,
    tracing: Tracing,
    told: Statement,
    unknown: Unknown | None,
    monitor: Monitor,
) -> Loop:
    record = Report(
        command="close-loop",
        dataset=run.record.dataset,
        seed=run.record.seed,
        time_s=monitor.time_record(),
        peak_memory_mb=peak_memory_mb(),
        before=before,
        after=after,
        verdict=VerdictRecord(kind=told.kind, effects=told.effects, sentence=told.sentence),
        effects=tuple(effect_record(f, run.model, after) for f in tracing.findings),
        unknown=None if unknown is None else UnknownRecord(**vars(unknown)),
        warnings=(*run.record.warnings, *tracing.notes),
    )
    fields = {name: getattr(run, name) for name in Run.__dataclass_fields__}
    return Loop(**{**fields, "record": record}, tracing=tracing)


def effect_record(finding: Finding, model: Model, after: FitRecord | None) -> EffectRecord:
    """A finding for the report; parameters are those of the fit after, where the effect is in it."""
    fitted = [p for p in after.parameters if p.name.startswith(f"{finding.id}.")] if after else []
    traced = [
        ParameterRecord(name=n, value=v, se=e, unit=_unit(model, n), status="free" if e > 0.0 else "frozen")
        for n, (v, e) in finding.values.items()
    ]
    visible = finding.smallest_visible
    return EffectRecord(
        id=finding.id,
        role=finding.role,
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
