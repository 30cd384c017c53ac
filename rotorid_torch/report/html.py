"""report.html: the report as one page that needs nothing else, neither files beside it nor a network."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from rotorid_torch.printable import printable
from rotorid_torch.report.records import FitRecord, ModeRecord, ParameterRecord, Report
from rotorid_torch.report.short_horizon import BRACKETS, NAMES, short_horizon
from rotorid_torch.report.summary import air_of, headline, list_summaries, next_steps, shown_flights

CAPTIONS = {
    "sampling": "Stamps as recorded: a line is a good clock, a cloud jitters, a lone point is a gap.",
    "spectra": "Where motion ends and noise begins; vibration stands out as a line.",
    "coherence": "In the grey band a response belongs to the controls; fit and judge there.",
    "controls": "What was flown: each control should move by itself in some flight.",
    "correlation": "Controls that go together, or with the motion, are told apart only where they do not.",
    "kinematics": "Sensors against each other. Red that blue repairs is a clock, a scale or a bias.",
    "evidence": "What each candidate would explain, over its floor: right of the line it explains more than it does on"
    " clean aircraft (ordinary physics: than by chance). Blue is accepted, red rejected, purple cannot be told apart.",
    "residual_spectrum": "What the free runs leave over on flights not used to fit, before and after.",
    "scores": "Every flight between its two yardsticks.",
    "figure5_flapping": "Flapping on flights that were not used to fit the model.",
    "figure7_velocities": "Velocities.",
    "figure8_rates": "Body rates.",
    "figure9_rotor": "Rotor.",
    "attitude": "Attitude.",
    "accelerations": "Specific forces at measured states, one constant per flight taken out.",
    "turning": "Angular accelerations at measured states, one constant per flight taken out.",
    "residual": "What the model leaves over. A slow drift points to trim or low-frequency derivatives, a burst at the"
    " edges of controls to delay or missing rotor dynamics, a line to vibration.",
}

ORDER = ("accepted", "indistinguishable", "suspected", "rejected", "below floor")
"""Verdicts on effects that were tested, in the order of the page's table."""


def render(report: Report, pictures: Mapping[str, bytes]) -> str:
    """Return the page; `pictures` are PNG bytes by name, shown in their order."""
    environment = Environment(
        loader=PackageLoader("rotorid_torch.report", "templates"),
        autoescape=select_autoescape(["html", "j2"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        number=number, percent=percent, relative=relative_error, motion=motion_of_mode, air_of=air_of
    )
    page = environment.get_template("report.html.j2").render(
        report=report,
        headline=headline(report),
        steps=next_steps(report),
        fits=[(title, fit, list_summaries(fit), shown_flights(fit)) for title, fit in _fits(report)],
        short={title: short_horizon(fit) for title, fit in _fits(report)},
        names=NAMES,
        brackets=BRACKETS,
        tested=sorted((e for e in report.effects if e.verdict in ORDER), key=lambda e: ORDER.index(e.verdict)),
        untested=[e for e in report.effects if e.verdict not in ORDER],
        pictures=[(name, _caption(name), base64.b64encode(png).decode()) for name, png in pictures.items()],
    )
    return printable(page)


def number(value: float | None, digits: int = 4) -> str:
    """Render a number with some significant digits; a dash for none."""
    return "–" if value is None else f"{value:.{digits}g}"


def percent(value: float | None) -> str:
    """Render a share in percent; a dash for none."""
    return "–" if value is None else f"{100 * value:.0f} %"


def relative_error(parameter: ParameterRecord) -> str:
    """Standard error as a share of the value."""
    if parameter.se is None or not parameter.value:
        return "–"
    return percent(parameter.se / abs(parameter.value))


def motion_of_mode(mode: ModeRecord) -> str:
    """Say what an eigenvalue means: frequency and damping, and the time to double or to halve."""
    real, imaginary = mode.eigenvalue
    if real is None or imaginary is None:
        return "–"
    speed = "neutral" if real == 0 else f"{'doubles' if real > 0 else 'halves'} in {math.log(2) / abs(real):.2g} s"
    if imaginary == 0:
        return speed
    frequency = math.hypot(real, imaginary)
    return f"{frequency / (2 * math.pi):.2g} Hz, damping {-real / frequency:.2f}, {speed}"


def _fits(report: Report) -> list[tuple[str, FitRecord]]:
    if report.after is None:
        return [("", report.before)] if report.before else []
    return [*([("before", report.before)] if report.before else []), ("after", report.after)]


def _caption(name: str) -> str:
    caption_key = next((key for key in CAPTIONS if name == key or name.startswith(f"{key}_")), None)
    if caption_key is None:
        return name
    flight = name[len(caption_key) + 1 :]
    return f"{flight}: {CAPTIONS[caption_key].lower()}" if flight else CAPTIONS[caption_key]
