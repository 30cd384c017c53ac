"""What the channels and declarations of a data set cannot tell: named, with what it means for the model."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rotorid_torch.core.names import ATTITUDES, FLAPPING, MOMENTS, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.structure import have, sticks_alone
from rotorid_torch.model.rotors import beyond_belief
from rotorid_torch.report.records import FitRecord

AXES = dict(zip(MOMENTS, ("x", "y", "z"), strict=True))
AGREES = 0.15
"""Relative difference from the declared control power that is not worth a sentence."""
SLOWER = 4.0
"""Times by which a disc that tilts more slowly than it cones is worth a sentence; one Lock number makes it 2 to 3.5."""
SURE = 2.0
"""Standard errors by which it must be so."""
CYCLIC = {"a1": "lon", "b1": "lat"}


def of_channels(dataset: Dataset, spec: ModelSpec) -> Iterator[str]:
    """States and physics that no channel shows, and channels that are therefore not scored."""
    if "u" not in spec.states:
        missing = [c for c in (*VELOCITIES, *ATTITUDES[:2]) if not have(dataset, (c,))]
        slow = "speed derivatives, drag and the slow modes stay unknown"
        yield f"{', '.join(missing)} not measured in every identify flight: u v w are no states; {slow}"
    elif "airspeed" not in dataset.facts[dataset.identify[0]].channels:
        yield "u v w are over ground and there is no airspeed: a wind is part of what goes with them, and of the trims"
    if "phi" not in spec.states:
        yield "phi and theta are not measured: gravity is not in the model, rates and specific forces are judged alone"
    left = [c for c in dataset.scored() if c not in spec.outputs]
    if left:
        yield f"{', '.join(left)} measured, but not all that they need beside them: left out and not scored"
    if dataset.kind == "helicopter":
        yield from _of_helicopter(dataset, spec)
    elif not spec.motors:
        yield "the motors' places are not declared ([[vehicle.motors]]): each command has free derivatives instead"
    elif "Z" not in spec.patterns:
        yield "neither az nor w is measured: the thrust curve is held at hover balance, control powers carry its error"


def _of_helicopter(dataset: Dataset, spec: ModelSpec) -> Iterator[str]:
    if (
        "u" in spec.states
        and spec.flapping == "none"
        and not all(dataset.facts[f].has(*FLAPPING) for f in dataset.identify)
    ):
        yield "no flapping measured: the rotor's motion is implicit, its lag is part of damping and control derivatives"
    sticks = [c for c in dataset.controls if spec.control_units.get(c) == "norm"]
    if sticks:
        yield (
            f"{', '.join(sticks)}: sticks in units of full travel, not blade angles; control derivatives hold linkage,"
            " mixer and any stabilisation in between"
            + ("; moments have derivatives by their own rate and the sticks alone" if sticks_alone(spec) else "")
            + (", X and Y by their own velocity alone" if sticks_alone(spec) and "u" in spec.states else "")
        )


def of_rotors(spec: ModelSpec, fit: FitRecord) -> Iterator[str]:
    """Control powers of a multirotor against its declared places, mass and inertia."""
    if not spec.motors or spec.mass is None or spec.inertia is None:
        return
    values = {p.name: p for p in fit.parameters}
    silent = [row for row in MOMENTS if values[f"rotors.power.{row}"].status == "frozen"]
    if silent:
        yield (
            f"{' '.join(silent)} not testable: the thrusts predict body rates over 0.1 s worse than holding them does,"
            " so the model holds them; commands that a rate controller makes faster than they were recorded, or"
            " streams that do not belong together in time, look like that"
        )
    wrong = beyond_belief(spec, {p.name: p.value or 0.0 for p in fit.parameters})
    for row in MOMENTS:
        power = values[f"rotors.power.{row}"].value
        if row in silent or power is None or (row == "N" and any(m.torque_ratio is None for m in spec.motors)):
            continue
        if row in wrong:
            yield (
                f"control power of {row} is {power:.2g} of what places, thrust and declared inertia give: no inertia is"
                " that far off; commands that answer the rates, or a lag that is not in the model, bias it"
            )
        elif abs(power - 1.0) > AGREES:
            declared = spec.inertia[MOMENTS.index(row)][MOMENTS.index(row)]
            yield (
                f"control power of {row} is {power:.2f} of what is declared; an inertia about {AXES[row]} of"
                f" {declared / power:.3g} kg m² ({100 * (1 / power - 1):+.0f} %) would explain it, if mass and arms are"
                " right and no lag is missing"
            )


def of_flapping(fit: FitRecord) -> Iterator[str]:
    """The disc's tilt against its coning: the blades' Lock number makes both late."""
    lags = {p.name: (-p.value, SURE * p.se) for p in fit.parameters if p.value is not None and p.se}
    cone, error = lags.get("rotor.a0.a0", (0.0, 0.0))
    for row, control in CYCLIC.items():
        tilt, doubt = lags.get(f"rotor.{row}.{row}", (math.inf, 0.0))
        if tilt > 0.0 and cone - error > SLOWER * (tilt + doubt):
            yield (
                f"{row} follows {control} within {1.0 / tilt:.2g} s, the coning follows col within {1.0 / cone:.2g} s:"
                f" blades that cone so fast tilt as fast; what makes {row} late may lie before the blades, a lag or"
                f" delay of {control} that the flapping's own lag takes up here"
            )
