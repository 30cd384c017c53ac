"""Evidence of nested linear models against refits of every fold by an independent solver; the level of p-values."""

import numpy as np
import pytest
import torch
from scipy.optimize import lsq_linear

from rotorid_torch.trace.evidence import FlightEquations
from rotorid_torch.trace.floor import adjusted_p

P, K, ROWS = 5, 3, 40


def drawn(seed, flights):
    """Rows [X, S, r] of flights, of which the signature columns explain a part."""
    chance = np.random.default_rng(seed)
    rows = chance.normal(size=(flights, ROWS, P + K + 1))
    rows[..., -1] += rows[..., :-1] @ chance.normal(size=P + K)
    return rows


def equations(rows, unseen, prior):
    products = [torch.from_numpy(np.einsum("fti,ftj->fij", r, r)) for r in (rows, unseen)]
    return FlightEquations(products[0], products[1], torch.from_numpy(prior.T @ prior), P)


def refitted(fitted, scored, prior, columns, low, high):
    """Log ratio of the rms of one flight without and with the candidate, both estimated from other flights."""
    rows = np.concatenate([*fitted, prior])
    wide = [*range(P), *(P + c for c in columns)]
    bounds = np.full((2, len(wide)), np.inf) * [[-1], [1]]
    bounds[0, P:], bounds[1, P:] = low, high
    with_it = lsq_linear(rows[:, wide], rows[:, -1], bounds, method="bvls", tol=1e-14).x
    without = np.linalg.lstsq(rows[:, :P], rows[:, -1])[0]
    size = [np.square(scored[:, -1] - scored[:, w] @ a).sum() for w, a in ((wide, with_it), (range(P), without))]
    return 0.5 * np.log(size[1] / size[0])


@pytest.mark.parametrize("columns", [[0], [1, 2], [0, 1, 2]])
@pytest.mark.parametrize("bound", [10.0, 0.3])
def test_held_out_evidence_is_that_of_exact_refits(columns, bound):
    rows, unseen = drawn(1, 4), drawn(2, 2)
    prior = np.zeros((P, P + K + 1))
    prior[:, :P] = 0.5 * np.eye(P)
    prior[:, -1] = 0.1
    low, high = torch.full((len(columns),), -bound, dtype=torch.float64), torch.full((len(columns),), bound).double()
    found = equations(rows, unseen, prior).held_out(columns, low, high)
    wanted = [refitted(np.delete(rows, f, 0), rows[f], prior, columns, -bound, bound) for f in range(4)]
    wanted += [refitted(rows, one, prior, columns, -bound, bound) for one in unseen]
    assert found.numpy() == pytest.approx(wanted, rel=1e-8)


def test_a_single_fitted_flight_is_not_scored():
    rows, unseen = drawn(3, 1), drawn(4, 2)
    low = torch.full((1,), -1.0, dtype=torch.float64)
    assert len(equations(rows, unseen, np.zeros((1, P + K + 1))).held_out([0], low, -low)) == 2


def test_noise_has_no_evidence_in_the_mean():
    chance = np.random.default_rng(5)
    gains = []
    for _ in range(50):
        rows = chance.normal(size=(6, ROWS, P + K + 1))
        one = equations(rows, rows[:0], np.zeros((1, P + K + 1)))
        wide = torch.full((K,), torch.inf, dtype=torch.float64)
        gains.append(float(one.held_out([0, 1, 2], -wide, wide).sum()))
    assert np.mean(gains) < 0.0  # an estimate from other flights adds its own error


def test_p_holds_its_level_for_correlated_effects_of_any_scale():
    """Exchangeable data and draws: at most 5 % of the families have any p below 5 %."""
    chance = torch.Generator().manual_seed(0)
    scales = torch.tensor([1.0, 100.0, 1e-3, 5.0], dtype=torch.float64)
    alarms, trials = 0, 600
    for _ in range(trials):
        common = torch.randn(40, 1, generator=chance, dtype=torch.float64)
        table = (common + torch.randn(40, 4, generator=chance, dtype=torch.float64)).exp() * scales
        observed = {str(e): float(table[0, e]) for e in range(4)}
        p = adjusted_p(observed, {str(e): table[1:, e] for e in range(4)})
        alarms += min(p.values()) <= 0.05
    assert alarms / trials < 0.05 + 3.0 * (0.05 * 0.95 / trials) ** 0.5


def test_p_counts_draws_and_steps_down():
    clean = {"a": torch.arange(19.0).double(), "b": torch.arange(19.0).double()}
    p = adjusted_p({"a": 1e3, "b": 9.5}, clean)
    assert p["a"] == pytest.approx(1 / 20)
    assert p["b"] == pytest.approx((1 + 9) / 20)  # once a is set aside, b is compared with its own draws alone


def test_p_is_monotone_in_the_statistic():
    clean = {e: torch.linspace(-1, 1, 9).double() for e in "abc"}
    p = adjusted_p({"a": 0.9, "b": 0.1, "c": -0.5}, clean)
    assert p["a"] <= p["b"] <= p["c"] <= 1.0


def test_flights_in_which_the_fitted_model_flies_away_are_no_evidence():
    rows, wide = drawn(6, 4), torch.full((1,), torch.inf, dtype=torch.float64)
    lost = equations(rows, 0.0 * drawn(7, 2), np.zeros((1, P + K + 1))).held_out([0], -wide, wide)
    assert len(lost) == 6
    assert not lost[4:].any()


def test_a_signature_that_is_not_finite_is_no_evidence():
    rows, wide = drawn(8, 3), torch.full((1,), torch.inf, dtype=torch.float64)
    rows[..., P] = np.nan
    assert not equations(rows, rows[:0], np.zeros((1, P + K + 1))).held_out([0], -wide, wide).any()
