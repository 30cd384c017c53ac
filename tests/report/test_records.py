"""report.json: what is written is read back equal, in the order of the contract, and bad files are told."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch.errors import InputError
from rotorid_torch.report import records

numbers = st.one_of(st.none(), st.floats(allow_nan=True, allow_infinity=True))
finite = st.one_of(st.none(), st.floats(allow_nan=False, allow_infinity=False))


def write(folder: Path, report: records.Report) -> Path:
    (folder / "report.json").write_bytes(records.encode_report(report))
    return folder


def test_report_round_trips(tmp_path: Path, report: records.Report):
    assert records.read_report(write(tmp_path, report)) == report


def test_keys_stand_in_the_order_of_the_contract(report: records.Report):
    top = json.loads(records.encode_report(report))
    expected = "format rotorid command dataset seed time_s peak_memory_mb before after verdict effects unknown warnings"
    assert list(top) == expected.split()
    assert list(top["before"]) == [
        *("method", "method_reason", "gusts"),
        *("parameters", "derivatives", "modes", "flights", "scores"),
    ]
    assert list(top["before"]["parameters"][0]) == ["name", "value", "se", "unit", "bounds", "at_bound", "status"]
    assert list(top["before"]["flights"]["sweep"]) == ["list", "J", "J_noise", "J_trim", "windows", "channels"]
    assert list(top["time_s"]) == ["reconstruct", "ftr", "ml", "trace", "total"]
    assert top["verdict"] is None
    assert top["after"] is None


def test_a_whole_report_of_close_loop_round_trips(tmp_path: Path, report: records.Report, fit: records.FitRecord):
    effect = records.EffectRecord(
        id="control.delay",
        role="undeclared",
        verdict="accepted",
        reason="gain above floor",
        gain=0.3,
        floor=0.02,
        smallest_visible=records.VisibleRecord(value=0.01, unit="s"),
        parameters=fit.parameters,
    )
    whole = records.Report(
        command="close-loop",
        dataset=report.dataset,
        seed=0,
        time_s=report.time_s,
        peak_memory_mb=1.0,
        before=fit,
        after=fit,
        verdict=records.VerdictRecord(kind="undeclared", effects=("control.delay",), sentence="The controls are late."),
        effects=(effect,),
        unknown=records.UnknownRecord(where="L", band_hz=(0.2, 2.0), goes_with="p", since_s=None, sentence="See L."),
    )
    assert records.read_report(write(tmp_path, whole)) == whole


@given(numbers, numbers, numbers)
def test_numbers_that_are_not_finite_become_null(value: float | None, se: float | None, bound: float | None):
    made = records.ParameterRecord(name="x", value=value, se=se, unit="", bounds=(-math.inf, bound))
    assert made.value is None or math.isfinite(made.value)
    assert made.bounds[0] is None
    assert made.bounds[1] is None or math.isfinite(made.bounds[1])


@given(finite, finite)
def test_finite_numbers_stay_as_they_are(value: float | None, se: float | None):
    made = records.ParameterRecord(name="x", value=value, se=se, unit="")
    assert (made.value, made.se) == (value, se)


@pytest.mark.parametrize("content", ["", "{", "[]", '{"format": 2, "rotorid": "9", "command": "identify"}'])
def test_what_is_no_report_is_told_in_one_line(tmp_path: Path, content: str):
    (tmp_path / "report.json").write_text(content)
    with pytest.raises(InputError, match=r"report\.json.*expected") as caught:
        records.read_report(tmp_path)
    assert "\n" not in str(caught.value)


def test_missing_report_is_told(tmp_path: Path):
    with pytest.raises(InputError, match="expected a RUN"):
        records.read_report(tmp_path / "nothing")
