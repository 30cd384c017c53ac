"""What a closed loop found, as records for the report."""

from __future__ import annotations

from dataclasses import replace

import msgspec

from rotorid_torch.model.model import Model
from rotorid_torch.run.pipeline import Run
from rotorid_torch.run.records import EffectRecord, ParameterRecord, Role, UnknownRecord, VisibleRecord
from rotorid_torch.trace.finding import Finding, Unknown
from rotorid_torch.trace.kinematic_findings import KinematicFinding


def of_sensors(found: KinematicFinding) -> Finding:
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


def as_fitted(finding: Finding, after: Run | None) -> Finding:
    """The finding with the values of the fit after, where that estimated them: sentence and tables say the same."""
    values = {p.name: (p.value, p.se) for p in _fitted(finding, after) if p.value is not None and p.se is not None}
    return replace(finding, values=values) if values else finding


def unknown_record(missing: Unknown) -> UnknownRecord:
    """What stays without a name, for the report."""
    return UnknownRecord(**{name: getattr(missing, name) for name in UnknownRecord.__struct_fields__})


def effect_record(finding: Finding, model: Model, after: Run | None, before: Run | None = None) -> EffectRecord:
    """A finding for the report; parameters are those of the fit after, where that estimated them.

    Of what the model has from the start they are those of the fit before, where nothing was added.
    """
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
        parameters=tuple(_fitted(finding, (after or before) if finding.part else after) or traced),
    )


def _fitted(finding: Finding, after: Run | None) -> list[ParameterRecord]:
    """Sizes of the effect that a fit estimated."""
    known, own = after.fit.parameters if after else (), f"{finding.part or finding.id}."
    return [p for p in known if p.name.startswith(own) and p.se and p.status != "nuisance"]


def _unit(model: Model, name: str) -> str:
    return next((p.unit for p in model.parameter_set.parameters if p.name == name), "")
