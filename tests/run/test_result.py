"""What Python gets from an identification."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from rotorid_torch.run import records
from rotorid_torch.run.figures import Overlay
from rotorid_torch.run.result import Run


@pytest.fixture
def run(report: records.Report, overlays: list[Overlay]) -> Run:
    return Run(SimpleNamespace(), report, tuple(overlays))


def test_table_lists_parameters_without_nuisances(run: Run):
    lines = run.table().splitlines()
    assert lines[0].split() == ["parameter", "value", "standard", "error", "unit", "status"]
    assert [line.split()[0] for line in lines[1:]] == ["forces.L.p", "forces.M.q", "forces.N.u"]
    assert "not identifiable" in lines[3]
    assert "at bound" in lines[2]


def test_scores_are_those_of_the_fit_that_counts(run: Run, fit: records.FitRecord):
    assert run.scores.acid == 0.12
    better = msgspec.structs.replace(fit, scores=records.ScoresRecord(identify=0.1, validate=0.1, acid=0.1))
    closed = Run(run.model, msgspec.structs.replace(run.record, after=better))
    assert closed.scores.acid == 0.1
    assert closed.before == fit
    assert closed.after == better


def test_report_is_the_page_or_the_numbers(run: Run, tmp_path: Path):
    page = run.report(tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == len(run.plot())
    run.report(tmp_path / "report.json")
    assert records.read_report(tmp_path) == run.record


def test_a_run_without_a_fit_says_so(run: Run):
    empty = Run(run.model, msgspec.structs.replace(run.record, before=None, command="check"))
    with pytest.raises(ValueError, match="check has no fit"):
        _ = empty.scores
