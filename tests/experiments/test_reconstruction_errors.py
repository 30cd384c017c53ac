"""Scores of a reconstruction against signals whose shares and slow parts are known in closed form."""

import math
from importlib import import_module

import torch


def of(name: str):
    return getattr(import_module("reconstruction_errors"), name)


def test_normal_errors_fall_within_their_deviation_as_often_as_the_normal_law_says() -> None:
    sd = torch.tensor([0.1, 20.0], dtype=torch.float64)
    error = sd * torch.randn(20000, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    for sigmas in (1.0, 3.0):
        expected = torch.full((2,), math.erf(sigmas / math.sqrt(2.0)), dtype=torch.float64)
        assert torch.allclose(of("share_within")(error, sd, sigmas), expected, atol=0.01)


def test_only_what_is_slow_counts_as_slow_error() -> None:
    dt = 0.01
    time = dt * (torch.arange(2000, dtype=torch.float64) + 0.5)
    slow, fast = torch.cos(2 * math.pi * 0.5 * time), torch.cos(2 * math.pi * 5.0 * time)
    both = torch.stack([0.3 * slow + 4.0 * fast, 0.1 * slow], dim=-1)
    assert torch.allclose(of("below")(both, dt, 2.0), torch.stack([0.3 * slow, 0.1 * slow], dim=-1), atol=1e-9)
    signal = 10.0 + torch.stack([slow, slow], dim=-1)
    assert torch.allclose(of("slow_error")(both, signal, dt), torch.tensor([0.3, 0.1], dtype=torch.float64), atol=1e-9)
    assert torch.allclose(
        of("slow_error")(both.expand(3, -1, -1), signal, dt), torch.tensor([0.3, 0.1], dtype=torch.float64).expand(3, 2)
    )


def test_least_error_is_that_of_the_ideal_smoother() -> None:
    """All of a hidden signal, all of the noise under a strong one, half the energy of each where they are equal."""
    dt, generator = 0.01, torch.Generator().manual_seed(1)
    white = of("below")(torch.randn(4000, 1, dtype=torch.float64, generator=generator), dt, 2.0)
    signal = white.repeat(1, 2) * torch.tensor([1.0, 3.0], dtype=torch.float64)

    def error(variance: float) -> torch.Tensor:
        return of("least_slow_error")(signal, lambda hertz: torch.full((len(hertz), 2), variance), dt)

    assert torch.allclose(error(1e9), torch.ones(2, dtype=torch.float64), atol=0.05)
    noise = math.sqrt(2.0 * 2.0 * dt * 1e-8)
    deviation = signal.std(dim=0, unbiased=False)
    assert torch.allclose(error(1e-8), noise / deviation, rtol=0.1)
    assert (0.3 < error(1.0)[0]) & (error(1.0)[0] < 0.75)
    assert (error(1.0)[1] < 0.7 * error(1.0)[0]).item()


def test_least_error_of_a_silent_stretch_is_less_than_of_a_steady_signal() -> None:
    """A burst of one second needs fewer coefficients than a signal of the same energy that lasts."""
    dt = 0.01
    time = dt * torch.arange(1600, dtype=torch.float64)
    burst = torch.sin(2 * math.pi * time) * ((time > 7.0) & (time < 9.0))
    steady = torch.randn(1600, dtype=torch.float64, generator=torch.Generator().manual_seed(2))[:, None]
    steady = of("below")(steady, dt, 2.0)[:, 0]
    steady = steady * burst.std() / steady.std()
    both = torch.stack([burst, steady], dim=-1)
    least = of("least_slow_error")(both, lambda hertz: torch.full((len(hertz), 2), 1.0), dt)
    assert least[0] < 0.8 * least[1]
