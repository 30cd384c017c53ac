"""The study of hidden effects: its runs, what its verdicts are worth, its tables, and that it continues."""

import dataclasses
import json
import os
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.experiments.test_experiments import quick

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")
pytest.importorskip("torch.utils.tensorboard")


def study() -> ModuleType:
    return import_module("undeclared_effects")


def line(hidden: tuple[str, ...] = (), **said: object) -> dict:
    """A run's line, as little of it as the tables need."""
    errors = {"before": {"validate": 0.5, "acid": 0.4}, "after": {"validate": 0.2, "acid": 0.1}}
    usual = {
        "verdict": "nothing undeclared",
        "named": [],
        "group": [],
        "structure": [],
        "unknown": None,
        "parameters": {},
        "noise_removed": errors,
        "seconds": 60.0,
        "aircraft": 0,
        "size": 1.0 if hidden else 0.0,
    }
    return {"case": f"{hidden} {said}", "hidden": list(hidden)} | usual | said


def test_every_effect_and_cause_is_hidden_on_every_aircraft_beside_clean_runs_and_pairs() -> None:
    module = study()
    args = module.Args(aircraft=2, clean=5, clean_aircraft=3, pairs=4)
    made = module.cases(args)
    single = [c.hidden[0] for c in made if len(c.hidden) == 1 and c.aircraft == 1]
    assert sorted(single) == sorted((*module.HIDDEN, *module.CAUSES))
    assert sum(not c.hidden for c in made) == 5
    assert sum(len(set(c.hidden)) == 2 for c in made) == 4
    assert {c.aircraft for c in made if not c.hidden} == {0, 1, 2}
    assert len({c.key for c in made}) == len(made)
    assert made == module.cases(args)
    assert next(c for c in made if c.hidden == ("environment.wind",)).flights == ("all", "headings")


def test_first_runs_find_the_floors_once_per_aircraft_and_flights(tmp_path: Path) -> None:
    module = study()
    args = module.Args(aircraft=2, clean=2, clean_aircraft=2, pairs=0)
    first, rest = module.to_run(args, tmp_path / "none.jsonl")
    floors = [(c.aircraft, c.flights) for c in first]
    assert len(set(floors)) == len(floors)
    assert set(floors) == {(c.aircraft, c.flights) for c in rest} | set(floors)
    assert sorted(c.key for c in [*first, *rest]) == sorted(c.key for c in module.cases(args))


def test_what_does_not_exist_is_not_hidden() -> None:
    module = study()
    with pytest.raises(SystemExit, match=r"no 'control\.magic'"):
        module.cases(module.Args(effects=("control.magic",)))


@pytest.mark.parametrize(
    ("hidden", "said", "worth"),
    [
        ((), {}, "silent"),
        ((), {"named": ["control.lag"]}, "false name"),
        ((), {"verdict": "group", "group": ["control.lag", "control.delay"]}, "false name"),
        ((), {"verdict": "unknown"}, "no name"),
        (("control.lag",), {"named": ["control.lag"]}, "named"),
        (("control.lag",), {"named": ["control.lag", "mass.cg"]}, "false name"),
        (("control.lag",), {"verdict": "group", "group": ["control.lag", "control.delay"]}, "in a group"),
        (("control.lag",), {"verdict": "group", "group": ["mass.cg", "control.delay"]}, "false name"),
        (("control.lag",), {}, "silent"),
        (("control.lag", "sensors.bias"), {"named": ["sensors.bias"]}, "in part"),
        (("control.lag", "sensors.bias"), {"named": ["sensors.bias", "control.lag"]}, "named"),
        (("rotor.lead_lag",), {"structure": ["rotor.inflow", "rotor.lead_lag"]}, "named"),
        (("rotor.lead_lag",), {"structure": ["rotor.inflow"]}, "silent"),
        (("rotor.lead_lag",), {"structure": ["rotor.lead_lag"], "named": ["control.lag"]}, "false name"),
        (("outside.product",), {"verdict": "unknown"}, "no name"),
    ],
)
def test_what_a_verdict_is_worth(hidden: tuple[str, ...], said: dict, worth: str) -> None:
    assert import_module("loop_tables").outcome(line(hidden, **said)) == worth


def test_localised_means_the_right_equation_signal_and_onset() -> None:
    tables = import_module("loop_tables")
    found = {"where": "L", "goes_with": "lat", "since_s": 6.3}
    assert tables.localised(line(("outside.slipped_control",), unknown=found))
    assert not tables.localised(line(("outside.slipped_control",), unknown=found | {"since_s": 6.6}))
    assert not tables.localised(line(("outside.slipped_control",), unknown=found | {"where": "M"}))
    assert not tables.localised(line(("outside.slipped_control",), unknown=found | {"goes_with": "time"}))
    assert not tables.localised(line(("outside.slipped_control",)))
    assert not tables.localised(line(("outside.product",), unknown={"where": "N", "goes_with": "p", "since_s": None}))
    assert tables.localised(line(("outside.product",), unknown={"where": "N", "goes_with": "p col", "since_s": None}))
    assert not tables.localised(line(("outside.product",), unknown={"where": "N", "goes_with": "p q", "since_s": None}))


def test_wilson_interval_against_scipy() -> None:
    stats = pytest.importorskip("scipy.stats")
    tables = import_module("loop_tables")
    for hits, runs in ((0, 60), (3, 60), (17, 20), (5, 5)):
        interval = stats.binomtest(hits, runs).proportion_ci(0.95, "wilson")
        assert tables.wilson(hits, runs) == pytest.approx((interval.low, interval.high), abs=2e-5)


def test_tables_count_runs_and_stand_between_the_markers(tmp_path: Path) -> None:
    tables = import_module("loop_tables")
    delay = {"control.delay.common": {"value": 0.066, "se": 0.003, "unit": "s", "true": 0.06}}
    told = {"told": {"J": {}, "noise_removed": {"validate": 0.16, "acid": 0.1}}}
    lines = [line(case=k) for k in range(3)]
    lines += [line(("control.delay",), named=["control.delay"], parameters=delay, **told)]
    lines += [line(("control.delay",), named=["control.lag"], verdict="undeclared"), {"case": "x", "failed": "why"}]
    text, summary = tables.undeclared_tables(lines)
    assert summary == {"whole": 5, "failed": 1, "outcomes": {"silent": 3, "named": 1, "false name": 1}}
    assert "| identifiable effects at size 1: named, nothing false beside | 1 of 2 (50 %; 9 to 91 %) |" in text
    assert "control.lag 1 |" in text
    assert "| control.delay | 2 | 0.500 | 0.200 | 0.400 | 0.100 | 1.25 | common 1.10 (2.0) | 60 |" in text
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- one: begin -->\nold\n<!-- one: end -->\nz\n")
    tables.write_between(page, "one", text)
    assert page.read_text() == f"a\n<!-- one: begin -->\n{text}\n<!-- one: end -->\nz\n"
    with pytest.raises(SystemExit, match="no markers"):
        tables.write_between(page, "two", text)


def test_the_record_keeps_lines_of_all_studies_and_the_last_of_a_case(tmp_path: Path) -> None:
    lines, record = import_module("loop_lines"), tmp_path / "records" / "lines.jsonl"
    first = line(case="a", study=1, warnings=["long"])
    lines.record_lines(record, [first, {"case": "b", "study": 1, "failed": "why"}])
    kept = lines.record_lines(record, [first | {"study": 2}, first | {"verdict": "unknown"}])
    assert {one["case"]: one.get("verdict", one.get("failed")) for one in kept} == {
        "study 1, a": "unknown",
        "study 1, b": "why",
        "study 2, a": "nothing undeclared",
    }
    assert not any("warnings" in one for one in kept)
    assert lines.read_lines(record) == kept


def test_a_study_continues_where_it_stopped_and_tries_failures_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, calls = study(), []

    def run(case, drawn, told, seed) -> dict:
        calls.append(case.key)
        if case.hidden == ("control.lag",) and calls.count(case.key) == 1:
            return {"case": case.key, "hidden": ["control.lag"], "failed": "no fit"}
        return line(case.hidden, case=case.key, aircraft=case.aircraft)

    monkeypatch.setattr(module, "run_case", run)
    monkeypatch.setattr(module, "draw", lambda number, seed, place: None)
    args = module.Args(effects=("control.delay", "control.lag"), aircraft=1, clean=1, clean_aircraft=1, pairs=0)
    args.out = tmp_path
    module.main(dataclasses.replace(args))
    assert json.loads(capsys.readouterr().out)["runs"] == 3
    with (tmp_path / "runs.jsonl").open("a", encoding="utf-8") as file:
        file.write('{"case": "half a li')  # as a killed run leaves it
    module.main(dataclasses.replace(args))
    again = json.loads(capsys.readouterr().out)
    assert (again["runs"], again["whole"], again["failed"]) == (1, 3, 0)
    assert len(calls) == 4


def test_runs_at_the_same_time_share_the_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = import_module("loop_runs")
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.setenv("ROTORID_THREADS", "7")
    asked = [("OMP_NUM_THREADS",), ("ROTORID_THREADS",)]
    assert sorted(runs.lines_of(os.getenv, asked, 1)) == ["7", "7"]
    assert sorted(runs.lines_of(os.getenv, asked, 1000)) == ["1", "1"]


def test_flying_with_the_recorded_angles_is_flying(tmp_path: Path) -> None:
    causes, drawn = import_module("outside_causes"), import_module("drawn_aircraft")
    from rotorid_torch.fly.aircraft import CONTROLS
    from rotorid_torch.fly.flight import fly_batch
    from rotorid_torch.fly.flight_test import load_aircraft
    from rotorid_torch.fly.manoeuvres import Condition

    aircraft, names = load_aircraft(), ("f321_lat", "dbl_col_p")
    trims, gains = drawn._prepared(aircraft, [Condition(0.0, 27.4, 0.0)] * 2, 1.0)
    usual = fly_batch(aircraft, trims, gains, names, 0.5)
    own = causes.fly_with(aircraft, trims, gains, names, 0.5, lambda time, x, trimmed: x[CONTROLS])
    np.testing.assert_allclose(own.states, usual.states, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(own.specific_force, usual.specific_force, rtol=1e-12, atol=1e-12)


def test_outside_causes_change_only_what_they_say() -> None:
    causes = import_module("outside_causes")
    from rotorid_torch.fly.aircraft import CONTROLS, RATES
    from rotorid_torch.fly.flight_test import load_aircraft

    aircraft = load_aircraft()
    x, trimmed = np.zeros((aircraft.states, 2)), np.full((4, 2), 0.1)
    x[CONTROLS], x[RATES.start] = 0.12, 0.2
    slipped = causes.CAUSES["outside.slipped_control"].at_blades(0, aircraft, 1.0)
    np.testing.assert_array_equal(slipped(5.9, x, trimmed), x[CONTROLS])
    low, high = aircraft.limits[1]
    np.testing.assert_allclose(slipped(6.1, x, trimmed)[1], 0.11 + causes.SLIP * (high - low))
    np.testing.assert_array_equal(slipped(6.1, x, trimmed)[[0, 2, 3]], x[CONTROLS][[0, 2, 3]])
    product = causes.CAUSES["outside.product"].at_blades(0, aircraft, 1.0)
    np.testing.assert_allclose(product(1.0, x, trimmed)[3], 0.12 + causes.PICKED_UP * 0.02 * 0.2)
    np.testing.assert_array_equal(product(1.0, x, trimmed)[:3], x[CONTROLS][:3])


def test_drawn_aircraft_are_the_same_again_and_declare_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = import_module("drawn_aircraft")
    monkeypatch.setattr(drawn, "SECONDS", 2.0)
    first, second = drawn.draw(0, 7, tmp_path), drawn.draw(1, 7, tmp_path)
    assert first == drawn.draw(0, 7, tmp_path)
    assert first.vehicle["vehicle"]["mass"] != second.vehicle["vehicle"]["mass"]
    flown = drawn.fly_drawn(first, ("sensors.bias",), 2.0, ("dbl_lat_p",), 3, tmp_path)
    assert flown.declaration["vehicle"]["mass"] == pytest.approx(first.vehicle["vehicle"]["mass"])
    assert flown.declaration["channels"]["p"]["noise"] == pytest.approx(0.002 * first.noise)
    measured, right = flown.measured["dbl_lat_p"], flown.right["dbl_lat_p"]
    np.testing.assert_allclose(measured["p"] - right["p"], 0.02, atol=1e-9)
    np.testing.assert_array_equal(measured["phi"], right["phi"])
    assert np.std(measured["q"][:150]) == pytest.approx(0.002 * first.noise, rel=0.3)
    folder = flown.write(tmp_path / "set")
    assert not (folder / "truth").exists()


@pytest.mark.slow
def test_undeclared_effects_are_hidden_found_and_told(tmp_path: Path) -> None:
    result = quick("undeclared_effects", tmp_path, "--out", str(tmp_path / "study"))
    assert result["whole"] == 13
    assert result["failed"] == 0
    assert result["outcomes"].get("false name", 0) <= 2
