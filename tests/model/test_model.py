"""The model as a module: equations of motion, broadcasting, tracing, and where the physics stays out of the tangent."""

from __future__ import annotations

import pytest
import torch
from torch.fx.experimental.proxy_tensor import make_fx

from rotorid_torch.core.names import FLAPPING, RATES, STICKS, VELOCITIES
from rotorid_torch.effects.spec import FlappingKind
from rotorid_torch.model.derivatives import FOLLOWED
from rotorid_torch.model.inflow import INDUCED
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from tests.known_models import BODY, DERIVATIVES, IMU, body_spec, helicopter, helicopter_spec, linear_vehicle, points

KINDS: tuple[FlappingKind, ...] = ("first order", "algebraic", "none")
G = 9.80665


def test_rates_are_those_worked_out_by_hand():
    inertia = ((500.0, 0.0, 0.0), (0.0, 1000.0, 0.0), (0.0, 0.0, 1250.0))
    model = linear_vehicle(inertia=inertia)
    x = torch.tensor([2.0, 1.0, -1.0, 0.1, 0.2, -0.3, 0.4, -0.2], dtype=torch.float64)
    u = torch.tensor([0.01, -0.02, 0.03, 0.04], dtype=torch.float64)
    d, sin, cos = DERIVATIVES, lambda a: torch.sin(x.new_tensor(a)), lambda a: torch.cos(x.new_tensor(a))
    force = (
        d["X.u"] * 2.0 + d["X.q"] * 0.2 + d["X.lon"] * 0.01,
        d["Y.v"] * 1.0 + d["Y.p"] * 0.1 + d["Y.lat"] * -0.02,
        -G + d["Z.w"] * -1.0 + d["Z.col"] * 0.03,
    )
    wanted = [
        force[0] - G * sin(-0.2) - (0.2 * -1.0 - -0.3 * 1.0),
        force[1] + G * cos(-0.2) * sin(0.4) - (-0.3 * 2.0 - 0.1 * -1.0),
        force[2] + G * cos(-0.2) * cos(0.4) - (0.1 * 1.0 - 0.2 * 2.0),
        d["L.v"] * 1.0 + d["L.p"] * 0.1 + d["L.q"] * 0.2 + d["L.lat"] * -0.02 + (1000 - 1250) / 500 * 0.2 * -0.3,
        d["M.u"] * 2.0 + d["M.p"] * 0.1 + d["M.q"] * 0.2 + d["M.lon"] * 0.01 + (1250 - 500) / 1000 * 0.1 * -0.3,
        d["N.v"] * 1.0 + d["N.r"] * -0.3 + d["N.col"] * 0.03 + d["N.ped"] * 0.04 + (500 - 1000) / 1250 * 0.1 * 0.2,
        0.1 + (0.2 * sin(0.4) - 0.3 * cos(0.4)) * sin(-0.2) / cos(-0.2),
        0.2 * cos(0.4) - -0.3 * sin(0.4),
    ]
    found = model(torch.tensor(0.0), x, u)
    torch.testing.assert_close(found, torch.stack([torch.as_tensor(w, dtype=torch.float64) for w in wanted]))


def test_accelerometers_are_those_of_the_imu_where_it_sits():
    model = linear_vehicle()
    x, u = points(model, 5)
    dx = model(torch.tensor(0.0), x, u)
    rates, acceleration = x[:, 3:6], dx[:, 3:6]
    at_centre = build(body_spec(imu=(0.0, 0.0, 0.0)))
    at_centre.theta.data.copy_(model.theta)
    point = torch.tensor(IMU, dtype=torch.float64).expand(5, 3)
    arm = torch.linalg.cross(acceleration, point) + torch.linalg.cross(rates, torch.linalg.cross(rates, point))
    torch.testing.assert_close(model.output(x, u)[:, 8:], at_centre.output(x, u)[:, 8:] + arm)
    assert torch.equal(model.output(x, u)[:, :8], x)


def test_measured_angular_acceleration_holds_the_gyroscopic_part():
    model = helicopter()
    x, u = points(model, 5)
    place = model.body.outputs.index("pdot")
    torch.testing.assert_close(model.output(x, u)[:, place], model(torch.tensor(0.0), x, u)[:, 3])


def test_level_reference_is_a_trim():
    for kind in KINDS:
        model = build(helicopter_spec(kind))
        x, u = model.reference_point
        rates = model(torch.tensor(0.0), x, u).detach()
        flapping = [model.layout.names.index(n) for n in FLAPPING if n in model.layout.names]
        rates[flapping] = 0.0  # their derivatives are all zero here: nothing holds them
        torch.testing.assert_close(rates, torch.zeros_like(rates), atol=1e-9, rtol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_one_batch_equals_one_row_at_a_time(kind: FlappingKind):
    models = [helicopter(kind, seed) for seed in range(3)]
    model = models[0]
    theta = torch.stack([m.theta.detach() for m in models])
    x, u = points(model, 4)
    for function in (model.rates, model.outputs_at):
        batch = function(theta[:, None], x, u)
        single = torch.stack([torch.stack([function(t, a, b) for a, b in zip(x, u, strict=True)]) for t in theta])
        assert batch.shape == single.shape
        torch.testing.assert_close(batch, single, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_rates_and_outputs_of_one_frame_are_those_of_two(kind: FlappingKind):
    model = helicopter(kind)
    x, u = points(model, 5)
    rates, outputs = model.motion(model.theta, x, u)
    assert torch.equal(rates, model.rates(model.theta, x, u))
    assert torch.equal(outputs, model.outputs_at(model.theta, x, u))


@pytest.mark.parametrize("kind", KINDS)
def test_states_and_controls_broadcast(kind: FlappingKind):
    model = helicopter(kind)
    x, u = points(model, 3)
    for function in (lambda x, u: model(torch.tensor(0.0), x, u), model.output):
        for a, b in ((x[:, None], u), (x[0], u), (x, u[0])):
            shape = torch.broadcast_shapes(a.shape[:-1], b.shape[:-1])
            full = function(a.expand(*shape, -1), b.expand(*shape, -1))
            torch.testing.assert_close(function(a, b), full, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_tracer_follows_the_rates(kind: FlappingKind):
    model = helicopter(kind)
    x, u = points(model, 4)
    theta = model.theta.detach()
    graph = make_fx(lambda *at: model.rates(*at), tracing_mode="fake", _allow_non_fake_inputs=True)(theta, x, u)
    other_x, other_u = points(model, 4, seed=9, spread=0.5)
    other = helicopter(kind, seed=5).theta.detach()
    assert torch.equal(graph(other, other_x, other_u), model.rates(other, other_x, other_u))
    values = [node.meta["val"] for node in graph.graph.nodes if "val" in node.meta]
    kinds = {v.dtype for v in values if isinstance(v, torch.Tensor) and v.is_floating_point()}
    assert kinds == {torch.float64}


def tangent(model: Model) -> torch.Tensor:
    """Derivatives of all rates by states and controls at the reference [nx, nx + nu]."""
    at = torch.tensor([model.reference.get(n, 0.0) for n in (*model.layout.names, *STICKS)], dtype=torch.float64)
    n, theta = len(model.layout), model.theta.detach()
    return torch.func.jacfwd(lambda z: model.rates(theta, z[:n], z[n:]))(at)


@pytest.mark.parametrize("kind", KINDS)
def test_declared_physics_stays_out_of_the_tangent(kind: FlappingKind):
    model = helicopter(kind)
    before = tangent(model)
    for name in model.parameter_set.names:
        if name.startswith(("rotor.tilt.", "tail.", "tailplane.")) or name == "inflow.N":
            model.theta.data[model.parameter_set.index(name)] += 2.0
    assert any(n.startswith("tailplane.") for n in model.parameter_set.names)
    torch.testing.assert_close(tangent(model), before, atol=1e-9, rtol=0)


def test_tangent_of_body_and_flapping_are_the_derivatives():
    model = helicopter()
    found, names = tangent(model), (*model.layout.names, *STICKS)
    for effect, rows in (
        ("forces", dict(zip("LMN", (3, 4, 5), strict=True))),
        ("rotor", dict(zip(FLAPPING, (8, 9, 10), strict=True))),
    ):
        for row, place in rows.items():
            for column in (*VELOCITIES, *RATES, *FLAPPING, *STICKS, INDUCED):
                value = float(model.theta.detach()[model.parameter_set.index(f"{effect}.{row}.{column}")])
                slow = float(found[place, names.index(column)])
                slow += float(found[place, names.index(FOLLOWED)]) if column == "ped" else 0.0
                assert slow == pytest.approx(value, abs=1e-9)


def test_physics_beyond_the_tangent_is_there():
    model = helicopter()
    x, u = points(model, 1, spread=0.3)
    theta = model.theta.detach().clone()
    for name in ("rotor.tilt.X", "rotor.tilt.M", "inflow.N", "tail.N.speed_speed"):
        more = theta.clone()
        more[model.parameter_set.index(name)] += 1.0
        assert not torch.allclose(model.rates(more, x, u), model.rates(theta, x, u), atol=1e-6)


def test_state_dict_goes_round():
    model, other = helicopter(seed=1), helicopter(seed=2)
    x, u = points(model, 3)
    other.load_state_dict(model.state_dict())
    assert torch.equal(other(torch.tensor(0.0), x, u), model(torch.tensor(0.0), x, u))
    assert all(v.dtype in (torch.float64, torch.int64) for v in model.state_dict().values())


def test_names_and_slices_agree():
    model = helicopter()
    assert model.layout.names == (*BODY, *FLAPPING, FOLLOWED, INDUCED)
    assert len(model.parameter_set) == len(model.theta)
    assert [e.stage for e in model.chain] == sorted(e.stage for e in model.chain)
    for k, effect in enumerate(model.chain):
        values = model.values(model.theta.detach(), k)
        for p in effect.declared:
            assert float(values[p.name]) == float(
                model.theta.detach()[model.parameter_set.index(f"{effect.id}.{p.name}")]
            )
