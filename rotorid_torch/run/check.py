"""`rotorid check`: the examination of the records, joint sensor errors with standard errors, a verdict per channel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import msgspec
from rich.console import Group
from rich.table import Table
from rich.text import Text

from rotorid_torch.consistency.equations import UNITS
from rotorid_torch.consistency.examination import check as records
from rotorid_torch.consistency.examination.controls import RESPONSES
from rotorid_torch.consistency.examination.finding import Finding, finding
from rotorid_torch.consistency.examination.grade import AxisGrade, Grade, graded, head
from rotorid_torch.consistency.examination.needs import examinable
from rotorid_torch.consistency.records.coherence import coherences
from rotorid_torch.consistency.sensor_errors.kinematic_findings import kinematic_findings
from rotorid_torch.consistency.sensor_errors.sensor_finding import KinematicFinding
from rotorid_torch.core import names
from rotorid_torch.core.parameters import ParameterTable
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.effects.families.sensors import PERIOD, SMOOTHED, SensorFilter
from rotorid_torch.printable import html_table, significant
from rotorid_torch.report.page.check_page import render_check
from rotorid_torch.report.records import encode_report
from rotorid_torch.report.summary import GRADED
from rotorid_torch.report.words.effects import words_of
from rotorid_torch.report.words.sizes import size
from rotorid_torch.report.words.verdict import CLOSE_LOOP, with_places
from rotorid_torch.run.output.arguments import refuse_arguments
from rotorid_torch.run.output.folder import run_folder
from rotorid_torch.run.output.monitor import Monitor
from rotorid_torch.run.output.write import png, report_of, write_pictures
from rotorid_torch.validate.declared_vehicle import of_declaration
from rotorid_torch.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GROSS = 300.0
"""Power of what no sensor error explains over that of the noise, above which errors of sensors are not searched for."""
WHOLE = {"rad": math.pi, "1": 1.0}
"""By unit: sizes of a sensor's error from which on it is none: half a turn, a scale of nothing or of twice."""
VERDICTS = {"error": "not fit", "warning": "with care", "note": "good", "good": "good"}

SHOWN, LINE = 8, 200
"""Lines of a check that its `repr` holds, and their letters."""


@dataclass(frozen=True)
class ChannelVerdict:
    """What to think of one channel or control.

    verdict : "good", "with care" or "not fit". noise : standard deviation of a sample, rms : of its motion, both in
    `unit`. band : in which it follows the controls, Hz; None where it nowhere does or is no response. reasons : the
    heads of the sentences that speak of it.
    """

    channel: str
    verdict: str
    unit: str
    noise: float
    rms: float
    band: tuple[float, float] | None
    reasons: tuple[str, ...]

    @property
    def name(self) -> str:
        """The channel's name."""
        return self.channel


@dataclass(frozen=True, repr=False)
class Check(ParameterTable):
    """All findings on a data set, gravest first, and its grade; `fit` is false where it is not usable.

    `check["p"]` is the verdict on a channel, `check.table()` those on all.

    because : what stands against "ready". sentence : the grade in words. axes : the grade of each axis. channels : a
    verdict for each. sensors : joint estimates of sensor errors from kinematics with their standard errors; empty where
    the channels allow none. data : the flights.
    """

    dataset: str
    grade: Grade
    sentence: str
    because: tuple[str, ...]
    axes: tuple[AxisGrade, ...]
    fit: bool
    findings: tuple[Finding, ...]
    channels: tuple[ChannelVerdict, ...]
    sensors: tuple[KinematicFinding, ...]
    data: Dataset = field(compare=False)

    entry = "channel"
    columns = shown = ("name", "verdict", "unit", "noise", "rms", "band", "reasons")

    @property
    def title(self) -> str:
        """The data set and its grade in words."""
        return f"{self.dataset}: {self.sentence}"

    @property
    def _estimates(self) -> Sequence[ChannelVerdict]:
        return self.channels

    def _rows(self) -> list[tuple[str, ...]]:
        return [(c.channel, c.verdict, c.unit, *_sizes(c), "; ".join(c.reasons)) for c in self.channels]

    def plot(self) -> dict[str, Figure]:
        """The pictures of the check's page as matplotlib figures, by name; none where flights allow no examination."""
        from rotorid_torch.report.check_figures import draw_check  # slow to import

        return draw_check(self.data) if examinable(self.data) else {}

    def to_dict(self) -> dict[str, Any]:
        """All of it but the flights, as numbers, words, lists and dicts: what check.json holds."""
        return {f.name: msgspec.to_builtins(getattr(self, f.name)) for f in fields(self) if f.name != "data"}

    def _repr_html_(self) -> str:
        """All findings, for a notebook."""
        rows = ((one.severity, _where(one), one.sentence) for one in self.findings)
        return html_table(self.title, ("", "where", "finding"), rows)

    def __repr__(self) -> str:
        lines = [self.title]
        lines += [": ".join(filter(None, (f.severity, _where(f), f.sentence))) for f in self.findings]
        more = [f"and {len(lines) - SHOWN} more findings"] if len(lines) > SHOWN else []
        return "\n".join([*(shorten(line, LINE, placeholder=" ...") for line in lines[:SHOWN]), *more])


def check(dataset: Dataset) -> Check:
    """Can a model be identified from it? Every record by itself, all against each other, and the controls.

    Raises
    ------
    InputError : no data set.

    Examples
    --------
    >>> import rotorid_torch as rotorid
    >>> rotorid.check(rotorid.load("DATASET")).grade
    'limited'
    """
    refuse_arguments("check", dataset=dataset)
    examined = records.check(dataset)
    findings, sensors, verdicts = examined.findings, (), ()
    if examined.comparable is not None:
        if not examined.gross:
            joint = kinematic_findings(examined.comparable, GROSS)
            sensors = joint.findings
            corrected = joint.corrected(examined.comparable) if joint.values else None
            explained = records.remaining(examined, corrected) if corrected else findings
            jointly = sensor_words(sensors, examined.aligned)
            filtered = _filtered(sensors)
            once = (f for f in explained if f not in examined.of_noise or not {*f.channel.split()} <= filtered)
            findings = (*once, *jointly)
        findings = tuple(sorted((*findings, *of_declaration(examined)), key=lambda f: records.RANK[f.severity]))
        verdicts = _verdicts(examined.flown, findings)
    whole = graded(examined.flown, findings)
    return Check(
        dataset=dataset.name,
        grade=whole.grade,
        sentence=whole.sentence,
        because=whole.because,
        axes=whole.axes,
        fit=whole.grade != "not usable",
        findings=findings,
        channels=verdicts,
        sensors=sensors,
        data=dataset,
    )


def sensor_words(sensors: Sequence[KinematicFinding], aligned: Sequence[str] = ()) -> tuple[Finding, ...]:
    """What to say of bias, scale, misalignment, lever arm, delay and filter, all at once, from exact kinematics.

    aligned : errors by name that a finding on large turns and clocks tells already.
    """
    if not sensors:
        sentence = "kinematics disagree far beyond the noise in ways that no constant sensor error makes:"
        more = "lags, scales and biases are told from pairs of channels only, not jointly."
        return (finding("note", "", sentence, more),)
    if all(f.verdict == "not testable" for f in sensors):
        return ()
    named = [
        f for f in sensors if f.verdict in ("accepted", "indistinguishable") and any(p.accepted for p in f.parameters)
    ]
    if not named:
        visible = "; ".join(said for f in sensors if (said := _visible(f)))
        sentence = f"all channels together show no constant sensor error. Such sizes would show: {visible}."
        return (finding("good", "", sentence),)
    said = {f"sensors.{name}" for name in aligned}
    return tuple(_sentence(f) for f in named if not {p.name for p in f.parameters if p.accepted} <= said)


def _visible(error: KinematicFinding) -> str:
    """The sizes from which on an error shows, by unit from the surest sensor to the least sure, with their names."""
    by_unit: dict[str, list[tuple[float, str]]] = {}
    for p in error.parameters:
        member = p.name.split(".")[2]
        if p.smallest_visible < WHOLE.get(p.unit, math.inf) and not member.endswith((PERIOD, SMOOTHED)):
            by_unit.setdefault(p.unit, []).append((p.smallest_visible, member))
    spans = [
        " to ".join(f"{size(value, None, unit)} ({member})" for value, member in dict.fromkeys((min(some), max(some))))
        for unit, some in by_unit.items()
    ]
    return f"{words_of(error.id).noun}, {', '.join(spans)}" if spans else ""


def _filtered(sensors: Sequence[KinematicFinding]) -> set[str]:
    """Channels behind a filter, which has taken their noise too."""
    every = (p.name for f in sensors for p in f.parameters if p.accepted)
    return {c for name in every if name.startswith(f"{SensorFilter.id}.") for c in _channels(name.split(".")[2])}


def _sentence(error: KinematicFinding) -> Finding:
    members = dict.fromkeys(c for p in error.parameters if p.accepted for c in _channels(p.name.split(".")[2]))
    sentence = f"{error.reason} (all channels together)."
    advice = f"Correct the records, or let {error.id} be estimated by close-loop."
    return finding("warning", " ".join(members), sentence, advice)


def _channels(member: str) -> tuple[str, ...]:
    """Channels of a sensor error's last name: a unit's, an IMU axis's, or the channel itself."""
    return UNITS.get(member.partition("_")[0]) or (() if member in ("x", "y", "z") else (member,))


def _verdicts(dataset: Dataset, findings: tuple[Finding, ...]) -> tuple[ChannelVerdict, ...]:
    bands = {c.channel: c.band for c in coherences(dataset, RESPONSES)}
    order = [c for c in (*dataset.controls, *names.CHANNELS, *dataset.scales()) if c in dataset.scales()]
    judged = [_verdict(dataset, channel, findings, bands.get(channel)) for channel in dict.fromkeys(order)]
    for one in (dead for dead in dataset.dead if dead.everywhere):
        why, unit = (head(one.sentence),), names.unit(one.channel)
        judged.append(ChannelVerdict(one.channel, VERDICTS["error"], unit, 0.0, 0.0, None, why))
    return tuple(judged)


def _verdict(
    dataset: Dataset, channel: str, findings: tuple[Finding, ...], band: tuple[float, float] | None
) -> ChannelVerdict:
    about = [f for f in findings if channel in f.channel.split() and f.severity in ("error", "warning")]
    worst = about[0].severity if about else "good"
    unit = dataset.control_specs[channel].unit if channel in dataset.controls else names.unit(channel)
    reasons, noise = tuple(dict.fromkeys(head(f.sentence) for f in about)), dataset.noise(channel)
    return ChannelVerdict(channel, VERDICTS[worst], unit, noise, dataset.scales()[channel], band, reasons)


def check_table(result: Check, dataset: Path | None = None) -> Group:
    """The grade, all findings, gravest first, the verdict on each channel; last the grade again and what to do.

    dataset : the folder, for the command that comes next.
    """
    title = Text(result.title, style="bold")
    table = Table("", "where", "finding")
    for one in result.findings:
        table.add_row(one.severity, _where(one), one.sentence)
    channels = Table("channel", "verdict", "noise", "moves", "follows controls", "because", title="Channel by channel")
    channels.title_justify = "left"
    for one in result.channels:
        noise, rms, band = _sizes(one)
        channels.add_row(one.channel, one.verdict, noise, f"{rms} {one.unit}".strip(), band, "; ".join(one.reasons))
    axes = [f"{one.axis} {one.grade}" for one in result.axes]
    graded = [title, *([Text(", ".join(axes))] if axes else [])]
    then = Text(f"Next: {with_places(_next(result), dataset, None)}")
    return Group(*graded, table, channels, Text(""), *graded, then)


def _sizes(one: ChannelVerdict) -> tuple[str, str, str]:
    """Noise, motion and band of a channel as people read them."""
    band = f"{one.band[0]:.1g}-{one.band[1]:.2g} Hz" if one.band else ""
    return significant(one.noise, 2), significant(one.rms, 2), band


def _next(result: Check) -> str:
    """What to do with the findings; with flights that are ready, to go on."""
    grave = sum(one.severity in ("error", "warning") for one in result.findings)
    if result.grade == "ready" or not grave:
        return CLOSE_LOOP
    return f"mend the errors and warnings above ({grave}), gravest first; the page of a RUN (--out RUN) shows each."


def write_check(out: Path, dataset: Dataset, result: Check, seed: int, monitor: Monitor) -> None:
    """Write a run: check.json holds everything, figures show it; errors and warnings become the report's warnings."""
    grave = [one for one in result.findings if one.severity in ("error", "warning")]
    with run_folder(out, "check") as folder, monitor.recording(folder):
        for one in result.findings:
            monitor.log(f"{one.severity}: {_line(one)}")
        pictures = {name: png(figure) for name, figure in result.plot().items()}
        write_pictures(folder, pictures, monitor)
        warnings = (f"{GRADED}{result.sentence}", *(_line(one) for one in grave))
        report = report_of("check", dataset, seed, monitor, None, warnings)
        head = {"format": 1, "rotorid": __version__, "sha256": dataset.sha256}
        whole = msgspec.json.encode(head | result.to_dict())
        (folder / "check.json").write_bytes(msgspec.json.format(whole, indent=2))
        (folder / "report.html").write_text(render_check(result, report, pictures), encoding="utf-8")
        (folder / "report.json").write_bytes(encode_report(report))


def _where(one: Finding) -> str:
    return " ".join(part for part in (one.flight, one.channel) if part)


def _line(one: Finding) -> str:
    where = _where(one)
    return f"{where}: {one.sentence}" if where else one.sentence
