"""The loop on known models: what is hidden is named, with its size; where nothing is hidden nothing is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from rotorid_torch.effects.base import Role, Showing
from rotorid_torch.effects.registry import registered
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.critical_values import Draws, Null
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.loop import trace
from rotorid_torch.trace.search.decide import Reason
from rotorid_torch.trace.search.forward_selection import Search
from rotorid_torch.trace.search.trajectories import Trajectories
from tests.trace.hidden_flights import flights, started, traced


def test_a_hidden_rate_limit_is_told_from_a_delay():
    found = traced(flights("control.rate_limit", control__rate_limit__inverse=1.2))
    assert found.accepted == ("control.rate_limit",)
    value, error = next(f for f in found.findings if f.id == "control.rate_limit").values["control.rate_limit.inverse"]
    assert abs(value - 1.2) < 3.0 * error


def test_one_late_control_is_found_where_all_together_are_not_late():
    """What the model lacks makes the other one lead by as much."""
    late = {"control__delay__lat": 0.06, "control__delay__lon": -0.06}
    found = traced(flights("control.delay", **late))
    assert found.accepted == ("control.delay",)
    finding = next(f for f in found.findings if f.id == "control.delay")
    assert finding.statistic is not None
    assert finding.critical_value is not None
    assert finding.statistic > finding.critical_value
    value, error = finding.values["control.delay.lat"]
    assert abs(value - 0.06) < 3.0 * error + 2e-3
    assert finding.values["control.delay.lon"][0] == 0.0
    assert "control.delay.common" not in finding.values  # each control has its size
    assert found.final.spec.each_control == ("control.delay",)
    assert build(found.null.spec).parameter_set.names  # and the model without it is whole


def test_a_hidden_delay_is_named_with_its_size():
    found = traced(flights("control.delay", control__delay__common=0.06))
    assert found.accepted == ("control.delay",)
    told = next(f for f in found.findings if f.id == "control.delay")
    value, error = told.values["control.delay.common"]
    assert "control.delay" not in found.null.spec.effects
    assert found.final.values["control.delay.common"] == value
    assert abs(value - 0.06) < 3.0 * error
    assert error < 0.01


def test_a_hidden_lag_is_told_from_a_delay():
    found = traced(flights("control.lag", control__lag__common=0.08))
    assert found.accepted == ("control.lag",)
    assert next(f for f in found.findings if f.id == "control.delay").verdict == "rejected"


def test_what_is_not_told_from_an_effect_leaves_with_it():
    found = traced(flights("control.delay", control__delay__common=0.06))
    others = [replace(f, group=("control.delay",), verdict="indistinguishable") for f in found.findings if not f.group]
    without = replace(found, findings=tuple(others)).without(
        Reason.UNSEEN_WORSE, {"control.delay": "nothing is left of it"}
    )
    assert {f.verdict for f in without.findings if f.id in {one.id for one in others}} == {"rejected"}
    assert not any("control.delay" in f.group for f in without.findings)


def test_where_nothing_is_hidden_nothing_is_named():
    found = traced(flights())
    assert found.accepted == ()
    assert found.structure == ()
    assert {f.verdict for f in found.findings} <= {"below floor", "indistinguishable", "not testable", "rejected"}
    told = {f.id for f in found.findings}
    assert {
        n for n, e in registered().items() if e.showing is Showing.TRAJECTORIES and e.role is not Role.LEARNT
    } <= told
    delay = next(f for f in found.findings if f.id == "control.delay")
    assert delay.smallest_visible is not None
    assert delay.smallest_visible[0] < 0.06


def test_where_no_clean_aircraft_could_be_drawn_none_is_asked_for_again():
    """Beside a delay that joined: residuals of that model are turned, in the words that were said first."""
    known, null = started(flights("control.delay", control__delay__common=0.06))
    asked: list[Null] = []

    def draw(null: Null, _effects: Sequence[str], _observed: Family) -> str:
        asked.append(null)
        return "none drawn"

    search = Search(Trajectories(known), draw)
    first = search.family_beside(null, ["control.delay"])
    again = search.tested_beside(first.family, ["control.delay"])
    assert len(asked) == 1
    assert again.draws.note == first.draws.note
    assert again.draws.note.endswith(": none drawn")


def test_errors_hold_the_scatter_over_clean_aircraft_of_what_was_estimated():
    """A size of each control scatters too, and says nothing of one size of all."""
    known, null = started(flights("control.delay", control__delay__common=0.06))
    drawn = 0.01 * torch.randn(19, dtype=torch.float64, generator=torch.Generator().manual_seed(0))

    def draw(_null: Null, _effects: Sequence[str], observed: Family) -> Draws:
        nothing = {name: torch.zeros(19, dtype=torch.float64) for name in observed.statistics}
        sizes = {"control.delay.common": drawn, "control.delay.lon": 3.0 * drawn}
        return Draws(nothing, "19 aircraft", clean=True, least=observed.least, sizes=sizes)

    found = trace(Null(null.spec, null.values), known, draw)
    assert found.accepted == ("control.delay",)
    assert found.spread["control.delay.common"] >= float(drawn.std())
    assert "control.delay.lon" not in found.spread
