"""What tracing found, as records for the report: of a closed loop, and of effects that `identify` was asked for."""

from collections.abc import Sequence
from dataclasses import replace

import msgspec

from rotorid_torch.consistency.sensor_errors.sensor_finding import KinematicFinding
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.examples import example
from rotorid_torch.effects.registry import registered
from rotorid_torch.model.model import Model
from rotorid_torch.report.records import EffectRecord, FitRecord, ParameterRecord, Role, VisibleRecord
from rotorid_torch.run.result import Run
from rotorid_torch.trace.evidence.fits import Flights, refit
from rotorid_torch.trace.measured.accelerations import MeasuredAccelerations
from rotorid_torch.trace.search.eligible import untried
from rotorid_torch.trace.search.requested import earned
from rotorid_torch.trace.search.trajectories import Trajectories
from rotorid_torch.trace.terms.finding import EffectFinding


def of_sensors(error: KinematicFinding) -> EffectFinding:
    """A kinematic finding as one of the loop; its statistic is in squares of the noise."""
    values = {p.name: (p.value, p.se) for p in error.parameters if p.accepted}
    return EffectFinding(
        error.id,
        "undeclared",
        error.verdict,
        error.reason,
        error.statistic,
        error.critical_value,
        error.smallest_visible,
        error.group,
        values,
        units={p.name: p.unit for p in error.parameters},
    )


def as_fitted(finding: EffectFinding, fit: FitRecord) -> EffectFinding:
    """The finding with the values of the fit that is told, where that estimated them: sentence and tables agree."""
    fitted = [p for p in _fitted(finding, fit) if p.value is not None and p.se is not None]
    values = {p.name: (p.value, p.se) for p in fitted if p.value is not None and p.se is not None}
    return replace(finding, values=values, units={p.name: p.unit for p in fitted}) if values else finding


def effect_record(finding: EffectFinding, model: Model, fit: FitRecord) -> EffectRecord:
    """A finding for the report; parameters are those of the fit that is told, where that estimated them."""
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
        gain=finding.statistic,
        floor=finding.critical_value,
        p=finding.p,
        smallest_visible=None if visible is None else VisibleRecord(value=visible[0], unit=visible[1]),
        group=finding.group,
        parameters=tuple(_fitted(finding, fit) or traced),
    )


def _fitted(finding: EffectFinding, fit: FitRecord) -> list[ParameterRecord]:
    """Sizes of the effect that a fit estimated."""
    prefix = f"{finding.part or finding.id}."
    return [p for p in fit.parameters if p.name.startswith(prefix) and p.se and p.status != "nuisance"]


def _unit(model: Model, name: str) -> str:
    """Unit of a parameter of the model, or of the library's effects where the model has none of the name."""
    declared = {p.name: p.unit for p in model.parameter_set.parameters}
    effect = next((e for e in registered() if name.startswith(f"{e}.")), None)
    if name in declared or effect is None:
        return declared.get(name, "")
    parameters = registered()[effect].from_spec(example(registered()[effect])).declared
    return next((p.unit for p in parameters if name == f"{effect}.{p.name}"), "")


def with_evidence(run: Run, dataset: Dataset, effects: Sequence[str], seed: int) -> Run:
    """The run with a record of each effect that was asked for.

    dataset : as the steps saw it. seed : of the residuals that say what chance explains.
    """
    flights, held = Flights(dataset, run.reconstruction), run.regressions.held
    if run.spec.motors:
        shared = MeasuredAccelerations(flights)
        findings = earned(shared, shared.fitted(run.spec), effects, seed)
    else:
        whole = refit(run.spec, flights, run.model.named_values, held)
        findings = earned(Trajectories(flights, tuple(held)), whole, effects, seed)
    record = msgspec.structs.replace(
        run.record,
        effects=tuple(effect_record(f, run.model, run.fit) for f in findings),
        warnings=(*run.record.warnings, *untried(dataset)),
    )
    return replace(run, record=record)
