"""The compiled filter and smoother against the one in torch, flight by flight, and on its own over a million steps."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from rotorid_torch import errors
from rotorid_torch.core.native import filtering
from rotorid_torch.core.native.graph.tracing import Unsupported
from rotorid_torch.identification.reconstruct import unscented_filter as filter_module
from rotorid_torch.identification.reconstruct.filter_problem import Dynamics, Filtered
from rotorid_torch.identification.reconstruct.sigma_points import ProcessNoise
from rotorid_torch.identification.reconstruct.unscented_filter import SampledSystem, filter_and_smooth

NX, NU, NY, SAMPLES, DT = 5, 2, 3, 60, 0.05


def draw(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


TURN, PUSH, SENSOR = draw(1, NX, NX), draw(2, NU, NX), draw(3, NX, NY)


def rates(x: Tensor, u: Tensor) -> Tensor:
    change = torch.sin(x @ TURN) - 0.5 * x + u @ PUSH + 0.2 * x[..., :1] * x.roll(1, -1)
    return torch.cat([change[..., :-1], torch.zeros_like(x[..., :1])], dim=-1)


def sensors(x: Tensor, u: Tensor) -> Tensor:
    return x @ SENSOR + 0.3 * torch.cos(x[..., :1]) * x[..., 1:4] + u[..., :1]


def covariance(seed: int, n: int, size: float) -> Tensor:
    root = draw(seed, n, n) + 2.0 * torch.eye(n, dtype=torch.float64)
    return size**2 * root @ root.mT


def problem(flights: int, known: bool = False) -> SampledSystem:
    """Gaps, a prior and process noise that differ from flight to flight; the last state known exactly on demand."""
    outputs = draw(4, flights, SAMPLES, NY)
    outputs[draw(5, flights, SAMPLES, NY) < -1.0] = torch.nan
    outputs[:, 20:25] = torch.nan
    outputs[0, 0, 1] = torch.nan
    P0 = torch.stack([covariance(10 + i, NX, 0.5) for i in range(flights)])
    if known:
        P0[:, -1], P0[..., -1] = 0.0, 0.0
    rows, columns = torch.tensor([0, 0, 1, 2, 3]), torch.tensor([0, 1, 1, 2, 3])
    values = torch.tensor([1.0, 0.3, 1.0, 0.5, 2.0]).double() * (1.0 + draw(6, flights, SAMPLES - 1, 1).square())
    prior, noise = (draw(7, flights, NX), P0), ProcessNoise(NX, rows, columns, 1e-3 * values)
    return SampledSystem(
        rates, sensors, prior, noise, covariance(8, NY, 0.2), draw(9, flights, SAMPLES, NU), outputs, DT
    )


def both(system: SampledSystem, **settings: Any) -> tuple[Filtered, Filtered]:
    return (
        filter_and_smooth(system, **settings, engine="native"),
        filter_and_smooth(system, **settings, engine="reference"),
    )


def assert_same(a: Filtered, b: Filtered, tolerance: float = 1e-9) -> None:
    """Means by the channel's largest value, covariances by their standard deviations."""
    for name, reference in vars(b).items():
        value = getattr(a, name)
        assert value.shape == reference.shape, name
        assert torch.equal(value.isnan(), reference.isnan()), name
        if "covariances" in name:
            sd = reference.diagonal(dim1=-2, dim2=-1).sqrt()
            sd = torch.where(sd > 0.0, sd, 1.0)
            error = (value - reference) / (sd.unsqueeze(-1) * sd.unsqueeze(-2))
            assert torch.equal(value, value.mT), name
        else:
            error = (value - reference) / reference.nan_to_num().abs().amax()
        assert error.nan_to_num().abs().max() < tolerance, name


@pytest.mark.parametrize("flights", [1, 3, 11])
@pytest.mark.parametrize("known", [False, True])
def test_native_and_torch_agree(flights: int, known: bool) -> None:
    native, reference = both(problem(flights, known))
    assert_same(native, reference)
    if known:
        assert native.smoothed_covariances is not None
        assert native.smoothed_covariances[..., -1, :].abs().max() == 0.0


@pytest.mark.parametrize(
    "weights", [filtering.Weights(0.6 * NX**0.5, 1.86, 0.5 / (0.36 * NX)), filtering.Weights(2.0, 1.9, 0.125)]
)
def test_native_and_torch_agree_for_any_sigma_points(weights: filtering.Weights) -> None:
    native, reference = both(problem(3), weights=weights)
    assert_same(native, reference)
    assert (reference.means - both(problem(3))[1].means).abs().max() > 1e-4


def test_without_smoothing_and_with_constant_noise() -> None:
    system = replace(problem(3), noise=ProcessNoise.constant(covariance(12, NX, 0.05)))
    native, reference = both(system, smooth=False)
    assert native.smoothed_means is None
    assert (native.means - reference.means).abs().max() < 1e-9
    assert (native.log_likelihood / reference.log_likelihood - 1.0).abs().max() < 1e-9


def test_threads_and_company_do_not_change_a_bit() -> None:
    system = problem(11)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = filter_and_smooth(system, engine="native")
        torch.set_num_threads(2)
        two = filter_and_smooth(system, engine="native")
    finally:
        torch.set_num_threads(threads)
    for name, value in vars(one).items():
        assert torch.equal(value.nan_to_num(), getattr(two, name).nan_to_num()), name
    native, _ = both(first_flight(system))
    assert (native.means[0] - one.means[0]).abs().max() < 1e-9


def first_flight(system: SampledSystem) -> SampledSystem:
    mean, cov = system.prior
    noise = replace(system.noise, values=system.noise.values[:1])
    return replace(
        system, prior=(mean[:1], cov[:1]), noise=noise, controls=system.controls[:1], outputs=system.outputs[:1]
    )


def test_leading_dimensions_are_kept() -> None:
    system = problem(6)
    (mean, cov), shape = system.prior, (2, 3)
    shaped = replace(
        system,
        prior=(mean.unflatten(0, shape), cov.unflatten(0, shape)),
        noise=replace(system.noise, values=system.noise.values.unflatten(0, shape)),
        controls=system.controls.unflatten(0, shape),
        outputs=system.outputs.unflatten(0, shape),
    )
    flat, deep = (filter_and_smooth(each, engine="native") for each in (system, shaped))
    assert deep.means.shape == (2, 3, SAMPLES, NX)
    assert torch.equal(deep.means.flatten(0, 1), flat.means)
    assert deep.log_likelihood.shape == (2, 3)


def test_models_that_differ_in_numbers_only_are_built_once() -> None:
    x, u = torch.ones(1, 2).double(), torch.ones(1, 1).double()
    made = [
        filtering.CompiledFilter.of(lambda x, u, k=k: -k * x + u, lambda x, u, k=k: torch.sin(k * x), x, u, 2)
        for k in (0.37, 41.5)
    ]
    assert made[0].source == made[1].source
    assert not torch.equal(made[0].numbers, made[1].numbers)


@pytest.mark.parametrize(
    ("f", "reason"),
    [
        (lambda x, u: rates(x, u) * draw(1, 3, 1, 1), "have shape"),
        (
            lambda x, u: rates(x, u) * torch.arange(1.0, x.shape[0] + 1.0).double().view(-1, *[1] * (x.dim() - 1)),
            "differ",
        ),
        (lambda x, u: rates(x, u) + 0.0 * x.sort(dim=-1).values, "sort"),
    ],
)
def test_what_cannot_be_compiled_is_done_in_torch_and_said_once(
    f: Dynamics, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    errors.say_once.cache_clear()
    system = replace(problem(3), f=f)
    with pytest.raises(Unsupported, match=reason):
        filter_and_smooth(system, engine="native")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(filter_module, "WORTH_COMPILING", 0)
        got = [filter_and_smooth(system) for _ in range(2)]
    wanted = filter_and_smooth(system, engine="reference")
    assert torch.equal(got[1].means, wanted.means)
    messages = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert len(messages) == 1
    assert reason in messages[0]


def test_derivatives_come_from_torch() -> None:
    system = problem(1)
    mean, cov = system.prior
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(filter_module, "WORTH_COMPILING", 0)
        got = filter_and_smooth(replace(system, prior=(mean.requires_grad_(), cov)), smooth=False)
    assert got.means.requires_grad


def test_covariances_stay_symmetric_positive_definite_for_a_million_steps() -> None:
    """An oscillator almost without process noise, and a constant that is learnt ever better."""
    samples = 1_000_000
    outputs = draw(20, samples, 1) + 3.0
    system = SampledSystem(
        lambda x, u: torch.stack([x[..., 1], -4.0 * x[..., 0] - 0.01 * x[..., 1], 0.0 * x[..., 2]], dim=-1),
        lambda x, u: x[..., :1] + x[..., 2:],
        (torch.zeros(3).double(), torch.diag(torch.tensor([1.0, 4.0, 1e6]).double())),
        ProcessNoise.constant(torch.diag(torch.tensor([0.0, 1e-12, 0.0]).double())),
        torch.eye(1).double(),
        torch.zeros(samples, 0).double(),
        outputs,
        0.01,
    )
    got = filter_and_smooth(system, smooth=False)
    cov = got.covariances
    assert torch.equal(cov, cov.mT)
    thin = cov[::29]
    sd = thin.diagonal(dim1=-2, dim2=-1).sqrt()
    assert torch.linalg.eigvalsh(thin / (sd[:, :, None] * sd[:, None, :])).min() > 1e-9
    assert abs(float(cov[-1, 2, 2]) * samples - 1.0) < 1e-3
    assert abs(float(got.means[-1, 2] - outputs.mean())) < 1e-3
