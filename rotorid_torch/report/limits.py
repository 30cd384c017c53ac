"""What the channels and declarations of a data set cannot tell: named, with what it means for the model."""

import math
from collections.abc import Iterator, Mapping, Sequence

from rotorid_torch.arguments import listed
from rotorid_torch.core.names import ATTITUDES, FLAPPING, MOMENTS, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.velocities.source import DECLARED_SPEED, inertial, starts_at_speed
from rotorid_torch.effects.spec import ModelSpec, MotorSpec
from rotorid_torch.identification.structure import have, sticks_alone
from rotorid_torch.model.rotors import beyond_belief, power_declared, powers_declared
from rotorid_torch.report.records import FitRecord

AXES = dict(zip(MOMENTS, ("x", "y", "z"), strict=True))
AGREES = 0.15
"""Relative difference from the declared control power that is not worth a sentence."""
SLOWER = 4.0
"""Times by which a disc that tilts more slowly than it cones is worth a sentence; one Lock number makes it 2 to 3.5."""
SURE = 2.0
"""Standard errors by which it must be so."""
TILTED = 0.1
"""m/s2 by which flights' constants along x and y differ at least to be worth a sentence: a tilt of 0.6 degrees."""
LIFTED = 0.02
"""The same of the thrust, over the weight."""
LEVER = 0.05
"""Share of the arm below which a motor does not turn the vehicle about an axis."""
CYCLIC = {"a1": "lon", "b1": "lat"}


def of_channels(dataset: Dataset, spec: ModelSpec) -> Iterator[str]:
    """States and physics that no channel shows, and channels that are therefore not scored."""
    yield from _lacking(dataset)
    if "u" not in spec.states:
        missing = [c for c in (*VELOCITIES, *ATTITUDES[:2]) if not have(dataset, (c,))]
        slow = "speed derivatives, drag and the slow modes stay unknown"
        if inertial(dataset) and not starts_at_speed(dataset):
            slow += f"; declare {DECLARED_SPEED}"
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
        return
    if spec.found_places is not None:
        yield _of_places(spec)
    if "Z" not in spec.patterns:
        yield "neither az nor w is measured: the thrust curve is held at hover balance, control powers carry its error"


def _lacking(dataset: Dataset) -> Iterator[str]:
    """Identify flights without channels that others have."""
    asked = (*VELOCITIES, *ATTITUDES, *SPECIFIC_FORCES, *FLAPPING)
    recorded = {name: {c for c in asked if dataset.facts[name].has(c)} for name in dataset.identify}
    some, lacking = set().union(*recorded.values()), dict[str, list[str]]()
    for name, has in recorded.items():
        lacking.setdefault(" ".join(c for c in asked if c in some - has), []).append(name)
    for channels, flights in lacking.items():
        if channels:
            yield (
                f"{listed(flights)}: no {channels}, which other identify flights have; what needs these channels in"
                " every identify flight is left out of the model: record them, or take such flights off the list"
            )


def _of_places(spec: ModelSpec) -> str:
    """Where flights say that motors stand whose places are not declared."""
    explained, start = spec.found_places or {}, "the motors' places are not declared ([[vehicle.motors]]): "
    unknown = [row for row in MOMENTS if row not in explained]
    lost = f"{' '.join(unknown)} not testable, for little of the angular acceleration goes with the motors"
    if not explained:
        return f"{start}thrust acts along -z; {lost}"
    each = [f"{name} {_stands(m, explained)}" for name, m in zip(spec.commands, spec.motors, strict=True)]
    share = ", ".join(f"{row} {r2:.2f}" for row, r2 in explained.items())
    said = f"{start}found from the flights (R² of {share}): {', '.join(each)}; arms over inertia alone are known"
    return f"{said}; {lost}" if unknown else said


def _stands(motor: MotorSpec, explained: Mapping[str, float]) -> str:
    """In words, by the moments that tell."""
    x, y, _ = motor.position
    least = 0.2 * max(abs(x), abs(y))
    along = ("ahead" if x > 0.0 else "behind") if "M" in explained and abs(x) > least else ""
    across = ("right" if y > 0.0 else "left") if "L" in explained and abs(y) > least else ""
    spin = ("ccw" if motor.spin > 0.0 else "cw") if "N" in explained else ""
    return " ".join(word for word in (along, across, spin) if word) or "near the middle"


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
    """Moments of a multirotor that nothing tells; control powers against its declared places, mass and inertia."""
    if not spec.motors:
        return
    values = {p.name: p for p in fit.parameters}
    silent = [row for row in MOMENTS if values[f"rotors.power.{row}"].status == "frozen"]
    if silent:
        yield (
            f"{' '.join(silent)} not testable: the thrusts explain little of the angular accelerations, predict rates"
            " over 0.1 s worse than holding them does, or seem to move another vehicle than the declared, so the model"
            " holds the rates; a mass, inertia or place that is declared wrongly, commands that a rate controller makes"
            " faster than they were recorded, or streams that do not belong together in time, look like that"
        )
        yield from _without_lever(spec, silent)
    if not powers_declared(spec):
        return
    assert spec.inertia is not None
    wrong = beyond_belief(spec, {p.name: p.value or 0.0 for p in fit.parameters})
    for row in MOMENTS:
        power = values[f"rotors.power.{row}"].value
        if row in silent or power is None or power_declared(spec, row) is None:
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


def _without_lever(spec: ModelSpec, silent: Sequence[str]) -> Iterator[str]:
    """Moments that no rotor makes where it stands: a control that was not recorded must."""
    places = [m.position for m in spec.motors]
    levers = {"L": [y for _, y, _ in places], "M": [x for x, _, _ in places]}
    arm = max((math.hypot(x, y) for x, y, _ in places), default=0.0)
    never = [row for row in silent if row in levers and max(map(abs, levers[row])) < LEVER * arm]
    if never and spec.found_places is None and not spec.surfaces:
        yield (
            f"no motor turns the vehicle in {' '.join(never)} where it stands: what does is not recorded (elevons,"
            " tilting servos), and these moments cannot be explained without it"
        )


def of_constants(spec: ModelSpec, fit: FitRecord) -> Iterator[str]:
    """Constants of a multirotor's specific forces that differ from flight to flight, and what they may be."""
    means = {
        c: [r.constant for f in fit.flights.values() if (r := f.responses.get(c)) and r.constant is not None]
        for c in SPECIFIC_FORCES
    }
    across = {c: v for c, v in means.items() if c != "az" and len(v) > 1 and max(v) - min(v) > TILTED}
    if across:
        most = max(abs(x - sum(v) / len(v)) for v in across.values() for x in v)
        ranges = ", ".join(f"{c} from {min(v):.2g} to {max(v):.2g} m/s²" for c, v in across.items())
        yield (
            f"constants of flights differ ({ranges}): the attitude's zero is tilted against the accelerometers by up to"
            f" {math.degrees(most / spec.gravity):.1f} degrees, differently in each flight, or these are biased; no"
            " effect of the model stands for it, and R² as measured counts it as an error"
        )
    level = means["az"]
    if len(level) > 1 and max(level) - min(level) > LIFTED * spec.gravity:
        yield (
            f"measured less modelled az is {min(level):.2g} to {max(level):.2g} m/s² on average, from flight to flight:"
            " battery, mass, propellers or the accelerometer's bias; R² as measured counts it as an error"
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
