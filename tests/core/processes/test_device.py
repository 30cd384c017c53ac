"""What runs on another device stays there: fit and filter where tensors of two devices refuse to meet, and on a GPU."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from rotorid_torch.core.gauss_newton import Options
from rotorid_torch.core.processes.device import moved
from rotorid_torch.identification.estimate import system as system_module
from rotorid_torch.identification.estimate.progressive_fit import Settings, fit
from rotorid_torch.identification.estimate.segments import Records, records_from
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.model_estimation import Means, estimate_model
from rotorid_torch.identification.model_regression import regress_model
from rotorid_torch.identification.reconstruct.filter_problem import Filtered
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.reconstruct.unscented_filter import unscented_filter
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.nominal import build
from tests.elsewhere import MadeElsewhere, MadeInside, backward, forward, held, one_by_one, there
from tests.identification.estimate.output_error_cases import Roll, roll_flight
from tests.known_models import flown, helicopter, manoeuvres, points, rate_vehicle

FEW = 4
"""Parameters; the stand-in for forward derivatives takes them one by one."""
GPU = pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"))


def on(device: str) -> torch.device | MadeElsewhere:
    """Where tensors are made."""
    return MadeElsewhere() if device == "elsewhere" else torch.device(device)


def to(device: str, tensor: Tensor) -> Tensor:
    return there(tensor) if device == "elsewhere" else tensor.to(device)


def sent(device: str, item: object) -> object:
    """As `moved`, to the pretended device too."""
    return moved(item, device) if device != "elsewhere" else _sent(item)


def _sent(item: object) -> object:
    parts = {name: there(part) for name, part in vars(item).items()}
    return replace(item, **parts)  # pyright: ignore[reportArgumentType]


def roll() -> tuple[nn.Module, Records, Settings]:
    rng = np.random.default_rng(5)
    flights = [roll_flight(rng, shift=0.3 * k) for k in range(3)]
    cut = [{key: np.asarray(flight[key])[18:38] for key in ("time", "controls", "outputs")} for flight in flights]
    records = records_from([flight | {"states": np.full((20, 2), np.nan)} for flight in cut])
    few = Options(max_iterations=1)
    return Roll(), records, Settings(engine="reference", lengths=(math.inf,), options=few)


def a_helicopter() -> tuple[nn.Module, Records, Settings]:
    model = helicopter()
    x, u = points(model, 2 * 6, seed=4, spread=0.01)
    states, controls = x.detach().reshape(2, 6, -1), u.detach().reshape(2, 6, -1)
    with torch.no_grad():
        outputs = System(model).output(model.theta.detach(), states, controls)
    records = Records(0.02, torch.tensor([6, 6]), torch.zeros(2, dtype=torch.float64), controls, outputs, states)
    known = model.parameter_set
    mean, sd = known.values[:FEW], known.prior_sd[:FEW].clamp(max=1.0)
    few = Options(max_iterations=1)
    floor = torch.full((outputs.shape[-1],), 0.01, dtype=torch.float64)
    settings = Settings(
        lengths=(math.inf,), sensor_noise=floor, prior_mean=mean, prior_sd=sd, engine="reference", options=few
    )
    return model, records, settings


@pytest.mark.parametrize("case", [roll, pytest.param(a_helicopter, marks=pytest.mark.slow)])
@pytest.mark.parametrize("device", ["elsewhere", GPU])
def test_a_fit_on_another_device_is_that_on_the_processor(
    device: str, case: Callable[[], tuple[nn.Module, Records, Settings]], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, records, settings = case()
    expected = fit(system_of(model), records, settings=settings).estimate()
    if device == "elsewhere":
        monkeypatch.setattr(nn.Module, "to", lambda module, _: module._apply(there))
        for name, stand_in in {"vmap": one_by_one, "jvp": forward, "vjp": backward}.items():
            monkeypatch.setattr(system_module, name, stand_in)
    with on(device):
        found = fit(system_of(model), sent(device, records), settings=sent(device, settings)).estimate()  # pyright: ignore[reportArgumentType]
    assert found.theta.device.type != "cpu"
    for name in ("theta", "noise", "model_error_ratio"):
        same(getattr(found, name), getattr(expected, name))
    same(found.uncertainty.standard_errors, expected.uncertainty.standard_errors)


def system_of(model: nn.Module) -> System:
    names = getattr(model, "parameter_set", None)
    return System(model, None if names is None else names.names[:FEW])


@pytest.mark.parametrize("device", [GPU])
def test_step_3_on_another_device_is_watched_on_the_processor(device: str) -> None:
    """The estimate is that of the processor, and what watches the fit computes with tensors of its own."""
    data = flown(rate_vehicle(), manoeuvres(3.0, 0.02), 0.02, noise=0.02, seed=2)
    motion = reconstruct(data, device=device)
    model = build(propose(data, motion))
    start, costs = regress_model(model, data, motion), []

    def watch(_: int, cost: float, theta: Tensor) -> None:
        costs.append(cost + float(torch.zeros(len(theta), dtype=torch.float64) @ theta))

    on_processor, on_device = (
        estimate_model(model, data, motion, start, Means(watch, device=d)) for d in ("cpu", device)
    )
    same(on_device.fit.theta, on_processor.fit.theta)
    assert costs


@pytest.mark.parametrize("device", ["elsewhere", GPU])
def test_a_filter_stays_on_the_device_of_its_inputs(device: str) -> None:
    rng = np.random.default_rng(2)
    time = 0.1 * np.arange(12)
    outputs = torch.tensor((np.cos(2.0 * time) + 0.01 * rng.standard_normal(12))[:, None])
    outputs[4] = math.nan

    def rates(x: Tensor, u: Tensor) -> Tensor:  # an oscillator whose squared frequency is to be learnt
        return torch.stack([x[..., 1], -x[..., 2] * x[..., 0], 0.0 * x[..., 2]], dim=-1)

    def filtered(place: Callable[[Tensor], Tensor]) -> Filtered:
        column = lambda *values: torch.tensor(values, dtype=torch.float64)  # noqa: E731
        x0, R = place(column(1.0, 0.0, 3.0)), place(column(1e-4).diag())
        P0, Q = place(column(0.01, 0.01, 1.0).diag()), place(column(1e-8, 1e-8, 0.0).diag())
        controls = place(torch.zeros(12, 0, dtype=torch.float64))
        return unscented_filter(rates, lambda x, _: x[..., :1], x0, P0, Q, R, controls, place(outputs), 0.1)

    expected = filtered(lambda tensor: tensor)
    with MadeInside() if device == "elsewhere" else nullcontext():  # nothing says where to make tensors but the inputs
        found = filtered(lambda tensor: to(device, tensor))
    for name, values in vars(expected).items():
        same(getattr(found, name), values)


def same(found: Tensor, expected: Tensor) -> None:
    """To a part in ten million of the largest: optimiser and filters amplify rounding, no more."""
    size = expected.nan_to_num(0.0).abs().max()
    torch.testing.assert_close(held(found).cpu(), expected, rtol=1e-6, atol=1e-7 * float(size), equal_nan=True)
