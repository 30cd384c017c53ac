"""Step 2 on flights of a known model: its derivatives come back, whatever shows the force."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lsim, lti
from torch import Tensor

from rotorid_torch.core.parameters import Parameter
from rotorid_torch.core.rigid import vec
from rotorid_torch.data import Dataset
from rotorid_torch.effects.base import Effect, Frame, Role, Stage, State, Values
from rotorid_torch.effects.registry import registered
from rotorid_torch.identification.model_regression import (
    ModelRegression,
    before,
    chained,
    end_to_end,
    integral,
    measured,
    regress_model,
)
from rotorid_torch.identification.reconstruct.reconstruction import Reconstruction, reconstruct
from rotorid_torch.identification.structure import lagged, propose
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from tests.known_models import BODY, DERIVATIVES, IMU, flown, linear_vehicle, manoeuvres

DT = 0.02
INERTIA = ((5000.0, 0.0, -800.0), (0.0, 12000.0, 0.0), (-800.0, 0.0, 10000.0))


def regressed(data: Dataset) -> tuple[ModelRegression, Model, Reconstruction]:
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction))
    return regress_model(model, data, reconstruction), model, reconstruction


def misses(found: ModelRegression, model: Model, sizes: dict[str, float] | None = None) -> dict[str, float]:
    """Errors of the derivatives, each times its regressor's rms, over the row's rms."""
    wanted = {f"forces.{n}": v for n, v in DERIVATIVES.items()}
    made = {}
    for row in found.by_row:
        terms = {
            n.split(".")[2]: wanted.get(n, 0.0) for n in model.parameter_set.names if n.startswith(f"forces.{row}.")
        }
        terms.pop("trim")
        spread = sizes or {}
        whole = np.sqrt(sum((v * spread.get(c, 1.0)) ** 2 for c, v in terms.items()))
        for c, v in terms.items():
            value = float(found.theta[model.parameter_set.index(f"forces.{row}.{c}")])
            made[f"{row}.{c}"] = abs(value - v) * spread.get(c, 1.0) / whole
    return made


@pytest.fixture(scope="module")
def clean() -> Dataset:
    return flown(
        linear_vehicle(inertia=INERTIA),
        manoeuvres(10.0, DT),
        DT,
        vehicle={"imu": list(IMU), "inertia": [list(r) for r in INERTIA]},
    )


def sizes(data: Dataset) -> dict[str, float]:
    return dict(data.scales())


def test_derivatives_come_back_from_records_without_noise(clean: Dataset):
    found, model, _ = regressed(clean)
    wrong = misses(found, model, sizes(clean))
    assert max(wrong.values()) < 0.01, max(wrong, key=lambda n: wrong[n])
    assert all(float(r.r2) > 0.999 for r in found.by_row.values())
    assert found.held == ()


def test_without_accelerometers_velocities_show_the_force(clean: Dataset):
    flights = {n: {c: f.channels[c] for c in ("time", *clean.controls, *BODY)} for n, f in clean.flights.items()}
    channels = {c: {"noise": clean.noise(c), "bias": "none"} for c in BODY}
    data = Dataset.from_arrays(
        flights, identify=clean.identify, channels=channels, controls=dict(clean.control_specs), vehicle=clean.vehicle
    )
    found, model, _ = regressed(data)
    wrong = misses(found, model, sizes(data))
    assert max(wrong.values()) < 0.015, max(wrong, key=lambda n: wrong[n])


def test_derivatives_come_back_from_noisy_records():
    data = flown(linear_vehicle(), manoeuvres(10.0, DT), DT, noise=0.02, seed=1)
    found, model, _ = regressed(data)
    wrong = misses(found, model, sizes(data))
    assert max(wrong.values()) < 0.06, max(wrong, key=lambda n: wrong[n])
    large = {n: v for n, v in wrong.items() if n in ("L.lat", "M.lon", "N.ped", "Z.col", "L.p", "M.q")}
    assert max(large.values()) < 0.05


def test_an_imu_off_the_centre_is_not_taken_for_derivatives(clean: Dataset):
    right, model, _ = regressed(clean)
    vehicle = {"imu": [0.0, 0.0, 0.0], "inertia": [list(r) for r in INERTIA]}
    flights = {n: dict(f.channels) for n, f in clean.flights.items()}
    wrong_place = Dataset.from_arrays(
        flights,
        identify=clean.identify,
        channels=dict(clean.channel_specs),
        controls=dict(clean.control_specs),
        vehicle=vehicle,
    )
    wrong, other, _ = regressed(wrong_place)
    place = model.parameter_set.index("forces.Y.lat")
    assert float(right.theta[place]) == pytest.approx(6.0, rel=0.02)
    # believed at the centre, the accelerometer's lever arm shows up as side force by the stick
    assert abs(float(wrong.theta[other.parameter_set.index("forces.Y.lat")]) - 6.0) > 3.0


def test_a_rate_that_follows_its_stick_at_once_follows_in_the_model():
    """Closed rate loops: the rate is the stick's image, without lag; no damping can be seen."""
    rng = np.random.default_rng(0)
    flights = {}
    for name, moves in manoeuvres(10.0, DT, ("lon", "lat", "ped")).items():
        time = DT * np.arange(len(moves))
        noise = lambda: 1e-3 * rng.standard_normal(len(time))  # noqa: B023, E731
        smooth = np.stack([np.convolve(c, np.ones(9) / 9, "same") for c in moves.T], -1)
        rates = {"p": 20.0 * smooth[:, 1], "q": 15.0 * smooth[:, 0], "r": 10.0 * smooth[:, 2]}
        controls = dict(zip(("lon", "lat", "ped"), smooth.T, strict=True))
        flights[name] = {"time": time, **controls, **{n: v + noise() for n, v in rates.items()}}
    data = Dataset.from_arrays(
        flights,
        identify=list(flights),
        channels={n: {"noise": 1e-3, "bias": "none"} for n in ("p", "q", "r")},
        controls={n: {"unit": "rad", "noise": 1e-6} for n in ("lon", "lat", "ped")},
    )
    found, model, _ = regressed(data)
    value = lambda n: float(found.theta[model.parameter_set.index(f"forces.{n}")])  # noqa: E731
    for row, rate, stick, gain in (("L", "p", "lat", 20.0), ("M", "q", "lon", 15.0), ("N", "r", "ped", 10.0)):
        assert value(f"{row}.{rate}") < 0.0
        assert -value(f"{row}.{stick}") / value(f"{row}.{rate}") == pytest.approx(gain, rel=0.05)


def test_coning_whose_lag_is_lost_in_noise_follows_what_drives_it(clean: Dataset):
    """A regression of its rate would say that it is not damped, and no run from there would come back."""
    rng = np.random.default_rng(0)
    flights = {n: {c: v.numpy() for c, v in f.channels.items()} for n, f in clean.flights.items()}
    for record in flights.values():
        coning = 0.2 * (record["col"] - record["col"][0]) + 0.002 * (record["w"] - record["w"][0])
        record["a0"] = coning + 2e-3 * rng.standard_normal(len(coning))
        for tilt, drives in (("a1", record["lon"] - record["q"]), ("b1", record["lat"] - record["p"])):
            record[tilt] = lagged(torch.from_numpy(drives - drives[0]), 0.1 / DT).numpy()
    noise = {**{c: clean.noise(c) for c in BODY}, "a0": 2e-3, "a1": 1e-6, "b1": 1e-6}
    data = Dataset.from_arrays(
        flights,
        identify=clean.identify,
        channels={c: {"noise": n, "bias": "none"} for c, n in noise.items()},
        controls=dict(clean.control_specs),
        vehicle=clean.vehicle,
    )
    found, model, _ = regressed(data)
    value = lambda n: float(found.theta[model.parameter_set.index(f"rotor.a0.{n}")])  # noqa: E731
    assert value("a0") == -10.0
    assert -value("col") / value("a0") == pytest.approx(0.2, rel=0.1)
    assert -value("w") / value("a0") == pytest.approx(0.002, rel=0.3)
    assert not any(n.startswith("rotor.") for n in found.held)


def test_theta_stays_inside_its_bounds(clean: Dataset):
    found, model, _ = regressed(clean)
    assert torch.equal(model.parameter_set.clamp(found.theta), found.theta)
    assert found.theta.shape == model.theta.shape
    assert float(found.theta[model.parameter_set.index("forces.Z.trim")]) == pytest.approx(-9.80665)


def test_signals_are_bridged_over_gaps(clean: Dataset):
    flights = {n: {c: v.clone() for c, v in f.channels.items()} for n, f in clean.flights.items()}
    flights["f_lon"]["q"][200:210] = torch.nan
    data = Dataset.from_arrays(
        flights,
        identify=clean.identify,
        channels=dict(clean.channel_specs),
        controls=dict(clean.control_specs),
        vehicle=clean.vehicle,
    )
    reconstruction = reconstruct(data)
    signals = measured(build(propose(data, reconstruction)), data, reconstruction, ["f_lon"]).signals
    assert bool(signals["q"].isfinite().all())


def test_integral_is_the_trapezoidal_rule():
    time = torch.linspace(0, 3, 301, dtype=torch.float64)
    torch.testing.assert_close(integral(torch.cos(time), 0.01), torch.sin(time), atol=1e-5, rtol=0)
    assert float(integral(time, 0.01)[0]) == 0.0


@given(st.integers(1, 70), st.integers(1, 4), st.integers(0, 2**31))
def test_linear_steps_chained_are_those_taken_one_after_the_other(samples: int, size: int, seed: int):
    rng = np.random.default_rng(seed)
    steps, x = rng.normal(scale=0.6, size=(samples, size, size)), rng.normal(size=size)
    found = chained(torch.from_numpy(steps), torch.from_numpy(x)).numpy()
    for k in range(samples):
        np.testing.assert_allclose(found[k], x, rtol=1e-9, atol=1e-12 * max(1.0, np.abs(found).max()))
        x = steps[k] @ x


class StackedLag(Effect):
    """Yaw by side speed that acts late; the signal and the state are stacked."""

    id, stage, role = "my.stacked", Stage.FORCES, Role.UNDECLARED

    def __init__(self) -> None:
        size = Parameter("size", 0.0, "rad/(s m)", (-1.0, 1.0), 0.1, doc="yaw by side speed")
        super().__init__((size,), (State("late", "m/s"),))

    def forward(self, frame: Frame, x: Tensor, p: Values) -> tuple[Frame, Tensor]:
        side, late = torch.stack([frame.signals["v"], x[..., 0]]).unbind(0)
        zero = torch.zeros_like(late)
        return frame.add(moment=vec(zero, zero, p["size"] * late)), ((side - late) / 0.5).unsqueeze(-1)


def test_a_state_that_an_effect_stacks_with_a_signal_follows_the_flight(clean: Dataset, monkeypatch):
    monkeypatch.setattr("rotorid_torch.effects.registry.EFFECTS", {**registered(), StackedLag.id: StackedLag})
    reconstruction = reconstruct(clean)
    model = build(propose(clean, reconstruction).with_effects(StackedLag.id))
    signals = measured(model, clean, reconstruction, ["f_lat"]).signals
    side = signals["v"].numpy()
    system = lti([1.0], [0.5, 1.0])
    late = lsim(system, side, DT * np.arange(len(side)), X0=[0.5 * side[0]])[1]
    assert signals[model.state_names(len(model.chain) - 1)[0]].numpy() == pytest.approx(
        late, abs=0.03 * np.abs(side).max()
    )


def test_flights_end_to_end_are_those_of_each_by_itself(clean: Dataset, monkeypatch):
    """Of different lengths, with a state that each flight begins at rest."""
    monkeypatch.setattr("rotorid_torch.effects.registry.EFFECTS", {**registered(), StackedLag.id: StackedLag})
    kept = {n: slice(0, f.samples - 70 * k) for k, (n, f) in enumerate(clean.flights.items())}
    cut = {
        n: {"time": f.time[kept[n]], **{c: v[kept[n]] for c, v in f.channels.items()}} for n, f in clean.flights.items()
    }
    data = Dataset.from_arrays(cut, identify=clean.identify, channels=clean.channel_specs)
    reconstruction = reconstruct(data)
    model = build(propose(data, reconstruction).with_effects(StackedLag.id))
    (group,) = end_to_end(data, data.identify)
    together = measured(model, data, reconstruction, group, before(model, data, reconstruction, group, StackedLag.id))
    alone = [measured(model, data, reconstruction, [name]) for name in group]
    assert together.samples == tuple(data.facts[name].samples for name in group)
    for name, signal in together.signals.items():
        torch.testing.assert_close(signal, torch.cat([one.signals[name] for one in alone]), rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(together.physics, torch.cat([one.physics for one in alone]), rtol=1e-12, atol=1e-14)
    monkeypatch.setattr("rotorid_torch.identification.model_regression.TOGETHER", 2 * data.facts[group[0]].samples)
    assert [len(names) for names in end_to_end(data, data.identify)] == [2] * (len(group) // 2) + [1] * (len(group) % 2)
