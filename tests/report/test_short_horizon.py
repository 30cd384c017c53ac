"""What a report says of a multirotor: what it explains and predicts; free runs do not appear."""

import math
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from rotorid_torch.report import records
from rotorid_torch.report.page.document import render
from rotorid_torch.report.scorecard import scorecard
from rotorid_torch.report.short_horizon import cell, explained, predicted, short_horizon
from rotorid_torch.report.summary import failing, headline, next_steps
from rotorid_torch.report.words.verdict import consequence
from rotorid_torch.run.result import SavedRun
from rotorid_torch.validate.judged import Prediction, Response


def response(rmse: float, r2: float) -> Response:
    return Response(rmse=rmse, r2=r2, unit="rad/s2")


def ahead(error: float, seconds: float = 0.5) -> Prediction:
    return Prediction(quantity="rates", seconds=seconds, unit="rad/s", error=error, held=2.0)


@pytest.fixture
def flown(report: records.Report) -> records.Report:
    """The report with responses and predictions of an excited and of a still acid flight."""
    fit = report.before
    assert fit is not None
    moved = msgspec.structs.replace(
        fit.flights["sweep"], J=40.0, responses={"pdot": response(1.0, 0.9), "omega1": response(40.0, 0.8)},
        predictions=(ahead(0.3, 0.1), ahead(1.0)),
    )  # fmt: skip
    still = msgspec.structs.replace(moved, responses={"pdot": response(0.1, -1.0)}, predictions=(ahead(3.0),))
    flights = {**fit.flights, "sweep": moved, "still": still}
    return msgspec.structs.replace(report, before=msgspec.structs.replace(fit, flights=flights))


def test_an_axis_that_a_flight_leaves_alone_counts_for_little(flown: records.Report):
    assert flown.before is not None
    (acid,) = short_horizon(flown.before)
    assert (acid.name, acid.flights) == ("acid", 2)
    assert acid.responses["pdot"] == pytest.approx(1.0 - 1.01 / (10.0 + 0.005))
    assert [(p.seconds, p.error) for p in acid.predictions] == [(0.1, 0.3), (0.5, 2.0)]
    assert explained(acid).endswith("the model explains 90 % of roll acceleration and 80 % of rotor speeds.")
    assert predicted(acid) == consequence(flown)
    assert predicted(acid) == "After 0.5 s the model is off in rates by 2 rad/s (2 if what was measured is held)."
    assert not acid.worse


def test_a_run_opens_with_what_its_report_opens_with(flown: records.Report):
    title = SavedRun(Path(), flown).title
    assert headline(flown).removesuffix(".") in title
    assert "J " not in title


def test_lists_that_measure_other_quantities_stand_in_one_table(flown: records.Report):
    """The velocities of a log without a position are predicted in no flight of its list."""
    assert flown.before is not None
    acid = flown.before.flights["sweep"]
    farther = msgspec.structs.replace(ahead(0.7), quantity="velocity")
    other = msgspec.structs.replace(
        acid, list="validate", responses={"ax": response(1.0, 0.5)}, predictions=(ahead(0.6, 0.1), farther)
    )
    fit = msgspec.structs.replace(flown.before, flights={"one": other, "two": acid})
    report = msgspec.structs.replace(flown, before=fit)
    console = Console(width=200, record=True)
    console.print(scorecard(report))
    for text in (render(report), console.export_text()):
        assert "velocity after 0.5 s" in text
        assert "rates after 0.5 s" in text
        assert "roll acceleration" in text
        assert "R² of forward force" in text


def test_a_flight_does_not_count_for_what_it_leaves_alone_nor_a_model_for_what_it_does_not_describe(
    flown: records.Report,
):
    assert flown.before is not None
    acid = flown.before.flights["sweep"]
    still = msgspec.structs.replace(response(1.0, -1.0), moved=False)
    silent = msgspec.structs.replace(response(1.0, 0.0), described=False)
    first = {"pdot": response(1.0, 0.9), "rdot": still, "ax": silent}
    flights = {
        "first": msgspec.structs.replace(acid, responses=first),
        "second": msgspec.structs.replace(acid, responses={"pdot": still, "rdot": still}),
    }
    fit = msgspec.structs.replace(flown.before, flights=flights)
    (horizon,) = short_horizon(fit)
    assert (horizon.still, horizon.silent) == (("rdot",), ("ax",))
    assert horizon.counted == pytest.approx({"pdot": 0.9})
    said = "Not counted: these flights leave yaw acceleration alone; nothing in the model makes forward force."
    assert predicted(horizon).endswith(said)
    assert failing(msgspec.structs.replace(fit, flights={"first": flights["first"]})) == ""


def test_a_constant_of_each_flight_is_taken_out_and_both_scores_are_told(flown: records.Report):
    """Two flights of one deviation, one with nothing but a constant as its error."""
    assert flown.before is not None
    off = msgspec.structs.replace(response(2.0, -3.0), constant=2.0, r2_without_constant=1.0)
    right = msgspec.structs.replace(response(0.5, 0.75), constant=0.0, r2_without_constant=0.75)
    acid = flown.before.flights["sweep"]
    flights = {n: msgspec.structs.replace(acid, responses={"ax": r}) for n, r in (("off", off), ("right", right))}
    (told,) = short_horizon(msgspec.structs.replace(flown.before, flights=flights))
    assert told.measured["ax"] == pytest.approx(1.0 - (4.0 + 0.25) / 2.0)
    assert told.responses["ax"] == pytest.approx(1.0 - (0.0 + 0.25) / 2.0)
    assert cell(told, "ax") == f"{told.responses['ax']:.3f} ({told.measured['ax']:.3f})"


def test_a_long_flight_counts_for_its_length(flown: records.Report):
    """Flights of 30 and 10 s count as four of 10 s, three of which are one flight."""
    assert flown.before is not None
    acid, pieces = flown.before.flights["sweep"], (response(0.5, 0.75), response(3.0, 0.1))
    long, short = (msgspec.structs.replace(r, seconds=t) for r, t in zip(pieces, (30.0, 10.0), strict=True))
    each = [long, short], [*[msgspec.structs.replace(long, seconds=10.0)] * 3, short]
    of = [{str(k): msgspec.structs.replace(acid, responses={"ax": r}) for k, r in enumerate(some)} for some in each]
    pooled = [short_horizon(msgspec.structs.replace(flown.before, flights=f))[-1].responses["ax"] for f in of]
    assert pooled[0] == pytest.approx(pooled[1])
    assert pooled[0] == pytest.approx(1.0 - (3 * 0.25 + 9.0) / (3 * 1.0 + 10.0))


def test_a_model_that_predicts_worse_than_holding_is_said_to_first(flown: records.Report):
    fit = flown.before
    assert fit is not None
    flights = {n: msgspec.structs.replace(f, predictions=(ahead(2.5),)) for n, f in fit.flights.items() if f.responses}
    worse = msgspec.structs.replace(fit, flights=flights)
    said = explained(short_horizon(worse)[-1])
    assert said.startswith("On the acid flights, which no fit has seen, the model predicts rates worse than holding")
    later = {n: msgspec.structs.replace(f, predictions=(ahead(0.3, 0.1), ahead(2.5))) for n, f in flights.items()}
    late = msgspec.structs.replace(fit, flights=later)
    assert any("Do not predict rates after 0.5 s" in s for s in next_steps(msgspec.structs.replace(flown, before=late)))
    said = explained(short_horizon(late)[-1])
    assert "the model predicts rates after 0.5 s worse than holding what was measured" in said
    assert failing(worse) == "on the acid flights the model predicts rates worse than holding what was measured"


def test_free_runs_do_not_appear(flown: records.Report):
    assert flown.before is not None
    assert headline(flown).startswith("On the acid flights, which no fit has seen, the model explains 90 %")
    assert failing(flown.before) == ""
    assert not any("worse than holding trim" in step for step in next_steps(flown))
    console = Console(width=200, record=True)
    console.print(scorecard(flown))
    text = console.export_text()
    assert "R² of roll acceleration" in text
    assert "holding trim" not in text
    page = render(flown)
    assert "R² of roll acceleration" in page
    assert "holding trim" not in page[: page.index('id="glossary"')]
    assert "Windows: J" not in page
    assert "Modes of the linearised model" not in page


def test_a_helicopters_report_has_no_word_of_it(report: records.Report):
    assert report.before is not None
    assert "Modes of the linearised model" in render(report)
    assert short_horizon(report.before) == []
    assert "responses" not in records.encode_report(report).decode()


def test_lists_go_by_all_flights(flown: records.Report):
    """Also by predictions that the first flight is too short for, and without what means nothing."""
    assert flown.before is not None
    acid = flown.before.flights["sweep"]
    silent = msgspec.structs.replace(response(1.0, 0.0), described=False)
    still = msgspec.structs.replace(response(1.0, -1.0), moved=False)
    endless = response(1.0, -math.inf)
    first = msgspec.structs.replace(acid, predictions=(), responses={"rdot": silent, "pdot": endless})
    second = msgspec.structs.replace(acid, responses={"rdot": still, "pdot": response(1.0, 0.9)})
    flights = {**flown.before.flights, "sweep": first, "still": second}
    (list_of_acid,) = short_horizon(msgspec.structs.replace(flown.before, flights=flights))
    assert [p.seconds for p in list_of_acid.predictions] == [0.1, 0.5]
    assert list_of_acid.silent == ("rdot",)
    assert list_of_acid.responses["pdot"] == pytest.approx(0.9)


def test_what_to_do_next_speaks_of_axes_that_the_model_lacks(flown: records.Report):
    assert flown.before is not None
    silent = msgspec.structs.replace(response(1.0, 0.0), described=False)
    acid = msgspec.structs.replace(flown.before.flights["sweep"], responses={"az": response(1.0, 0.9), "rdot": silent})
    report = msgspec.structs.replace(flown, before=msgspec.structs.replace(flown.before, flights={"sweep": acid}))
    assert next_steps(report)[0].startswith("Nothing in the model makes yaw acceleration: ")
    assert not any("Nothing in the model" in step for step in next_steps(flown))
