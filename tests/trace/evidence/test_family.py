"""The family of candidates: a pseudo-effect tells a name of the control path from what only imitates it."""

from __future__ import annotations

import pytest

from rotorid_torch.trace.evidence.family import Family, family
from rotorid_torch.trace.evidence.fits import Fitted, Flights, refit
from rotorid_torch.trace.evidence.screen import PATH
from rotorid_torch.trace.terms.candidate import Candidate
from tests.trace.hidden_flights import flights, started

FILTER = PATH


@pytest.fixture(scope="module")
def late() -> tuple[Flights, Fitted]:
    return started(flights("control.delay", control__delay__common=0.06))


def with_name(late: tuple[Flights, Fitted], effect: str) -> Family:
    """The family beside a model that has the effect under its name."""
    known, null = late
    spec = Candidate(effect).joined_to(null.spec)
    named = refit(spec, known, {**null.values, f"{effect}.common": 0.06}, near=null)
    return family(named, ["forces.quadratic_damping"], [effect])


def test_a_filter_of_the_controls_explains_more_beside_an_imitation_than_beside_the_cause(
    late: tuple[Flights, Fitted],
):
    beside = {e: with_name(late, e).contest[FILTER] for e in ("control.delay", "control.lag")}
    assert beside["control.lag"] > 0.1
    assert beside["control.delay"] < 0.1 * beside["control.lag"]


def test_the_filter_judges_no_more_than_names_of_the_control_path(late: tuple[Flights, Fitted]):
    alone = family(late[1], ["control.delay"])
    assert alone.statistics[FILTER] > 0.1
    assert FILTER not in alone.contest


def test_the_smallest_statistic_that_counts_is_that_of_one_more_parameter(late: tuple[Flights, Fitted]):
    alone = family(late[1], ["control.delay"])
    count, samples = len(late[0].dataset.identify), late[1].per_sample
    assert alone.least["control.delay"] == pytest.approx(0.5 * count * count / samples)
    assert not set(alone.least) & set(alone.descriptions)
