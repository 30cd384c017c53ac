"""Delay of the controls: exact where it can be, accurate in between, and differentiable everywhere."""

from __future__ import annotations

import msgspec
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from rotorid_torch.core.native.recurrences import CompiledRecursion
from rotorid_torch.effects.base import Effect, Stage, Values
from rotorid_torch.effects.examples import example
from rotorid_torch.effects.families.control import LONGEST, ControlDelay, ControlLag
from rotorid_torch.effects.registry import registered
from rotorid_torch.errors import Unsupported
from tests.known_models import body_spec

DT = 0.02


def delayed(controls: Tensor, delay: float | Tensor) -> Tensor:
    vector = torch.as_tensor(delay, dtype=torch.float64).unsqueeze(-1)
    return ControlDelay().tape(controls, ("lon", "lat")[: controls.shape[-1]], DT, Values(vector, ("common",)))


def noise(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def smooth(time: Tensor) -> Tensor:
    return torch.stack([torch.sin(3.0 * time), torch.cos(2.0 * time)], dim=-1)


TIME = DT * torch.arange(300, dtype=torch.float64)


def test_a_spec_lets_every_control_have_a_size_of_its_own():
    plain, alone = body_spec(), msgspec.structs.replace(body_spec(), each_control=("control.delay",))
    for spec, free in ((plain, {"common"}), (alone, set(plain.controls))):
        delay, lag = ControlDelay.from_spec(spec), ControlLag.from_spec(spec)
        assert {p.name for p in delay.declared if p.free} == free
        assert {p.name for p in lag.declared if p.free} == {"common"}
    assert all(p.bounds[0] == 0.0 for p in ControlDelay.from_spec(alone).declared)  # by itself no control leads


def test_no_delay_is_the_record_itself():
    record = noise(50, 2)
    assert torch.equal(delayed(record, 0.0), record)


@pytest.mark.parametrize("samples", range(1, 13))
def test_whole_samples_shift_exactly_and_hold_the_beginning(samples: int):
    record = noise(50, 2)
    found = delayed(record, samples * DT)
    torch.testing.assert_close(found[samples:], record[:-samples], rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(found[:samples], record[:1].expand(samples, -1), rtol=1e-12, atol=1e-12)


@given(st.floats(0.0, LONGEST))
def test_a_smooth_record_is_shifted_accurately(delay: float):
    found, wanted = delayed(smooth(TIME), delay), smooth(TIME - delay)
    error = (found - wanted).abs()[20:]
    assert float(error[:-1].max()) < 3e-5
    assert float(error[-1].max()) < 5e-3  # no sample beyond
    held = TIME < delay - DT
    assert torch.equal(found[held], smooth(TIME)[:1].expand(int(held.sum()), -1))


@given(st.floats(0.0, LONGEST), st.floats(-2.0, 2.0))
def test_straight_lines_and_constants_stay_so(delay: float, slope: float):
    record = (slope * TIME)[:, None]
    torch.testing.assert_close(delayed(record, delay)[20:-2], (slope * (TIME - delay))[20:-2, None], rtol=0, atol=1e-12)
    constant = torch.full((50, 1), slope, dtype=torch.float64)
    assert torch.allclose(delayed(constant, delay), constant, rtol=1e-14)


@pytest.mark.parametrize("delay", [0.005, 0.013, 0.02, 0.031, 0.1])
def test_derivative_by_the_delay_is_that_of_differences(delay: float):
    record, h = noise(80, 2), 1e-6
    found = torch.func.jacfwd(lambda d: delayed(record, d))(torch.tensor(delay, dtype=torch.float64))
    wanted = (delayed(record, delay + h) - delayed(record, delay - h)) / (2 * h)
    torch.testing.assert_close(found, wanted, rtol=1e-3, atol=1e-3 * float(wanted.abs().max()))


def test_derivative_at_no_delay_is_minus_the_slope():
    found = torch.func.jacfwd(lambda d: delayed(smooth(TIME), d))(torch.tensor(0.0, dtype=torch.float64))
    slope = torch.stack([3.0 * torch.cos(3.0 * TIME), -2.0 * torch.sin(2.0 * TIME)], dim=-1)
    torch.testing.assert_close(found[1:-1], -slope[1:-1], rtol=0, atol=3e-3)


def test_several_delays_run_over_several_flights():
    records, delays = noise(4, 60, 2), torch.tensor([0.0, 0.013, 0.04], dtype=torch.float64)
    found = delayed(records, delays[:, None])
    assert found.shape == (3, 4, 60, 2)
    for k, delay in enumerate(delays.tolist()):
        for f in range(4):
            torch.testing.assert_close(found[k, f], delayed(records[f], delay), rtol=1e-12, atol=1e-12)
    assert delayed(noise(60, 2), delays).shape == (3, 60, 2)


def test_a_record_shorter_than_the_delay_is_held():
    record = noise(3, 2)
    assert torch.allclose(delayed(record, 0.2), record[:1].expand(3, -1))


WITH_MEMORY = {e: cls for e, cls in registered().items() if cls.tape is not Effect.tape}
RECURSIVE = {"control.backlash", "control.lag", "control.rate_limit", "propulsion.motor_lag", "sensors.filter"}


def taped(effect: Effect, names: tuple[str, ...], record: Tensor, vector: Tensor) -> Tensor:
    return effect.tape(record, names, DT, Values(vector, tuple(p.name for p in effect.declared)))


@pytest.mark.parametrize("effect_id", WITH_MEMORY)
def test_compiled_and_in_torch_a_record_is_the_same(effect_id: str, monkeypatch: pytest.MonkeyPatch):
    spec = example(WITH_MEMORY[effect_id])
    effect = WITH_MEMORY[effect_id].from_spec(spec)
    names = (*spec.controls, *spec.inputs) if effect.stage is Stage.CONTROL else spec.outputs
    record = 0.02 * noise(3, 120, len(names)).cumsum(-2)
    gap = record.clone()
    gap[1, 50:53, 0] = torch.nan
    sizes = torch.tensor([p.typical or p.value for p in effect.declared], dtype=torch.float64)
    vectors = [sizes, 0.3 * sizes + 0.1 * sizes.abs().max()]

    def run() -> list[Tensor]:
        values = [taped(effect, names, r, v) for r in (record, gap) for v in vectors]
        return values + [torch.func.jacfwd(lambda v: taped(effect, names, record, v))(v) for v in vectors]

    native, asked = run(), []

    def refused(self: CompiledRecursion, *given: object) -> None:
        asked.append(given)
        raise Unsupported("no compiler")

    monkeypatch.setattr(CompiledRecursion, "run", refused)
    monkeypatch.setattr("rotorid_torch.core.native.build.say_once", lambda text: None)
    for k, (found, wanted) in enumerate(zip(native, run(), strict=True)):
        tolerance = 1e-12 if k < 4 else 1e-9
        torch.testing.assert_close(found, wanted, rtol=tolerance, atol=tolerance, equal_nan=True)
    assert bool(asked) == (effect_id in RECURSIVE)
