"""A pendulum is seen in the forces on the measured motion with about its size; where there is none, nothing is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from scipy.optimize import lsq_linear
from torch import Tensor

from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import Fitted, Flights, refit
from rotorid_torch.trace.evidence.force_evidence import derivatives_beside, equations_of, seen_in_forces
from rotorid_torch.trace.evidence.residual import LeftOver, left_over
from rotorid_torch.trace.evidence.screen import Screen, Signature, signatures
from rotorid_torch.trace.terms.candidate import Candidate
from tests.known_models import flown, linear_vehicle, manoeuvres, rate_vehicle, with_values
from tests.trace import hidden_flights

DT = 0.02
LOAD = "mass.slung_load"


@cache
def without_load(ratio: float) -> Fitted:
    """What is fitted, knowing of no load, to flights of a vehicle that carries one."""
    truth = with_values(linear_vehicle(effects=(LOAD,)), {f"{LOAD}.ratio": ratio, f"{LOAD}.length": 6.0})
    data = flown(truth, manoeuvres(12.0, DT), DT, noise=0.02)
    found = reconstruct(data)
    model = build(propose(data, found))
    start = dict(zip(model.parameter_set.names, regress_model(model, data, found).theta.tolist(), strict=True))
    return refit(propose(data, found), Flights(data, found), start)


def over_of(null: Fitted) -> LeftOver:
    return left_over(null.model, null.flights.dataset, null.flights.reconstruction, null.flights.dataset.identify)


def seen(null: Fitted, *effects: str) -> Screen:
    return seen_in_forces(null, over_of(null), [Candidate(e) for e in effects])


def held_out(over: LeftOver, changes: Tensor, variant: Sequence[Signature]) -> tuple[Tensor, Tensor]:
    """Sizes of the parameters of an effect, and its evidence."""
    screened = Screen(tuple(variant), (), equations_of(over, changes))
    values = screened.shown(variant[0].effect)
    sizes = torch.tensor([values[s.parameter] for s in variant], dtype=torch.float64)
    return sizes, screened.evidence(variant[0].effect)


def test_a_load_is_seen_with_its_cable_and_about_its_size():
    found = seen(without_load(0.1), LOAD, "control.delay")
    assert found.candidates == (Candidate(LOAD),)
    assert bool((found.evidence(LOAD) > 0.0).all())
    assert len(found.evidence(LOAD)) == 4
    assert found.shown(LOAD)[f"{LOAD}.length"] == 6.0
    assert found.shown(LOAD)[f"{LOAD}.ratio"] == pytest.approx(0.1, rel=0.4)
    assert seen(without_load(0.1), "control.delay").candidates == ()


def test_no_load_is_seen_where_there_is_none():
    none, some = (float(seen(without_load(ratio), LOAD).evidence(LOAD).sum()) for ratio in (0.0, 0.1))
    assert none < 0.05 * some


def equations(rows: int, seed: int = 0) -> tuple[LeftOver, Tensor]:
    """Residuals of some equations on four flights beside two signals, and what two parameters of an effect change."""
    chance = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=chance, dtype=torch.float64)  # noqa: E731
    signals, changes = draw(200, 2), draw(200, rows, 2)
    flight = torch.arange(4).repeat_interleave(50)
    own = torch.nn.functional.one_hot(flight).to(torch.float64)
    scale = torch.logspace(-2, 2, rows, dtype=torch.float64)
    residual = scale * draw(200, rows) + changes @ torch.tensor([0.7, -0.2], dtype=torch.float64)
    names = ("X", "M", "N")[:rows]
    time, none = DT * torch.arange(50.0).repeat(4).double(), signals[:, :0]
    return LeftOver(names, residual, ("p", "q"), signals, time, own, none, flight, changes[..., :0]), changes


def two(low: float = -9.0, high: float = 9.0) -> tuple[Signature, ...]:
    return tuple(Signature("my.effect", f"my.effect.{n}", 0.0, 1.0, (low, high), "") for n in "ab")


@pytest.mark.parametrize(("low", "high"), [(-9.0, 9.0), (0.0, 0.5)])
def test_evidence_in_forces_is_that_of_exact_refits_without_each_flight(low: float, high: float):
    """Against a bounded solver of its own on the equations' rows, each as sharp as its residual."""
    over, changes = equations(3)
    rows = [torch.cat([changes[:, k], over.residual[:, k, None]], dim=1) for k in range(3)]
    beyond = np.stack([over.beyond(one, k).numpy() for k, one in enumerate(rows)])
    beyond = beyond / np.sqrt(np.square(beyond[..., -1]).mean(axis=1))[:, None, None]

    def size(kept: np.ndarray) -> np.ndarray:
        stacked = beyond[:, kept].reshape(-1, 3)
        return lsq_linear(stacked[:, :2], stacked[:, 2], (low, high), method="bvls", tol=1e-14).x

    sizes, evidence = held_out(over, changes, two(low, high))
    wanted = []
    for f in range(4):
        mine = (over.flight == f).numpy()
        left = beyond[:, mine, 2] - beyond[:, mine, :2] @ size(~mine)
        wanted.append(np.mean(0.5 * np.log(np.square(beyond[:, mine, 2]).sum(1) / np.square(left).sum(1))))
    assert evidence.numpy() == pytest.approx(wanted, rel=1e-8)
    assert sizes.numpy() == pytest.approx(size(np.ones(200, dtype=bool)), rel=1e-8)


def test_a_size_beside_another_at_its_bound_is_the_best_there():
    """Without bounds -0.8 and 2.3; within 0 to 2 the best are 0 and 0.7, not 0 and 2."""
    A = torch.tensor([[1.0, 1.0], [3.0, 1.0]], dtype=torch.float64).repeat(3, 1)
    y = torch.tensor([1.5, -0.1], dtype=torch.float64).repeat(3)
    none = torch.zeros(6, 0, dtype=torch.float64)
    flight = torch.zeros(6, dtype=torch.int64)
    over = LeftOver(("X",), y[:, None], (), none, torch.arange(6.0), none, none, flight, none[:, None])
    sizes, evidence = held_out(over, A[:, None, :], two(0.0, 2.0))
    torch.testing.assert_close(sizes, torch.tensor([0.0, 0.7], dtype=torch.float64))
    assert evidence.tolist() == []  # a single flight is predicted by no other


def test_noise_in_forces_has_no_evidence_in_the_mean():
    found = []
    for seed in range(60):
        over, changes = equations(3, seed)
        noise = torch.randn(200, 3, generator=torch.Generator().manual_seed(900 + seed), dtype=torch.float64)
        found.append(float(held_out(replace(over, residual=noise), changes, two())[1].sum()))
    assert np.mean(found) < 0.0  # a size from other flights adds its own error


def test_equations_in_which_nothing_moves_tell_nothing():
    null = without_load(0.1)
    model, over = build(null.spec.with_effects(LOAD)), over_of(null)
    still = replace(over, residual=over.residual.clone().index_fill_(1, torch.tensor([1, 3, 5]), 0.0))
    one = [s for s in signatures(model, [LOAD]) if s.others][:1]
    sizes, evidence = held_out(still, over.residual[..., None], one)
    assert torch.isfinite(evidence).all()
    assert torch.isfinite(sizes).all()
    none = replace(over, residual=torch.zeros_like(over.residual))
    sizes, evidence = held_out(none, over.residual[..., None], one)
    assert not evidence.any()
    assert not sizes.any()


def test_derivatives_from_the_measured_motion_stand_beside_an_effect_of_its_size():
    """A play that no fit knew of makes derivatives small; beside it they are estimated anew, but for those held."""
    play = "control.backlash"
    known, null = hidden_flights.started(hidden_flights.flights(play, control__backlash__width=0.012))
    spec = null.spec.with_effects(play)
    found = derivatives_beside(null, spec, {f"{play}.width": 0.012}, ("forces.L.lat",))
    assert found[f"{play}.width"] == 0.012
    assert found["forces.L.lat"] == null.values["forces.L.lat"]
    truth = rate_vehicle().named_values["forces.M.lon"]
    assert abs(found["forces.M.lon"] - truth) < 0.5 * abs(null.values["forces.M.lon"] - truth)
    model = with_values(build(spec), {**null.values, f"{play}.width": 0.012})
    again = regress_model(model, known.dataset, known.reconstruction).theta
    assert found["forces.M.q"] == pytest.approx(float(again[model.parameter_set.index("forces.M.q")]))
