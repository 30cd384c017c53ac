"""Verdicts follow from numbers: unseen flights decide, what is absorbed is told with the flights that would tell."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from rotorid_torch.core.parameters import Parameter, ParameterSet
from rotorid_torch.trace.decide import (
    astray,
    at_edge,
    free_run_gain,
    not_joined,
    nothing,
    objection,
    rivals,
    smallest_visible,
)


def screened(gain: float, shown: float, imitators: tuple[str, ...] = ()) -> Any:
    signature = SimpleNamespace(effect="forces.drag", step=0.02, unit="1/m")
    return SimpleNamespace(
        gain=lambda effects: gain,
        shown=lambda effect: shown,
        imitators=lambda effect: imitators,
        signatures=(signature,),
    )


def test_what_derivatives_absorb_is_told_with_them_and_with_the_flights_that_would_separate_it():
    found = not_joined(screened(1e-4, 2e-4, ("forces.X.u",)), "forces.drag", 1e-3, (), hot=False)
    assert (found.verdict, found.group) == ("indistinguishable", ("forces.X.u",))
    assert found.reason.endswith("forces.X.u take its place; flights trimmed at other speeds would tell")


def test_what_would_have_shown_itself_is_below_its_floor():
    assert not_joined(screened(1e-4, 1.0), "forces.drag", 1e-3, (), hot=False).verdict == "below floor"


def test_what_an_accepted_effect_explains_better_is_rejected():
    found = not_joined(screened(0.0, 1.0), "forces.drag", 1e-3, ("rotor.stall",), hot=True)
    assert found.verdict == "rejected"
    assert "rotor.stall explains better" in found.reason


def test_the_smallest_visible_size_grows_with_the_root_of_the_floor():
    value, unit = smallest_visible(screened(0.0, 0.01), "forces.drag", 0.0001) or (0.0, "")
    assert (value, unit) == (pytest.approx(0.02 * 0.1), "1/m")
    assert smallest_visible(screened(0.0, 0.0), "forces.drag", 0.0001) is None


def fitted(
    cost: float, free_runs: tuple[float, ...], error: float = 0.01, value: float = 0.05, flights: int = 8
) -> Any:
    """A fit as decisions see it; its segments of unseen flights fit better the less it costs."""
    size = torch.full((len(free_runs), 1), cost, dtype=torch.float64)
    parameter = Parameter("forces.drag.x", 0.0, "1/m", (0.0, 1.0), typical=0.02)
    values = {"forces.drag.x": value}
    return SimpleNamespace(
        spec=SimpleNamespace(effects=("forces.drag",)),
        fit=SimpleNamespace(likelihood=SimpleNamespace(records=SimpleNamespace(dt=0.02))),
        flights=SimpleNamespace(dataset=SimpleNamespace(identify=tuple(str(f) for f in range(flights)))),
        cost=cost,
        per_sample=1.0,
        values=values,
        error=lambda name: error,
        free_runs=torch.tensor(free_runs, dtype=torch.float64),
        seen=SimpleNamespace(size=lambda: size),
        unseen=SimpleNamespace(size=lambda: size),
        model=SimpleNamespace(parameter_set=ParameterSet((parameter,)), named_values=values),
    )


@pytest.mark.parametrize(
    ("candidate", "reason"),
    [
        (fitted(1.0, (0.08, 0.09)), None),
        (fitted(1.0, (0.12, 0.14)), "free runs of flights that no fit has seen are worse by it (2 of 2)"),
        (fitted(1.0, (0.12, 0.09)), None),
        (fitted(1.0, (0.101, 0.102)), None),
        (fitted(1.0, (0.08, 0.09), error=float("inf")), "within 3 of its standard errors"),
        (fitted(1.0, (float("nan"), float("nan"))), None),
        (fitted(2.5, (0.08, 0.09)), "no more than clean aircraft"),
    ],
)
def test_free_runs_of_unseen_flights_decide_too(candidate: Any, reason: str | None):
    said = objection(fitted(2.0, (0.1, 0.1)), candidate, "forces.drag", 0.1, {"forces.drag.x": 0.001})
    assert (said is None) if reason is None else reason in (said or "")


def test_ordinary_physics_is_measured_by_chance_and_by_its_size():
    """Clean aircraft have it; what is nothing within its errors does not belong into a model."""
    said = objection(fitted(2.0, (0.1, 0.1)), fitted(2.5, (0.1, 0.1)), "rotor.speed", 0.1, {})
    assert said == "fitted in full, it explains no more than by chance"
    model = fitted(1.0, (0.1, 0.1)).model
    assert nothing(model, lambda name: 0.001, "forces.drag") is None
    assert "from nothing" in (nothing(model, lambda name: math.inf, "forces.drag") or "")


@pytest.mark.parametrize(
    ("flights", "scatter", "differs"),
    [(8, 0.018, False), (8, 0.022, True), (40, 0.022, False), (4, 0.018, True), (4, 0.01, False), (2, 0.0, False)],
)
def test_a_size_must_be_the_same_in_all_flights_as_far_as_so_few_of_them_tell(
    flights: int, scatter: float, differs: bool
):
    candidate = fitted(1.0, (0.08, 0.09), flights=flights)
    said = objection(fitted(2.0, (0.1, 0.1)), candidate, "forces.drag", 0.1, {"forces.drag.x": scatter})
    assert said == ("its size differs from flight to flight" if differs else None)


def test_flights_without_a_free_run_are_left_out():
    nan = float("nan")
    found = free_run_gain(fitted(1.0, (0.2, nan)), fitted(1.0, (0.1, nan)))
    assert found.tolist() == pytest.approx([0.6931], rel=1e-3)


@pytest.mark.parametrize(
    ("effects", "lag", "told"),
    [
        (("control.delay", "control.lag"), 0.011, True),
        (("control.delay", "control.lag"), 0.025, False),
        (("control.lag",), 0.011, False),
        (("forces.drag", "control.lag"), 0.011, False),
        (("control.backlash", "control.lag"), 0.011, False),
    ],
)
def test_a_lag_shorter_than_the_records_interval_is_no_finding_beside_a_delay(
    effects: tuple[str, ...], lag: float, told: bool
):
    candidate = fitted(1.0, (0.08, 0.09))
    candidate.spec.effects = effects
    parameter = Parameter("control.lag.common", 0.0, "s", (0.0, 1.0), typical=0.06)
    candidate.model.parameter_set = ParameterSet((parameter,))
    candidate.values = candidate.model.named_values = {"control.lag.common": lag}
    candidate.error = lambda name: 0.001
    said = objection(fitted(2.0, (0.1, 0.1)), candidate, "control.lag", 0.1, {"control.lag.common": 0.001})
    assert (said is not None) == told
    if told:
        assert "0.011 s beside control.delay is shorter than the interval of the records" in (said or "")


@pytest.mark.parametrize(
    ("other", "cost", "near"),
    [
        ("control.lag", 1.04, True),
        ("control.lag", 1.06, False),
        ("forces.drag", 1.04, False),
        ("forces.drag", 1.0, True),
    ],
)
def test_a_delay_and_a_lag_that_explain_nearly_the_same_are_not_told_apart(other: str, cost: float, near: bool):
    sizes = (0.1, 0.1)
    them = {"control.delay": fitted(1.0, sizes), other: fitted(cost, sizes)}
    found = rivals(fitted(2.0, sizes), them, dict.fromkeys(them, 0.01), list(them))
    assert found == ("control.delay", [other] if near else [])


@pytest.mark.parametrize(("nuisance", "edge"), [(False, True), (True, False)])
def test_how_flights_begin_may_lie_at_the_edge_of_its_range(nuisance: bool, edge: bool):
    place = Parameter("control.backlash.place.lon", 0.0, "1", (-1.0, 1.0), nuisance=nuisance)
    model: Any = SimpleNamespace(
        parameter_set=ParameterSet((place,)), named_values={"control.backlash.place.lon": -1.0}
    )
    assert (at_edge(model, "control.backlash") is not None) == edge


@pytest.mark.parametrize(("runs", "so"), [((0.2, 1e5), True), ((0.2, 2.0), False), ((math.nan, 0.9), True)])
def test_a_model_that_does_worse_than_held_trim_flies_astray(runs: tuple[float, ...], so: bool):
    model = fitted(1.0, runs)
    model.trims = torch.tensor([0.8, 0.8], dtype=torch.float64)
    assert astray(model) == so
