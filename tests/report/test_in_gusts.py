"""A model that was identified in gusts is judged with the gusts fed in, and the report says so."""

from __future__ import annotations

import msgspec
import pytest

from rotorid_torch.report.records import FitRecord, GustRecord, Report
from rotorid_torch.report.summary import air_of, headline, list_summaries


@pytest.fixture
def in_gusts(fit: FitRecord) -> FitRecord:
    flights = {n: msgspec.structs.replace(f, J=1.1, J_gust=0.9, J_fed=0.2) for n, f in fit.flights.items()}
    gust = GustRecord(axis="u", intensity=1.0, intensity_se=0.1, length=60.0, length_se=None)
    return msgspec.structs.replace(fit, flights=flights, gusts=(gust,))


def test_share_and_headline_are_of_runs_with_gusts(in_gusts: FitRecord, report: Report):
    for summary in list_summaries(in_gusts):
        assert summary.explained == pytest.approx(1.0 - (0.2**2 - 0.06**2) / (1.0 - 0.06**2))
    said = headline(msgspec.structs.replace(report, before=in_gusts))
    assert "the gusts that a smoother finds" in said


def test_both_scores_and_the_air_are_told(in_gusts: FitRecord, fit: FitRecord):
    said = air_of(in_gusts)
    assert "u 1 ± 0.1 m/s, length 60 ± - m" in said
    assert "identify 0.9 and 0.2" in said
    count = sum(f.list == "identify" for f in fit.flights.values())
    assert f"their {count} flights have in common, {1.0 / count**0.5:.2g} m/s" in said
    assert air_of(fit) == ""
