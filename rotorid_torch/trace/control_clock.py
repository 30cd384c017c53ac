"""Controls recorded late, beside what kinematics says of the other sensors: one verdict on all clocks."""

from __future__ import annotations

import math
from dataclasses import replace

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.late_controls import SURE_STICKS, LateControls, late_controls
from rotorid_torch.trace.kinematic_findings import KinematicFinding, KinematicFindings, SensorParameter
from rotorid_torch.trace.kinematics import kinematic_findings

CLOCKS = "sensors.delay"


def sensor_findings(dataset: Dataset) -> KinematicFindings:
    """Errors of the sensors from kinematics, and whether the record of the controls is late against the response.

    The second is looked for in records without the first: rates that are early by their attitude come before their
    controls too. Only controls after the response are an error of a record; a response that comes later is physics,
    and left to `control.delay`, `control.lag` and the like.
    """
    found = kinematic_findings(dataset)
    late = late_controls(found.corrected(dataset))
    if late is None:
        return found
    return replace(found, findings=tuple(_joined(one, late) if one.id == CLOCKS else one for one in found.findings))


def _joined(found: KinematicFinding, late: LateControls) -> KinematicFinding:
    """The verdict on clocks with that of the controls' record."""
    gain, floor = (late.seconds / late.se) ** 2 if late.se > 0.0 else math.inf, SURE_STICKS**2
    name, visible = f"{CLOCKS}.controls", SURE_STICKS * late.se
    own = SensorParameter(name, late.seconds, late.se, "s", accepted=True, gain=gain, smallest_visible=visible)
    others = any(p.accepted for p in found.parameters)
    said = (
        f"controls at least {late.seconds * 1e3:.0f} ms late (± {late.se * 1e3:.1f}): {late.clearest} comes first,"
        " which no vehicle does; its own lag comes on top and cannot be told from these streams"
    )
    return KinematicFinding(
        id=CLOCKS,
        verdict=found.verdict if others else "accepted",
        reason=f"{found.reason}; {said}" if others else said,
        gain=max(found.gain, gain) if others else gain,
        floor=found.floor if others else floor,
        parameters=(*found.parameters, own),
        smallest_visible=found.smallest_visible or (visible, "s"),
        group=found.group if others else (),
    )
