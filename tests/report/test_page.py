"""The page and the pictures: everything inside, nothing fetched, and words that follow from the numbers."""

from __future__ import annotations

import io
import itertools
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from rotorid_torch.printable import significant
from rotorid_torch.report import figures, records, summary
from rotorid_torch.report.overlay import Overlay
from rotorid_torch.report.page import tables
from rotorid_torch.report.page.check_page import headline as check_headline
from rotorid_torch.report.page.document import Shown, render
from rotorid_torch.report.page.pictures import main_picture
from rotorid_torch.report.page.svg import ticks
from rotorid_torch.report.scorecard import scorecard
from rotorid_torch.report.words.verdict import worst_of
from rotorid_torch.run.output.write import write_report
from rotorid_torch.validate.judged import Response

VOID = {"meta", "img", "br", "link", "input"}
IN_SVG = {"path", "rect"}
LARGEST = 3_000_000
"""Bytes of a page, at most."""


class Page(HTMLParser):
    """Collects references, heads, pictures and labels, and checks that every tag is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.bare: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag not in VOID | IN_SVG:
            self.open.append(tag)
        self.references += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]
        self.ids += [values["id"] or ""] if "id" in values else []
        lacks = (
            (tag == "th" and values.get("scope") not in ("col", "row"))
            or (tag == "img" and not values.get("alt"))
            or (tag == "svg" and not values.get("aria-label"))
            or (tag in ("input", "select") and "label" not in self.open)
        )
        self.bare += [f"{tag} {values}"] if lacks else []

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in VOID | IN_SVG
        self.handle_starttag(tag, attrs)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, report: records.Report, overlays: list[Overlay]) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_report(folder, report, Shown(overlays))
    return folder


@pytest.fixture
def page(run: Path) -> str:
    return (run / "report.html").read_text(encoding="utf-8")


def test_page_refers_to_nothing_outside_itself(page: str):
    parsed = Page()
    parsed.feed(page)
    assert parsed.open == []
    assert parsed.references
    assert all(re.match(r"data:|#", reference) for reference in parsed.references)
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(|<script[^>]* src|fetch\(|XMLHttpRequest", page)
    assert len(page) < LARGEST


def test_heads_say_of_what_pictures_have_words_and_controls_have_labels(page: str):
    parsed = Page()
    parsed.feed(page)
    assert parsed.bare == []
    assert len(parsed.ids) == len(set(parsed.ids))
    assert all(reference[1:] in parsed.ids for reference in parsed.references if reference.startswith("#"))


def test_page_begins_with_what_was_discovered_and_escapes_names(page: str):
    assert "&lt;uh60&gt; &amp; hover" in page
    marks = ("<h1", "very good", "Worst:", "<svg", "What to do next", 'id="scores"', 'id="model"', 'id="warnings"')
    order = [page.index(mark) for mark in marks]
    assert order == sorted(order)
    assert "the flight f2 has no height" in page
    assert "forces.L.p" in page
    assert "-4.1<small>± 0.2" in page
    assert "flapping and inflow settled" in page
    assert "bias.p.f1" not in page
    assert 'name="viewport"' in page


def test_a_page_names_no_place_so_that_it_can_be_copied(report: records.Report):
    page = render(msgspec.structs.replace(report, command="identify"))
    assert "<code>rotorid close-loop DATASET --out LOOP</code>." in page
    assert "DATASET is the folder of the flights, LOOP a new one." in page


def test_papers_figures_are_written(run: Path):
    names = sorted(file.stem for file in (run / "figures").iterdir())
    assert names == [
        "attitude_sweep",
        "figure5_flapping",
        "figure7_velocities_sweep",
        "figure8_rates_sweep",
        "figure9_rotor_sweep",
        "residual",
        "scores",
    ]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in (run / "figures").iterdir())


def test_a_vehicle_without_velocity_and_flapping_gets_what_it_has(fit: records.FitRecord, overlays: list[Overlay]):
    overlay = overlays[-1]
    rates_only = Overlay("x", "acid", overlay.time, {"p": overlay.measured["p"]}, {"p": overlay.model["p"]})
    assert sorted(figures.drawings([rates_only], fit)) == ["figure8_rates_x", "residual", "scores"]


def test_a_run_without_a_fit_still_has_a_page(report: records.Report):
    assert "No model was fitted" in render(msgspec.structs.replace(report, before=None))


def test_a_page_of_close_loop_shows_before_and_after(report: records.Report, fit: records.FitRecord):
    effect = records.EffectRecord(id="control.delay", role="undeclared", verdict="accepted", reason="gain above floor")
    verdict = records.VerdictRecord(
        kind="undeclared", effects=("control.delay",), sentence="Undeclared: control.delay."
    )
    page = render(msgspec.structs.replace(report, after=fit, effects=(effect,), verdict=verdict))
    assert "<h1>The controls reach the rotor later than recorded.</h1>" in page
    assert page.index("<h2>before</h2>") < page.index("<h2>after</h2>") < page.index("What to do next")
    assert "✔ accepted" in page


def with_list(fit: records.FitRecord, J: float) -> records.FitRecord:
    scores = msgspec.structs.replace(fit.scores, acid=J, validate=J)
    return msgspec.structs.replace(fit, scores=scores)


@pytest.mark.parametrize(
    ("J", "word"), [(0.06, "100 %"), (0.12, "very good"), (0.3, "good"), (0.5, "usable"), (0.9, "poor"), (7.0, "worse")]
)
def test_headline_grades_the_flights_not_seen(report: records.Report, fit: records.FitRecord, J: float, word: str):
    assert word in summary.headline(msgspec.structs.replace(report, before=with_list(fit, J)))


def test_a_list_that_is_worse_than_trim_is_graded_without_a_negative_share(report: records.Report):
    windows = records.WindowsRecord(median=None, p10=None, p90=None)
    flights = {
        name: records.FlightRecord(list=name, J=J, J_noise=0.05, J_trim=1.0, windows=windows, channels={})
        for name, J in {"validate": 0.3, "acid": 2.0}.items()
    }
    scores = records.ScoresRecord(identify=None, validate=0.3, acid=2.0)
    made = records.FitRecord(parameters=(), modes=(), flights=flights, scores=scores)
    said = summary.headline(msgspec.structs.replace(report, before=made))
    assert said.endswith("; on the acid flights worse than holding trim.")


@pytest.mark.parametrize(("J", "useless"), [(0.3, False), (2.0, True)])
def test_a_model_of_no_use_is_told_first_where_no_flight_was_kept_back(report: records.Report, J: float, useless: bool):
    windows = records.WindowsRecord(median=None, p10=None, p90=None)
    one = records.FlightRecord(list="identify", J=J, J_noise=0.05, J_trim=1.0, windows=windows, channels={})
    scores = records.ScoresRecord(identify=J, validate=None, acid=None)
    made = records.FitRecord(parameters=(), modes=(), flights={"one": one}, scores=scores)
    said = summary.headline(msgspec.structs.replace(report, before=made))
    assert said.startswith("On the identify flights the model is worse than holding trim: do not use") == useless
    assert "No flight was kept back" in said


@pytest.mark.parametrize(
    ("J", "said"),
    [
        (0.1, ""),
        (0.5, ""),
        (0.8, "on the validate flights the model explains only 36 % of the motion"),
        (1.5, "on the validate flights the model is worse than holding trim"),
        (math.inf, "on the validate flights the model is worse than holding trim"),  # not judged by the acid flights
    ],
)
def test_a_model_that_is_of_no_use_on_unseen_flights_is_told(fit: records.FitRecord, J: float, said: str):
    assert summary.failing(with_list(fit, J)) == said


@given(J=st.dictionaries(st.sampled_from(records.LISTS), st.floats(0.05, 30.0) | st.just(math.inf), min_size=1))
def test_every_model_that_is_worse_than_trim_is_told_by_the_list_that_decides(
    J: dict[Any, float],
):
    """Of lists whose noise alone scores 0.05, and held trim 1."""
    windows = records.WindowsRecord(median=None, p10=None, p90=None)
    flights = {
        name: records.FlightRecord(list=name, J=value, J_noise=0.05, J_trim=1.0, windows=windows, channels={})
        for name, value in J.items()
    }
    scores = records.ScoresRecord(**{name: J.get(name) for name in records.LISTS})
    made = records.FitRecord(parameters=(), modes=(), flights=flights, scores=scores)
    decides = next(name for name in ("validate", "acid", "identify") if name in J)
    said, explained = summary.failing(made), 1.0 - (J[decides] ** 2 - 0.05**2) / (1.0 - 0.05**2)
    assert bool(said) == (explained < summary.USABLE)
    assert said == "" or said.startswith(f"on the {decides} flights")
    assert ("worse than holding trim" in said) == (explained < 0.0)


def test_next_steps_name_what_is_wrong(report: records.Report, fit: records.FitRecord):
    steps = "\n".join(summary.next_steps(msgspec.structs.replace(report, before=with_list(fit, 7.0))))
    assert steps.count("worse than holding trim") == 1  # of all lists together
    assert re.search(r"worse than holding trim on the validate \(J 7.* against .*\) and acid \(J 7", steps)
    assert "forces.M.q at a bound" in steps
    assert "do not tell forces.N.u" in steps
    assert "phugoid" in steps
    assert "time to double 6.3 s" in steps


@pytest.mark.parametrize(("name", "J", "said"), [("p", 0.6, True), ("p", 0.1, False), ("u", 0.6, False)])
def test_a_poor_model_without_velocities_asks_for_them(report: records.Report, name: str, J: float, said: bool):
    assert report.before is not None
    parameter = records.ParameterRecord(name=f"forces.L.{name}", value=-3.2, se=0.05, unit="1/s")
    poor = msgspec.structs.replace(with_list(report.before, J), parameters=(parameter,))
    steps = summary.next_steps(msgspec.structs.replace(report, before=poor))
    assert any("record velocities" in step for step in steps) is said


def test_a_faultless_fit_says_that_nothing_stands_out(report: records.Report, fit: records.FitRecord):
    clean = msgspec.structs.replace(fit, parameters=fit.parameters[:1], modes=fit.modes[1:])
    (only,) = summary.next_steps(msgspec.structs.replace(report, before=clean))
    assert "Nothing stands out" in only


def test_weakest_channel_ignores_an_axis_that_hardly_moves(fit: records.FitRecord):
    def channel(rmse: float, r2: float) -> records.ChannelRecord:
        return records.ChannelRecord(rmse=rmse, r2=r2, theil=0.5, theil_parts=(0.0, 1.0, 0.0))

    moved, unmoved = channel(0.1, 0.99), channel(0.1, -3.0)
    flights = {
        "moves": msgspec.structs.replace(fit.flights["f1"], channels={"p": moved, "q": moved}),
        "judged": msgspec.structs.replace(fit.flights["f2"], channels={"p": unmoved, "q": channel(0.4, 0.8)}),
    }
    assert summary.weakest_channel(msgspec.structs.replace(fit, flights=flights)) == ("judged", "q", pytest.approx(0.4))


@pytest.mark.parametrize(
    ("eigenvalue", "words"),
    [
        ((-3.3, 0.0), ("", "", "0.21", "")),
        ((0.0, 0.0), ("", "", "", "")),
        ((0.11, 0.42), ("0.069", "-0.25", "", "6.3")),
        ((float("nan"), 0.0), ("", "", "", "")),
    ],
)
def test_a_mode_as_people_read_it(eigenvalue: tuple[float, float], words: tuple[str, ...]):
    (row,) = tables.mode_rows([records.ModeRecord(eigenvalue=eigenvalue, name="x")])
    assert (row.frequency, row.damping, row.halves, row.doubles) == words


def test_modes_of_one_name_are_numbered():
    modes = [
        records.ModeRecord(eigenvalue=(-k, 1.0), name=n) for k, n in ((1, "flapping"), (2, "wa1"), (3, "flapping"))
    ]
    assert [row.name for row in tables.mode_rows(modes)] == ["flapping 1", "inflow, fore and aft", "flapping 2"]


def test_the_scorecard_ends_with_the_verdict_and_one_thing_to_do(report: records.Report):
    written = io.StringIO()
    Console(width=100, file=written).print(scorecard(report))
    lines = [line for line in written.getvalue().splitlines() if line]
    warning = next(k for k, line in enumerate(lines) if line.startswith("warning:"))
    verdict = next(k for k, line in enumerate(lines) if line.startswith("On the validate flights"))
    worst, step = (next(k for k, line in enumerate(lines) if line.startswith(w)) for w in ("Worst channel:", "Next:"))
    assert warning < verdict < worst < step


def test_scorecard_fits_a_screen(report: records.Report):
    written = io.StringIO()
    Console(width=100, file=written).print(scorecard(report))
    text = written.getvalue()
    assert "0.120" in text
    assert "warning: the flight f2" in text
    assert len(text.splitlines()) < 25


def test_of_many_flights_the_page_shows_the_first_of_each_list(report: records.Report, fit: records.FitRecord):
    one = next(iter(fit.flights.values()))
    flights = {f"f{k}": msgspec.structs.replace(one, list=records.LISTS[k % 3]) for k in range(60)}
    many = msgspec.structs.replace(fit, flights=flights)
    assert list(summary.shown_flights(many)) == [f"f{3 * k + which}" for which in range(3) for k in range(12)]
    page = render(msgspec.structs.replace(report, before=many))
    assert "36 of the 60 flights" in page
    assert '<th scope="row">f59</th>' in page
    assert len(figures.scores(many).axes[0].get_yticks()) == 36


def test_the_picture_claims_no_gain_where_there_is_none(overlays: list[Overlay]):
    """Before and after are the same flights; then the model before is off by a constant."""
    same = main_picture(overlays, overlays)
    assert same is not None
    assert "is described worst; none gains" in same.caption
    assert "the error falls" not in same.caption
    worse = [replace(o, model={c: m + 1.0 for c, m in o.model.items()}) for o in overlays]
    better = main_picture(worse, overlays)
    assert better is not None
    assert "gains most: the error falls from" in better.caption


def test_the_picture_shows_no_response_that_does_not_count(report: records.Report, overlays: list[Overlay]):
    """A flight leaves alone what noise alone moves, and noise is described worst."""
    assert report.before is not None
    worst = main_picture([], overlays)
    assert worst is not None
    found = re.search(r"\((\w+)\) on (\w+),", worst.caption)
    assert found is not None
    channel, flight = found.groups()
    left = Response(rmse=1.0, r2=0.0, unit="rad/s2", moved=False)
    one = msgspec.structs.replace(next(iter(report.before.flights.values())), responses={channel: left})
    flights = report.before.flights | {flight: one}
    other = main_picture([], overlays, msgspec.structs.replace(report.before, flights=flights))
    assert other is not None
    assert f"({channel}) on {flight}," not in other.caption
    none = {o.flight: msgspec.structs.replace(one, responses=dict.fromkeys(o.measured, left)) for o in overlays}
    still = msgspec.structs.replace(report.before, flights=none)
    shown = main_picture([], overlays, still)
    assert shown is not None
    assert "is described worst" in shown.caption
    assert worst_of(still).endswith("flights the model moves none of the accelerations")


def test_the_picture_is_of_fitted_flights_where_there_are_no_others(overlays: list[Overlay]):
    shown = main_picture([], [replace(o, list="identify") for o in overlays])
    assert shown is not None
    assert "a flight that the model was made from" in shown.caption
    assert main_picture([], []) is None


def test_a_check_s_headline_leaves_many_reasons_to_the_axes_below():
    few, many = "limited to roll (yaw limited: r is noisy)", f"limited to roll ({'; '.join(['r is noisy'] * 20)})"
    assert check_headline(few) == "Limited to roll (yaw limited: r is noisy)."
    assert check_headline(many) == "Limited to roll."


def test_the_scorecard_says_the_next_command_with_the_places_at_hand(report: records.Report):
    written = io.StringIO()
    asked = msgspec.structs.replace(report, command="identify")
    Console(file=written, width=300).print(scorecard(asked, Path("my flights"), Path("my/run")))
    assert "rotorid close-loop 'my flights' --out my/run-loop" in written.getvalue()


@pytest.mark.parametrize(("low", "high"), [(0.9e-4, 2.1e-4), (0.003, 0.04), (1.2, 1.9), (1e-4, 30.0), (4.1e-4, 4.9e-4)])
def test_a_logarithmic_axis_has_two_numbers_at_least(low: float, high: float):
    assert len(ticks(low, high, 3, log=True)) >= 2


@pytest.mark.parametrize(("low", "high"), [(2e-4, 0.5), (2e-3, 50.0), (3e-5, 0.8), (2e-4, 2e3)])
def test_numbers_on_a_logarithmic_axis_stand_apart(low: float, high: float):
    """Where several decades are shown, two of one decade lie upon each other."""
    marks = ticks(low, high, 3, log=True)
    assert 2 <= len(marks) <= 4
    assert min(math.log10(b / a) for a, b in itertools.pairwise(marks)) >= 0.99


@pytest.mark.parametrize(("error", "said"), [(12.3, "10"), (0.00072, "0.0007"), (96.0, "100"), (0.3, "0.3")])
def test_an_error_has_one_digit_and_no_exponent(error: float, said: str):
    assert significant(error) == said


def test_the_picture_shows_the_channel_that_the_first_screen_calls_the_worst(
    report: records.Report, overlays: list[Overlay]
):
    assert report.before is not None
    sweep = report.before.flights["sweep"]
    poor = msgspec.structs.replace(sweep.channels["q"], rmse=5.0, r2=0.1)
    flights = {"sweep": msgspec.structs.replace(sweep, channels=sweep.channels | {"q": poor})}
    fit = msgspec.structs.replace(report.before, flights=flights)
    shown = main_picture([], overlays, fit)
    assert shown is not None
    assert worst_of(fit).startswith("pitch rate (q) on sweep")
    assert shown.caption.startswith("Pitch rate (q) on sweep")
    response = Response(rmse=1.0, r2=0.1, unit="rad/s", described=False)
    flown = msgspec.structs.replace(sweep, responses={"p": msgspec.structs.replace(response, described=True)})
    still = msgspec.structs.replace(sweep, list="acid", responses={"p": msgspec.structs.replace(response, rmse=9.0)})
    drone = msgspec.structs.replace(fit, flights={"dbl_lat_n": still, "sweep": flown})
    shown = main_picture([], overlays, drone)
    assert shown is not None
    assert worst_of(drone) == "roll rate (p) on the acid flights, 10 % explained"
    assert shown.caption.startswith("Roll rate (p) on dbl_lat_n")


def test_the_scorecard_names_three_of_what_takes_an_effect_s_place(report: records.Report):
    reason = "these flights would not show it: forces.X.a0, forces.X.u, forces.Y.r, forces.Z.w take its place"
    effect = records.EffectRecord(id="my.drag", role="undeclared", verdict="indistinguishable", reason=reason)
    written = io.StringIO()
    Console(width=300, file=written).print(scorecard(msgspec.structs.replace(report, effects=(effect,))))
    assert "forces.X.a0, forces.X.u, forces.Y.r and 1 more take its place" in written.getvalue()
