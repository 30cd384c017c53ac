"""Step 3 where the air moves: the method is chosen by residuals, gusts and derivatives come back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.core.native import build as build_native
from rotorid_torch.data import Dataset
from rotorid_torch.errors import InputError
from rotorid_torch.identification.gusts import follow, least_error, steady_wind
from rotorid_torch.identification.method_choice import GUSTY
from rotorid_torch.identification.model_estimation import Means, ModelEstimate, estimate_model, records
from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.regress.equation import START
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.gusts import GUSTS, fed, in_gusts
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.validate.gusts import in_gusts as in_free_runs
from tests.gusty_flights import DT, INTENSITY, LENGTH, turbulent
from tests.known_models import DERIVATIVES, flown, linear_vehicle, manoeuvres, points, rate_vehicle


def estimated(data: Dataset, method: str) -> tuple[ModelEstimate, Model]:
    step1 = reconstruct(data)
    model = build(propose(data, step1, ()))
    return estimate_model(model, data, step1, regress_model(model, data, step1), Means(method=method)), model


@pytest.fixture(scope="module")
def case() -> tuple[Dataset, Tensor]:
    return turbulent()


@pytest.mark.slow
def test_gusts_and_derivatives_come_back(case: tuple[Dataset, Tensor]):
    data, gusts = case
    answer, model = estimated(data, "auto")
    assert answer.method == "filter-error"
    assert answer.air is not None
    assert answer.flights == data.identify
    assert "the air moves" in answer.why
    for axis in answer.air.axes:
        assert abs(axis.intensity - INTENSITY) < 3.0 * axis.intensity_se
        assert abs(np.log(axis.length / LENGTH)) < 3.0 * axis.length_se / axis.length
    for k in range(3):
        both = torch.stack([answer.air.velocities[..., k].flatten(), gusts[..., k].flatten()])
        assert float(torch.corrcoef(both)[0, 1]) > 0.8
    by_output_error = estimated(data, "output-error")[1]
    for name in ("L.p", "M.q", "N.r", "N.ped", "M.u"):
        off, other = (abs(m.named_values[f"forces.{name}"] / DERIVATIVES[name] - 1.0) for m in (model, by_output_error))
        assert off < 0.06
        assert off < max(other, 0.02)
    errors = dict(zip(answer.names, answer.fit.errors.tolist(), strict=True))
    for row in ("X", "Y", "Z"):  # calm air has other trims by what the flights' wind, which they do not tell, does
        wind = [model.named_values.get(f"forces.{row}.{v}", 0.0) for v in ("u", "v", "w")] * answer.air.steady.numpy()
        assert errors[f"forces.{row}.trim"] > np.sqrt((wind**2).sum()) > 0.0
    off = [abs(model.named_values[n := f"forces.{k}"] - v) / errors[n] for k, v in DERIVATIVES.items()]
    assert float(np.median(off)) < 1.5
    assert max(off) < 4.5


def test_calm_air_is_output_errors():
    data = flown(linear_vehicle(), manoeuvres(8.0, DT), DT, noise=0.02, seed=2)
    (auto, _), (asked, _) = estimated(data, "auto"), estimated(data, "output-error")
    assert auto.method == asked.method == "output-error"
    assert auto.air is None
    assert torch.equal(auto.fit.theta, asked.fit.theta)
    assert "the air is calm" in auto.why
    assert f"{GUSTY:g}" in auto.why


def test_where_no_filter_can_be_compiled_a_method_is_refused_only_to_whoever_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("ROTORID_CACHE", str(tmp_path))
    data = flown(linear_vehicle(), manoeuvres(5.0, DT), DT, noise=0.02, seed=2)
    calm, _ = estimated(data, "output-error")
    monkeypatch.setattr(build_native, "LIMIT_S", 1e-3)
    step1 = reconstruct(data)
    model = build(propose(data, step1, ()))
    start = regress_model(model, data, step1)
    answer = estimate_model(
        model, data, step1, start, Means(method="filter-error", why="fitted by the filter error method: before")
    )
    assert answer.method == "output-error"
    assert "no filter can be compiled" in answer.why
    assert torch.equal(answer.fit.theta, calm.fit.theta)
    with pytest.raises(InputError, match="--method: filter-error: no filter can be compiled for this model"):
        estimate_model(model, data, step1, start, Means(method="filter-error"))


def test_where_the_filter_loses_the_flights_a_method_is_refused_only_to_whoever_asked(case: tuple[Dataset, Tensor]):
    """By derivatives with which the vehicle flies away within a sample."""
    data = case[0]
    step1 = reconstruct(data)
    model = build(propose(data, step1, ()))
    start = regress_model(model, data, step1)
    theta = start.theta.clone()
    theta[[model.parameter_set.index(f"forces.{name}") for name in ("M.u", "L.v")]] = 300.0
    start = replace(start, theta=theta)
    answer = estimate_model(model, data, step1, start, Means(method="filter-error", why="fitted so before"))
    assert answer.method == "output-error"
    assert "the filter loses these flights" in answer.why
    asked = estimate_model(model, data, step1, start, Means(method="output-error"))
    assert torch.equal(answer.fit.theta, asked.fit.theta)
    with pytest.raises(InputError, match="--method: filter-error: by the derivatives that a regression finds"):
        estimate_model(model, data, step1, start, Means(method="filter-error"))


def test_a_method_that_nobody_asked_for_keeps_its_reason():
    data = flown(linear_vehicle(), manoeuvres(5.0, DT), DT, noise=0.02, seed=2)
    step1 = reconstruct(data)
    model = build(propose(data, step1, ()))
    start = regress_model(model, data, step1)
    for before in ("", "fitted by output error: before"):
        answer = estimate_model(model, data, step1, start, Means(method="output-error", why=before))
        assert answer.why == (before or "fitted by output error, as asked for")


def test_rates_alone_have_nothing_that_gusts_act_through():
    data = flown(rate_vehicle(), manoeuvres(8.0, DT), DT, noise=0.03, seed=3)
    assert "no velocities" in estimated(data, "auto")[0].why
    with pytest.raises(InputError, match="--method"):
        estimated(data, "filter-error")


def test_gusts_act_as_the_same_velocity_the_other_way():
    model = linear_vehicle()
    gusty, (x, u) = in_gusts(model), points(model, 5)
    g, force = torch.randn(2, 5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    states = torch.cat([x, g, torch.zeros_like(g)], dim=-1)
    air = x.clone()
    air[:, :3] -= g
    through_air = model.outputs_at(model.theta, air, u)[:, 8:]  # specific forces: where the air alone matters
    assert torch.allclose(gusty.outputs_at(gusty.theta, states, u)[:, 8:], through_air, atol=1e-12)
    assert torch.allclose(gusty.outputs_at(gusty.theta, states, u)[:, :3], x[:, :3])
    fed_model, inputs = fed(model), torch.cat([u, g], dim=-1)
    assert fed_model.body.controls[-3:] == GUSTS
    still = gusty.rates(gusty.theta, states, u)
    assert torch.allclose(fed_model.rates(fed_model.theta, x, inputs), still[:, :8], atol=1e-12)
    pushed = gusty.rates(gusty.theta, torch.cat([x, g, force], dim=-1), u)
    assert torch.allclose((pushed - still)[:, :3], force, atol=1e-12)
    assert torch.allclose((pushed - still)[:, 3:11], torch.zeros(5, 8, dtype=torch.float64))


@pytest.mark.slow
def test_the_same_flights_have_the_same_gusts(case: tuple[Dataset, Tensor]):
    data = case[0]
    step1 = reconstruct(data)
    model = build(propose(data, step1, ()))
    answer = estimate_model(model, data, step1, regress_model(model, data, step1), Means(method="filter-error"))
    assert answer.air is not None
    again = follow(model, answer.names, answer.air, records(model, data, step1))
    assert torch.allclose(again, answer.air.velocities, atol=0.02)
    scored = dict(in_free_runs(model, data, {"f_lat": (data.flights["f_lat"].time, case[1][1])}))["f_lat"]
    assert scored["J_fed"] < 0.5 * scored["J_gust"]


def test_rows_that_gusts_keep_regression_from_telling_are_doubtful(case: tuple[Dataset, Tensor]):
    """Lags and trims are never: no regression tells the ones, and the others are found with the air anyway."""
    data = case[0]
    step1 = reconstruct(data)
    model = build(propose(data, step1, ()))
    answer = regress_model(model, data, step1)
    weak = {row for row, r in answer.by_row.items() if r.band[1] <= START}
    doubtful = answer.doubtful(model.parameter_set.free)
    assert {n.split(".")[1] for n in doubtful} == weak
    assert not [n for n in doubtful if n.endswith((".trim", "L.p", "M.q", "N.r"))]
    poor = replace(answer, by_row={"L": replace(answer.by_row["L"], band=(0.1, START))})
    assert "forces.L.v" in poor.doubtful(model.parameter_set.free)
    assert "forces.L.p" not in poor.doubtful(model.parameter_set.free)


def test_what_flights_have_in_common_is_as_large_as_that_of_drawn_gusts():
    rng, rate, dt, samples = np.random.default_rng(0), 0.1, 0.1, (150, 50)
    means = np.zeros(4000)
    for count in samples:
        g = rng.standard_normal(4000)
        for _ in range(count):
            means += g / sum(samples)
            g = np.exp(-dt * rate) * g + np.sqrt(1.0 - np.exp(-2.0 * dt * rate)) * rng.standard_normal(4000)
    assert 2.0 * means.std() == pytest.approx(steady_wind(rate, 2.0, dt * torch.tensor(samples)), rel=0.04)


def test_no_estimate_of_a_length_is_surer_than_by_gusts_themselves():
    """Maximum likelihood by 400 sets of exact gusts scatters as `least_error` says: it is a bound, and a near one."""
    rng, rate, flights, samples = np.random.default_rng(0), 0.1, 8, 150
    stays = np.exp(-0.1 * rate)
    gusts = np.empty((400, flights, samples))
    gusts[..., 0] = rng.standard_normal((400, flights))
    for k in range(1, samples):
        gusts[..., k] = stays * gusts[..., k - 1] + np.sqrt(1.0 - stays**2) * rng.standard_normal((400, flights))
    tried = np.exp(np.linspace(np.log(rate) - 2.5, np.log(rate) + 2.5, 401))
    fits = []
    for one in tried:  # the variance that is best with this rate; both scales enter the likelihood in closed form
        a = np.exp(-0.1 * one)
        square = gusts[..., 0] ** 2 + ((gusts[..., 1:] - a * gusts[..., :-1]) ** 2).sum(-1) / (1.0 - a * a)
        count = flights * samples
        fits.append(0.5 * count * np.log(square.sum(-1) / count) + 0.5 * flights * (samples - 1) * np.log(1.0 - a * a))
    best = np.log(tried[np.argmin(fits, axis=0)] / rate)
    assert 0.95 < best.std() / least_error(rate, flights * samples * 0.1, flights) < 1.25
