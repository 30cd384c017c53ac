"""Can a model be identified from a data set, on which axes, and if not, what to fly or mend? Three grades."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from rotorid_torch.consistency.examination.controls import FEEDBACK, TEST_INPUT
from rotorid_torch.consistency.examination.finding import Finding
from rotorid_torch.consistency.examination.needs import examinable
from rotorid_torch.consistency.records.coherence import coherences
from rotorid_torch.consistency.records.excitation import BAND_HZ, STILL, Excitation, excitations, power_in_band
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset

Grade = Literal["ready", "limited", "not usable"]
AXES = {
    "roll": ("lat", ("p",)),
    "pitch": ("lon", ("q",)),
    "yaw": ("ped", ("r",)),
    "vertical": ("col", ("az", "w")),
}
"""Control of each axis of a helicopter, and the responses that show the axis, best first."""
MOTORS = {"roll": "roll", "pitch": "pitch", "yaw": "yaw", "vertical": "thrust"}
"""What the motors do together on each axis."""
HARMLESS = ("time", "voltage")
"""Channels on which a warning limits nothing that is identified."""
OF_RESPONSE = ("nowhere follows", "hardly moves")
"""What is said of a response, and may be of several."""
TOLD = 3
"""Reasons that one sentence gives."""


@dataclass(frozen=True)
class AxisGrade:
    """Grade of one axis (roll, pitch, yaw, vertical) and why it is not ready."""

    axis: str
    grade: Grade
    because: tuple[str, ...] = ()


@dataclass(frozen=True)
class Graded:
    """Grade of a data set, why it is not ready, and the grades of its axes."""

    grade: Grade
    because: tuple[str, ...]
    axes: tuple[AxisGrade, ...]

    @property
    def sentence(self) -> str:
        """The grade in words: on which axes a model can be identified, and what stands against the others."""
        usable = [one.axis for one in self.axes if one.grade != "not usable"]
        more = f"; and {len(self.because) - TOLD} more" if len(self.because) > TOLD else ""
        why = "; ".join(self.because[:TOLD]) + more
        if self.grade == "ready":
            return f"ready: a model can be identified on {_listed(usable) or 'what is recorded'}"
        if self.grade == "limited":
            some = len(usable) < len(self.axes)
            ready = bool(self.axes) and all(one.grade == "ready" for one in self.axes)
            care = "ready, other channels with care" if ready else "with care"
            how = f" to {_listed(usable)}" if some else f": {_listed(usable) or 'what is recorded'} {care}"
            return f"limited{how} ({why})"
        whole = (re.sub(r"^([\w, ]+) not usable: (.*)$", r"\2 (\1)", one) for one in self.because[:TOLD])
        return f"not usable, because {'; '.join(whole)}{more}"


def graded(dataset: Dataset, findings: Sequence[Finding]) -> Graded:
    """Grade of a data set by all that was found on it.

    An error makes it not usable, and so does every axis that is not. An axis is not usable where its response nowhere
    follows the controls, or nothing was flown on it; it is limited where its control answers the motion, or a warning
    is of its channels. Other warnings limit the whole.
    """
    errors = tuple(dict.fromkeys(_told(f) for f in findings if f.severity == "error"))
    if errors or not examinable(dataset):
        return Graded("not usable", errors or ("no control moves in a flight that is long enough",), ())
    axes = tuple(_axes(dataset, findings))
    spread = {channel for one in axes for channel in _channels(one.axis, _motors_alone(dataset))}
    others = tuple(
        dict.fromkeys(
            _told(f)
            for f in findings
            if f.severity == "warning" and not spread & {*f.channel.split()} and f.channel not in HARMLESS
        )
    )
    reasons = tuple(_reasons(axes))
    counted = [one.grade for one in axes]
    if counted and all(grade == "not usable" for grade in counted):
        return Graded("not usable", reasons, axes)
    limited = others or any(grade != "ready" for grade in counted)
    return Graded("limited" if limited else "ready", (*reasons, *others), axes)


def _reasons(axes: Sequence[AxisGrade]) -> Iterator[str]:
    """What stands against axes; those of which the same is said of another response share a sentence."""
    alike: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for one in axes:
        for why in one.because if one.grade != "ready" else ():
            response, _, said = why.partition(" ")
            response, said = (response, said) if response in STILL and said.startswith(OF_RESPONSE) else ("", why)
            alike.setdefault((one.grade, said), []).append((one.axis, response))
    for (grade, said), members in alike.items():
        responses = _listed([response for _, response in members if response])
        words = said.replace("nowhere follows", "nowhere follow") if len(members) > 1 else said
        yield f"{_listed([axis for axis, _ in members])} {grade}: {f'{responses} {words}'.strip()}"


def _axes(dataset: Dataset, findings: Sequence[Finding]) -> Iterator[AxisGrade]:
    responses = [c for _, channels in AXES.values() for c in channels]
    bands = {c.channel: c.band for c in coherences(dataset, responses)}
    flown = {e.axis.name: e for e in excitations(dataset)}
    motors = _motors_alone(dataset)
    for axis, (control, channels) in AXES.items():
        response = next((c for c in channels if c in bands), "")
        excitation = flown.get(MOTORS[axis] if motors else control)
        if not response and (motors or excitation is None):
            continue
        rms = power_in_band(dataset.records(response), dataset.facts[dataset.identify[0]].dt)[1] if response else 0.0
        yield _axis(axis, Shown(response, rms, bands.get(response) is not None), excitation, findings, motors)


class Shown(NamedTuple):
    """Channel that shows what an axis does (empty: none is recorded), its rms in the band, whether it follows them."""

    channel: str
    rms: float
    follows: bool


def _axis(axis: str, shown: Shown, flown: Excitation | None, findings: Sequence[Finding], motors: bool) -> AxisGrade:
    """Grade of an axis by its response and by what its control did."""
    response, rms, follows = shown
    wrong, doubts = list[str](), list[str]()
    if not response:
        doubts.append("its response is not recorded")
    elif rms < STILL[response]:
        band = f"{BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz"
        wrong.append(f"{response} hardly moves ({rms:.2g} {names.unit(response)} rms from {band}): nothing was flown")
    elif not follows:
        wrong.append(f"{response} nowhere follows the controls")
    if flown is not None and flown.above_white < TEST_INPUT and (flown.moved or motors):
        wrong.append("nothing was flown on it: its control moves no more than a controller answers noise")
    elif flown is not None and not flown.moved:
        wrong.append("its control hardly moves in any identify flight")
    elif flown is not None and flown.independent < FEEDBACK and not flown.leads:
        doubts.append("its control follows the motion: only combinations of derivatives can be identified")
    channels = _channels(axis, motors)
    about = [f for f in findings if f.severity == "warning" and channels & {*f.channel.split()}]
    doubts += [] if wrong else [head(f.sentence) for f in about]
    if wrong:
        return AxisGrade(axis, "not usable", tuple(dict.fromkeys(wrong)))
    return AxisGrade(axis, "limited" if doubts else "ready", tuple(dict.fromkeys(doubts)))


def _motors_alone(dataset: Dataset) -> bool:
    return all(map(names.is_motor, dataset.controls))


def _channels(axis: str, motors: bool) -> set[str]:
    """Channels of an axis, on which a warning limits it: every response, also beside the first, and its control."""
    control, responses = AXES[axis]
    return {*responses, *(() if motors else (control,))}


def _told(one: Finding) -> str:
    where = " ".join(part for part in (one.flight, one.channel) if part)
    return f"{where}: {head(one.sentence)}" if where else head(one.sentence)


def _listed(axes: Sequence[str]) -> str:
    return ", ".join(axes)


def head(sentence: str) -> str:
    """A sentence's first clause, without what stands in brackets."""
    clear = re.sub(r" ?\((?:[^()]|\([^()]*\))*\)", "", sentence)
    return re.split(r"[:;] |\. |\.$", clear)[0]
