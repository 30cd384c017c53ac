"""What happens to a record: exact where it can be, smooth where it must be, and nothing at the null."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch
from scipy.signal import lsim
from torch import Tensor

from rotorid_torch.effects.signal_operations import (
    lagged,
    low_passed,
    rate_limited,
    shifted,
    smoothed,
    with_play,
    with_play_behind_noise,
)

DT = 0.02
TIME = DT * torch.arange(200, dtype=torch.float64)


def noise(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def one(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


@pytest.mark.parametrize("tau", [0.003, 0.02, 0.1, 1.5])
def test_lag_is_the_exact_response_to_a_record_linear_between_samples(tau: float):
    record = noise(200, 1)
    wanted = lsim(([1.0], [tau, 1.0]), (record[:, 0] - record[0, 0]).numpy(), TIME.numpy())[1] + float(record[0, 0])
    np.testing.assert_allclose(lagged(record, one(tau), DT)[:, 0].numpy(), wanted, atol=1e-10)


def test_no_lag_is_the_record_and_its_derivative_the_slope():
    record = noise(50, 1)
    assert torch.equal(lagged(record, one(0.0), DT), record)
    found = torch.func.jacfwd(lambda tau: lagged(record, tau, DT))(one(0.0))[1:, 0, 0]
    torch.testing.assert_close(found, -record[:, 0].diff() / DT)


@pytest.mark.parametrize(("frequency", "damping"), [(6.0, 0.3), (18.8, 0.7), (40.0, 1.2)])
def test_a_filter_of_second_order_is_the_exact_response_to_what_samples_can_hold(frequency: float, damping: float):
    fine = torch.linspace(0.0, 4.0, 40 * 200, dtype=torch.float64)
    u = (fine * 2.0).sin() + 0.5 * (7.0 * fine + 1.0).cos() - 0.5 * math.cos(1.0)
    u = u * (1.0 - (-((fine / 0.8) ** 4)).exp())  # begins at rest
    system = ([frequency**2], [1.0, 2.0 * damping * frequency, frequency**2])
    wanted = lsim(system, u.numpy(), fine.numpy())[1]
    step = 40
    dt = float(fine[step] - fine[0])
    found = low_passed(u[::step, None], one(1.0 / frequency), one(damping), one(0.0), dt)[:, 0]
    np.testing.assert_allclose(found.numpy(), wanted[::step], atol=2e-3)


def test_a_window_without_phase_lowers_a_sine_and_leaves_its_place():
    omega, sigma = 9.0, 0.06
    sine = (omega * TIME).sin()[:, None]
    found = low_passed(sine, one(0.0), one(0.7), one(sigma**2), DT)
    inner = slice(40, -40)
    torch.testing.assert_close(found[inner], math.exp(-0.5 * (omega * sigma) ** 2) * sine[inner], atol=1e-3, rtol=0)


def test_neither_filter_nor_window_is_the_record():
    none = torch.zeros(2, dtype=torch.float64)
    assert torch.equal(low_passed(noise(50, 2), none, none, none, DT), noise(50, 2))


def test_lag_of_one_sample_and_of_a_batch():
    assert torch.equal(lagged(noise(1, 2), torch.tensor([0.1, 0.2], dtype=torch.float64), DT), noise(1, 2))
    taus = torch.tensor([[0.0, 0.1], [0.2, 0.05]], dtype=torch.float64)
    batch = lagged(noise(30, 2), taus, DT)
    for k in range(2):
        torch.testing.assert_close(batch[k], lagged(noise(30, 2), taus[k], DT), rtol=1e-13, atol=1e-13)


def test_early_is_late_backwards():
    record = noise(60, 1)
    early, late = shifted(record, one(-0.06), DT), shifted(record.flip(0), one(0.06), DT).flip(0)
    torch.testing.assert_close(early, late, rtol=1e-12, atol=1e-12)


def test_each_column_has_its_own_shift():
    record = noise(60, 2)
    found = shifted(record, torch.tensor([0.0, 0.04], dtype=torch.float64), DT)
    assert torch.equal(found[:, 0], record[:, 0])
    torch.testing.assert_close(found[2:, 1], record[:-2, 1], rtol=1e-12, atol=1e-12)


def test_a_step_is_followed_at_the_limit_and_reached():
    record = 0.1 * (TIME > 0.5).double()[:, None]
    found = rate_limited(record, one(1.0 / 0.2), DT)[:, 0]
    rate = found.diff() / DT
    assert float(rate.max()) == pytest.approx(0.2, rel=0.01)
    assert float(rate.max()) <= 0.2
    assert float(found[-1]) == pytest.approx(0.1, abs=1e-12)
    half = int((found > 0.05).nonzero()[0])
    assert DT * half == pytest.approx(0.5 + 0.05 / 0.2, abs=0.03)


def test_slow_motion_knows_no_limit():
    record = (0.1 * torch.sin(TIME))[:, None]  # at most 0.1 per s
    assert torch.equal(rate_limited(record, one(0.0), DT), record)
    torch.testing.assert_close(rate_limited(record, one(1.0 / 0.5), DT), record, atol=1e-6, rtol=0)


@pytest.mark.parametrize("value", [0.01, 0.3, 3.0, 30.0])
def test_limit_and_play_of_a_whole_record_are_those_of_one_sample_after_the_other(value: float):
    record = noise(300, 2).cumsum(0)
    for follow, parameter in ((partial(rate_limited, dt=DT), 0.1 * value), (with_play, value)):
        found, rows = follow(record, one(parameter).expand(2)), [record[0]]
        for u in record[1:]:  # two samples, of which the first one is where the last one came to
            rows.append(follow(torch.stack([rows[-1], u]), one(parameter).expand(2))[1])
        torch.testing.assert_close(found, torch.stack(rows), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("place", [0.0, 0.7, -1.0])
def test_play_swallows_a_turn_and_then_drags_from_where_it_stands(place: float):
    record = 0.3 + (0.1 * torch.sin(math.pi * TIME))[:, None]
    found = with_play(record, one(0.04), one(place))[:, 0]
    hard, y = [], 0.3 + 0.02 * place
    for u in record[:, 0].tolist():
        y = min(max(y, u - 0.02), u + 0.02)
        hard.append(y - 0.02 * place)
    assert float((found - torch.tensor(hard, dtype=torch.float64)).abs().max()) < 0.12 * 0.02
    assert torch.equal(with_play(record, one(0.0), one(place)), record)


def test_a_play_in_the_middle_is_one_without_a_place():
    record = noise(200, 2).cumsum(0)
    torch.testing.assert_close(with_play(record, one(2.0), one(0.0)), with_play(record, one(2.0)))


@pytest.mark.parametrize("place", [-1.0, 1.0])
def test_a_record_that_stands_still_is_not_moved_by_its_play(place: float):
    record = torch.full((50, 1), 0.3, dtype=torch.float64)
    torch.testing.assert_close(with_play(record, one(0.04), one(place)), record, rtol=0, atol=1e-15)


def test_a_play_of_nothing_is_told_what_it_would_change():
    record = torch.where(TIME < 1.0, 0.1, 0.3)[:, None].double()
    slope = torch.func.jacfwd(lambda width: with_play(record, width, one(0.5)))(one(0.0))[:, 0, 0]
    torch.testing.assert_close(slope, torch.where(TIME < 1.0, 0.0, -0.5 * (1.0 + 0.5)).double(), atol=0.02, rtol=0)


def test_derivatives_by_the_place_in_a_play_are_those_of_the_whole_record():
    record, width = noise(60, 2).cumsum(0), torch.tensor([2.0, 3.0], dtype=torch.float64)
    at = torch.tensor([0.4, -0.3], dtype=torch.float64)
    path = partial(with_play, record, width)
    differences = torch.stack([(path(at + d) - path(at - d)) / 2e-6 for d in 1e-6 * torch.eye(2, dtype=at.dtype)], -1)
    torch.testing.assert_close(torch.func.jacfwd(path)(at), differences, atol=1e-5, rtol=1e-5)


def test_noise_of_the_record_pushes_no_play():
    dt, width = 0.01, 0.03
    time = dt * torch.arange(2000, dtype=torch.float64)
    record = (0.05 * torch.sin(math.pi * time) + 0.03 * torch.sin(7.0 * time))[:, None]
    read, moved = record + 0.1 * width * noise(len(time), 1), with_play(record, one(width))
    by_width = torch.linspace(0.8, 1.5, 36, dtype=torch.float64) * width

    def best(path: Callable[[Tensor], Tensor]) -> float:
        off = torch.stack([(path(w[None]) - moved)[20:].square().mean() for w in by_width])
        return float(by_width[off.argmin()]) / width

    assert best(lambda w: with_play(read, w)) > 1.15
    assert best(lambda w: with_play_behind_noise(read, w, dt)) == pytest.approx(1.0, abs=0.04)
    torch.testing.assert_close(with_play_behind_noise(read, one(0.0), dt), read, rtol=0, atol=1e-15)


def test_smoothed_is_the_weighted_mean_of_what_is_near_and_held_at_the_ends():
    record, width = noise(2, 30, 3), 5
    weights = np.hanning(width + 2)[1:-1] / np.hanning(width + 2).sum()
    padded = np.pad(record.numpy(), ((0, 0), (2, 2), (0, 0)), mode="edge")
    mean = sum(w * padded[:, k : k + 30] for k, w in enumerate(weights))
    torch.testing.assert_close(smoothed(record, width), torch.from_numpy(mean), rtol=1e-12, atol=1e-12)
    assert torch.equal(smoothed(record, 1), record)


@pytest.mark.parametrize(("follow", "value"), [(partial(rate_limited, dt=DT), 0.03), (with_play, 1.0)])
def test_derivatives_by_limit_and_play_are_those_of_the_whole_record(follow: Callable[..., Tensor], value: float):
    path = partial(follow, noise(40, 2).cumsum(0))
    at = torch.tensor([[value, 1.3 * value], [0.7 * value, value]], dtype=torch.float64)
    step = torch.tensor([[1.0, -2.0], [0.5, 1.0]], dtype=torch.float64)
    differences = (path(at + 1e-6 * step) - path(at - 1e-6 * step)) / 2e-6
    forward = torch.func.jvp(path, (at,), (step,))[1]
    torch.testing.assert_close(forward, differences, atol=1e-5, rtol=1e-5)
    _, back, *_ = torch.func.vjp(path, at)
    torch.testing.assert_close((back(torch.ones_like(forward))[0] * step).sum(), forward.sum())
    torch.testing.assert_close((torch.func.jacfwd(path)(at) * step).sum((-1, -2)), forward)
    torch.testing.assert_close(torch.vmap(path)(at[:, None]), path(at)[:, None])
    both = torch.vmap(follow, in_dims=(2, 1))(torch.stack([noise(40, 2), noise(40, 2).flip(0)], dim=2), at.mT)
    torch.testing.assert_close(both, torch.stack([follow(noise(40, 2), at[0]), follow(noise(40, 2).flip(0), at[1])]))


def test_a_record_of_one_sample_is_where_it_begins():
    record = noise(1, 2)
    assert torch.equal(rate_limited(record, one(3.0), DT), record)
    assert torch.equal(with_play(record, one(0.1)), record)
