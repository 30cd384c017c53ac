"""What every effect promises: the library's own, and effects as users write them."""

from __future__ import annotations

import re

import pytest
import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

from rotorid_torch.core.parameters import ParameterSet
from rotorid_torch.effects.base import Effect, Stage, Values
from rotorid_torch.effects.registry import EFFECTS, registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.validate.free_run import equilibrium
from tests.effects.own_effects import OWN
from tests.known_models import DERIVATIVES, body_spec, points, with_values

DT = 0.02
UNIT = re.compile(
    r"1|((1|rad|m|kg|s|N|V|Hz)[0-9]?( (rad|m|kg|s|N|V)[0-9]?)*)(/\(?(rad|m|kg|s|N|V)[0-9]?( (rad|m|kg|s)[0-9]?)*\)?)?"
)
ALL = sorted(registered())


@pytest.fixture(params=[*ALL, *(e.id for e in OWN)])
def effect(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> type[Effect]:
    for own in OWN:
        monkeypatch.setitem(EFFECTS, own.id, own)
    return EFFECTS[request.param]


def model_with(effect: type[Effect]) -> Model:
    model = build(spec_with(effect))
    return with_values(model, {f"forces.{n}": v for n, v in DERIVATIVES.items()})


def spec_with(effect: type[Effect]) -> ModelSpec:
    return body_spec(effects=(effect.id,))


def records() -> Tensor:
    return torch.randn(3, 40, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 0.05


def places(model: Model, effect: type[Effect]) -> list[int]:
    return [i for i, n in enumerate(model.parameter_set.names) if n.startswith(f"{effect.id}.")]


def inside(model: Model, effect: type[Effect]) -> Tensor:
    """Theta with the effect's parameters away from null, inside their bounds."""
    theta = model.theta.detach().clone()
    for i in places(model, effect):
        low, high = (float(b[i]) for b in (model.parameter_set.lower, model.parameter_set.upper))
        theta[i] += 0.1 * (min(high, 1.0) - max(low, -1.0)) * (0.5 if float(theta[i]) <= low else 0.1)
    return theta


def passed(model: Model, theta: Tensor, controls: Tensor) -> Tensor:
    """The control record after the control path, for a theta [..., P]."""
    for k, effect in enumerate(model.chain):
        if effect.stage is Stage.CONTROL:
            controls = effect.tape(controls, model.body.controls, DT, model.values(theta, k))
    return controls


def test_null_is_the_model_without_the_effect_bit_for_bit(effect: type[Effect]):
    model, without = model_with(effect), build(body_spec())
    with_values(without, {f"forces.{n}": v for n, v in DERIVATIVES.items()})
    x, u = points(model, 5)
    n = len(without.layout)
    found, wanted = model(torch.tensor(0.0), x, u), without(torch.tensor(0.0), x[:, :n], u)
    assert torch.equal(found[:, :n], wanted)
    assert torch.equal(model.output(x, u), without.output(x[:, :n], u))
    assert torch.equal(model.tape(records(), DT), records())


def test_away_from_null_it_does_something(effect: type[Effect]):
    model = model_with(effect)
    theta, (x, u) = inside(model, effect), points(model, 5, spread=0.5)
    changed = not torch.equal(model.rates(theta, x, u), model.rates(model.theta, x, u))
    assert changed or not torch.equal(passed(model, theta, records()), records())


def test_one_batch_equals_one_row_at_a_time(effect: type[Effect]):
    model = model_with(effect)
    x, u = points(model, 4)
    theta = torch.stack([model.theta.detach(), inside(model, effect)])
    for function in (model.rates, model.outputs_at):
        single = torch.stack([torch.stack([function(t, a, b) for a, b in zip(x, u, strict=True)]) for t in theta])
        torch.testing.assert_close(function(theta[:, None], x, u), single, rtol=1e-12, atol=1e-12)
    single = torch.stack([torch.stack([passed(model, t, c) for c in records()]) for t in theta])
    torch.testing.assert_close(
        passed(model, theta[:, None], records()).expand_as(single), single, rtol=1e-12, atol=1e-12
    )


def test_derivatives_by_its_parameters_are_finite_and_right(effect: type[Effect]):
    model = model_with(effect)
    x, u = points(model, 5, spread=0.5)
    smooth = torch.sin(torch.linspace(0, 4, 200, dtype=torch.float64))[:, None].repeat(1, 4)

    def response(theta: Tensor) -> Tensor:
        return torch.cat([model.rates(theta, x, u).flatten(), passed(model, theta, smooth).flatten()])

    for theta in (model.theta.detach(), inside(model, effect)):
        found = torch.func.jacfwd(response)(theta)
        for i in places(model, effect):
            high = float(model.parameter_set.upper[i])
            ahead = torch.zeros_like(theta)
            ahead[i] = 1e-6
            sides = (1, 2) if float(theta[i]) <= float(model.parameter_set.lower[i]) else (-1, 1)
            assert float(theta[i]) + 2e-6 < high
            if sides == (-1, 1):
                wanted = (response(theta + ahead) - response(theta - ahead)) / 2e-6
            else:  # at a bound: one-sided, second order
                wanted = (4 * response(theta + ahead) - response(theta + 2 * ahead) - 3 * response(theta)) / 2e-6
            assert bool(found[:, i].isfinite().all())
            torch.testing.assert_close(found[:, i], wanted, rtol=1e-5, atol=1e-5)


def test_a_tracer_follows_it(effect: type[Effect]):
    model = model_with(effect)
    x, u = points(model, 4)

    def whole(theta: Tensor, x: Tensor, u: Tensor, controls: Tensor) -> tuple[Tensor, Tensor]:
        return model.rates(theta, x, u), passed(model, theta, controls)

    graph = make_fx(whole)(model.theta.detach(), x, u, records())
    theta = inside(model, effect)
    other, moves = points(model, 4, seed=3), records().flip(0)
    for found, wanted in zip(graph(theta, *other, moves), whole(theta, *other, moves), strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-14, atol=1e-14)
        assert found.dtype == torch.float64


def test_its_states_start_in_equilibrium_and_stay(effect: type[Effect]):
    model = model_with(effect)
    n = len(model.body.states)
    x, u = points(model, 4)
    whole = equilibrium(model, x[:, :n], u)
    rates = model(torch.tensor(0.0), whole, u)[:, n:]
    torch.testing.assert_close(rates, torch.zeros_like(rates), atol=1e-8, rtol=0)


def test_it_is_described(effect: type[Effect]):
    made = effect.from_spec(spec_with(effect))
    assert re.fullmatch(r"[a-z_]+(\.[a-z_0-9]+)+", effect.id)
    assert effect.__doc__ is not None
    assert "Source:" in effect.__doc__
    assert made.declared, "an effect without parameters cannot be tested against its null"
    assert len(ParameterSet(made.declared)) == len({p.name for p in made.declared})
    for p in made.declared:
        assert UNIT.fullmatch(p.unit), p.unit
        assert p.doc
    assert all(s.unit for s in made.states)


def test_values_read_by_the_names_that_were_declared():
    values = Values(torch.arange(6.0).view(2, 3), ("a", "b", "c"))
    assert values["b"].tolist() == [1.0, 4.0]
    assert values.stack("c", "a").tolist() == [[2.0, 0.0], [5.0, 3.0]]
