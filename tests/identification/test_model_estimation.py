"""Step 3 on flights of known models: what flew comes back within its standard errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.data import Dataset
from rotorid_torch.effects.base import Frame, Values
from rotorid_torch.effects.registry import EFFECTS
from rotorid_torch.identification.estimate.segments import Records
from rotorid_torch.identification.model_estimation import (
    ModelEstimate,
    _idle,
    averaged,
    controls_that_acted,
    estimate_model,
    initial_spread,
    records,
)
from rotorid_torch.identification.model_regression import ModelRegression, measured, regress_model
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from tests.effects.own_effects import OWN, OwnLag
from tests.known_models import DERIVATIVES, body_spec, flown, linear_vehicle, manoeuvres, rate_vehicle, with_values

DT = 0.02


@pytest.fixture(autouse=True)
def own_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    for own in OWN:
        monkeypatch.setitem(EFFECTS, own.id, own)


def estimated(data: Dataset, *effects: str) -> tuple[ModelEstimate, Model, ModelRegression]:
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction, effects))
    start = regress_model(model, data, reconstruction)
    return estimate_model(model, data, reconstruction, start), model, start


def deviations(found: ModelEstimate, model: Model, truth: dict[str, float]) -> dict[str, float]:
    """Estimates minus truth, in standard errors; trims left out."""
    se = dict(zip(found.names, found.fit.uncertainty.standard_errors.tolist(), strict=True))
    theta = model.theta.detach()
    return {
        n: (float(theta[model.parameter_set.index(n)]) - truth.get(n, 0.0)) / se[n]
        for n in found.names
        if not n.endswith("trim") and se[n] > 0
    }


@pytest.fixture(scope="module")
def rates() -> Dataset:
    return flown(rate_vehicle(), manoeuvres(8.0, DT), DT, noise=0.03, seed=3)


def test_known_parameters_come_back_within_three_standard_errors():
    data = flown(linear_vehicle(), manoeuvres(8.0, DT), DT, noise=0.02, seed=2)
    found, model, start = estimated(data)
    assert found.fit.minimum.converged
    off = deviations(found, model, {f"forces.{n}": v for n, v in DERIVATIVES.items()})
    assert len(off) == 60
    size = np.abs(list(off.values()))
    assert float((size < 3.0).mean()) > 0.97
    assert float(size.max()) < 4.5
    assert 0.5 < float(np.sqrt((size**2).mean())) < 1.5
    assert not torch.equal(model.theta.detach(), start.theta)
    assert found.criterion < float("inf")


def test_rates_alone(rates: Dataset):
    found, model, _ = estimated(rates)
    off = deviations(
        found, model, {n: v for n, v in zip(model.parameter_set.names, rate_vehicle().theta.tolist(), strict=True)}
    )
    assert max(abs(v) for v in off.values()) < 3.5
    torch.testing.assert_close(found.fit.model_error_ratio, torch.ones(3).double(), atol=0.1, rtol=0)


def test_a_delay_comes_back():
    truth = with_values(rate_vehicle(effects=("control.delay",)), {"control.delay.common": 0.07})
    data = flown(truth, manoeuvres(8.0, DT), DT, noise=0.02, seed=4)
    found, model, _ = estimated(data, "control.delay")
    values = dict(zip(model.parameter_set.names, model.theta.tolist(), strict=True))
    assert values["control.delay.common"] == pytest.approx(0.07, abs=0.003)
    off = deviations(found, model, dict(zip(truth.parameter_set.names, truth.theta.tolist(), strict=True)))
    assert abs(off["control.delay.common"]) < 3.0
    assert max(abs(v) for v in off.values()) < 4.0


def test_a_delay_that_is_not_there_is_found_at_zero(rates: Dataset):
    found, model, _ = estimated(rates, "control.delay")
    value = float(model.theta.detach()[model.parameter_set.index("control.delay.common")])
    se = float(found.fit.uncertainty.standard_errors[found.names.index("control.delay.common")])
    bound = bool(found.fit.minimum.at_bound[found.names.index("control.delay.common")])
    assert value == 0.0 or value < 3.0 * se
    assert bound == (value == 0.0)


@pytest.mark.parametrize("inverse", [1.2, 4.0])
def test_a_rate_limit_comes_back_from_a_model_that_has_none(inverse: float):
    """At no limit there is no slope that leads to one."""
    truth = with_values(rate_vehicle(effects=("control.rate_limit",)), {"control.rate_limit.inverse": inverse})
    data = flown(truth, manoeuvres(8.0, DT), DT, noise=0.02, seed=4)
    found, model, _ = estimated(data, "control.rate_limit")
    assert model.named_values["control.rate_limit.inverse"] == pytest.approx(inverse, rel=0.1)
    off = deviations(found, model, truth.named_values)
    assert abs(off["control.rate_limit.inverse"]) < 3.5


def test_a_rate_limit_that_is_not_there_is_found_to_do_nothing(rates: Dataset):
    (found, model, _), (without, _, _) = estimated(rates, "control.rate_limit"), estimated(rates)
    assert found.fit.minimum.converged
    assert model.named_values["control.rate_limit.inverse"] == 0.0
    assert found.fit.minimum.point.cost == pytest.approx(without.fit.minimum.point.cost, abs=0.1)


def test_beside_one_control_s_limit_no_other_control_is_begun_at_one():
    model = rate_vehicle(effects=("control.rate_limit",), each_control=("control.rate_limit",))
    assert set(_idle(model)) == {f"control.rate_limit.{c}" for c in model.body.controls}
    assert _idle(with_values(model, {"control.rate_limit.lat": 1.2})) == {}


def test_an_own_effect_with_a_state_comes_back():
    truth = with_values(
        rate_vehicle(effects=("own.lag",)), {"own.lag.L": 20.0, "own.lag.tau": 0.4, "forces.L.lat": 10.0}
    )
    data = flown(truth, manoeuvres(8.0, DT), DT, noise=0.01, seed=5)
    found, model, _ = estimated(data, "own.lag")
    assert model.layout.names[-1] == "own.lag.late"
    off = deviations(found, model, dict(zip(truth.parameter_set.names, truth.theta.tolist(), strict=True)))
    assert abs(off["own.lag.L"]) < 4.0
    assert abs(off["own.lag.tau"]) < 4.0


def test_states_of_effects_follow_the_record_to_start_from():
    model = with_values(rate_vehicle(effects=("own.lag",)), {"own.lag.tau": 0.4})
    data = flown(model, manoeuvres(8.0, DT), DT)
    reconstruction = reconstruct(data)
    late = measured(model, data, reconstruction, ["f_lat"]).signals["own.lag.late"]
    stick, wanted = data.flights["f_lat"].channels["lat"], [0.0]
    for a, b in zip(stick[:-1].tolist(), stick[1:].tolist(), strict=True):
        wanted.append(wanted[-1] + DT / 0.4 * (0.5 * (a + b) - wanted[-1]))
    torch.testing.assert_close(late, torch.tensor(wanted).double(), atol=3e-3, rtol=0)
    known = records(model, data, reconstruction).states[..., -1]
    assert bool(known.isfinite().all())


@pytest.mark.parametrize(("declared", "known"), [(0.002, 0.002), (0.5, 0.02)])
def test_what_a_channel_tells_is_no_freer_than_it_is_measured(declared: float, known: float):
    """A heading that is free by degrees would give every segment a sideslip of its own, in any wind."""
    data = flown(linear_vehicle(), manoeuvres(3.0, DT), DT)
    heading = {n: {**f.channels, "psi": torch.zeros_like(f.time)} for n, f in data.flights.items()}
    data = Dataset.from_arrays(heading, identify=data.identify, channels={"psi": {"noise": declared}})
    model = linear_vehicle(effects=("environment.wind",), reference={**body_spec().reference, "psi": 0.0})
    spread = dict(zip(model.layout.names, initial_spread(model, data).tolist(), strict=True))
    assert spread["environment.wind.psi"] == known
    assert spread["v"] == float("inf")


def test_an_effect_that_integrates_starts_at_zero(monkeypatch: pytest.MonkeyPatch):
    class OwnIntegral(OwnLag):
        id = "own.integral"

        def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
            return frame, frame.signals["lat"].unsqueeze(-1).expand_as(x)

    monkeypatch.setitem(EFFECTS, "own.integral", OwnIntegral)
    model = rate_vehicle(effects=("own.integral",))
    data = flown(model, manoeuvres(3.0, DT), DT)
    state = measured(model, data, reconstruct(data), ["f_lat"]).signals["own.integral.late"]
    assert abs(float(state[0])) < 1e-9
    assert float(state.max()) == pytest.approx(0.04 * 0.9, abs=2e-3)


def test_parameters_that_step_2_holds_stay(rates: Dataset):
    reconstruction = reconstruct(rates)
    model = build(propose(rates, reconstruction))
    start = regress_model(model, rates, reconstruction)
    held = ("forces.L.q", "forces.N.p")
    found = estimate_model(model, rates, reconstruction, replace(start, held=held))
    assert not set(held) & set(found.names)
    places = [model.parameter_set.index(n) for n in held]
    assert torch.equal(model.theta.detach()[places], start.theta[places])


def test_fast_records_are_averaged():
    record = torch.arange(11.0, dtype=torch.float64)[:, None].repeat(1, 2)
    record[4, 1] = torch.nan
    found = averaged(record, 3)
    assert found[:, 0].tolist() == [1.0, 4.0, 7.0]
    assert found[:, 1].tolist() == [1.0, 4.0, 7.0]
    record[3:6, 1] = torch.nan
    assert bool(averaged(record, 3)[1, 1].isnan())


@pytest.mark.parametrize("declared", [None, 0.004, 0.02])
def test_controls_lose_the_noise_that_is_declared_and_nothing_else(declared: float | None):
    time = DT * torch.arange(600, dtype=torch.float64)
    acted = torch.stack([0.1 * torch.sin((1.0 + k) * time) for k in range(2)], dim=-1)
    noise = torch.randn(acted.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    recorded = acted + 0.004 * noise
    flight = {"time": time, "lon": recorded[:, 0], "omega1": recorded[:, 1], "p": acted[:, 0]}
    data = Dataset.from_arrays(
        {"a": {name: values.numpy() for name, values in flight.items()}},
        identify=["a"],
        controls={"lon": {"noise": declared} if declared else {}},
        channels={"omega1": {"noise": declared}} if declared else {},  # a rotor that turns on record
    )
    recorded = data["a"].bridged(("lon", "omega1"))
    result = controls_that_acted(data, "a", ("lon", "omega1"))
    if not declared:
        torch.testing.assert_close(result, recorded, rtol=0.0, atol=1e-12)
    else:  # what is declared five times too large takes no more than the noise that is present
        assert float((result - acted).square().mean().sqrt()) < 0.5 * 0.004


def test_records_are_at_fifty_hertz_at_least():
    for dt, wanted in ((0.01, 0.02), (1 / 154, 3 / 154), (0.04, 0.04)):
        data = flown(rate_vehicle(), manoeuvres(3.0, dt), dt)
        reconstruction = reconstruct(data)
        found = records(build(propose(data, reconstruction)), data, reconstruction)
        assert found.dt == pytest.approx(wanted)
        assert found.states.shape[-1] == 3


def test_flights_that_leave_the_memory_change_nothing(rates: Dataset, monkeypatch: pytest.MonkeyPatch):
    def regressed() -> tuple[ModelRegression, Records]:
        reconstruction = reconstruct(rates)
        spec = propose(rates, reconstruction)
        model = build(spec)
        return regress_model(model, rates, reconstruction), records(model, rates, reconstruction)

    whole, batch = regressed()
    monkeypatch.setattr("rotorid_torch.data.on_demand.BUDGET", 1)
    again, pieces = regressed()
    torch.testing.assert_close(again.theta, whole.theta, rtol=0.0, atol=0.0)
    torch.testing.assert_close(pieces.states, batch.states, rtol=0.0, atol=0.0, equal_nan=True)
    torch.testing.assert_close(pieces.outputs, batch.outputs, rtol=0.0, atol=0.0, equal_nan=True)
    assert pieces.lengths.tolist() == batch.lengths.tolist()


def test_flights_of_different_lengths_share_a_batch():
    moves = manoeuvres(6.0, DT) | {"short": manoeuvres(3.0, DT)["f_lat"]}
    data = flown(rate_vehicle(), moves, DT, noise=0.01)
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction))
    batch = records(model, data, reconstruction)
    i = data.identify.index("short")
    short = int(batch.lengths[i])
    assert short < batch.samples == int(batch.lengths.max())
    assert bool(batch.outputs[i, short:].isnan().all())
    assert bool(batch.states[i, short:].isnan().all())
    assert torch.equal(batch.controls[i, short:], batch.controls[i, short - 1].expand(batch.samples - short, -1))
    assert bool(batch.outputs[i, :short].isfinite().all())


def test_a_state_whose_channel_a_flight_lacks_is_not_made_up():
    vehicle = linear_vehicle(effects=("environment.wind",), reference={"psi": 0.3, "environment.wind.psi": 0.3})
    data = flown(linear_vehicle(), manoeuvres(8.0, DT), DT, noise=0.02, seed=2)
    states = records(vehicle, data, reconstruct(data)).states
    assert states[..., vehicle.layout.names.index("environment.wind.psi")].isnan().all()
    assert states[..., : len(vehicle.body.states)].isfinite().all()
