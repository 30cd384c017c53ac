"""Scores of a reconstruction against signals whose shares and slow parts are known in closed form."""

import math

import torch

from rotorid_torch.validate.reconstruction import below, share_within, slow_error


def test_normal_errors_fall_within_their_deviation_as_often_as_the_normal_law_says() -> None:
    sd = torch.tensor([0.1, 20.0], dtype=torch.float64)
    error = sd * torch.randn(20000, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    for sigmas in (1.0, 3.0):
        expected = torch.full((2,), math.erf(sigmas / math.sqrt(2.0)), dtype=torch.float64)
        assert torch.allclose(share_within(error, sd, sigmas), expected, atol=0.01)


def test_only_what_is_slow_counts_as_slow_error() -> None:
    dt = 0.01
    time = dt * (torch.arange(2000, dtype=torch.float64) + 0.5)
    slow, fast = torch.cos(2 * math.pi * 0.5 * time), torch.cos(2 * math.pi * 5.0 * time)
    both = torch.stack([0.3 * slow + 4.0 * fast, 0.1 * slow], dim=-1)
    assert torch.allclose(below(both, dt, 2.0), torch.stack([0.3 * slow, 0.1 * slow], dim=-1), atol=1e-9)
    signal = 10.0 + torch.stack([slow, slow], dim=-1)
    assert torch.allclose(slow_error(both, signal, dt), torch.tensor([0.3, 0.1], dtype=torch.float64), atol=1e-9)
    assert torch.allclose(
        slow_error(both.expand(3, -1, -1), signal, dt), torch.tensor([0.3, 0.1], dtype=torch.float64).expand(3, 2)
    )
