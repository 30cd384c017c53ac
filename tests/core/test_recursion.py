"""Recursions over records: native code, torch sample by sample and gradients through a plain loop agree."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial

import pytest
import torch
from torch import Tensor

from rotorid_torch import errors
from rotorid_torch.core.native.build import NO_COMPILER, library
from rotorid_torch.core.native.recurrences import SERIES, CompiledRecursion, Step
from rotorid_torch.core.recursion import followed, linear, reference

agree = partial(torch.testing.assert_close, rtol=1e-12, atol=1e-12)
agree_in_slope = partial(torch.testing.assert_close, rtol=1e-9, atol=1e-9)


def noise(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def saturated(y: Tensor, u: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Approaches its input by a bounded step, the bounds another one up and down."""
    return y + torch.where(u > y, high * torch.tanh((u - y) / high), low * torch.tanh((u - y) / low))


def plain(step: Step, start: Tensor, inputs: Sequence[Tensor], samples: int) -> Tensor:
    """The same by a loop that knows nothing of what is tested."""
    y, rows = start, []
    for k in range(samples):
        y = step(y, *(u[..., k if u.shape[-2] > 1 else 0, :] for u in inputs))
        rows.append(y)
    return torch.stack(rows, dim=-2)


def case(batch: tuple[int, ...] = (3,), samples: int = 40, columns: int = 2) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Start and inputs of `saturated`, some of them the same for all flights, or at all samples."""
    record = noise(1, *batch, samples, columns).cumsum(-2)
    return noise(2, *batch, columns), (record, 0.3 + noise(3, 1, columns).square(), 0.2 + noise(4, samples, 1).square())


@pytest.mark.parametrize(("batch", "samples", "columns"), [((), 1, 1), ((3,), 40, 2), ((2, 2), 7, 5), ((40,), 30, 3)])
def test_native_code_gives_what_torch_gives_sample_by_sample(batch: tuple[int, ...], samples: int, columns: int):
    start, inputs = case(batch, samples, columns)
    found = CompiledRecursion.of(saturated, 3).run(start, inputs)
    for native, torch_s in zip(found, reference(saturated, start, inputs), strict=True):
        agree(native, torch_s)
    agree(found[0], plain(saturated, start, inputs, samples))


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch):
    start, inputs = case((SERIES,), 20, 3)
    monkeypatch.setenv("ROTORID_THREADS", "1")
    alone = CompiledRecursion.of(saturated, 3).run(start, inputs)
    monkeypatch.setenv("ROTORID_THREADS", "3")
    for one, other in zip(alone, CompiledRecursion.of(saturated, 3).run(start, inputs), strict=True):
        assert torch.equal(one, other)


@pytest.fixture(params=["native", "torch"])
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "torch":

        def refused(self: CompiledRecursion, start: Tensor, inputs: Sequence[Tensor]) -> tuple[Tensor, ...]:
            raise errors.Unsupported(NO_COMPILER)

        monkeypatch.setattr(CompiledRecursion, "run", refused)
        monkeypatch.setattr("rotorid_torch.core.native.build.say_once", lambda text: None)
    return request.param


def test_first_derivatives_are_those_of_a_plain_loop(engine: str):
    start, inputs = case()
    given = (start, *inputs)
    weights, tangents = noise(5, 3, 40, 2), tuple(noise(6 + k, *v.shape) for k, v in enumerate(given))

    def by_loop(start: Tensor, *inputs: Tensor) -> Tensor:
        return plain(saturated, start, inputs, 40)

    def tested(start: Tensor, *inputs: Tensor) -> Tensor:
        return followed(saturated, start, *inputs)

    value, slope, *_ = torch.func.jvp(tested, given, tangents)
    wanted, wanted_slope, *_ = torch.func.jvp(by_loop, given, tangents)
    agree(value, wanted)
    agree_in_slope(slope, wanted_slope)
    for found, right in zip(_gradients(tested, given, weights), _gradients(by_loop, given, weights), strict=True):
        agree_in_slope(found, right)


def _gradients(function: Callable[..., Tensor], given: Sequence[Tensor], weights: Tensor) -> Sequence[Tensor]:
    return torch.func.vjp(function, *given)[1](weights)


def test_gradients_flow_without_functional_transforms(engine: str):
    start, inputs = case()
    leaves = [v.clone().requires_grad_() for v in (start, *inputs)]
    followed(saturated, *leaves).square().sum().backward()
    again = [v.clone().requires_grad_() for v in (start, *inputs)]
    plain(saturated, again[0], again[1:], 40).square().sum().backward()
    for one, other in zip(leaves, again, strict=True):
        agree_in_slope(one.grad, other.grad)


def test_batches_of_functional_transforms_are_further_dimensions(engine: str):
    start, inputs = case()
    starts, lows = noise(8, 4, *start.shape), 0.3 + noise(9, 4, 1, 2).square()
    found = torch.vmap(lambda s, low: followed(saturated, s, inputs[0], low, inputs[2]))(starts, lows)
    each = [followed(saturated, s, inputs[0], low, inputs[2]) for s, low in zip(starts, lows, strict=True)]
    agree(found, torch.stack(each))
    low = inputs[1]
    forward, back = (
        transform(lambda v: followed(saturated, start, inputs[0], v, inputs[2]))(low)
        for transform in (torch.func.jacfwd, torch.func.jacrev)
    )
    agree_in_slope(forward, back)


def test_a_missing_sample_is_handed_on_alike(engine: str):
    factor, driven = torch.full((1, 1), 0.5, dtype=torch.float64), noise(1, 9, 1)
    driven[4] = torch.nan
    found = followed(linear, torch.zeros(1, dtype=torch.float64), factor, driven)
    agree(found, plain(linear, torch.zeros(1).double(), (factor, driven), 9), equal_nan=True)
    assert found.isnan().sum() == 5


def test_single_precision_stays_so():
    record = noise(1, 10, 2).float()
    found = followed(linear, record[0], torch.full((1, 2), 0.5), record)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, plain(linear, record[0], (torch.full((1, 2), 0.5), record), 10))


def test_without_a_compiler_torch_does_it_and_says_so_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    start, inputs = case()
    native = followed(saturated, start, *inputs)
    monkeypatch.setenv("CXX", "no-such-compiler")
    library.cache_clear()
    errors.say_once.cache_clear()
    with caplog.at_level(logging.WARNING):
        found = [followed(saturated, start, *inputs) for _ in range(2)]
    library.cache_clear()
    errors.say_once.cache_clear()
    assert [r.getMessage() for r in caplog.records] == [
        f"records are followed in torch, sample by sample: {NO_COMPILER}"
    ]
    for one in found:
        agree(one, native)
