"""A pendulum is seen in the forces on the measured motion with about its size; where there is none, nothing is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import pytest
import torch

from rotorid_torch.identification.reconstruct import reconstruct
from rotorid_torch.identification.step2 import regress_model
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.fits import Fitted, Flights, refit
from rotorid_torch.trace.floor import Floors
from rotorid_torch.trace.forces import _explained, seen_in_forces
from rotorid_torch.trace.residual import LeftOver, left_over
from rotorid_torch.trace.screen import Signature, signatures
from rotorid_torch.trace.search import Search
from tests.known_models import flown, linear_vehicle, manoeuvres, with_values

DT = 0.02
LOAD = "mass.slung_load"


def without_load(ratio: float) -> Fitted:
    """What is fitted, knowing of no load, to flights of a vehicle that carries one."""
    truth = with_values(linear_vehicle(effects=(LOAD,)), {f"{LOAD}.ratio": ratio, f"{LOAD}.length": 6.0})
    data = flown(truth, manoeuvres(12.0, DT), DT, noise=0.02)
    found = reconstruct(data)
    model = build(propose(data, found))
    start = dict(zip(model.parameter_set.names, regress_model(model, data, found).theta.tolist(), strict=True))
    return refit(propose(data, found), Flights(data, found), start)


def test_a_load_is_seen_with_its_cable_and_about_its_size():
    found = seen_in_forces(without_load(0.1), (), [LOAD, "control.delay"], 0)
    assert set(found) == {LOAD}
    assert found[LOAD].gain > 3.0 * found[LOAD].chance
    assert found[LOAD].start[f"{LOAD}.length"] == 6.0
    assert found[LOAD].start[f"{LOAD}.ratio"] == pytest.approx(0.1, rel=0.4)


def test_what_clean_aircraft_show_in_forces_too_is_not_tried():
    null = without_load(0.1)
    gain = seen_in_forces(null, (), [LOAD], 0)[LOAD].gain

    def tried(clean: float) -> Sequence[str]:
        floors = Floors({}, "", in_forces={LOAD: torch.full((24,), clean, dtype=torch.float64)})
        return list(Search(null.flights, (), floors, lambda line: None, 0).seen_in_forces(null, (), [LOAD]))

    assert tried(0.9 * gain) == [LOAD]
    assert tried(1.1 * gain) == []


def test_equations_in_which_nothing_moves_tell_nothing():
    null = without_load(0.1)
    model = build(msgspec.structs.replace(null.spec, effects=(LOAD,)))
    over = left_over(null.model, null.flights.dataset, null.flights.reconstruction, null.flights.dataset.identify)
    still = replace(over, residual=over.residual.clone().index_fill_(1, torch.tensor([1, 3, 5]), 0.0))
    one = [s for s in signatures(model, [LOAD]) if s.beside][:1]
    gains, sizes = _explained(still, over.residual[..., None], one, 0)
    assert torch.isfinite(gains).all()
    assert torch.isfinite(sizes).all()
    none = replace(over, residual=torch.zeros_like(over.residual))
    assert not _explained(none, over.residual[..., None], one, 0)[0].any()


def test_no_load_is_seen_where_there_is_none():
    seen = seen_in_forces(without_load(0.0), (), [LOAD], 0)[LOAD]
    assert seen.gain <= seen.chance


def test_a_size_beside_another_at_its_bound_is_the_best_there():
    """Without bounds -0.8 and 2.3; within 0 to 2 the best are 0 and 0.7, not 0 and 2."""
    A = torch.tensor([[1.0, 1.0], [3.0, 1.0]], dtype=torch.float64).repeat(3, 1)
    y = torch.tensor([1.5, -0.1], dtype=torch.float64).repeat(3)
    none = torch.zeros(6, 0, dtype=torch.float64)
    over = LeftOver(("X",), y[:, None], (), none, torch.arange(6.0), none, none, torch.zeros(6), none[:, None])
    two = tuple(Signature("my.effect", f"my.effect.{n}", 0.0, 1.0, (0.0, 2.0), "") for n in "ab")
    sizes = _explained(over, A[:, None, :], two, 0)[1]
    torch.testing.assert_close(sizes, torch.tensor([0.0, 0.7], dtype=torch.float64))
