"""How a search ends: a name must explain the curves that stand out beside the model without names."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rotorid_torch.trace.evidence.fits import Fitted, Flights, refit
from rotorid_torch.trace.search.forward_selection import Search, Trial, row_of
from rotorid_torch.trace.search.outcome import Outcome, how_it_ended
from rotorid_torch.trace.search.trajectories import Trajectories
from rotorid_torch.trace.terms.candidate import Candidate
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
    return how_it_ended(search, (), final, effects)


def test_a_name_beside_which_the_curves_stay_is_suspected_and_what_stays_is_told(damped: tuple[Flights, Fitted]):
    outcome, unknown = ended(damped, LAG, common=0.03)
    assert outcome.share is not None
    assert outcome.share < SETTINGS.adequate
    assert not outcome.adequate
    assert unknown is not None
    assert (unknown.where, unknown.goes_with) == ("L", "p")


def test_a_name_that_takes_the_curves_is_adequate(damped: tuple[Flights, Fitted]):
    outcome, _ = ended(damped, DAMPING, L=3.0)
    assert outcome.adequate
