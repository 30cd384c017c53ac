"""Flights packed for the plots that readers zoom: numbers of 16 bits in base64, as many points as a page can hold."""

import base64
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor

from rotorid_torch.core import names
from rotorid_torch.report.overlay import Overlay

BYTES = 1_300_000
"""Of all flights in the page, at most."""
POINTS = (60, 900)
"""Of one line: never fewer, never more."""
BAND_EVERY = 8
"""Points of a line from one point of its band to the next; bands are smooth."""
MISSING = 65535
GROUPS = {
    "rates": names.RATES,
    "velocities": names.VELOCITIES,
    "attitude": names.ATTITUDES,
    "angular accelerations": ("pdot", "qdot", "rdot"),
    "specific forces": names.SPECIFIC_FORCES,
    "rotor": (*names.FLAPPING, "omega", "torque"),
}


def packed(before: Sequence[Overlay], after: Sequence[Overlay]) -> dict[str, Any]:
    """All flights as the page's script takes them.

    "flights": name, list, first time, step, "controls" and "channels" by name; a channel holds "m" measured, "a" the
    model, "b" the model before (where it differs), "s" the standard deviation of the model, each packed by itself.
    "channels": unit, meaning and noise of each. "groups": channels that are looked at together.
    """
    earlier = {overlay.flight: overlay for overlay in before}
    lines = sum(len(o.controls) + len(o.common(list(o.measured))) * (3 if before else 2) for o in after)
    points = int(np.clip(BYTES / (2.7 * max(lines, 1)), *POINTS))
    flights = [_flight(o, earlier.get(o.flight), points) for o in after if len(o.time) > 1]
    used = list(dict.fromkeys(c for flight in flights for c in flight["channels"]))
    grouped = {group: [c for c in channels if c in used] for group, channels in GROUPS.items()}
    others = [c for c in used if not any(c in channels for channels in grouped.values())]
    grouped["others"] = others
    noise = {c: sigma for o in after for c, sigma in o.noise.items() if math.isfinite(sigma)}
    units = {c: unit for o in after for c, unit in o.units.items()}
    return {
        "flights": flights,
        "groups": {group: channels for group, channels in grouped.items() if channels},
        "channels": {c: {"unit": names.unit(c), "about": names.about(c), "noise": noise.get(c, 0.0)} for c in used},
        "controls": {c: {"unit": unit, "about": names.about(c)} for c, unit in units.items()},
        "integrated": all(o.integrated for o in after),
    }


def _flight(overlay: Overlay, other: Overlay | None, points: int) -> dict[str, Any]:
    step = max(1, math.ceil(len(overlay.time) / points))
    channels = {}
    for name in overlay.common(list(overlay.measured)):
        record = {"m": _packed(overlay.measured[name][::step]), "a": _packed(overlay.model[name][::step])}
        if other is not None and name in other.model and len(other.model[name]) == len(overlay.time):
            record["b"] = _packed(other.model[name][::step])
        if name in overlay.band:
            record["s"] = _packed(overlay.band[name][:: step * BAND_EVERY])
        channels[name] = record
    return {
        "name": overlay.flight,
        "list": overlay.list,
        "t0": float(overlay.time[0]),
        "dt": step * float(overlay.time[1] - overlay.time[0]),
        "n": len(overlay.time[::step]),
        "controls": {name: _packed(values[::step]) for name, values in overlay.controls.items()},
        "channels": channels,
    }


def _packed(values: Tensor) -> list[Any]:
    """Smallest value, size of one step, and base64 of 16-bit steps from there, little-endian; 65535 is a gap."""
    numbers = values.numpy().astype(np.float64)
    finite = np.isfinite(numbers)
    low, high = (float(numbers[finite].min()), float(numbers[finite].max())) if finite.any() else (0.0, 0.0)
    unit = (high - low) / (MISSING - 1) or 1.0
    steps = np.full(len(numbers), MISSING, dtype="<u2")
    steps[finite] = np.round((numbers[finite] - low) / unit)
    return [float(f"{low:.8g}"), float(f"{unit:.8g}"), base64.b64encode(steps.tobytes()).decode()]
