"""The page of a run, put together: one file that opens from a disk and asks no network for anything."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape

from rotorid_torch.core import names
from rotorid_torch.printable import percent, printable, significant
from rotorid_torch.report.overlay import Overlay
from rotorid_torch.report.page import pictures, plots, tables
from rotorid_torch.report.page.facts import ModelFacts
from rotorid_torch.report.records import FitRecord, Report
from rotorid_torch.report.short_horizon import BRACKETS, NAMES, cell, predictions_of, responses_of, short_horizon
from rotorid_torch.report.summary import air_of, list_summaries, shown_flights
from rotorid_torch.report.words import sizes, verdict
from rotorid_torch.report.words.effects import words_of
from rotorid_torch.report.words.glossary import GLOSSARY

STATIC = files("rotorid_torch.report.page") / "static"
LONG_HEADLINE = 140
"""Characters of a headline, two lines of a wide screen and four of a phone, above which smaller letters are taken."""
_COMMAND = re.compile(r"rotorid [a-z-]+( --[a-z]+| [A-Z]+\b| \w+\.fmu)+")
STEP_NAMES = {"reconstruct": "motion and forces", "ftr": "regression", "ml": "maximum likelihood", "trace": "tracing"}


@dataclass(frozen=True)
class Shown:
    """What a page shows besides the report: flights of the model and of the one before, and the model as tables."""

    overlays: Sequence[Overlay] = ()
    before: Sequence[Overlay] = ()
    facts: ModelFacts = field(default_factory=ModelFacts)


def render(report: Report, shown: Shown | None = None) -> str:
    """Return the page of a run that fits a model, or reconstructs."""
    shown = shown or Shown()
    named = [e for e in report.effects if e.verdict in ("accepted", "indistinguishable")]
    named.sort(key=lambda e: e.role != "undeclared")
    explained = pictures.effect_pictures(shown.overlays, named)
    undeclared = [e.id for e in named if e.role == "undeclared" and e.id in explained]
    first = undeclared[0] if len(undeclared) == 1 else ""  # of several, before and after show them together
    main = explained.pop(first, None) or pictures.main_picture(shown.before, shown.overlays, report.fit, report.unknown)
    plotted, opening = plots.packed(shown.before, shown.overlays), verdict.opening(report)
    plotted |= {"flight": main.flight, "channel": main.channel} if main else {}
    return rendered(
        "report.html.j2",
        report=report,
        opening=opening,
        long=len(opening) > LONG_HEADLINE,
        consequence=verdict.consequence(report),
        grades=verdict.grades(report),
        steps=verdict.steps(report),
        main=main,
        explained=explained,
        ranking=pictures.evidence(report.effects),
        spectra=pictures.spectra(shown.before, shown.overlays),
        rows=tables.evidence_rows(report.effects),
        untested=[e for e in report.effects if e.verdict == "not testable"],
        fits=[(title, fit, list_summaries(fit), shown_flights(fit)) for title, fit in fits_of(report)],
        short={title: short_horizon(fit) for title, fit in fits_of(report)},
        facts=shown.facts,
        names=NAMES,
        brackets=BRACKETS,
        cell=cell,
        plotted=plotted if plotted["flights"] else None,
        data=Markup(json.dumps(plotted, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")),
    )


def fits_of(report: Report) -> list[tuple[str, FitRecord]]:
    """Fits of a report, the one that counts first."""
    before = [("before" if report.after else "", report.before)] if report.before else []
    return [*([("after", report.after)] if report.after else []), *before]


@cache
def environment() -> Environment:
    """The templates, with what they write numbers and words by."""
    templates = Environment(
        loader=PackageLoader("rotorid_torch.report.page", "templates"),
        autoescape=select_autoescape(["html", "j2"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters.update(
        number=number,
        share=share,
        percent=percent,
        responses_of=responses_of,
        predictions_of=predictions_of,
        unbroken=unbroken,
        with_commands=with_commands,
        air_of=air_of,
        derivatives=tables.derivatives,
        modes=lambda fit: list(tables.mode_rows(fit.modes)),
        meaning=tables.meaning_of,
        visible=tables.visible,
        unit=sizes.plain,
        unit_of=lambda channel: sizes.plain(names.unit(channel)),
    )
    templates.globals.update(static=static, term=term, glossary=GLOSSARY, step_names=STEP_NAMES, noun=noun)
    return templates


@cache
def static(name: str) -> Markup:
    """A file of `static/`, as it is."""
    return Markup(STATIC.joinpath(name).read_text(encoding="utf-8"))


def term(word: str, key: str = "") -> Markup:
    """A word with its meaning on hover and focus."""
    return Markup('<abbr tabindex="0" title="{}">{}</abbr>').format(GLOSSARY[key or word], word)


def number(value: float | None, digits: int = 4) -> str:
    """Render a number with some significant digits; a dash for none."""
    return "–" if value is None else significant(value, digits)


def share(value: float | None) -> str:
    """Render an R², which is rounding where it is below a thousandth; a dash for none."""
    return "–" if value is None else f"{value:z.3f}"


def unbroken(words: str) -> str:
    """Words whose numbers stay on one line with their errors and units."""
    return re.sub(
        r"(?<=\d) (?=[±%])|(?<=±) (?=\d)|(?<=\d) (?=(?:ms|s|mm|m|rad|kg|g|N|Hz|m/s\S*|rad/s\S*)\b)", "\u00a0", words
    )


def with_commands(words: str) -> Markup:
    """Words, the commands in them as code."""
    return Markup(_COMMAND.sub(r"<code>\g<0></code>", str(escape(unbroken(words)))))


def noun(effect: str) -> str:
    """An effect as a thing, in words."""
    return words_of(effect).noun


def rendered(template: str, **values: object) -> str:
    """A page of another template."""
    return printable(environment().get_template(template).render(**values))
