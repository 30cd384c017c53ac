"""Free runs that torch differentiates: their numbers, their derivatives, and what is refused."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from rotorid_torch.core.integrate import simulate
from rotorid_torch.data import Dataset
from rotorid_torch.errors import InputError
from rotorid_torch.model.model import Model
from rotorid_torch.model.training.equilibrium import equilibrium
from rotorid_torch.model.training.free_run import FreeRun
from tests.known_models import flown, helicopter, linear_vehicle, manoeuvres
from tests.mistakes import one_line

DT = 0.02
STARTS = (0.5, 2.0, 4.0)


@pytest.fixture(scope="module")
def clean() -> Dataset:
    return flown(linear_vehicle(), manoeuvres(9.0, DT), DT)


def eager(model: Model, x0: Tensor, controls: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
    """The same by torch alone."""
    states = simulate(lambda t, x, u: model.rates(theta, x, u), x0, controls, DT)
    return states, model.outputs_at(theta, states, controls)


def test_runs_from_measured_starts_follow_their_flight(clean: Dataset):
    run = linear_vehicle().free_run(clean.flights["f_lon"], STARTS, 2.0)
    assert run.outputs.shape == (3, 101, len(linear_vehicle().body.outputs))
    assert float(run.residual.detach().abs().max()) < 0.02  # of a line through a quarter second, at its start
    assert torch.equal(run["q"], run.outputs[..., linear_vehicle().body.outputs.index("q")])


@pytest.mark.parametrize("model", [linear_vehicle(), helicopter("first order")], ids=["body", "rotor"])
def test_derivatives_are_those_of_torch(model: Model):
    """By all parameters and by the initial state, rotor states among them."""
    chance = torch.Generator().manual_seed(0)
    x = torch.tensor([model.reference.get(n, 0.0) for n in model.layout.names], dtype=torch.float64)
    u = torch.tensor([model.reference.get(n, 0.0) for n in model.body.controls], dtype=torch.float64)
    x0 = (x + 0.02 * torch.randn(3, len(x), generator=chance, dtype=torch.float64)).requires_grad_()
    controls = u + 0.01 * torch.randn(3, 40, len(u), generator=chance, dtype=torch.float64)
    pairs = model.trajectories(x0, controls, DT), eager(model, x0, controls, model.theta)
    weights = [torch.randn(part.shape, generator=chance, dtype=torch.float64) for part in pairs[1]]
    got, wanted = (
        torch.autograd.grad([(p * w).sum() for p, w in zip(pair, weights, strict=True)], [model.theta, x0])
        for pair in pairs
    )
    for g, w in zip(got, wanted, strict=True):
        assert (g - w).norm() < 1e-10 * w.norm()


def test_rotor_states_that_rest_carry_derivatives():
    """The whole derivative of a run, its start at rest included, against differences."""
    model = helicopter("first order")
    flights = flown(model, manoeuvres(3.0, DT), DT)
    flight = flights.flights["f_lon"]

    def cost() -> Tensor:
        return model.free_run(flight, 0.5, 1.0)["a1"].square().sum()

    (slope,) = torch.autograd.grad(cost(), model.theta)
    for name in ("rotor.a1.q", "rotor.a1.lon"):
        place, values = model.parameter_set.index(name), []
        step = 1e-5 * max(1.0, abs(float(model.theta.detach()[place])))
        for sign in (1.0, -1.0):
            with model.restored(), torch.no_grad():
                model.theta[place] += sign * step
                values.append(float(cost().detach()))
        assert float(slope[place]) == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-4)


def test_side_by_side_is_as_one_by_one(clean: Dataset):
    model, flights = linear_vehicle(), [clean.flights[n] for n in ("f_lon", "f_col")]
    many = model.free_run([flights[0], flights[1], flights[0]], STARTS, 1.0)
    for k, (flight, start) in enumerate(zip((0, 1, 0), STARTS, strict=True)):
        one = model.free_run(flights[flight], start, 1.0)
        torch.testing.assert_close(one.outputs, many.outputs[k], rtol=1e-12, atol=1e-12)
        torch.testing.assert_close(one.measured, many.measured[k])


def test_an_initial_state_may_be_told_and_the_body_alone_rests():
    model = helicopter("first order")
    flight = flown(model, manoeuvres(3.0, DT), DT).flights["f_lon"]
    n = len(model.body.states)
    body = torch.tensor([model.reference[s] for s in model.body.states], dtype=torch.float64)
    run = model.free_run(flight, 0.5, 1.0, x0=body)
    u = flight.bridged(model.body.controls)[25]
    torch.testing.assert_close(run.states[0], equilibrium(model, body, u), rtol=0, atol=1e-8)
    again = model.free_run(flight, 0.5, 1.0, x0=run.states[0].detach())
    torch.testing.assert_close(again.states, run.states)
    assert torch.equal(run.states[0, :n].detach(), body)


def test_torch_does_it_where_native_code_does_not():
    """In single precision, rotor states that rest included."""
    model = helicopter("first order")
    single = copy.deepcopy(model).float()
    flight = flown(model, manoeuvres(3.0, DT), DT).flights["f_lon"]
    runs = [m.free_run(flight, (0.5, 1.0), 0.5) for m in (model, single)]
    assert runs[1].outputs.dtype == torch.float32
    torch.testing.assert_close(runs[1].outputs.double(), runs[0].outputs, rtol=1e-4, atol=1e-4)
    wanted, got = (
        torch.autograd.grad(r.outputs.square().mean(), m.theta)[0].double()
        for r, m in zip(runs, (model, single), strict=True)
    )
    assert (got - wanted).norm() < 1e-3 * wanted.norm()


def test_adam_on_windows_finds_a_derivative(clean: Dataset):
    """From half of it, everything else held by zero steps."""
    model, place = linear_vehicle(), linear_vehicle().parameter_set.index("forces.M.q")
    true = float(model.theta.detach()[place])
    with torch.no_grad():
        model.theta[place] = 0.5 * true
    adam = torch.optim.Adam(model.parameters(), lr=0.1)
    mask = torch.zeros_like(model.theta)
    mask[place] = 1.0
    for _ in range(60):
        adam.zero_grad()
        run: FreeRun = model.free_run(clean.flights["f_lon"], (1.0, 2.0, 3.0), 2.0)
        run.residual.square().mean().backward()
        assert model.theta.grad is not None
        model.theta.grad.mul_(mask)
        adam.step()
    assert float(model.theta[place].detach()) == pytest.approx(true, rel=0.05)


def other_place(model: Model) -> None:
    with torch.no_grad():
        model.imu += 1.0


def other_planet(model: Model) -> None:
    model.body = replace(model.body, gravity=3.7)


@pytest.mark.parametrize("change", [other_place, other_planet])
def test_numbers_that_change_outside_theta_are_followed(clean: Dataset, change: Callable[[Model], None]):
    """Code that was made of other buffers, or other attributes, is not used."""
    model, flight = linear_vehicle(), clean.flights["f_lon"]
    x0 = torch.full((len(model.layout),), 0.3, dtype=torch.float64)
    before = model.free_run(flight, 0.0, 1.0, x0=x0).outputs.detach()
    change(model)
    after = model.free_run(flight, 0.0, 1.0, x0=x0)
    controls = flight.bridged(model.body.controls)[None, :51]
    wanted = eager(model, x0[None], controls, model.theta)[1][0]
    assert not torch.allclose(before, wanted)
    torch.testing.assert_close(after.outputs, wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"start": 8.0}, "flight f_lon: start: 8 s, 2 s on, leaves the flight; expected 0 to 7 s"),
        ({"seconds": 20.0}, "flight f_lon: seconds: is 20; expected 0.02 to 9 s"),
        ({"flight": ["f_lon", "f_col"], "start": 1.0}, "free_run: start: 1 starts for 2 flights"),
        ({"x0": torch.zeros(3)}, "free_run: x0: has 3 columns; expected 8"),
        ({"x0": torch.zeros(2, 8)}, "free_run: x0: has shape (2, 8); expected (n,), or (1, n) for 1 starts"),
        ({"x0": [None] * 8}, "free_run: x0: holds None"),
        ({"start": "1 s"}, "free_run: start: is '1 s'"),
        ({"start": float("nan")}, "free_run: start: holds NaN"),
        ({"start": None}, "free_run: start: is None"),
        ({"seconds": -1.0}, "free_run: seconds: is -1; expected a number above 0"),
        ({"seconds": float("inf")}, "free_run: seconds: is inf"),
        ({"seconds": "2"}, "free_run: seconds: is '2'"),
    ],
)
def test_what_is_refused(clean: Dataset, changes: dict, wrong: str):
    asked = {"flight": "f_lon", "start": 0.0, "seconds": 2.0} | changes
    names = asked.pop("flight")
    flight = clean.flights[names] if isinstance(names, str) else [clean.flights[n] for n in names]
    with pytest.raises(InputError) as error:
        linear_vehicle().free_run(flight, **asked)
    assert wrong in str(error.value)


@pytest.mark.parametrize("flight", [None, "f_lon", ["f_lon"], {"f_lon": 1}, 3])
def test_what_is_no_flight_is_refused(flight: Any):
    assert 'expected a Flight, as data["NAME"]' in one_line(lambda: linear_vehicle().free_run(flight), "flight")


def test_runs_are_told_in_a_line(clean: Dataset):
    line = repr(linear_vehicle().free_run(clean.flights["f_lon"], (1.0, 2.0), 2.0))
    assert len(line) < 300
    assert "(2,) starts, 101 samples over 2 s" in line
