"""The closed loop from Python and as a RUN: what is hidden is named, before and after are told, all in one folder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.stats import ttest_1samp

import rotorid_torch as rotorid
from rotorid_torch.data import Dataset
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import load
from rotorid_torch.report import limits
from rotorid_torch.report.records import (
    FitRecord,
    FlightRecord,
    ParameterRecord,
    ScoresRecord,
    WindowsRecord,
    read_report,
)
from rotorid_torch.run.close_loop import _loop
from rotorid_torch.run.free_runs import before_and_after, free_run_gain, score_of, worse
from rotorid_torch.run.output.monitor import Monitor
from rotorid_torch.trace.evidence.critical_values import Null
from rotorid_torch.trace.loop import Tracing
from rotorid_torch.trace.terms.finding import EffectFinding, Unknown
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.verdict import statement
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DT = 0.02
MODEL = build(HELICOPTER)


def late(delay: float) -> Dataset:
    return hiding("control.delay", "common", delay, manoeuvres(8.0, DT))


def damped(quadratic: float) -> Dataset:
    """Rolls that are damped by p |p| as well."""
    large = {name: 3.0 * move for name, move in manoeuvres(6.0, DT).items()}
    return hiding("forces.quadratic_damping", "L", quadratic, large)


def hiding(effect: str, parameter: str, value: float, moves: dict[str, np.ndarray]) -> Dataset:
    truth = with_values(rate_vehicle(effects=(effect,)), {f"{effect}.{parameter}": value})
    both = {**moves, **{f"{name}_again": -0.8 * move for name, move in moves.items()}}
    lists = {"identify": list(moves), "validate": [f"{name}_again" for name in moves]}
    return flown(truth, both, DT, noise=0.02, seed=3, lists=lists)


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> tuple[rotorid.Loop, Path]:
    place = tmp_path_factory.mktemp("closed") / "RUN"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(limits, "of_rotors", lambda spec, fit: [f"remarked of {' '.join(spec.effects) or 'nothing'}"])
        return rotorid.close_loop(late(0.06), out=place, hybrid=True), place


def test_a_loop_draws_what_its_folder_holds(closed: tuple[rotorid.Loop, Path]):
    loop, place = closed
    drawn = loop.plot()
    assert {"evidence", "residual_spectrum"} <= set(drawn)
    assert set(drawn) == set(rotorid.open_run(place).plot())


def test_the_report_names_the_delay_with_its_error(closed: tuple[rotorid.Loop, Path]):
    loop, place = closed
    report = read_report(place)
    assert report.command == "close-loop"
    assert report.verdict is not None
    assert (report.verdict.kind, report.verdict.effects) == ("undeclared", ("control.delay",))
    delay = next(e for e in report.effects if e.id == "control.delay")
    value = next(p for p in delay.parameters if p.name == "control.delay.common")
    assert value.value == pytest.approx(0.06, abs=3.0 * (value.se or 0.0))
    assert {e.verdict for e in report.effects} >= {"accepted", "not testable"}
    assert report.time_s.trace is not None
    assert loop.verdict == report.verdict
    assert "the model again, with a delay in the control path" in (place / "log.txt").read_text()


def test_nothing_found_is_no_clean_bill_for_a_model_that_fails(
    closed: tuple[rotorid.Loop, Path], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("rotorid_torch.run.close_loop.failing", lambda fit: "on the validate flights the model is poor")
    loop, _ = closed
    tracing = replace(loop.tracing or pytest.fail("nothing was traced"), unknown=None)
    told = _loop(loop, None, [], Monitor(), tracing).record.verdict
    assert told is not None
    assert told.sentence.startswith("On the validate flights the model is poor. Something is missing from it")


@pytest.mark.parametrize(("judged", "poor", "told"), [(True, "", True), (False, "poor", True), (False, "", False)])
def test_what_no_clean_aircraft_judges_is_told_where_the_model_fails(
    closed: tuple[rotorid.Loop, Path], monkeypatch: pytest.MonkeyPatch, judged: bool, poor: str, told: bool
):
    monkeypatch.setattr("rotorid_torch.run.close_loop.failing", lambda fit: poor)
    loop, _ = closed
    missing = Unknown("L", (0.1, 2.0), "lat", 6.0, "Something is missing in L.", judged)
    tracing = replace(loop.tracing or pytest.fail("nothing was traced"), unknown=missing)
    record = _loop(loop, None, [], Monitor(), tracing).record
    assert (record.verdict.kind if record.verdict else None) == ("unknown" if told else "nothing undeclared")
    assert (record.unknown is not None) is told
    assert record.verdict is not None
    assert record.verdict.sentence.startswith("Poor. ") is bool(poor)


def test_unseen_flights_are_better_after_than_before(closed: tuple[rotorid.Loop, Path]):
    loop, _ = closed
    assert loop.before is not None
    assert loop.after is not None
    before, after = loop.before.scores.validate, loop.after.scores.validate
    assert before is not None
    assert after is not None
    assert after < 0.5 * before


def test_what_is_remarked_is_of_the_model_after(closed: tuple[rotorid.Loop, Path]):
    loop, _ = closed
    remarked = [w for w in loop.record.warnings if w.startswith("remarked of")]
    assert remarked == [f"remarked of {' '.join(loop.spec.effects)}"]
    assert "control.delay" in remarked[0]


def test_the_run_holds_model_pictures_and_page(closed: tuple[rotorid.Loop, Path]):
    _, place = closed
    model, spec = load(place / "model.pt")
    assert "control.delay" in spec.effects
    assert np.isfinite(model.theta.detach().numpy()).all()
    assert {"evidence.png", "residual_spectrum.png"} <= {f.name for f in (place / "figures").iterdir()}
    assert "control.delay" in (place / "report.html").read_text(encoding="utf-8")


def test_a_network_finds_nothing_left_beside_the_delay(closed: tuple[rotorid.Loop, Path]):
    loop, _ = closed
    network = next(e for e in loop.effects if e.id == "neural.forces")
    assert (network.role, network.verdict) == ("learnt", "rejected")
    assert "no fit has seen" in network.reason
    assert loop.verdict is not None
    assert "network" not in loop.verdict.sentence


def test_where_no_aircraft_can_be_drawn_the_report_says_so(closed: tuple[rotorid.Loop, Path]):
    loop, _ = closed
    assert any("residuals, turned in time" in w for w in loop.record.warnings)


@pytest.mark.slow
def test_a_network_stays_where_something_is_left_that_no_candidate_explains(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("rotorid_torch.trace.loop.candidates", lambda spec: ([], []))
    monkeypatch.setattr("rotorid_torch.learning.network.TRIALS", 1)
    loop = rotorid.close_loop(damped(8.0), hybrid=True)
    network = next(e for e in loop.effects if e.id == "neural.forces")
    assert (network.role, network.verdict) == ("learnt", "accepted")
    assert network.gain is not None
    assert network.floor is not None
    assert network.gain > network.floor
    assert loop.verdict is not None
    assert loop.verdict.kind == "nothing undeclared"
    assert "network" in loop.verdict.sentence
    assert loop.before is not None
    assert loop.after is not None
    before, after = loop.before.scores.validate, loop.after.scores.validate
    assert before is not None
    assert after is not None
    assert after < 0.8 * before


@pytest.mark.parametrize(("error", "accepted"), [(0.02, ()), (0.002, ("control.delay",))])
def test_a_name_whose_interval_holds_nothing_in_the_reported_model_is_rejected(error: float, accepted: tuple[str, ...]):
    model = build(HELICOPTER.with_effects("control.delay"))
    model.start_from({"control.delay.common": 0.01})
    size = ParameterRecord(name="control.delay.common", value=0.01, se=error, unit="s", status="free")
    first, run = run_with(0.12), run_with(0.11)
    run = replace(run, model=model, fit=msgspec.structs.replace(run.fit, parameters=(size,)))
    findings = (EffectFinding("control.delay", "undeclared", "accepted", ""),)
    tracing = replace(tracing_of("control.delay"), findings=findings)
    _, after, stands = before_and_after(first, tracing, False, pytest.fail, lambda spec, values: run)
    assert stands.accepted == accepted
    assert (after is run) == bool(accepted)
    assert ("the interval holds the size of nothing" in stands.findings[0].reason) == (not accepted)


def test_names_with_which_free_runs_are_worse_are_suspected_and_do_not_join():
    null = Null(HELICOPTER, {"from": 0.0})
    final = Null(HELICOPTER.with_effects("control.delay"), {"from": 1.0})
    findings = (
        EffectFinding("control.delay", "undeclared", "accepted", "", values={"control.delay.common": (0.05, 0.01)}),
        EffectFinding("control.lag", "undeclared", "below floor", "why"),
    )
    missing = Unknown("L", (0.1, 2.0), "p", None, "Something is missing in L.")
    tracing = Tracing(null, final, (), ("control.delay",), findings, unknown=missing)
    first, better, bad = (run_with(J) for J in (0.12, 0.11, 0.13))
    kept = before_and_after(first, tracing, False, pytest.fail, lambda spec, values: better)
    assert kept == (first, better, tracing)
    before, after, refused = before_and_after(first, tracing, False, pytest.fail, lambda spec, values: bad)
    assert (before, after) == (first, None)
    assert (refused.accepted, refused.unknown) == ((), missing)
    assert "control.delay" not in refused.final.spec.effects
    assert [f.verdict for f in refused.findings] == ["suspected", "below floor"]
    assert refused.findings[0].reason == "free runs of flights that no fit has seen are worse with it (1 of 1)"
    assert refused.findings[0].values == findings[0].values
    for unknown in (refused.unknown, None):
        told = statement(refused.findings, unknown)
        assert (told.kind, told.effects) == ("unknown", ())
        assert "control.delay (common 0.05 ± 0.01)" in told.sentence


def test_a_model_that_is_worse_than_holding_trim_names_nothing():
    first, useless, fair = run_with(1.6), run_with(1.5), run_with(0.9)
    findings = (EffectFinding("control.backlash", "undeclared", "accepted", ""),)
    tracing = replace(tracing_of("control.backlash"), findings=findings)
    assert before_and_after(first, tracing, False, pytest.fail, lambda spec, v: fair) == (first, fair, tracing)
    _, after, told = before_and_after(first, tracing, False, pytest.fail, lambda spec, v: useless)
    assert (after, told.accepted, told.findings[0].verdict) == (None, (), "suspected")
    assert "worse than holding trim" in told.findings[0].reason


def tracing_of(*accepted: str, structure: tuple[str, ...] = ()) -> Tracing:
    """Null and final differ by their values, which say whose fit a run begins from."""
    null, final = (Null(HELICOPTER, {"from": mark}) for mark in (0.0, 1.0))
    return Tracing(null, final, structure, accepted, ())


def test_structure_alone_begins_from_the_model_without_undeclared_effects():
    first, begun, better = run_with(0.12), [], run_with(0.11)
    tracing = tracing_of(structure=("rotor.lead_lag",))

    def wrong(spec: Any, values: dict[str, float]) -> Any:
        begun.append(values["from"])
        return better

    assert before_and_after(first, tracing, False, wrong, pytest.fail) == (first, better, tracing)
    assert begun == [0.0]
    worse = before_and_after(first, tracing, False, lambda spec, values: run_with(0.13), pytest.fail)
    assert worse == (first, None, tracing)


def test_free_runs_of_a_multirotor_decide_nothing_and_cost_nothing():
    first, worse, runs = replace(run_with(0.12), spec=MULTIROTOR), run_with(0.2), []
    tracing = tracing_of("propulsion.motor_lag")
    found = before_and_after(first, tracing, True, pytest.fail, lambda spec, values: runs.append(spec) or worse)
    assert found == (first, worse, tracing)
    assert len(runs) == 1


def test_sensors_alone_are_put_right_from_the_model_without_undeclared_effects():
    first, better = run_with(0.12), {0.0: run_with(0.1)}
    tracing = tracing_of()
    found = before_and_after(first, tracing, True, pytest.fail, lambda spec, values: better[values["from"]])
    assert found == (first, better[0.0], tracing)


def test_where_an_effect_is_refused_records_stay_right_and_the_null_stands():
    first, right = run_with(0.12), {0.0: run_with(0.1), 1.0: run_with(0.11)}
    tracing = tracing_of("control.delay")
    before, after, told = before_and_after(first, tracing, True, pytest.fail, lambda spec, v: right[v["from"]])
    assert (before, after) == (first, right[0.0])
    assert told.accepted == ()
    right[1.0] = run_with(0.09)
    before, after, told = before_and_after(first, tracing, True, pytest.fail, lambda spec, v: right[v["from"]])
    assert (before, after, told) == (first, right[1.0], tracing)


def run_with(J: float | None, identify: float | None = None) -> rotorid.Run:
    """A run by the J of one flight of a list that decides."""
    return run_of(over("validate", [J]) | ({} if identify is None else over("identify", [identify])))


def over(list_: Any, scores: Sequence[float | None]) -> dict[str, FlightRecord]:
    """Free runs of flights of one list."""
    windows = WindowsRecord(median=None, p10=None, p90=None)
    return {
        f"{list_}{k}": FlightRecord(list=list_, J=J, J_noise=0.05, J_trim=1.0, windows=windows, channels={})
        for k, J in enumerate(scores)
    }


def run_of(flights: dict[str, FlightRecord]) -> rotorid.Run:
    """A run whose free runs these are; of the steps it has nothing."""
    totals: dict[str, float | None] = {}
    for name in ("identify", "validate", "acid"):
        scores = [f.J for f in flights.values() if f.list == name and f.J is not None]
        totals[name] = math.sqrt(sum(J * J for J in scores) / len(scores)) if scores else None
    fit = FitRecord(parameters=(), modes=(), flights=flights, scores=ScoresRecord(**totals))
    nothing: Any = None
    return rotorid.Run(MODEL, HELICOPTER, fit, nothing, nothing, nothing, nothing, ())


def judged(before: dict[str, Any], after: dict[str, Any], tracing: Tracing) -> Tracing:
    """What stands of the tracing where the model with its effects flies so."""
    run = run_of(after)
    return before_and_after(run_of(before), tracing, False, pytest.fail, lambda spec, values: run)[2]


@pytest.mark.parametrize(
    ("after", "stays"),
    [
        ((0.101, 0.103, 0.099, 0.102), True),  # as good as before
        ((0.12, 0.11, 0.13, 0.12), False),
        ((0.1001, 0.1002, 0.1001, 0.1002), False),  # by little, but in every flight
        ((0.2, 0.08, 0.09, 0.1), True),  # no worse but for chance
        ((3.0, 3.0, 3.0, math.nan), False),
        ((0.05, 0.06, 0.05, math.nan), True),  # one flight says nothing of the mean
    ],
)
def test_free_runs_speak_against_an_effect_only_where_they_are_worse_by_more_than_chance(
    after: tuple[float, ...], stays: bool
):
    found = judged(over("validate", [0.1] * 4), over("validate", after), tracing_of("control.delay"))
    assert bool(found.accepted) is stays


@pytest.mark.parametrize("count", [2, 4, 9])
@pytest.mark.parametrize("shift", [-0.1, 0.02, 0.05, 0.2])
def test_worse_is_a_one_sided_t_test_of_log_ratios(count: int, shift: float):
    chance = np.random.default_rng(count)
    before = 0.1 * np.exp(0.1 * chance.standard_normal(count))
    after = before * np.exp(shift + 0.05 * chance.standard_normal(count))
    runs = [run_of(over("validate", list(J))) for J in (before, after)]
    ratios = np.log(before) - np.log(after)
    assert free_run_gain(*runs).numpy() == pytest.approx(ratios)
    p = ttest_1samp(ratios, 0.0, alternative="less").pvalue  # pyright: ignore[reportAttributeAccessIssue]
    assert worse(*runs) == (p < SETTINGS.level)


def test_a_flight_that_flies_away_with_both_models_says_nothing_of_either():
    both = [run_of(over("validate", [0.1, math.nan, None])) for _ in range(2)]
    assert free_run_gain(*both).tolist() == [0.0, 0.0, 0.0]
    assert not worse(*both)
    saved = [run_of(over("validate", J)) for J in ([math.nan, math.nan], [0.1, 0.12])]
    assert not worse(*saved)
    assert worse(*reversed(saved))


def test_where_no_flight_was_kept_back_the_fitted_ones_decide():
    before, after = over("identify", [0.1] * 4), over("identify", [0.12, 0.13, 0.12, 0.11])
    assert not judged(before, after, tracing_of("control.delay")).accepted
    unseen = over("validate", [0.1] * 4)
    assert judged(before | unseen, after | unseen, tracing_of("control.delay")).accepted


def test_acid_flights_decide_nothing():
    before = over("identify", [0.1] * 4) | over("acid", [0.1])
    after = over("identify", [0.098] * 4) | over("acid", [1.5])
    assert judged(before, after, tracing_of("control.delay")).accepted


def runs_of(*each: Sequence[float]) -> list[rotorid.Run]:
    """Runs by the scores of their flights that no fit has seen."""
    return [run_of(over("validate", scores)) for scores in each]


def test_a_good_effect_is_not_refused_for_the_structure_beside_it():
    first, whole, bare = runs_of([0.1] * 4, (0.107, 0.108, 0.107, 0.109), (0.102, 0.098, 0.101, 0.1))
    runs = iter((whole, bare))
    tracing = tracing_of("control.delay", structure=("rotor.lead_lag",))
    _, after, found = before_and_after(first, tracing, False, lambda spec, v: first, lambda spec, v: next(runs))
    assert after is bare
    assert found.accepted


@pytest.mark.parametrize(
    ("with_structure", "stays"),
    [((0.1, 0.1, 0.1, 0.1), True), ((0.105, 0.1, 0.106, 0.101), True), ((0.12, 0.13, 0.11, 0.12), False)],
)
def test_ordinary_physics_stays_beside_a_named_effect_unless_free_runs_are_worse_by_more_than_chance(
    with_structure: tuple[float, ...], stays: bool
):
    """Without it the effect's size would take up what it explains."""
    first, whole, bare = runs_of([0.2] * 4, with_structure, [0.102] * 4)
    runs = iter((whole, bare))
    tracing = tracing_of("control.delay", structure=("rotor.lead_lag",))
    _, after, _ = before_and_after(first, tracing, False, lambda spec, values: first, lambda spec, values: next(runs))
    assert after is (whole if stays else bare)


@pytest.mark.parametrize(
    ("with_structure", "stays"),
    [
        ((0.1, 0.1, 0.1, 0.1), True),
        ((0.101, 0.099, 0.09, 0.1), True),
        ((0.097, 0.092, 0.12, 0.107), False),  # in two of four flights better, and worse on average
        ((0.12, 0.13, 0.11, 0.12), False),
        ((0.1, 0.1, 0.1, math.nan), False),
    ],
)
def test_structure_alone_stays_unless_free_runs_are_worse_on_average_or_fly_away(
    with_structure: tuple[float, ...], stays: bool
):
    first, whole = runs_of([0.1] * 4, with_structure)
    tracing = tracing_of(structure=("rotor.lead_lag",))
    found = before_and_after(first, tracing, False, lambda spec, values: whole, pytest.fail)
    assert found == (first, whole if stays else None, tracing)


def test_a_run_without_a_score_is_not_the_best():
    assert score_of(run_with(0.12)) == 0.12
    assert score_of(run_with(math.nan)) == score_of(run_with(None)) == math.inf


def test_without_unseen_flights_the_fitted_ones_tell_which_model_flies():
    fitted, away = (run_of(over("identify", [J])) for J in (0.6, 2e7))
    assert score_of(fitted) < score_of(away)


def test_a_model_that_flies_away_on_unseen_flights_is_not_judged_by_the_fitted_ones():
    assert score_of(run_with(None, 0.6)) == math.inf
