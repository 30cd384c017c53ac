"""Verdicts follow from numbers: unseen flights decide, what is absorbed is told with the flights that would tell."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from rotorid_torch.trace.decide import helps, left_over, smallest_visible


def gains(*numbers: float) -> torch.Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


@pytest.mark.parametrize(
    ("better", "answer"),
    [
        ((0.1, 0.12, 0.08, 0.11), True),
        ((0.3, -0.2, -0.1, 0.25), False),
        ((1.0, -0.01, -0.01, -0.01), False),
        ((-0.1, -0.1), False),
        ((0.1,), True),
    ],
)
def test_flights_that_no_fit_has_seen_gain_more_than_by_chance(better: tuple[float, ...], answer: bool):
    assert helps(gains(*better)) is answer


def screened(gain: float, shown: float, imitators: tuple[str, ...] = ()) -> Any:
    signature = SimpleNamespace(effect="forces.drag", step=0.02, unit="1/m")
    return SimpleNamespace(
        gain=lambda effects: gain,
        shown=lambda effect: shown,
        imitators=lambda effect: imitators,
        signatures=(signature,),
    )


def test_what_derivatives_absorb_is_told_with_them_and_with_the_flights_that_would_separate_it():
    found = left_over(screened(1e-4, 2e-4, ("forces.X.u",)), "forces.drag", 1e-3, (), hot=False)
    assert (found.verdict, found.group) == ("indistinguishable", ("forces.X.u",))
    assert found.reason.endswith("forces.X.u take its place; flights trimmed at other speeds would tell")


def test_what_would_have_shown_itself_is_below_its_floor():
    assert left_over(screened(1e-4, 1.0), "forces.drag", 1e-3, (), hot=False).verdict == "below floor"


def test_what_an_accepted_effect_explains_better_is_rejected():
    found = left_over(screened(0.0, 1.0), "forces.drag", 1e-3, ("rotor.stall",), hot=True)
    assert found.verdict == "rejected"
    assert "rotor.stall explains better" in found.reason


def test_the_smallest_visible_size_grows_with_the_root_of_the_floor():
    value, unit = smallest_visible(screened(0.0, 0.01), "forces.drag", 0.0001) or (0.0, "")
    assert (value, unit) == (pytest.approx(0.02 * 0.1), "1/m")
    assert smallest_visible(screened(0.0, 0.0), "forces.drag", 0.0001) is None
