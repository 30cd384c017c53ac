"""What a report says of a multirotor: what it explains and predicts first, and that free runs mean nothing."""

from types import SimpleNamespace

import msgspec
import pytest
from rich.console import Console

from rotorid_torch.report import records, remarks
from rotorid_torch.report.html import render
from rotorid_torch.report.scorecard import scorecard
from rotorid_torch.report.short_horizon import FREE_RUN, explained, short_horizon
from rotorid_torch.report.summary import failing, headline, next_steps


def response(rmse: float, r2: float) -> records.ResponseRecord:
    return records.ResponseRecord(rmse=rmse, r2=r2, unit="rad/s2")


def ahead(error: float, seconds: float = 0.5) -> records.PredictionRecord:
    return records.PredictionRecord(quantity="rates", seconds=seconds, unit="rad/s", error=error, held=2.0)


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
    said = explained(acid)
    assert "roll acceleration 0.90, rotor speeds 0.80" in said
    assert "errors after 0.5 s: rates 2 rad/s (2 if held)" in said


def test_free_runs_are_told_to_mean_nothing_and_do_not_lead(flown: records.Report):
    assert flown.before is not None
    assert headline(flown).startswith("On the acid flights, which it has not seen, the model explains (R²")
    assert failing(flown.before) == ""
    assert not any("worse than holding trim" in step for step in next_steps(flown))
    console = Console(width=200, record=True)
    console.print(scorecard(flown))
    text = console.export_text()
    assert text.index("R² of roll acceleration") < text.index("free runs of 8 s, which mean nothing here")
    page = render(flown, {})
    assert "R² of roll acceleration" in page
    assert FREE_RUN[1:60] in page
    step3 = SimpleNamespace(fit=SimpleNamespace(minimum=SimpleNamespace(converged=True)))
    said = list(remarks.of_estimate(step3, flown.before))  # pyright: ignore[reportArgumentType]
    assert said[0] == FREE_RUN


def test_a_helicopters_report_has_no_word_of_it(report: records.Report):
    assert report.before is not None
    assert short_horizon(report.before) == []
    assert "responses" not in records.encode_report(report).decode()
