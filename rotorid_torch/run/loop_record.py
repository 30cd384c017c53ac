"""What a closed loop found, as records for the report."""

from __future__ import annotations

from dataclasses import replace

import msgspec

from rotorid_torch.model.model import Model
from rotorid_torch.report.records import EffectRecord, ParameterRecord, Role, UnknownRecord, VisibleRecord
from rotorid_torch.run.result import Run
from rotorid_torch.trace.finding import Finding, Unknown
from rotorid_torch.trace.kinematic_findings import KinematicFinding


def of_sensors(error: KinematicFinding) -> Finding:
    """A kinematic finding as one of the loop; its gain is in squares of the noise."""
    values = {p.name: (p.value, p.se) for p in error.parameters if p.accepted}
    return Finding(
        error.id,
        "undeclared",
        error.verdict,
        error.reason,
        error.gain,
        error.floor,
        error.smallest_visible,
        error.group,
        values,
    )


def as_fitted(finding: Finding, run: Run) -> Finding:
    """The finding with the values of the fit that is told, where that estimated them: sentence and tables agree."""
    values = {p.name: (p.value, p.se) for p in _fitted(finding, run) if p.value is not None and p.se is not None}
    return replace(finding, values=values) if values else finding


def unknown_record(missing: Unknown) -> UnknownRecord:
    """What stays without a name, for the report."""
    return UnknownRecord(**{name: getattr(missing, name) for name in UnknownRecord.__struct_fields__})


def effect_record(finding: Finding, model: Model, run: Run) -> EffectRecord:
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
        gain=finding.gain,
        floor=finding.floor,
        p=finding.p,
        smallest_visible=None if visible is None else VisibleRecord(value=visible[0], unit=visible[1]),
        group=finding.group,
        parameters=tuple(_fitted(finding, run) or traced),
    )


def _fitted(finding: Finding, run: Run) -> list[ParameterRecord]:
    """Sizes of the effect that a fit estimated."""
    prefix = f"{finding.part or finding.id}."
    return [p for p in run.fit.parameters if p.name.startswith(prefix) and p.se and p.status != "nuisance"]


def _unit(model: Model, name: str) -> str:
    return next((p.unit for p in model.parameter_set.parameters if p.name == name), "")
