"""The one decision: every row of its table, what the interval of a size says, what two fits say."""

from __future__ import annotations

import math
import string
from dataclasses import fields
from itertools import product
from typing import get_args

import numpy as np
import pytest
import torch
from scipy.stats import norm

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.model.model import Model
from rotorid_torch.trace.evidence.fits import Fitted, refit, total
from rotorid_torch.trace.search.decide import (
    TABLE,
    Interval,
    Reason,
    Row,
    Size,
    decide,
    errors_of,
    improves,
    likelihood_gain,
    size_by,
    size_of,
)
from rotorid_torch.trace.search.words import REASONS, reason, size_details
from rotorid_torch.trace.terms.finding import Verdict
from rotorid_torch.trace.terms.significance import exceeds
from tests.known_models import rate_vehicle, with_values
from tests.trace.hidden_flights import flights, started

DELAY, DAMPING = "control.delay", "forces.quadratic_damping"
CASES = [
    (Row(), "accepted", Reason.NAMED),
    (Row(part=True), "accepted", Reason.PART),
    (Row(part=True, testable=False), "accepted", Reason.PART),
    (Row(testable=False, significant=False), "not testable", Reason.NOT_TESTABLE),
    (Row(taken_up=True), "indistinguishable", Reason.TAKEN_UP),
    (Row(significant=False), "below floor", Reason.BELOW_LEVEL),
    (Row(significant=False, observable=False), "indistinguishable", Reason.ABSORBED),
    (Row(observable=False), "accepted", Reason.NAMED),
    (Row(still=False, in_set=False), "rejected", Reason.BETTER_EXPLAINED),
    (Row(fitted=False), "rejected", Reason.NO_BETTER_FIT),
    (Row(estimate=Interval.ACTIVE_BOUND), "rejected", Reason.ACTIVE_BOUND),
    (Row(estimate=Interval.WITHIN_ERROR), "rejected", Reason.WITHIN_ERROR),
    (Row(unseen_better=False), "rejected", Reason.UNSEEN_WORSE),
    (Row(in_set=False), "rejected", Reason.BETTER_EXPLAINED),
    (Row(runs_worse=True), "suspected", Reason.FREE_RUNS_WORSE),
    (Row(useful=False), "suspected", Reason.NO_MODEL),
    (Row(adequate=False), "suspected", Reason.NOT_ADEQUATE),
    (Row(alone=False), "indistinguishable", Reason.GROUP),
]


@pytest.mark.parametrize(("row", "verdict", "why"), CASES)
def test_each_row_of_the_table(row: Row, verdict: str, why: Reason):
    assert decide(row) == (verdict, why)


def test_no_row_of_the_table_is_left_out():
    assert {decide(row) for row, _, _ in CASES} == {(verdict, why) for _, verdict, why in TABLE}


def every_row() -> list[Row]:
    """All that can be observed of a candidate."""
    values = [list(Interval) if f.name == "estimate" else [False, True] for f in fields(Row)]
    return [Row(**dict(zip((f.name for f in fields(Row)), one, strict=True))) for one in product(*values)]  # pyright: ignore[reportArgumentType]


def test_a_name_is_given_only_where_everything_speaks_for_it():
    """Only what is significant, has a size and helps unseen flights; or what the model has from the start."""
    found = {decide(row)[0] for row in every_row()}
    assert found <= set(get_args(Verdict))
    for row in every_row():
        asked = (
            row.testable,
            not row.taken_up,
            row.significant,
            row.fitted,
            row.unseen_better,
            row.in_set,
            row.alone,
            row.adequate,
            not row.runs_worse,
            row.useful,
        )
        assert (decide(row)[0] == "accepted") == (row.part or (all(asked) and row.estimate is Interval.SIZE))


def test_what_no_clean_aircraft_would_tell_apart_is_no_name_whatever_else_is_observed():
    tested = [row for row in every_row() if row.testable and not row.part]
    assert {decide(row)[0] for row in tested if not row.significant} == {"below floor", "indistinguishable"}


def test_every_reason_has_words_and_their_blanks_are_filled():
    known = {
        "imitators": "a",
        "flights": "b",
        "others": "c",
        "explained_by": "d explains",
        "worse": 1,
        "share": 2.0,
        "least": 1.0,
    }
    known |= {"part": "e", "lacking": "f", "parameter": "p", "value": 1.0, "error": 0.1, "better": 1, "count": 2}
    assert set(REASONS) == set(Reason)
    for which, words in REASONS.items():
        assert {name for _, name, _, _ in string.Formatter().parse(words) if name} <= set(known)
        assert "{" not in reason(which, **known)


def late(value: float) -> Model:
    return with_values(rate_vehicle(effects=(DELAY,)), {f"{DELAY}.common": value})


def test_a_delay_within_half_a_sample_is_none():
    """Controls that are held between samples reach the rotor half a sample later than those that go straight."""
    for value, is_size in ((0.004, False), (0.006, False), (0.008, True)):
        found = size_by(late(value), {f"{DELAY}.common": 1e-3}, DELAY, between=0.005)
        assert (found.estimate is Interval.SIZE) == is_size
    turning = with_values(rate_vehicle(effects=(DAMPING,)), dict.fromkeys((f"{DAMPING}.{row}" for row in "LMN"), 0.004))
    assert size_by(turning, {f"{DAMPING}.L": 1e-3}, DAMPING, between=0.005).estimate is Interval.SIZE


@pytest.mark.parametrize("value", [0.05, -0.0, 0.0196, 0.0195])
def test_a_size_is_one_where_its_interval_of_95_per_cent_excludes_nothing(value: float):
    error = 0.01
    found = size_by(late(value), {f"{DELAY}.common": error}, DELAY)
    outside = abs(value) > norm.ppf(0.975) * error
    assert found == Size(Interval.SIZE if outside else Interval.WITHIN_ERROR, f"{DELAY}.common", value, error)


@pytest.mark.parametrize("tests", [1, 4, 20])
def test_intervals_of_several_effects_hold_their_level_together(tests: int):
    """Bonferroni: each at 0.05 over their number."""
    error = 0.01
    edge = float(norm.ppf(1.0 - 0.025 / tests)) * error
    for value, told in ((1.001 * edge, Interval.SIZE), (0.999 * edge, Interval.WITHIN_ERROR)):
        assert size_by(late(value), {f"{DELAY}.common": error}, DELAY, tests).estimate is told


def test_a_size_that_was_not_estimated_is_none():
    assert size_by(late(0.3), {}, DELAY).estimate is Interval.WITHIN_ERROR
    assert size_by(late(0.3), {f"{DELAY}.common": math.inf}, DELAY).estimate is Interval.WITHIN_ERROR


def test_of_several_sizes_the_surest_tells():
    """Roll is damped, pitch and yaw are not known."""
    model = rate_vehicle(effects=(DAMPING,))
    values = {f"{DAMPING}.L": 0.5, f"{DAMPING}.M": 5.0, f"{DAMPING}.N": 0.001}
    errors = {f"{DAMPING}.L": 0.05, f"{DAMPING}.M": 4.0, f"{DAMPING}.N": 0.1}
    found = size_by(with_values(model, values), errors, DAMPING)
    assert found == Size(Interval.SIZE, f"{DAMPING}.L", 0.5, 0.05)
    assert size_by(model, {n: 20.0 * e for n, e in errors.items()}, DAMPING).estimate is Interval.WITHIN_ERROR


def bounds_of(name: str) -> Parameter:
    model = late(0.0)
    return model.parameter_set.parameters[model.parameter_set.index(name)]


def test_a_size_at_an_end_of_its_range_is_none_but_nothing_is_no_end():
    name = f"{DELAY}.common"
    low, high = bounds_of(name).bounds
    assert low == bounds_of(name).value == 0.0
    assert size_by(late(high), {name: 1e-3}, DELAY) == Size(Interval.ACTIVE_BOUND, name, high)
    assert size_by(late(0.99 * high), {name: 1e-3}, DELAY).estimate is Interval.SIZE
    assert size_by(late(low), {name: 1e-3}, DELAY).estimate is Interval.WITHIN_ERROR


def test_a_bound_of_a_parameter_that_is_held_is_not_active():
    """Each control may have a delay of its own; where one size is common to all, those are held at nothing."""
    model = late(0.05)
    own = {p.name: p.free for p in model.parameter_set.sizes(DELAY)}
    assert own[f"{DELAY}.common"]
    assert len(own) > 1
    held = with_values(late(0.05), {n: bounds_of(n).bounds[1] for n, free in own.items() if not free})
    assert size_by(held, {f"{DELAY}.common": 0.001}, DELAY).estimate is Interval.SIZE


@pytest.fixture(scope="module")
def fits() -> tuple[Fitted, Fitted]:
    """The model without and with the delay that the flights have."""
    known, null = started(flights(DELAY, control__delay__common=0.06))
    return null, refit(null.spec.with_effects(DELAY), known, {**null.values, f"{DELAY}.common": 0.05}, near=null)


def test_what_two_fits_say_of_a_candidate(fits: tuple[Fitted, Fitted]):
    null, late = fits
    assert likelihood_gain(null, late) == pytest.approx((null.cost - late.cost) / null.per_sample)
    assert likelihood_gain(late, null) == -likelihood_gain(null, late) < 0.0
    better = null.log_ratios(late)
    identify, validate = null.flights.dataset.identify, null.flights.dataset.validate
    assert len(better) == len(identify) + len(validate)
    assert torch.equal(null.unseen_log_ratios(late), better[len(identify) :])
    assert exceeds(better)
    assert not exceeds(-better)
    residuals = [one.unseen.residual[one.unseen.flight == 0].numpy() for one in fits]
    rms = [np.sqrt(np.nanmean(r**2, axis=(0, 1))) for r in residuals]
    assert float(better[len(identify)]) == pytest.approx(float(np.mean(np.log(rms[0] / rms[1]))))


def test_a_flight_in_which_both_models_fly_away_tells_nothing_of_unseen_flights():
    inf = math.inf
    for ratios, better in (
        ([0.1, math.nan], True),
        ([-0.1, math.nan], False),
        ([-0.1, inf], True),  # the null alone flies away
        ([0.1, -inf], False),
        ([inf, -inf], False),
        ([math.nan], False),
    ):
        assert improves(torch.tensor(ratios)) is better
    assert total(torch.tensor([0.5, inf, math.nan, -inf, -0.2])) == pytest.approx(0.3)


def test_a_fit_that_failed_gains_nothing(fits: tuple[Fitted, Fitted], monkeypatch: pytest.MonkeyPatch):
    null, late = fits
    monkeypatch.setattr(Fitted, "cost", property(lambda one: math.nan if one is late else 0.0))
    assert likelihood_gain(null, late) == -math.inf


def test_errors_of_a_size_are_no_smaller_than_its_scatter_over_flights(fits: tuple[Fitted, Fitted]):
    null, late = fits
    name = f"{DELAY}.common"
    told = size_of(late, DELAY)
    assert (told.estimate, told.parameter, told.value) == (Interval.SIZE, name, late.values[name])
    assert told.error == max(late.error(name), late.scatter(DELAY)[name]) > 0.0
    assert errors_of(late, DELAY, {name: 9.0})[name] == (late.values[name], 9.0)
    assert errors_of(late, DELAY, {})[name] == (late.values[name], late.error(name))
    assert list(errors_of(late, DELAY, {})) == [name]  # sizes of single controls, which are held, were not estimated
    details = size_details(null, late, DELAY)
    assert (details["parameter"], details["better"], details["count"]) == (name, 4, 4)
