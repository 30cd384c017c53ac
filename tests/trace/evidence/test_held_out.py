"""Evidence of nested linear models against refits of every fold by an independent solver; what a size is to show."""

import numpy as np
import pytest
import torch
from scipy.optimize import lsq_linear

from rotorid_torch.trace.evidence.held_out import FlightEquations

P, K, RESPONSES, ROWS = 5, 3, 2, 20


def drawn(seed, flights):
    """Rows [F, R, T, n] of flights, of which the signature columns explain a part."""
    chance = np.random.default_rng(seed)
    rows = chance.normal(size=(flights, RESPONSES, ROWS, P + K + 1))
    rows[..., -1] += rows[..., :-1] @ chance.normal(size=P + K)
    return rows


def equations(rows, unseen, prior):
    products = [torch.from_numpy(np.einsum("frti,frtj->frij", r, r)) for r in (rows, unseen)]
    return FlightEquations(products[0], products[1], torch.from_numpy(prior.T @ prior), P)


def refitted(fitted, scored, prior, columns, low, high):
    """Mean log ratio of one flight's rms without and with the candidate, both estimated from other flights."""
    rows = np.concatenate([fitted.reshape(-1, prior.shape[1]), prior])
    wide = [*range(P), *(P + c for c in columns)]
    bounds = np.full((2, len(wide)), np.inf) * [[-1], [1]]
    bounds[0, P:], bounds[1, P:] = low, high
    with_it = lsq_linear(rows[:, wide], rows[:, -1], bounds, method="bvls", tol=1e-14).x
    without = np.linalg.lstsq(rows[:, :P], rows[:, -1])[0]
    size = [np.square(scored[..., -1] - scored[..., w] @ a).sum(-1) for w, a in ((wide, with_it), (range(P), without))]
    return 0.5 * np.log(size[1] / size[0]).mean()


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
        rows = chance.normal(size=(6, RESPONSES, ROWS, P + K + 1))
        one = equations(rows, rows[:0], np.zeros((1, P + K + 1)))
        wide = torch.full((K,), torch.inf, dtype=torch.float64)
        gains.append(float(one.held_out([0, 1, 2], -wide, wide).sum()))
    assert np.mean(gains) < 0.0  # an estimate from other flights adds its own error


def test_flights_in_which_the_fitted_model_flies_away_are_no_evidence():
    rows, wide = drawn(6, 4), torch.full((1,), torch.inf, dtype=torch.float64)
    lost = equations(rows, 0.0 * drawn(7, 2), np.zeros((1, P + K + 1))).held_out([0], -wide, wide)
    assert len(lost) == 6
    assert not lost[4:].any()


def test_a_signature_that_is_not_finite_is_no_evidence():
    rows, wide = drawn(8, 3), torch.full((1,), torch.inf, dtype=torch.float64)
    rows[..., P] = np.nan
    assert not equations(rows, rows[:0], np.zeros((1, P + K + 1))).held_out([0], -wide, wide).any()


def test_each_of_several_residuals_has_its_own_evidence():
    """Residuals that know nothing of the motion stand beside the data's own, and change nothing of it."""
    first, second = drawn(9, 4), drawn(10, 4)
    low = torch.full((K,), -0.3, dtype=torch.float64)
    both = np.concatenate([first, first[..., :-1] @ np.ones((P + K, 1)) + second[..., -1:]], axis=-1)
    products = torch.from_numpy(np.einsum("frti,frtj->frij", both, both))
    none = torch.zeros(both.shape[-1], both.shape[-1], dtype=torch.float64)
    together = FlightEquations(products, products[:0], none, P, residuals=2)
    for residual in range(2):
        alone = both[..., [*range(P + K), P + K + residual]]
        wanted = equations(alone, alone[:0], np.zeros((1, P + K + 1))).held_out([0, 1, 2], low, -low)
        torch.testing.assert_close(together.held_out([0, 1, 2], low, -low, residual), wanted, rtol=1e-10, atol=0.0)


@pytest.mark.parametrize("size", [0.02, 0.3, 2.0])
def test_a_size_is_expected_to_give_what_it_gives_where_nothing_else_is_left(size):
    """A residual of a signature at a size beside noise at right angles to all that is fitted."""
    chance = np.random.default_rng(11)
    rows = []
    for _ in range(5 * RESPONSES):
        basis = np.linalg.qr(chance.normal(size=(ROWS, P + 2)))[0]
        X, S, noise = basis[:, :P], 3.0 * basis[:, P : P + 1] + basis[:, :P] @ chance.normal(size=(P, 1)), basis[:, -1:]
        rows.append(np.concatenate([X, S, noise, noise + size * S], axis=1))
    rows, prior = np.array(rows).reshape(5, RESPONSES, ROWS, P + 3), np.zeros((1, P + 2))
    bare, full = rows[..., [*range(P + 1), P + 1]], rows[..., [*range(P + 1), P + 2]]
    wide = torch.full((1,), torch.inf, dtype=torch.float64)
    told = equations(bare, bare[:0], prior).expected(0, size)
    assert told > 0.0
    assert float(equations(full, full[:0], prior).held_out([0], -wide, wide).sum()) == pytest.approx(told, rel=1e-6)
    assert equations(bare, bare[:0], prior).expected(0, 0.0) == 0.0


def test_a_larger_size_is_expected_to_give_more():
    one = equations(drawn(12, 4), drawn(13, 2), np.zeros((1, P + K + 1)))
    expected = [one.expected(1, size) for size in (0.1, 1.0, 10.0)]
    assert 0.0 < expected[0] < expected[1] < expected[2]
    assert one.expected(1, -1.0) == expected[1]


def test_a_response_that_a_flight_has_not_measured_counts_for_nothing():
    rows, wide = drawn(10, 4), torch.full((1,), torch.inf, dtype=torch.float64)
    lacking = np.concatenate([rows, 0.0 * rows[:, :1]], axis=1)
    prior = np.zeros((1, P + K + 1))
    both = [equations(one, one[:0], prior).held_out([0], -wide, wide) for one in (rows, lacking)]
    assert both[0].numpy() == pytest.approx(both[1].numpy(), rel=1e-12)


def test_a_response_that_a_flight_leaves_alone_counts_little():
    """A candidate that spoils what is nearly at rest in one flight has the evidence of what it explains elsewhere."""
    rows, wide = drawn(14, 4), torch.full((1,), torch.inf, dtype=torch.float64)
    rows[0, 1] *= 1e-3
    rows[0, 1, :, P] *= 1e3
    products = torch.from_numpy(np.einsum("frti,frtj->frij", rows, rows))
    prior = (products.new_zeros(1, P), products.new_zeros(1))
    usual = products.new_full((4, RESPONSES), float(ROWS))
    by_scale = [FlightEquations.of(products, products[:0], prior, 1, s) for s in (None, usual)]
    evidence = [float(one.held_out([0], -wide, wide)[0]) for one in by_scale]
    assert evidence[0] < -1.0
    assert abs(evidence[1]) < 0.5


@pytest.mark.parametrize("size", [0.1, 1.0, 30.0])
def test_a_size_is_expected_to_give_what_it_gives_where_it_raises_the_usual_residuals(size):
    """Noise at right angles to the signature; s_r is the rms of all that the fitted model leaves."""
    chance, rows = np.random.default_rng(15), []
    for _ in range(6):
        basis = np.linalg.qr(chance.normal(size=(ROWS, 2)))[0]
        rows.append(np.stack([3.0 * basis[:, 0], basis[:, 1], basis[:, 1] + 3.0 * size * basis[:, 0]], axis=-1)[None])
    products = torch.from_numpy(np.einsum("frti,frtj->frij", rows, rows))
    nothing, wide = (products.new_zeros(1, 0), products.new_zeros(1)), torch.full((1,), torch.inf, dtype=torch.float64)
    both = []
    for last in (1, 2):
        chosen = products[..., [0, last], :][..., [0, last]]
        both.append(FlightEquations.of(chosen, chosen[:0], nothing, 1, chosen[..., 1, 1]))
    given = float(both[1].held_out([0], -wide, wide).sum())
    assert both[0].expected(0, size) == pytest.approx(given, rel=1e-6)
    assert given < 6 * 0.5 * np.log(2.0)
