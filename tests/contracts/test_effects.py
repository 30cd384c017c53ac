"""What every effect promises: the library's own, and effects as users write them."""

from __future__ import annotations

import math
import re
from functools import cache

import msgspec
import pytest
import torch
from torch import Tensor

from rotorid_torch.core.names import RECIPROCALS
from rotorid_torch.core.native.graph.symbols import Graph
from rotorid_torch.core.native.graph.tracing import scalarise
from rotorid_torch.core.parameters import ParameterSet
from rotorid_torch.effects.base import Effect, Role, Showing, Stage, Values
from rotorid_torch.effects.examples import HELICOPTER, MULTIROTOR, example
from rotorid_torch.effects.registry import EFFECTS, registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.model.training.equilibrium import equilibrium
from rotorid_torch.validate.free_run import Runs
from tests.effects.own_effects import OWN
from tests.known_models import points, scattered, with_values

DT = 0.02
UNIT = re.compile(
    r"1|((1|rad|m|kg|s|N|V|Hz)[0-9]?( (rad|m|kg|s|N|V)[0-9]?)*)(/\(?(rad|m|kg|s|N|V)[0-9]?( (rad|m|kg|s)[0-9]?)*\)?)?"
)
IDS = (
    *("control.delay", "control.lag", "control.rate_limit", "control.backlash"),
    *(
        "rotor.inflow",
        "rotor.flap_second_order",
        "rotor.lead_lag",
        "rotor.wake_distortion",
        "rotor.speed",
        "rotor.stall",
    ),
    *("forces.drag", "forces.quadratic_damping", "forces.translational_lift", "forces.tail_interference"),
    *("environment.ground", "environment.wind", "environment.turbulence", "environment.vibration"),
    *("mass.payload", "mass.cg", "mass.inertia", "mass.slung_load"),
    *("sensors.bias", "sensors.scale", "sensors.misalignment", "sensors.lever_arm", "sensors.delay", "sensors.filter"),
    *("propulsion.motor_lag", "propulsion.voltage", "propulsion.rotor_inertia", "propulsion.rotor_drag"),
    *("propulsion.axial_inflow", "propulsion.flapping", "propulsion.unequal"),
    "neural.forces",
)
"""Every id that users are promised."""
STRUCTURE = {"inflow", "flap_second_order", "lead_lag", "speed", "translational_lift"}
SMALL = 1e-9
CALM = 30.0


@pytest.fixture(params=[*sorted(registered()), *(e.id for e in OWN)])
def effect(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> type[Effect]:
    for own in OWN:
        monkeypatch.setitem(EFFECTS, own.id, own)
    return EFFECTS[request.param]


@cache
def plain(multirotor: bool) -> Model:
    """The vehicle without effects, its derivatives known."""
    return scattered(build(MULTIROTOR if multirotor else HELICOPTER))


def with_effects(spec: ModelSpec, *names: str) -> Model:
    """The vehicle with effects at their null."""
    without = plain(spec is MULTIROTOR)
    model = build(msgspec.structs.replace(spec, effects=names))
    return with_values(model, dict(zip(without.parameter_set.names, without.theta.tolist(), strict=True)))


def model_with(effect: type[Effect]) -> tuple[Model, Model]:
    """The vehicle with the effect at its null, and without it."""
    spec = example(effect)
    return with_effects(spec, effect.id), plain(spec is MULTIROTOR)


def records(columns: int) -> Tensor:
    return torch.randn(3, 40, columns, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 0.05


def places(model: Model, *effects: str) -> list[int]:
    return [i for i, n in enumerate(model.parameter_set.names) if n.startswith(tuple(f"{e}." for e in effects))]


def at_typical(model: Model, *effects: str) -> Tensor:
    """Theta with the effects' parameters at typical size; own effects without one away from null, inside bounds."""
    theta, declared = model.theta.detach().clone(), model.parameter_set.parameters
    for i in places(model, *effects):
        p = declared[i]
        theta[i] = p.typical if p.typical != 0.0 or p.name.startswith("environment") else p.value + 0.05
    return model.parameter_set.clamp(theta)


def passed(model: Model, theta: Tensor, stage: Stage, record: Tensor) -> Tensor:
    """A record after the control path, what sensors did to it undone, or after the sensors, for a theta [..., P]."""
    names = model.body.controls if stage is Stage.CONTROL else model.body.outputs
    for k, effect in enumerate(model.chain):
        if stage is Stage.CONTROL and effect.stage is Stage.SENSORS:
            record = effect.read(record, names, DT, model.values(theta, k))
    for k, effect in enumerate(model.chain):
        if effect.stage is stage:
            record = effect.tape(record, names, DT, model.values(theta, k))
    return record


def waves(columns: int) -> Tensor:
    return torch.sin(torch.linspace(0, 4, 100, dtype=torch.float64)[:, None] * (1.0 + torch.arange(columns) / columns))


def everything(model: Model, theta: Tensor, x: Tensor, u: Tensor) -> Tensor:
    """All that a model gives at points and for records, flat."""
    parts = (model.rates(theta, x, u), model.outputs_at(theta, x, u))
    at = torch.tensor([model.reference.get(n, 0.0) for n in model.body.controls], dtype=torch.float64)
    control = passed(model, theta, Stage.CONTROL, at + 0.05 * waves(len(at)))
    recorded = passed(model, theta, Stage.SENSORS, waves(len(model.body.outputs)))
    return torch.cat([part.flatten() for part in (*parts, control, recorded)])


def test_every_promised_effect_is_there_in_its_role():
    assert set(IDS) <= set(registered())
    for name in IDS:
        effect, last = registered()[name], name.partition(".")[2]
        wanted = Role.LEARNT if name.startswith("neural") else Role.STRUCTURE if last in STRUCTURE else Role.UNDECLARED
        assert effect.role is wanted, name
        assert effect.untestable(example(effect)) is None, name


def test_null_is_the_model_without_the_effect(effect: type[Effect]):
    model, without = model_with(effect)
    x, u = points(model, 5)
    common = model.layout.places(without.layout.names)
    found, wanted = model(torch.tensor(0.0), x, u), without(torch.tensor(0.0), x[:, common], u)
    torch.testing.assert_close(found[:, common], wanted, atol=1e-12, rtol=0)
    torch.testing.assert_close(model.output(x, u), without.output(x[:, common], u), atol=1e-12, rtol=0)
    for names, path in ((model.body.controls, model.tape), (model.body.outputs, model.recorded)):
        torch.testing.assert_close(path(records(len(names)), DT), records(len(names)), atol=1e-12, rtol=0)


def test_at_typical_size_it_does_something(effect: type[Effect]):
    model, _ = model_with(effect)
    x, u = points(model, 5, spread=0.5)
    changed = everything(model, at_typical(model, effect.id), x, u) - everything(model, model.theta.detach(), x, u)
    assert bool((changed.abs() > 1e-6).any()) != (effect.showing is Showing.INNOVATIONS)


def test_one_batch_equals_one_row_at_a_time(effect: type[Effect]):
    model, _ = model_with(effect)
    x, u = points(model, 4)
    theta = torch.stack([model.theta.detach(), at_typical(model, effect.id)])
    for function in (model.rates, model.outputs_at):
        single = torch.stack([torch.stack([function(t, a, b) for a, b in zip(x, u, strict=True)]) for t in theta])
        torch.testing.assert_close(function(theta[:, None], x, u), single, rtol=1e-12, atol=1e-12)
    for stage, count in ((Stage.CONTROL, len(model.body.controls)), (Stage.SENSORS, len(model.body.outputs))):
        single = torch.stack([torch.stack([passed(model, t, stage, c) for c in records(count)]) for t in theta])
        batch = passed(model, theta[:, None], stage, records(count)).expand_as(single)
        torch.testing.assert_close(batch, single, rtol=1e-12, atol=1e-12)


def test_derivatives_by_its_parameters_are_right_and_reach_each(effect: type[Effect]):
    model, _ = model_with(effect)
    x, u = points(model, 5, spread=0.5)
    low, high = model.parameter_set.lower, model.parameter_set.upper
    for theta in (model.theta.detach(), at_typical(model, effect.id)):
        own = torch.eye(len(theta), dtype=torch.float64)[places(model, effect.id)[:40]]
        ahead = torch.vmap(lambda d, at=theta: torch.func.jvp(lambda th: everything(model, th, x, u), (at,), (d,))[1])
        found = dict(zip(places(model, effect.id), ahead(own), strict=False))
        for i in places(model, effect.id)[:40]:
            size = max(abs(model.parameter_set.parameters[i].typical), 1e-2)
            step = torch.zeros_like(theta)
            step[i] = 1e-5 * size * (1.0 if float(theta[i]) < 0.5 * float(low[i] + high[i]) else -1.0)
            near = torch.stack([everything(model, theta + k * step, x, u) for k in range(3)])
            wanted = (4 * near[1] - near[2] - 3 * near[0]) / (2.0 * float(step[i]))
            assert bool(found[i].isfinite().all())
            torch.testing.assert_close(size * found[i], size * wanted, rtol=1e-5, atol=1e-6)
    if effect.showing is not Showing.INNOVATIONS:
        unmoved = [model.parameter_set.names[i] for i, column in found.items() if not bool(column.any())]
        assert not unmoved


def test_native_code_knows_its_operations(effect: type[Effect]):
    model, _ = model_with(effect)
    x, u = (a[0] for a in points(model, 1))
    theta, graph = at_typical(model, effect.id), Graph()
    for function in (model.rates, model.outputs_at):
        examples = {"th": theta, "x": x, "u": u}
        nodes = scalarise(graph, function, examples)  # held against torch at another point as well
        found = graph.evaluated(nodes, {n: v.tolist() for n, v in examples.items()})
        wanted = function(theta, x, u).detach()
        torch.testing.assert_close(torch.tensor(found, dtype=torch.float64), wanted, rtol=SMALL, atol=SMALL)


@pytest.mark.parametrize("spec", [HELICOPTER, MULTIROTOR])
def test_compiled_trajectories_with_all_effects_are_torch_s(spec: ModelSpec):
    chosen = [n for n in IDS if registered()[n].untestable(spec) is None]
    model = with_effects(spec, *chosen)
    with torch.no_grad():
        model.theta.copy_(at_typical(model, *chosen))
    x, u = points(model, 2, seed=2, spread=0.05)
    controls = u[:, None] + 0.02 * torch.sin(torch.linspace(0, 3, 26, dtype=torch.float64))[:, None]
    native = Runs.of(model)
    assert native.compiled is not None
    exact = [record.detach() for record in Runs(model, None)(x, controls, DT)]
    assert float(exact[0].abs().max()) < CALM  # what runs away turns rounding into differences
    for found, wanted in zip(native(x, controls, DT), exact, strict=True):
        torch.testing.assert_close(found, wanted, rtol=SMALL, atol=SMALL)


@pytest.mark.parametrize("name", IDS)
def test_its_states_are_known_where_a_segment_begins(name: str):
    """At its null nothing shows a state: one that may begin anywhere goes anywhere, and takes the fit with it."""
    effect = registered()[name]
    states = effect.from_spec(example(effect)).states
    assert [s.name for s in states if not math.isfinite(s.spread)] == []


def test_its_states_start_in_equilibrium_or_where_measured(effect: type[Effect]):
    model, _ = model_with(effect)
    with torch.no_grad():
        model.theta.copy_(at_typical(model, effect.id))
    n, own = len(model.body.states), model.own_states
    x, u = points(model, 4, spread=0.02)
    starts = torch.full((4, len(own)), torch.nan, dtype=torch.float64)
    for k, state in enumerate(own):
        if state.channel is not None:
            starts[:, k] = model.reference[state.channel] + 0.1
    whole = equilibrium(model, x[:, :n], u, starts)
    rates = model(torch.tensor(0.0), whole, u)[:, n:]
    for k, state in enumerate(own):
        if state.channel is None:
            torch.testing.assert_close(rates[:, k], torch.zeros(4, dtype=torch.float64), atol=1e-6, rtol=0)
        else:
            assert torch.equal(whole[:, n + k], starts[:, k])


def test_it_is_described(effect: type[Effect]):
    made = effect.from_spec(example(effect))
    assert re.fullmatch(r"[a-z_]+(\.[a-z_0-9]+)+", effect.id)
    assert effect.__doc__ is not None
    assert "Source:" in effect.__doc__
    assert made.declared, "an effect without parameters cannot be tested against its null"
    assert len(ParameterSet(made.declared)) == len({p.name for p in made.declared})
    for p in made.declared:
        assert UNIT.fullmatch(p.unit), p.unit
        assert p.doc
        assert p.typical == 0.0 or p.bounds[0] <= p.typical <= p.bounds[1]
    assert all(s.unit for s in made.states)


def test_values_read_by_the_names_that_were_declared():
    values = Values(torch.arange(6.0).view(2, 3), ("a", "b", "c"))
    assert values["b"].tolist() == [1.0, 4.0]
    assert values.stack("c", "a").tolist() == [[2.0, 0.0], [5.0, 3.0]]


def test_a_share_that_acts_in_full_is_no_active_bound():
    """A fit that ends at a bound is refused, but at zero and at the value of nothing."""
    for name in ("propulsion.voltage", "propulsion.rotor_drag", "propulsion.axial_inflow"):
        declared = [p for p in registered()[name].from_spec(MULTIROTOR).declared if p.bounds == (0.0, 1.0)]
        assert declared
        assert [p.value for p in declared] == [1.0] * len(declared)


def test_what_is_told_as_its_inverse_is_the_inverse_of_a_limit():
    inverted = [
        f"{name}.{p.name}"
        for name, effect in EFFECTS.items()
        for p in effect.from_spec(example(effect)).declared
        if p.unit in RECIPROCALS
    ]
    assert inverted
    assert all(name.startswith("control.rate_limit.") for name in inverted)
