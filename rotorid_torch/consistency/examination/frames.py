"""Axes and units of velocities and positions, against what gravity, specific force and the path say."""

from collections.abc import Iterator

import numpy as np

from rotorid_torch.consistency.conventions import OF_ANGLES, convention
from rotorid_torch.consistency.examination.finding import Finding, Severity, finding
from rotorid_torch.consistency.pairs.alignment import climbs
from rotorid_torch.consistency.pairs.axes import LEAST_TURN, Frame, feels, height_frame, path_frame, velocity_frame
from rotorid_torch.consistency.pairs.far_lags import late_positions
from rotorid_torch.consistency.pairs.time_base import time_base
from rotorid_torch.data.dataset import Dataset

SURE = 4.0
"""Standard errors."""
MUCH = 0.1
"""Share of the rates' variance that another convention leaves unexplained, from which on it is an error."""
LEAST_SCALE = 1.2
"""Factor, or one over it, from which on a unit is another one; less is a scale error, which pairs of sensors tell."""
UNITS = {
    "u v": {"knots": 3600.0 / 1852.0, "ft/s": 1.0 / 0.3048, "km/h": 3.6, "mph": 3600.0 / 1609.344, "cm/s": 100.0},
    "position": {"ft": 1.0 / 0.3048, "cm": 100.0, "mm": 1000.0, "km": 0.001},
}
"""What one m/s and one m are in other units."""
NEAR = 0.05
"""Share by which a factor may differ from that of a unit whose name is guessed."""


def frames(dataset: Dataset) -> Iterator[Finding]:
    """Velocities, then positions against them: another unit, axes that are turned, exchanged or of the wrong sign."""
    if climbs([dataset.flights[name] for name in dataset.identify], dataset.vehicle.gravity):
        sentence = "w has the wrong sign by attitude, gravity and specific force: it is positive up."
        yield finding("error", "w", sentence, "Turn it: z points down.")
        return
    velocity = velocity_frame(dataset, feels(dataset))
    if velocity is not None and _wrong("u v", velocity) and not _accelerometers_alone(dataset):
        by = "attitude, gravity and specific force" if feels(dataset) else "attitude and gravity"
        advice = "Correct them before anything else: every derivative by them is wrong."
        yield finding("error", "u v", f"by {by} {_wrong('u v', velocity)}.", advice)
        return  # positions are compared with the path of these velocities
    sure = {"north east": velocity is not None, "height": all(facts.has("w", "az") for facts in dataset.facts.values())}
    for channels, frame in (("north east", path_frame(dataset)), ("height", height_frame(dataset))):
        words = _wrong(channels, frame) if frame is not None else ""
        if late := _late(dataset, channels, frame.explained if frame is not None and words else 0.0):
            yield late
        elif frame is not None and words:
            who = "" if sure[channels] else " Or the velocities are."
            turned = not _scaled(frame) and frame.form == "plain" and channels != "height"
            advice = "Correct the positions." if not turned else "Is the heading magnetic, or the map turned?"
            yield finding("warning" if turned else "error", channels, f"by velocity and attitude {words}.{who}", advice)


def conventions(dataset: Dataset) -> Iterator[Finding]:
    """Angles of another order, or rates of angles in place of body rates."""
    other = convention(dataset)
    if other is None:
        return
    left = f"so taken, the attitude leaves {other.after:.1%} of the rates' variance instead of {other.before:.1%}."
    grave: Severity = "error" if other.before > MUCH else "warning"
    if other.form == OF_ANGLES:
        sentence = f"p q r are the rates of change of phi, theta and psi (a linear model's?), not body rates: {left}"
        yield finding(grave, "p q r", sentence, "Turn them into body rates.")
    else:
        turns = ", ".join(other.form.lower())
        sentence = f"the attitude's angles are of turns about {turns}, in this order, not about z, y, x: {left}"
        yield finding(grave, "phi theta psi", sentence, "Convert them to angles 3-2-1.")


def _late(dataset: Dataset, channels: str, explained: float) -> Finding | None:
    """Positions whose clock is off by more than pairs of channels are searched for; None where none is.

    explained : what other axes or units explain of them; where that is more, it is no clock.
    """
    late = {name: far for name, far in late_positions(dataset).items() if name in channels.split()}
    if not late or max(far.left for far in late.values()) > 1.0 - explained:
        return None
    words = {name: "late" if far.seconds > 0.0 else "early" for name, far in late.items()}
    lags = ", ".join(f"{n} {abs(far.seconds):.2f} s {words[n]} (± {far.se:.2g})" for n, far in late.items())
    sentence = f"{lags} against velocity and attitude:"
    return finding("warning", " ".join(late), sentence, "two clocks, or one that began later. Shift the stream.")


def time(dataset: Dataset) -> Iterator[Finding]:
    """A time base, or a unit of the rates, by which the attitude turns too fast on all axes alike."""
    base = time_base(dataset)
    if base is None:
        return
    grave: Severity = "error" if abs(np.log(base.ratio)) > np.log(LEAST_SCALE) else "warning"
    fast = f"{base.ratio:.3f} (± {base.se:.3f}) times as fast"
    sentence = f"attitude turns {fast} as the body rates say, on all axes alike"
    dt = float(np.median([facts.dt for facts in dataset.facts.values()]))
    stamps = f"the time base is wrong, samples are {base.ratio * dt:.4g} s apart rather than {dt:.4g} s"
    if base.in_degrees:
        sentence = f"p q r are {1.0 / base.ratio:.3g} times as large as the attitude says, on all axes alike (deg/s?)."
        yield finding("error", "p q r", sentence, "The unit is rad/s.")
    elif base.of == "time":
        lost = f", or {1.0 - 1.0 / base.ratio:.0%} of the rows were lost under even stamps" if base.ratio > 1.0 else ""
        cause = f"{stamps}{lost}. Correct the stamps first."
        yield finding(grave, "time p q r", f"{sentence}, and so velocities change:", cause)
    elif base.of == "rates":
        cause = "and velocities change as they should: the rates share a scale or unit error."
        yield finding(grave, "p q r", f"{sentence},", cause, f"Multiply them by {base.ratio:.4g}.")
    else:
        cause = f"{stamps}, or the rates share a scale or unit error."
        yield finding(grave, "time p q r", f"{sentence}:", cause, "Correct it before anything else.")


def _accelerometers_alone(dataset: Dataset) -> bool:
    """Whether gravity alone says that the velocities are right: then it is the accelerometers that are not."""
    by_gravity = velocity_frame(dataset, felt=False) if feels(dataset) else None
    return by_gravity is not None and not _wrong("u v", by_gravity)


def _scaled(frame: Frame) -> bool:
    return abs(np.log(frame.scale)) > max(np.log(LEAST_SCALE), SURE * frame.errors[0])


def _wrong(channels: str, frame: Frame) -> str:
    """What is wrong with a record of this frame, in words; empty where nothing is."""
    parts = list[str]()
    degrees, error = np.degrees(frame.turn), np.degrees(frame.errors[1])
    turned = abs(frame.turn) > max(LEAST_TURN, SURE * frame.errors[1])
    if frame.form == "earth":
        parts.append("u v are velocities north and east, not in body axes")
    elif channels == "height":
        parts += ["height is positive down"] if turned else []
    elif frame.form == "mirrored":
        exchanged = abs(abs(degrees) - 90.0) < 45.0
        first, second = channels.split()
        sign = first if abs(degrees) > 135.0 else second
        parts.append(f"{first} and {second} are exchanged" if exchanged else f"{sign} has the wrong sign")
    elif turned:
        parts.append(f"{channels} are turned by {degrees:+.1f}° (± {error:.1g}) about the vertical")
    if _scaled(frame):
        verb, pronoun = ("are", "they") if " " in channels else ("is", "it")
        size = f"{frame.scale:.3g} (± {frame.scale * frame.errors[0]:.1g}) times as large as {pronoun} should be"
        parts.append(f"{channels} {verb} {size}{unit_of(channels, frame.scale)}")
    return " and ".join(parts)


def unit_of(channels: str, scale: float) -> str:
    """Unit that is so many times as small as it should be, as a question; empty where none is."""
    units = UNITS["u v" if channels in ("u v", "airspeed") else "position"]
    near = [name for name, factor in units.items() if abs(scale / factor - 1.0) < NEAR]
    return f" ({near[0]}?)" if near else ""
