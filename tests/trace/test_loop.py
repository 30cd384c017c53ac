"""The loop on known models: what is hidden is named, with its size; where nothing is hidden nothing is named."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
import torch

from rotorid_torch.effects.base import Role, Showing
from rotorid_torch.effects.registry import registered
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.decide import gain
from rotorid_torch.trace.finding import Unknown
from rotorid_torch.trace.fits import Fitted
from rotorid_torch.trace.floor import Floors
from rotorid_torch.trace.loop import _missing, trace
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
    assert finding.gain is not None
    assert finding.floor is not None
    assert finding.gain > finding.floor
    value, error = finding.values["control.delay.lat"]
    assert abs(value - 0.06) < 3.0 * error + 2e-3
    assert finding.values["control.delay.lon"][0] == 0.0
    assert finding.values["control.delay.common"][0] == 0.0
    assert found.final.spec.each_control == ("control.delay",)
    assert build(found.null.spec).parameter_set.names  # and the model without it is whole


def test_a_hidden_delay_is_named_with_its_size():
    found = traced(flights("control.delay", control__delay__common=0.06))
    assert found.accepted == ("control.delay",)
    told = next(f for f in found.findings if f.id == "control.delay")
    value, error = told.values["control.delay.common"]
    assert isinstance(found.null, Fitted)
    assert isinstance(found.final, Fitted)
    assert told.gain == pytest.approx(gain(found.null, found.final), rel=0.01)
    assert abs(value - 0.06) < 3.0 * error
    assert error < 0.01


def test_a_hidden_lag_is_told_from_a_delay():
    found = traced(flights("control.lag", control__lag__common=0.08))
    assert found.accepted == ("control.lag",)
    assert next(f for f in found.findings if f.id == "control.delay").verdict == "rejected"


def test_a_lag_that_is_promising_is_weighed_against_a_delay_whatever_the_screen_says_of_that():
    known, null = started(flights("control.lag", control__lag__common=0.08))
    level, said = torch.full((24,), 1e-4, dtype=torch.float64), []

    def floors(model: object, effects: Sequence[str]) -> Floors:
        each = {e: 1e6 * level for e in effects if e.startswith("control.")}
        return Floors({e: 1e6 * level if e == "control.delay" else level for e in effects}, "", each_control=each)

    found = trace(null.spec, null.values, (), known, floors, said.append)
    assert found.accepted == ("control.lag",)
    assert any(line.startswith("control.delay: gain ") for line in said)


def test_what_has_no_name_is_judged_by_clean_aircraft_or_told_as_not_judged(monkeypatch: pytest.MonkeyPatch):
    """Clean aircraft that fly elsewhere, in still air say, tell nothing of it."""
    missing = Unknown("L", (0.1, 2.0), "p", None, "Something is missing in L.")
    monkeypatch.setattr("rotorid_torch.trace.loop.unknown", lambda *given: missing)
    known, null = started(flights())
    level = torch.full((24,), 1e-4, dtype=torch.float64)
    gains, weights = {"control.delay": level}, {"L": level}
    assert _missing(null, (), known, Floors(gains, ""), 0) is None
    assert _missing(null, (), known, Floors(gains, "", traces=weights), 0) == missing
    alone = _missing(null, (), known, Floors({}, ""), 0)
    assert alone is not None
    assert not alone.judged


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


def test_what_is_missing_without_a_name_is_told_of_the_fit_that_was_not_settled(monkeypatch: pytest.MonkeyPatch):
    asked: list[tuple[str, ...]] = []

    def missing(fitted: Fitted, accepted: Sequence[str], *rest: object) -> Unknown:
        asked.append(tuple(fitted.spec.effects))
        return Unknown(f"{len(asked)}", (0.1, 2.0), "ped", 6.0, "")

    monkeypatch.setattr("rotorid_torch.trace.loop._missing", missing)
    found = traced(flights())
    assert found.unknown == found.unknown_before
    found = traced(flights("control.delay", control__delay__common=0.06))
    assert asked == [(), (), ("control.delay",)]
    assert found.unknown != found.unknown_before
