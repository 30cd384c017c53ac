"""The closed loop from Python and as a RUN: what is hidden is named, before and after are told, all in one folder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.core.parameters import ParameterSet
from rotorid_torch.data import Dataset
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR
from rotorid_torch.model.nominal import build
from rotorid_torch.model.save import load
from rotorid_torch.run import limits
from rotorid_torch.run.closing import _before_and_after, _in_gusts, _loop
from rotorid_torch.run.free_runs import best_of
from rotorid_torch.run.monitor import Monitor
from rotorid_torch.run.records import read_report
from rotorid_torch.trace.finding import Finding, Unknown
from rotorid_torch.trace.loop import Tracing
from rotorid_torch.trace.verdict import statement
from tests.known_models import flown, manoeuvres, rate_vehicle, with_values

DT = 0.02


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


def test_nothing_found_is_no_clean_bill_for_a_model_that_fails(
    closed: tuple[rotorid.Loop, Path], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("rotorid_torch.run.closing.failing", lambda fit: "on the validate flights the model is poor")
    loop, _ = closed
    tracing = replace(loop.tracing or pytest.fail("nothing was traced"), unknown=None)
    told = _loop(loop, None, [], Monitor(), tracing).record.verdict
    assert told is not None
    assert told.sentence.startswith("On the validate flights the model is poor. Something is missing from it")


@pytest.mark.parametrize(("judged", "poor", "told"), [(True, "", True), (False, "poor", True), (False, "", False)])
def test_what_no_clean_aircraft_judges_is_told_where_the_model_fails(
    closed: tuple[rotorid.Loop, Path], monkeypatch: pytest.MonkeyPatch, judged: bool, poor: str, told: bool
):
    monkeypatch.setattr("rotorid_torch.run.closing.failing", lambda fit: poor)
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
    assert any("shuffled residuals" in w for w in loop.record.warnings)


@pytest.mark.slow
def test_a_network_stays_where_something_is_left_that_no_candidate_explains(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("rotorid_torch.trace.loop.candidates", lambda spec: ([], []))
    monkeypatch.setattr("rotorid_torch.trace.network.MEANINGLESS", 1)
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


def test_effects_that_make_free_runs_worse_are_refused_and_what_they_took_up_is_told():
    null, final = run_with(None), run_with(None)
    findings = tuple(
        Finding(e, "undeclared", "indistinguishable", "", group=(other,), values={f"{e}.common": (0.05, 0.01)})
        for e, other in (("control.delay", "control.lag"), ("control.lag", "control.delay"))
    )
    missing = Unknown("L", (0.1, 2.0), "p", None, "Something is missing in L.")
    groups = {"control.delay": ("control.lag",)}
    tracing = Tracing(null, final, (), ("control.delay",), groups, findings, unknown_before=missing)
    first, better, worse = (run_with(J) for J in (0.12, 0.11, 0.13))
    fail = pytest.fail
    kept = _before_and_after(first, tracing, False, fail, lambda spec, values: better)
    assert kept == (first, better, tracing)
    before, after, refused = _before_and_after(first, tracing, False, fail, lambda spec, values: worse)
    assert (before, after) == (first, None)
    assert (refused.accepted, refused.groups, refused.final, refused.unknown) == ((), {}, null, missing)
    assert {f.verdict for f in refused.findings} == {"rejected"}
    assert statement(refused.findings, refused.unknown).kind == "unknown"


@pytest.mark.parametrize(("before", "after", "stays"), [(0.12, 0.06, True), (0.12, 0.1, False), (0.06, 0.052, True)])
def test_what_explains_less_than_what_stays_without_a_name_is_no_name(before: float, after: float, stays: bool):
    missing = Unknown("b1", (0.1, 2.0), "p lat", None, "Something is missing in b1.")
    delay = Finding("control.delay", "undeclared", "accepted", "", values={"control.delay.common": (0.05, 0.01)})
    tracing = replace(tracing_of("control.delay"), findings=(delay,), unknown=missing)
    first, run = run_with(before), run_with(after)
    _, _, found = _before_and_after(first, tracing, False, pytest.fail, lambda spec, values: run)
    assert bool(found.accepted) is stays
    assert found.unknown == missing
    assert statement(found.findings, found.unknown).kind == ("undeclared" if stays else "unknown")
    for other in (None, replace(missing, judged=False)):
        alone = _before_and_after(first, replace(tracing, unknown=other), False, pytest.fail, lambda spec, values: run)
        assert alone[2].accepted


@pytest.mark.parametrize(
    ("effect", "since", "stays"),
    [("control.backlash", 6.0, False), ("control.backlash", None, True), ("mass.slung_load", 6.0, True)],
)
def test_a_control_path_that_changes_in_the_midst_of_the_flights_has_no_name(
    effect: str, since: float | None, stays: bool
):
    missing = Unknown("b1", (0.1, 2.0), "lat", since, "Something is missing in b1.")
    named = Finding(effect, "undeclared", "accepted", "", values={f"{effect}.size": (0.005, 0.0001)})
    before = replace(missing, since_s=None)
    tracing = replace(tracing_of(effect), findings=(named,), unknown=missing, unknown_before=before)
    run = run_with(0.06)
    found = _before_and_after(run_with(0.12), tracing, False, pytest.fail, lambda spec, values: run)[2]
    assert bool(found.accepted) is stays
    assert found.unknown == missing
    assert statement(found.findings, found.unknown).kind == ("undeclared" if stays else "unknown")


def test_what_begins_later_is_told_of_the_model_that_stays_where_it_shows_it():
    """A refused effect takes up a part of it: what is left beside it may lie in another equation."""
    beside = Unknown("M", (0.1, 2.0), "ped", 6.0, "Something is missing in M.")
    before = replace(beside, where="N", sentence="Something is missing in N.")
    named = Finding("control.lag", "undeclared", "accepted", "", values={"control.lag.common": (0.05, 0.0001)})
    tracing = replace(tracing_of("control.lag"), findings=(named,), unknown=beside, unknown_before=before)
    found = _before_and_after(run_with(0.12), tracing, False, pytest.fail, lambda spec, values: run_with(0.06))[2]
    assert not found.accepted
    assert found.unknown == before


def test_what_begins_later_is_told_where_the_model_fails_on_the_fitted_flights_too():
    missing = Unknown("b1", (0.1, 2.0), "lat", 6.0, "Something is missing in b1.")
    tracing = replace(tracing_of("control.lag"), unknown=missing)
    before = over("identify", [1.5] * 6) | over("validate", [0.9] * 4)
    found = judged(before, over("identify", [1.2] * 6) | over("validate", [0.5] * 4), tracing)
    assert not found.accepted
    assert found.unknown == missing


@pytest.mark.parametrize(("verdict", "told"), [("accepted", False), ("below floor", True)])
def test_what_gusts_leave_over_is_not_told_as_something_missing(verdict: Any, told: bool):
    missing = Unknown("M", (0.1, 2.0), "v", None, "Something is missing in M.")
    tracing = replace(tracing_of(), unknown=missing, unknown_before=missing)
    found = _in_gusts(tracing, [Finding("environment.turbulence", "undeclared", verdict, "")])
    assert (found.unknown == missing, found.unknown_before == missing) == (told, told)


def tracing_of(*accepted: str, structure: tuple[str, ...] = ()) -> Tracing:
    """Null and final differ by their values, which say whose fit a run begins from."""
    null, final = (SimpleNamespace(spec=HELICOPTER, values={"from": k}) for k in (0.0, 1.0))
    return Tracing(null, final, structure, accepted, {}, ())


def test_structure_alone_begins_from_the_last_fit_of_the_search():
    first, begun, better = run_with(0.12), [], run_with(0.11)
    tracing = tracing_of(structure=("rotor.lead_lag",))

    def wrong(spec: Any, values: dict[str, float]) -> Any:
        begun.append(values["from"])
        return better

    assert _before_and_after(first, tracing, False, wrong, pytest.fail) == (first, better, tracing)
    assert begun == [1.0]
    worse = _before_and_after(first, tracing, False, lambda spec, values: run_with(0.13), pytest.fail)
    assert worse == (first, None, tracing)


def test_free_runs_of_a_multirotor_decide_nothing_and_cost_nothing():
    first, worse, runs = run_with(0.12), run_with(0.2), []
    first.spec = MULTIROTOR
    tracing = tracing_of("propulsion.motor_lag")
    found = _before_and_after(first, tracing, True, pytest.fail, lambda spec, values: runs.append(spec) or worse)
    assert found == (first, worse, tracing)
    assert len(runs) == 1


def test_sensors_alone_are_put_right_from_the_last_fit():
    first, better = run_with(0.12), {1.0: run_with(0.1)}
    tracing = tracing_of()
    found = _before_and_after(first, tracing, True, pytest.fail, lambda spec, values: better[values["from"]])
    assert found == (first, better[1.0], tracing)


def test_where_an_effect_is_refused_records_stay_right_and_the_null_stands():
    first, right = run_with(0.12), {0.0: run_with(0.1), 1.0: run_with(0.11)}
    tracing = tracing_of("control.delay")
    before, after, told = _before_and_after(first, tracing, True, pytest.fail, lambda spec, v: right[v["from"]])
    assert (before, after) == (first, right[0.0])
    assert (told.accepted, told.final) == ((), tracing.null)


def run_with(J: float | None, identify: float | None = None) -> Any:
    flights = {"f": SimpleNamespace(list="validate", J=J, J_noise=0.05, J_trim=1.0)}
    model = SimpleNamespace(parameter_set=ParameterSet(()), named_values={})
    fit = fit_of(flights)
    return SimpleNamespace(
        scores={"validate": J, "identify": identify}, spec=HELICOPTER, values={}, fit=fit, model=model
    )


def fit_of(flights: dict[str, Any]) -> Any:
    """Flights and the scores of their lists, root mean squares of the J that are known."""
    totals: dict[str, float | None] = {}
    for name in ("identify", "validate", "acid"):
        known = [f.J for f in flights.values() if f.list == name and f.J is not None and not math.isnan(f.J)]
        totals[name] = math.sqrt(sum(J * J for J in known) / len(known)) if known else None
    return SimpleNamespace(flights=flights, scores=SimpleNamespace(**totals), parameters=())


def over(list_: str, scores: Sequence[float]) -> dict[str, Any]:
    """Free runs of flights of one list."""
    return {f"{list_}{k}": SimpleNamespace(list=list_, J=J, J_noise=0.05, J_trim=1.0) for k, J in enumerate(scores)}


def judged(before: dict[str, Any], after: dict[str, Any], tracing: Tracing) -> Tracing:
    """What stands of the tracing where the model with its effects flies so."""
    first, run = run_with(0.1), run_with(0.1)
    first.fit, run.fit = fit_of(before), fit_of(after)
    return _before_and_after(first, tracing, False, pytest.fail, lambda spec, values: run)[2]


@pytest.mark.parametrize(
    ("after", "stays"),
    [
        ((0.101, 0.103, 0.099, 0.102), True),  # as good as before
        ((0.12, 0.11, 0.13, 0.12), False),
        ((0.2, 0.08, 0.09, 0.1), True),  # no worse but for chance
        ((0.05, 0.05, 0.05, 3.0), False),  # flies away, and the rest is better
        ((0.09, 0.09, 0.09, math.nan), False),
    ],
)
def test_free_runs_speak_against_an_effect_only_where_they_are_clearly_worse(after: tuple[float, ...], stays: bool):
    """Segments that no fit has seen gained by it; a free run drifts, and hides little of what they show."""
    found = judged(over("validate", [0.1] * 4), over("validate", after), tracing_of("control.delay"))
    assert bool(found.accepted) is stays


@pytest.mark.parametrize(("fitted", "stays"), [((0.1, 0.11, 0.1, 0.1), True), ((0.13, 0.11, 0.12, 0.1), False)])
def test_an_effect_that_makes_free_runs_of_fitted_flights_clearly_worse_is_refused(
    fitted: tuple[float, ...], stays: bool
):
    """Unseen flights may be as good as before by chance: what acts describes the flights it was fitted on better."""
    before = over("identify", [0.1] * 4) | over("validate", [0.2] * 4)
    after = over("identify", fitted) | over("validate", [0.199] * 4)
    assert bool(judged(before, after, tracing_of("control.backlash")).accepted) is stays


def test_flights_that_flew_away_without_an_effect_do_not_hide_those_that_do_with_it():
    before, after = ([0.1, 0.1, math.nan], [0.1, math.nan, 0.1])
    assert not judged(over("validate", before), over("validate", after), tracing_of("control.delay")).accepted


def test_acid_flights_decide_nothing():
    before = over("identify", [0.1] * 4) | over("acid", [0.1])
    after = over("identify", [0.098] * 4) | over("acid", [1.5])
    assert judged(before, after, tracing_of("control.delay")).accepted


@pytest.mark.parametrize(("sure", "after", "stays"), [(True, 0.102, True), (False, 0.102, False), (False, 0.098, True)])
def test_an_effect_that_segments_hardly_show_must_make_free_runs_better(sure: bool, after: float, stays: bool):
    tracing = replace(tracing_of("environment.wind"), sure=sure)
    first, run = run_with(0.1), run_with(after)
    found = _before_and_after(first, tracing, False, pytest.fail, lambda spec, values: run)[2]
    assert bool(found.accepted) is stays


@pytest.mark.parametrize(("before", "after", "stays"), [(0.25, 0.255, True), (0.35, 0.355, False), (0.355, 0.35, True)])
def test_free_runs_that_are_no_better_speak_for_an_effect_only_where_they_are_good(
    before: float, after: float, stays: bool
):
    """Held trim scores 1: what leaves more than a tenth of the squared motion may be imitated."""
    first, run = run_with(before), run_with(after)
    found = _before_and_after(first, tracing_of("control.lag"), False, pytest.fail, lambda spec, values: run)[2]
    assert bool(found.accepted) is stays


@pytest.mark.parametrize(("after", "stays"), [(0.5, True), (0.6, False)])
def test_a_model_that_still_does_not_describe_the_flights_earns_its_effects_no_name(after: float, stays: bool):
    """Held trim scores 1: more than 30 % of the squared motion is left."""
    found = judged(over("validate", [0.9] * 4), over("validate", [after] * 4), tracing_of("control.backlash"))
    assert bool(found.accepted) is stays


@pytest.mark.parametrize(("fitted", "stays"), [(0.5, True), (1.2, False)])
def test_a_model_that_does_not_describe_what_it_was_fitted_on_earns_no_name(fitted: float, stays: bool):
    """Unseen flights alone may be described by luck where they move less."""
    before = over("identify", [1.5] * 6) | over("validate", [0.9] * 4)
    after = over("identify", [fitted] * 6) | over("validate", [0.5] * 4)
    for flights in (before, after):
        flights["unscored"] = SimpleNamespace(list="identify", J=math.nan, J_noise=math.nan, J_trim=math.nan)
    assert bool(judged(before, after, tracing_of("control.lag")).accepted) is stays


@pytest.mark.parametrize(
    ("delay", "told", "said"),
    [
        (0.05, "free", None),
        (0.05, "not identifiable", "from nothing"),
        (0.0, "free", "from nothing"),
        (0.25, "free", "at the edge of its range"),
    ],
)
def test_what_is_nothing_or_no_physics_once_identified_again_has_no_name(delay: float, told: str, said: str | None):
    name = Finding("control.delay", "undeclared", "accepted", "", values={"control.delay.common": (0.05, 0.01)})
    first, run = run_with(0.12), run_with(0.1)
    run.model = with_values(build(HELICOPTER.with_effects("control.delay")), {"control.delay.common": delay})
    run.fit.parameters = (SimpleNamespace(name="control.delay.common", se=0.01, at_bound=False, status=told),)
    tracing = replace(tracing_of("control.delay"), findings=(name,))
    found = _before_and_after(first, tracing, False, pytest.fail, lambda spec, values: run)[2]
    assert bool(found.accepted) is (said is None)
    assert said is None or said in found.findings[0].reason


def test_what_is_nothing_in_the_end_takes_no_other_name_with_it():
    names = tuple(Finding(e, "undeclared", "accepted", "") for e in ("control.delay", "control.backlash"))
    tracing = replace(tracing_of("control.delay", "control.backlash"), findings=names)
    asked = []

    def right(spec: Any, values: Any) -> Any:
        asked.append(spec.effects)
        run = run_with(0.1)
        both = build(HELICOPTER.with_effects("control.delay", "control.backlash"))
        run.model = with_values(both, {"control.backlash.width": 0.005})
        told = {"at_bound": False, "status": "free"}
        run.fit.parameters = (
            SimpleNamespace(name="control.delay.common", se=0.01, **told),
            SimpleNamespace(name="control.backlash.width", se=0.0001, **told),
        )
        return run

    tracing.final.spec = HELICOPTER.with_effects("control.delay", "control.backlash")
    found = _before_and_after(run_with(0.12), tracing, False, pytest.fail, right)[2]
    assert found.accepted == ("control.backlash",)
    assert asked == [tracing.final.spec.effects, (*HELICOPTER.effects, "control.backlash")]
    assert {f.id: f.verdict for f in found.findings} == {"control.delay": "rejected", "control.backlash": "accepted"}


def test_a_good_effect_is_not_refused_for_the_structure_beside_it():
    whole, bare, first = run_with(0.107), run_with(0.1025), run_with(0.1)
    runs = iter((whole, bare))
    tracing = tracing_of("control.delay", structure=("rotor.lead_lag",))
    _, after, found = _before_and_after(first, tracing, False, lambda spec, v: first, lambda spec, v: next(runs))
    assert after is bare
    assert found.accepted


@pytest.mark.parametrize(("with_structure", "stays"), [(0.1, True), (0.103, True), (0.12, False)])
def test_ordinary_physics_stays_beside_a_named_effect_unless_free_runs_are_clearly_worse(
    with_structure: float, stays: bool
):
    """Without it the effect's size would take up what it explains."""
    whole, bare = run_with(with_structure), run_with(0.102)
    runs = iter((whole, bare))
    tracing = tracing_of("control.delay", structure=("rotor.lead_lag",))
    first = run_with(0.2)
    _, after, _ = _before_and_after(first, tracing, False, lambda spec, values: first, lambda spec, values: next(runs))
    assert after is (whole if stays else bare)


def test_a_run_without_a_score_is_not_thebest():
    first, unknown, none = run_with(0.12), run_with(math.nan), run_with(None)
    assert best_of([first, unknown]) is first
    assert best_of([unknown, first]) is first
    assert best_of([none, last := run_with(None)]) is last


def test_without_unseen_flights_the_fitted_ones_tell_which_model_flies():
    plain, astray = run_with(None, 0.6), run_with(None, 2e7)
    assert best_of([plain, astray]) is plain
    assert best_of([astray, plain]) is plain
