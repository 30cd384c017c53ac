"""All clocks in one verdict: the sensors' by kinematics, velocities without accelerometers, and the controls."""

import math
from dataclasses import replace

from rotorid_torch.consistency.conventions import convention, in_usual_convention
from rotorid_torch.consistency.pairs.late_controls import SURE_STICKS, LateControls, late_controls
from rotorid_torch.consistency.pairs.velocity_clock import IMITATED_S, VelocityClock, velocity_clock
from rotorid_torch.consistency.sensor_errors.kinematic_findings import kinematic_findings
from rotorid_torch.consistency.sensor_errors.sensor_finding import KinematicFinding, KinematicFindings, SensorParameter
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.families.airframe import Drag
from rotorid_torch.effects.families.sensors import SensorDelay

CLOCKS = SensorDelay.id
VELOCITIES, CONTROLS = f"{CLOCKS}.velocities", f"{CLOCKS}.controls"


def sensor_findings(dataset: Dataset) -> KinematicFindings:
    """Errors of the sensors from kinematics, the velocities' clock without accelerometers, and that of the controls.

    Each is looked for in records without those before: rates that are early by their attitude come before their
    controls too. Only controls after the response are an error of a record; a response that comes later is physics,
    and left to `control.delay`, `control.lag` and the like. Angles and rates are taken as they are written.
    """
    dataset = in_usual_convention(dataset, convention(dataset))
    findings = kinematic_findings(dataset)
    moved = None if VELOCITIES in findings.values else velocity_clock(findings.corrected(dataset))
    if moved is not None:
        findings = _with(findings, _of_velocities(findings[CLOCKS], moved))
    late = late_controls(findings.corrected(dataset))
    return findings if late is None else _with(findings, _of_controls(findings[CLOCKS], late))


def _with(findings: KinematicFindings, clocks: KinematicFinding) -> KinematicFindings:
    return replace(findings, findings=tuple(clocks if one.id == CLOCKS else one for one in findings.findings))


def _of_velocities(clocks: KinematicFinding, clock: VelocityClock) -> KinematicFinding:
    """The verdict on clocks with the velocities' shift, which drag by speed can stand for in part."""
    visible = IMITATED_S + SURE_STICKS * clock.se
    time_shift = SensorParameter(
        VELOCITIES, clock.seconds, clock.se, "s", True, (clock.seconds / clock.se) ** 2, visible
    )
    u, v = (f"{k:.2f} ± {e:.2f}" for k, e in zip(clock.drag, clock.drag_se, strict=True))
    none, drag, shift, both = clock.r2
    said = (
        f"u and v {abs(clock.seconds) * 1e3:.0f} ms {'late' if clock.seconds > 0 else 'early'} (± {clock.se * 1e3:.0f})"
        f" against attitude and rates, beside drag by speed of {u} and {v} 1/s, which the derivatives hold: R² of du/dt"
        f" and dv/dt is {none:.2f} with neither, {drag:.2f} with drag, {shift:.2f} with the shift, {both:.2f} with"
        " both; without accelerometers what pushed the aircraft is not known, so the two partly stand for each other"
    )
    joined = _joined(clocks, time_shift, said)
    if any(p.accepted for p in clocks.parameters):
        return joined  # other clocks are certain; the words tell what this one is worth
    return replace(joined, verdict="indistinguishable", group=(*clocks.group, Drag.id))


def _of_controls(clocks: KinematicFinding, late: LateControls) -> KinematicFinding:
    """The verdict on clocks with that of the controls' record."""
    statistic = (late.seconds / late.se) ** 2 if late.se > 0.0 else math.inf
    shift = SensorParameter(CONTROLS, late.seconds, late.se, "s", True, statistic, SURE_STICKS * late.se)
    said = (
        f"controls at least {late.seconds * 1e3:.0f} ms late (± {late.se * 1e3:.1f}): {late.clearest} comes first,"
        " which no vehicle does; its own lag comes on top and cannot be told from these streams"
    )
    return replace(_joined(clocks, shift, said), verdict="accepted", group=())  # nothing stands for it


def _joined(clocks: KinematicFinding, shift: SensorParameter, said: str) -> KinematicFinding:
    """The finding with one more accepted parameter, in the place of one of that name."""
    others = any(p.accepted for p in clocks.parameters)
    return KinematicFinding(
        id=CLOCKS,
        verdict=clocks.verdict if others else "accepted",
        reason=f"{clocks.reason}; {said}" if others else said,
        statistic=max(clocks.statistic, shift.statistic) if others else shift.statistic,
        critical_value=clocks.critical_value if others else SURE_STICKS**2,
        parameters=(*(p for p in clocks.parameters if p.name != shift.name), shift),
        smallest_visible=clocks.smallest_visible or (shift.smallest_visible, "s"),
        group=clocks.group if others else (),
    )
