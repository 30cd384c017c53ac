"""The golden study: its cases, what its verdicts are worth, its tables, that it continues; a library with a gap."""

import dataclasses
import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import rotorid_torch
from rotorid_torch.data import Dataset
from rotorid_torch.effects.examples import HELICOPTER
from rotorid_torch.effects.registry import obstacle, registered
from tests.experiments.test_experiments import quick

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")
pytest.importorskip("torch.utils.tensorboard")


def golden() -> ModuleType:
    return import_module("golden")


def line(hidden: tuple[str, ...] | None = (), kind: str = "effect", **said: object) -> dict:
    """A case's line, as little of it as the tables need."""
    scores = {"identify": 0.1, "validate": 0.2, "acid": None}
    usual = {
        "case": f"{hidden} {kind} {said}",
        "code": "c0de",
        "git": "v1",
        "half": "tuning",
        "kind": kind,
        "hidden": None if hidden is None else list(hidden),
        "also": [],
        "size": 1.0 if hidden else 0.0,
        "aircraft": 0,
        "dataset": "",
        "verdict": "nothing undeclared",
        "sentence": "Nothing.",
        "named": [],
        "group": [],
        "suspected": [],
        "structure": [],
        "sizes": {},
        "unknown": None,
        "J": {"before": scores, "after": scores},
        "seconds": 60.0,
        "cpu_s": 30.0,
        "cold": False,
    }
    return usual | said


def test_halves_share_no_aircraft_and_no_noise_and_hide_everything_in_each_round() -> None:
    module = golden()
    halves = [list(module.drawn_cases(half, 20, 100, 2)) for half in module.SEEDS]
    assert len(set(module.SEEDS.values())) == 2
    assert {c.seed for c in halves[0]}.isdisjoint(c.seed for c in halves[1])
    for cases in halves:
        assert len({c.key for c in cases}) == len(cases)
        gusty = [c.hidden[1:] for c in cases if c.kind == "gusts"]
        assert gusty == [(), ("control.delay",), ("mass.slung_load",)] * 100
        cases = cases[:-300]
        clean, first = [c for c in cases if not c.hidden], [c for c in cases if c.hidden][: (len(cases) - 100) // 2]
        assert len(clean) == 100
        assert len({c.aircraft for c in clean[:20]}) == 20
        singles = [(c.kind, *c.hidden, c.size) for c in first if c.kind in ("effect", "removed")]
        kinds = [("effect", 1.0), ("effect", 0.5), ("removed", 1.0)]
        effects = import_module("golden_study.cases").HIDDEN
        pairs = [(kind, effect, size) for kind, size in kinds for effect in effects]
        assert sorted(singles) == sorted(p for p in pairs if p[0] != "removed" or not p[1].startswith("sensors."))
        assert sum(len(set(c.hidden)) == 2 for c in first) == 14
        assert max(np.bincount([c.aircraft for c in first])) - min(np.bincount([c.aircraft for c in first])) <= 1


def test_cases_of_sets_that_are_not_there_are_left_out(tmp_path: Path) -> None:
    module = golden()
    (tmp_path / "uh60-delay").mkdir()
    (tmp_path / "uh60-delay" / "dataset.toml").touch()
    cases = module.cases(module.Args(data=tmp_path, half=(module.Half.SHARED,)))
    assert [(c.kind, c.hidden) for c in cases] == [("shared", ("control.delay",)), ("removed", ("control.delay",))]
    only = module.cases(module.Args(data=tmp_path, only=(module.Kind.CLEAN,), clean=3))
    assert [c.kind for c in only] == ["clean"] * 3


@pytest.mark.parametrize(
    ("hidden", "said", "worth"),
    [
        ((), {}, "silent"),
        ((), {"named": ["control.lag"]}, "false name"),
        ((), {"verdict": "group", "group": ["control.lag", "control.delay"]}, "false name"),
        ((), {"verdict": "unknown"}, "no name"),
        (("control.lag",), {"named": ["control.lag"]}, "named"),
        (("control.lag",), {"named": ["control.lag", "mass.cg"]}, "false name"),
        (("control.lag",), {"named": ["control.lag", "mass.cg"], "also": ["mass.cg"]}, "named"),
        (("control.lag",), {"named": ["mass.cg"], "also": ["mass.cg"]}, "silent"),
        (("control.lag",), {"verdict": "group", "group": ["control.lag", "control.delay"]}, "in a group"),
        (("control.lag",), {"verdict": "group", "group": ["mass.cg", "control.delay"]}, "false name"),
        (("control.lag",), {"verdict": "group", "group": ["mass.cg", "unattributed.L"]}, "in a group"),
        (("control.lag", "sensors.bias"), {"named": ["sensors.bias"]}, "in part"),
        (("control.lag", "sensors.bias"), {"named": ["sensors.bias", "control.lag"]}, "named"),
        (("rotor.lead_lag",), {"structure": ["rotor.inflow", "rotor.lead_lag"]}, "named"),
        (("rotor.lead_lag",), {"structure": ["rotor.inflow"]}, "silent"),
        (("rotor.lead_lag",), {"structure": ["rotor.lead_lag"], "named": ["control.lag"]}, "false name"),
        (("outside.product",), {"verdict": "unknown"}, "no name"),
        (("control.lag",), {"kind": "removed", "named": ["control.delay"]}, "false name"),
        (("control.lag",), {"kind": "removed", "verdict": "unknown", "suspected": ["control.delay"]}, "no name"),
        (("control.lag",), {"kind": "removed", "structure": ["rotor.lead_lag"]}, "silent"),
    ],
)
def test_what_a_verdict_is_worth(hidden: tuple[str, ...], said: dict, worth: str) -> None:
    assert import_module("golden_study.table").outcome(line(hidden, **said)) == worth


def test_localised_means_the_right_equation_signal_and_onset() -> None:
    localised = import_module("golden_study.table").localised
    found = {"where": "L", "goes_with": "lat", "since_s": 6.3}
    assert localised(line(("outside.slipped_control",), unknown=found))
    assert not localised(line(("outside.slipped_control",), unknown=found | {"since_s": 6.6}))
    assert not localised(line(("outside.slipped_control",), unknown=found | {"where": "M"}))
    assert not localised(line(("outside.slipped_control",), unknown=found | {"goes_with": "time"}))
    assert not localised(line(("outside.slipped_control",)))
    assert not localised(line(("outside.product",), unknown={"where": "N", "goes_with": "p", "since_s": None}))
    assert localised(line(("outside.product",), unknown={"where": "N", "goes_with": "p col", "since_s": None}))
    assert not localised(line(("outside.product",), unknown={"where": "N", "goes_with": "p q", "since_s": None}))


def test_wilson_interval_against_scipy() -> None:
    stats = pytest.importorskip("scipy.stats")
    tables = import_module("recorded.tables")
    for hits, runs in ((0, 60), (3, 60), (17, 20), (5, 5)):
        interval = stats.binomtest(hits, runs).proportion_ci(0.95, "wilson")
        assert tables.wilson(hits, runs) == pytest.approx((interval.low, interval.high), abs=2e-5)


def test_tables_set_versions_side_by_side() -> None:
    size = import_module("golden_study.closed_loop").size
    sizes = {"a": size(0.066, 0.003, 0.06), "b": size(0.066, 0.004, 0.06), "c": size(0.1, 0.1, None)}
    assert [s["holds"] for s in sizes.values()] == [False, True, None]
    lines = [line(kind="clean", case=k) for k in range(3)]
    lines += [line(kind="clean", verdict="unknown"), line(kind="clean", suspected=["mass.cg"])]
    lines += [line(("control.delay",), named=["control.delay"], sizes=sizes, cold=True)]
    lines += [line(("control.delay",), named=["control.lag"], verdict="undeclared")]
    lines += [line(("mass.cg",), named=["control.lag"]), line(("mass.cg",), "removed", named=["control.lag"])]
    lines += [line(("control.lag",), "removed", failed="why")]
    lines += [line(None, "shared", half="shared", dataset="uh60-x1", code="other", git="v2")]
    text = import_module("golden_study.table").golden_table(lines)
    head, _, *rows = (row.strip("| ").split(" | ") for row in text.split("\n\n")[0].splitlines())
    assert head == ["what", "tuning, v1 (c0de)", "shared, v2 (other)"]
    rates = {what: cell for what, cell, _ in rows}
    assert rates["nothing hidden: something is named or suspected"].startswith("2 of 5")
    assert rates["identifiable, size 1: named, nothing false beside"] == "1 of 2 (50 %; 9 to 91 %)"
    assert rates["identifiable, size 0.5: named, nothing false beside"] == "no runs"
    assert rates["absorbed: misnamed"].startswith("1 of 1")
    assert rates["entry taken out of the library: misnamed"].startswith("1 of 1")
    assert rates["all wrong names"].startswith("3 of 9")
    assert rates["95 % intervals of named sizes that hold the truth"].startswith("1 of 2")
    assert rates["seconds of a case (of its processors), clean aircraft to be flown: median"] == "60 (30), 1 runs"
    assert rates["ended with an error"] == "1"
    assert "| effect | control.delay | 1 | 1 named, 1 false name | control.lag 1 | 60 (30), 2 runs |" in text
    assert "| shared | uh60-x1 | not stated | other | Nothing. | 0.200 → 0.200 |  →  | 60 |" in text


def test_a_study_continues_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, calls = golden(), []

    def run(case, shared: Path, aircraft: Path) -> dict:
        calls.append(case.key)
        return line(case=module.key(case)) | ({"failed": "no fit"} if case.repeat else {})

    monkeypatch.setattr(module, "run_case", run)
    monkeypatch.setenv("PYTHONSAFEPATH", "")
    monkeypatch.setattr(module, "draw", lambda number, seed, place: None)
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path / "cache"))
    args = module.Args(half=(module.Half.TUNING,), only=(module.Kind.CLEAN,), clean=3, aircraft=2, most=2)
    args.out, args.record = tmp_path / "out", tmp_path / "records" / "golden.jsonl"
    module.main(dataclasses.replace(args))
    with args.record.open("a", encoding="utf-8") as file:
        file.write('{"case": "half a li')  # as a killed run leaves it
    module.main(dataclasses.replace(args))
    module.main(dataclasses.replace(args))
    results = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    assert [(t["runs"], t["lines"]) for t in results] == [(2, 2), (1, 3), (0, 3)]
    assert len(set(calls)) == len(calls) == 3
    monkeypatch.setattr(import_module("golden_study.closed_loop"), "version", lambda: "another")
    module.main(dataclasses.replace(args))
    assert json.loads(capsys.readouterr().out)["runs"] == 2


def test_processes_load_the_version_that_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = golden()
    (tmp_path / "rotorid_torch").mkdir()
    (tmp_path / "rotorid_torch" / "__init__.py").write_text("raise SystemExit(7)")
    monkeypatch.setenv("PYTHONSAFEPATH", "")
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", str(Path(rotorid_torch.__file__).parents[1]))
    command = [sys.executable, "-m", "rotorid_torch.core.names"]
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == 7
    assert module.study(module.Args(most=0, out=tmp_path / "out", record=tmp_path / "golden.jsonl")) == 0
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == 0


def test_an_entry_is_out_of_the_library_as_long_as_it_is_asked_for() -> None:
    without = import_module("golden_study.closed_loop").without_entries
    entry = registered()["environment.turbulence"]
    with without(("environment.turbulence", "outside.product")):
        assert obstacle("environment.turbulence", HELICOPTER) == "taken out of the library"
        assert registered()["environment.turbulence"].role is entry.role
    assert registered()["environment.turbulence"] is entry
    assert "outside.product" not in registered()


def test_a_cause_is_put_into_the_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = import_module("golden_study.cases")
    time = np.arange(0.0, 4.0, 0.01)
    channels = {"time": time, "lat": np.sin(time), "p": np.cos(time)}
    data = Dataset.from_arrays({"f": channels}, identify=["f"], controls={"lat": {"unit": "rad"}})
    monkeypatch.setattr(module.rotorid, "load", lambda place: data)
    case = module.Case(module.Half.SHARED, module.Kind.REMOVED, ("control.delay",), 1.0, dataset="uh60-hover")
    flown = module.flights_of(case, tmp_path, tmp_path, tmp_path)
    assert flown.true == {"control.delay.common": 0.06}
    early, held = (flown.dataset.flights["f"].channels[c].numpy() for c in ("lat", "p"))
    assert np.nanmax(np.abs(early - np.sin(time + 0.06))) < 1e-4
    assert np.isnan(early).sum() < 12
    assert np.array_equal(held, np.cos(time))
    late = dataclasses.replace(case, dataset="uh60-delay")  # hides it by itself
    assert module.flights_of(late, tmp_path, tmp_path, tmp_path).dataset is data


def test_an_error_is_a_line_of_the_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module, cases = import_module("golden_study.closed_loop"), import_module("golden_study.cases")
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path))
    case = cases.Case(cases.Half.SHARED, cases.Kind.SHARED, dataset="uh60-hover")
    result = module.run_case(case, tmp_path / "none", tmp_path)
    assert result["failed"].startswith("InputError")
    assert result["case"] == module.key(case)


def test_the_quick_case_is_closed_and_recorded(tmp_path: Path) -> None:
    record = tmp_path / "golden.jsonl"
    kinds = ("--half", "tuning", "judging", "--only", "quick", "clean")
    result = quick("studies/golden", tmp_path, *kinds, "--record", str(record), "--out", str(tmp_path / "study"))
    assert (result["runs"], result["lines"]) == (1, 1)
    result = json.loads(record.read_text(encoding="utf-8"))
    assert result["verdict"] in ("nothing undeclared", "structure")
    assert result["J"]["after"]["identify"] < 0.2
    assert result["cpu_s"] > 0.0
