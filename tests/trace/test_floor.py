"""Floors hold the share of false alarms over all candidates together, whatever their own scales are."""

from __future__ import annotations

import pytest
import torch

from rotorid_torch.trace.floor import Floors, family_wise
from rotorid_torch.trace.screen import Screen


def test_five_per_cent_of_clean_vehicles_pass_any_floor():
    chance = torch.Generator().manual_seed(0)
    scales = torch.tensor([1e-6, 1e-3, 1.0, 1e3], dtype=torch.float64)
    drawn, fresh = (
        torch.randn(4, n, generator=chance, dtype=torch.float64) ** 2 * scales[:, None] for n in (400, 4000)
    )
    names = ("a", "b", "c", "d")
    floors = family_wise(dict(zip(names, drawn, strict=True)))
    passed = torch.stack([fresh[i] > floors[e] for i, e in enumerate(names)]).any(dim=0)
    assert 0.02 < float(passed.to(torch.float64).mean()) < 0.09


def test_a_candidate_that_never_gains_has_no_floor_of_its_own():
    none, some = torch.zeros(30, dtype=torch.float64), torch.rand(30, dtype=torch.float64) + 0.1
    floors = family_wise({"never": none, "often": some})
    assert floors["never"] < 1e-200
    assert floors["often"] > float(some.mean())


def test_effects_of_all_controls_and_of_each_are_one_family():
    """Five per cent of clean vehicles pass any floor at all, whether a size is common or each control's own."""
    chance = torch.Generator().manual_seed(4)
    common, each = torch.rand(2, 400, dtype=torch.float64, generator=chance)
    nothing = Screen((), torch.zeros(1, 1, 1), torch.zeros(0), 1.0, ())
    floors = Floors({"control.delay": common, "mass.cg": 0.5 * common}, "", each_control={"control.delay": each})
    shared, own = floors.with_each_control(nothing, ["control.delay"], nothing, ["control.delay"])
    assert floors.of(nothing, ["control.delay"]) == shared
    assert set(shared) == {"control.delay", "mass.cg"}
    assert set(own) == {"control.delay"}
    passing = (common > shared["control.delay"]) | (each > own["control.delay"])
    assert 0.03 < float(passing.double().mean()) <= 0.05


def test_what_delays_seem_to_be_on_clean_aircraft_scatters():
    seemed = torch.tensor([-0.01, 0.0, 0.004, -0.002], dtype=torch.float64)
    floors = Floors({}, "", sizes={"control.delay.common": seemed, "control.lag.common": 0.0 * seemed})
    assert floors.scatter("control.delay") == {"control.delay.common": pytest.approx(seemed.numpy().std(ddof=1))}
    assert floors.scatter("mass.cg") == {}


def test_nothing_drawn_gives_no_floor():
    assert family_wise({}) == {}
