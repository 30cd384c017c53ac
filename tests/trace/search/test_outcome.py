"""How a search ends: a name must explain what stands out beside the model without names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
import torch

from rotorid_torch.trace.evidence.critical_values import Draws
from rotorid_torch.trace.evidence.fits import Fitted, Flights, refit
from rotorid_torch.trace.search.forward_selection import Search, Trial, row_of
from rotorid_torch.trace.search.outcome import Outcome, how_it_ended, of_motion_alone, share_explained
from rotorid_torch.trace.search.trajectories import Trajectories
from rotorid_torch.trace.terms.candidate import UNATTRIBUTED, Candidate
from rotorid_torch.trace.terms.finding import Unknown
from rotorid_torch.trace.terms.settings import SETTINGS
from tests.trace.hidden_flights import flights, started

DAMPING, LAG = "forces.quadratic_damping", "control.lag"


@pytest.fixture(scope="module")
def damped() -> tuple[Flights, Fitted]:
    """Roll is damped by the square of the rate, which the model lacks."""
    return started(flights(DAMPING, forces__quadratic_damping__L=6.0, noise=0.01))


def ended(damped: tuple[Flights, Fitted], effect: str, **sizes: float) -> tuple[Outcome, Unknown | None]:
    """How a search ends in which an effect has joined; residuals turned in time stand for clean aircraft."""
    shared, null = damped
    effects = [LAG, DAMPING]
    scored = Trajectories(shared)
    search = Search(scored, lambda null, asked, beside: replace(scored.draws_by_chance(beside, asked, 0), clean=True))
    search.family_beside(null, effects)
    start = {**null.values, **{f"{effect}.{name}": size for name, size in sizes.items()}}
    final = refit(null.spec.with_effects(effect), shared, start, near=null)
    candidate = Candidate(effect)
    search.joined, search.null = [candidate], null
    search.trials[candidate] = Trial(candidate, null, final, row_of(null, final, candidate))
    return how_it_ended(search, final, effects)


def test_a_name_beside_which_the_curves_stay_is_suspected_and_what_stays_is_told(damped: tuple[Flights, Fitted]):
    outcome, unknown = ended(damped, LAG, common=0.03)
    assert outcome.share is not None
    assert outcome.share < SETTINGS.adequate
    assert not outcome.adequate
    assert unknown is not None
    assert (unknown.where, unknown.goes_with) == ("L", "p")


def test_beside_a_name_that_explains_the_motion_what_is_next_to_nothing_there_is_left_out(
    damped: tuple[Flights, Fitted],
):
    """An onset in yaw stays, a fiftieth of what the damping explains in the motion."""
    outcome, unknown = ended(damped, DAMPING, L=3.0)
    assert outcome.adequate
    assert outcome.share is None
    assert unknown is None


SWINGING = {"X, curve": 0.014, "X, onset": 0.04, "L, curve": 0.011, "Y, step": 1e-4}
"""What stands out beside a model that lacks a load on a cable: the load swings on, whatever the controls do."""


def judged(after: Mapping[str, float]) -> float:
    """Share that names explain of what swings, by draws in which none of that is."""
    chance = torch.Generator().manual_seed(0)
    drawn = {f"{UNATTRIBUTED}{n}": 1e-4 * torch.rand(19, generator=chance, dtype=torch.float64) for n in SWINGING}
    draws = Draws(drawn, "", clean=True)
    before, beside = ({f"{UNATTRIBUTED}{n}": torch.tensor([t]) for n, t in one.items()} for one in (SWINGING, after))
    return share_explained(before, beside, of_motion_alone(beside), draws)


def test_a_name_that_takes_the_curves_of_what_swings_is_none_where_the_swinging_stays():
    share = judged({"X, curve": 0.005, "X, onset": 0.031, "L, curve": 0.004, "Y, step": 1e-4})
    assert share == pytest.approx(1.0 - 0.031 / 0.04)
    assert share < SETTINGS.adequate


def test_the_load_itself_explains_what_swings_and_a_step_beside_it_is_another_event():
    assert judged({"X, curve": 3e-4, "X, onset": 7e-4, "L, curve": 0.0017, "Y, step": 0.05}) > SETTINGS.adequate


def test_a_curve_that_a_name_does_not_touch_speaks_against_the_name_only_as_the_larger_part():
    share = judged({"X, onset": 0.0028, "X, curve": 0.014})
    assert share == pytest.approx(1.0 - 0.014 / 0.04, abs=0.1)  # usual sizes of the two differ by chance
    assert share > SETTINGS.adequate
