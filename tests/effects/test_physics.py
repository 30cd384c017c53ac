"""Effects against solutions worked out by hand."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
import torch
from scipy import signal
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from torch import Tensor

from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.rigid import gyroscopic
from rotorid_torch.effects.base import Frame, Values
from rotorid_torch.effects.examples import HELICOPTER, MOTORS, MULTIROTOR
from rotorid_torch.effects.families.main_rotor import LeadLag, Stall
from rotorid_torch.effects.families.propulsion import usual_inflow
from rotorid_torch.effects.registry import make
from rotorid_torch.effects.spec import ModelSpec, MotorSpec
from rotorid_torch.errors import InputError
from rotorid_torch.model.model import Model
from rotorid_torch.model.nominal import build
from rotorid_torch.simulation.multirotor.flight import Fleet
from rotorid_torch.simulation.multirotor.hidden import felt_per_speed
from rotorid_torch.simulation.multirotor.rotor import Flow
from rotorid_torch.simulation.multirotor.vehicles import multirotor
from tests.known_models import helicopter_spec, points, with_values

G = 9.80665
RIGID = msgspec.structs.replace(
    HELICOPTER, flapping="none", outputs=HELICOPTER.outputs[:-3], hub=None,
    patterns=dict.fromkeys(("X", "Y", "Z", "L", "M", "N"), ("u",)),
)  # fmt: skip
"""Nothing but trims: what an effect adds is all there is."""


def made(effect: str, spec: ModelSpec = RIGID, **values: float) -> Model:
    return with_values(
        build(msgspec.structs.replace(spec, effects=(effect,))), {f"{effect}.{k}": v for k, v in values.items()}
    )


def rates(model: Model, own: tuple[float, ...] = (), /, **signals: float) -> dict[str, float]:
    """Rates by name at the reference but for these signals and the effect's own states."""
    added = [s.name for s in model.own_states if "." in s.name]  # not those of the nominal model
    at = {**model.reference, **signals, **dict(zip(added, own, strict=False))}
    vector = lambda names: torch.tensor([at.get(n, 0.0) for n in names], dtype=torch.float64)  # noqa: E731
    found = model(torch.tensor(0.0), vector(model.layout.names), vector(model.body.controls)).detach()
    return dict(zip(model.layout.names, found.tolist(), strict=True))


def outputs(model: Model, **signals: float) -> dict[str, float]:
    at = {**model.reference, **signals}
    vector = lambda names: torch.tensor([at.get(n, 0.0) for n in names], dtype=torch.float64)  # noqa: E731
    found = model.output(vector(model.layout.names), vector(model.body.controls)).detach()
    return dict(zip(model.body.outputs, found.tolist(), strict=True))


def test_drag_is_along_the_velocity_and_square():
    model = made("forces.drag", x=0.002, y=0.002, z=0.002)
    found = rates(model, u=30.0, v=-40.0)
    assert found["u"] == pytest.approx(-0.002 * 30.0 * 50.0, rel=1e-6)
    assert found["v"] == pytest.approx(0.002 * 40.0 * 50.0, rel=1e-6)
    assert rates(model)["u"] == 0.0


def test_quadratic_damping_opposes_either_sign():
    model = made("forces.quadratic_damping", spec=msgspec.structs.replace(RIGID, inertia=None, mass=None), L=2.0, N=1.0)
    assert rates(model, p=0.5)["p"] == pytest.approx(-0.5)
    assert rates(model, p=-0.5, r=2.0)["p"] == pytest.approx(0.5)
    assert rates(model, r=2.0)["r"] == pytest.approx(-4.0)


def test_induced_velocity_falls_as_momentum_theory_says():
    model = made("forces.translational_lift", Z=0.5, hover=10.0)
    v = 15.0
    vi = 10.0 * math.sqrt(math.sqrt(1 + (v * v / 200) ** 2) - v * v / 200)
    assert vi**2 * (v**2 + vi**2) == pytest.approx(10.0**4)
    assert rates(model, u=v)["w"] == pytest.approx(-0.5 * (10.0 - vi))


@pytest.mark.parametrize(("z_by_radius", "gain"), [(0.5, 4 / 3), (0.75, 1.125), (1.0, 16 / 15), (2.0, 64 / 63)])
def test_ground_effect_is_cheeseman_and_bennett_s(z_by_radius: float, gain: float):
    spec = msgspec.structs.replace(RIGID, hub=(0.0, 0.0, -1.7), reference={**RIGID.reference, "height": 1e5})
    model = made("environment.ground", spec, strength=1.0)
    height = z_by_radius * 8.18 - 1.7
    assert rates(model, (height,))["w"] == pytest.approx(-G * (gain - 1.0), rel=1e-6)
    assert rates(model, (height,), w=-2.0)["environment.ground.height"] == pytest.approx(2.0)


def test_near_the_ground_the_rotor_s_image_takes_induced_velocity_away():
    """Cheeseman and Bennett: vi falls by (R/(4 z))^2; far from the ground nothing changes."""
    declared = helicopter_spec()
    spec = msgspec.structs.replace(
        declared, effects=("environment.ground",), reference={**declared.reference, "height": 1e5, "u": 0.0, "v": 0.0}
    )
    model = build(spec)
    model.start_from({"environment.ground.strength": 1.0})
    names = model.layout.names
    x = torch.tensor([spec.reference.get(n, 0.0) for n in names], dtype=torch.float64)
    tau, vi = model.named_values["inflow.tau"], x[names.index("vi")]
    u = torch.tensor([spec.reference[c] for c in model.body.controls], dtype=torch.float64)

    def wanted(z_by_radius: float) -> float:
        at = x.clone()
        at[names.index("environment.ground.height")] = z_by_radius * 8.18 - 2.1
        return float((tau * model.rates(model.theta, at, u)[names.index("vi")] + vi).detach())

    assert wanted(0.5) / wanted(1e4) == pytest.approx(0.75, rel=1e-6)
    assert wanted(1.0) / wanted(1e4) == pytest.approx(15 / 16, rel=1e-6)


def test_wind_blows_in_body_axes_and_leaves_the_ground_alone():
    model = made("environment.wind", north=7.0, east=-3.0)
    frame_of = lambda own, **at: model.frame(  # noqa: E731
        model.theta,
        torch.tensor(
            [{**model.reference, "environment.wind.psi": own, **at}.get(n, 0.0) for n in model.layout.names]
        ).double(),
        torch.zeros(4, dtype=torch.float64),
    )[0]
    frame = frame_of(1.2, u=5.0, phi=0.3, theta=-0.2)
    turn = Rotation.from_euler("ZYX", [1.2, -0.2, 0.3])
    wind = np.array([7.0, -3.0, 0.0])
    air = np.array([5.0, 0.0, 0.0]) - turn.inv().apply(wind) + wind  # the reference is level and heads north
    np.testing.assert_allclose(frame.stack(("u", "v", "w")).detach().numpy(), air, atol=1e-7)
    np.testing.assert_allclose(frame.over_ground().detach().numpy(), [5.0, 0.0, 0.0])
    assert outputs(model, u=5.0)["u"] == 5.0


def test_wind_drags_a_hovering_multirotor_along_and_more_of_it_with_faster_rotors():
    """A drag that grows with the rotors' speed grows with all of the wind, whatever the flights' mean heading is."""
    effects = ("environment.wind", "propulsion.rotor_drag")
    spec = msgspec.structs.replace(MULTIROTOR, effects=effects, reference={**MULTIROTOR.reference, "psi": 0.7})
    wind = {"environment.wind.north": 6.0, "environment.wind.east": -2.0}
    model = with_values(build(spec), {**wind, "propulsion.rotor_drag.x": 0.4, "propulsion.rotor_drag.y": 0.4})
    faster = {name: 1.2 * spec.reference[name] for name in spec.driven}
    for heading, forward in ((0.0, 6.0), (math.pi / 2, -2.0), (math.pi, -6.0)):
        at = {"environment.wind.psi": heading}
        assert outputs(model, **at)["ax"] == pytest.approx(0.4 * forward, abs=1e-6)
        assert outputs(model, **at, **faster)["ax"] == pytest.approx(1.2 * 0.4 * forward, abs=1e-6)


def test_a_pendulum_swings_at_its_frequency():
    model = made("mass.slung_load", ratio=0.2, length=6.0, damping=0.0, hook=0.0)
    x0 = torch.zeros(len(model.layout), dtype=torch.float64)
    x0[model.layout.names.index("mass.slung_load.x")] = 0.01
    controls = torch.zeros(601, 4, dtype=torch.float64)
    swing = simulate(model, x0, controls, 0.01)[:, model.layout.names.index("mass.slung_load.x")].detach()
    turns = ((swing[:-1] > 0) & (swing[1:] <= 0)).nonzero()[:, 0]
    assert 0.01 * float(turns[1] - turns[0]) == pytest.approx(2 * math.pi / math.sqrt(G * 1.2 / 6.0), rel=0.01)


def test_the_load_and_the_vehicle_keep_their_common_centre():
    model = made("mass.slung_load", ratio=0.2, length=6.0, damping=0.0, hook=0.0)
    names = model.layout.names
    x0 = torch.zeros(len(names), dtype=torch.float64)
    x0[names.index("mass.slung_load.x")] = 0.05
    states = simulate(model, x0, torch.zeros(301, 4, dtype=torch.float64), 0.01).detach()
    load = states[:, 0] + 6.0 * states[:, names.index("mass.slung_load.x_rate")]
    assert float((states[:, 0] + 0.2 * load).abs().max()) < 2e-4 * float(load.abs().max())


def test_a_load_swings_with_a_body_that_pitches_under_its_hook():
    """Against Lagrange's equations of a body in hover and a point mass on a rigid cable, small and in one plane."""
    ratio, length, hook = 0.2, 6.0, 1.5
    model = made("mass.slung_load", ratio=ratio, length=length, damping=0.0, hook=hook)
    assert RIGID.mass is not None
    assert RIGID.inertia is not None
    m, load, inertia = RIGID.mass, ratio * RIGID.mass, float(np.array(RIGID.inertia)[1, 1])
    at_load = np.array([1.0, hook, length])  # the load's speed by those of place, pitch and cable
    mass = np.diag([m, inertia, 0.0]) + load * np.outer(at_load, at_load)
    stiff = np.diag([0.0, load * G * hook, load * G * length])
    stiff[0, 1] = (m + load) * G  # thrust stays with the body
    second = -np.linalg.solve(mass, stiff)
    time = np.linspace(0.0, 2.5, 126)
    moved = lambda t, y: np.concatenate([y[3:], second @ y[:3]])  # noqa: E731
    wanted = solve_ivp(moved, (0.0, 2.5), [0.0, 0.0, 0.002, 0.0, 0.0, 0.0], t_eval=time, rtol=1e-9, atol=1e-12).y
    names = model.layout.names
    x0 = torch.zeros(len(names), dtype=torch.float64)
    x0[names.index("mass.slung_load.x")] = 0.002
    found = simulate(model, x0, torch.zeros(126, 4, dtype=torch.float64), 0.02).detach().numpy()
    for name, k in (("theta", 1), ("mass.slung_load.x", 2)):
        np.testing.assert_allclose(found[:, names.index(name)], wanted[k], atol=0.005 * np.abs(wanted[k]).max())


def test_a_shifted_centre_of_gravity_turns_the_body_by_force_times_arm():
    d = msgspec.structs.replace(RIGID, patterns={**RIGID.patterns, "Z": ("col",)})
    model = with_values(made("mass.cg", d, x=0.2), {"forces.Z.col": -80.0})
    lift = 80.0 * 0.02
    found = rates(model, col=0.02)
    assert found["q"] == pytest.approx(-0.2 * 7440.0 * lift / 54200.0)
    plain = outputs(with_values(build(d), {"forces.Z.col": -80.0}), col=0.02, q=0.5)
    seen = outputs(model, col=0.02, q=0.5)
    assert seen["ax"] - plain["ax"] == pytest.approx(0.2 * 0.25 + found["q"] * 0.0, abs=1e-9 + 0.5 * abs(found["q"]))


def test_other_inertia_turns_as_a_body_of_that_inertia():
    spec = msgspec.structs.replace(RIGID, patterns={**RIGID.patterns, "L": ("lat",)})
    model = with_values(made("mass.inertia", spec, Ixx=0.2, Ixz=-0.1), {"forces.L.lat": 40.0})
    found = rates(model, p=0.4, q=-0.3, r=0.2, lat=0.01)
    declared = torch.tensor(HELICOPTER.inertia, dtype=torch.float64)
    true = declared.clone()
    true[0, 0] *= 1.2
    true[0, 2] = true[2, 0] = 0.9 * declared[0, 2]
    moment = declared @ torch.tensor([0.4, 0.0, 0.0], dtype=torch.float64)
    wanted = torch.linalg.solve(true, moment) + gyroscopic(torch.tensor([0.4, -0.3, 0.2], dtype=torch.float64), true)
    torch.testing.assert_close(torch.tensor([found[n] for n in "pqr"], dtype=torch.float64), wanted)


def test_stall_takes_the_lift_above_the_limit():
    spec = msgspec.structs.replace(RIGID, patterns={**RIGID.patterns, "Z": ("col",)})
    model = with_values(made("rotor.stall", spec, loss=0.5, limit=0.10), {"forces.Z.col": -100.0})
    full = next(e.full for e in model.chain if isinstance(e, Stall))
    assert G / full == pytest.approx(0.0715, rel=0.05)  # blade loading of hover
    high = 100.0 * 0.06
    above = (G + high) / full - 0.10
    assert rates(model, col=0.06)["w"] == pytest.approx(-high + 0.5 * full * above, rel=0.02)
    assert rates(model, col=0.0)["w"] == pytest.approx(0.0, abs=0.02)


def flapping_matrix(model: Model) -> Tensor:
    names = [n for n in model.layout.names if n in ("a0", "a1", "b1") or n.startswith("rotor.")]
    places = model.layout.places(names)
    x, u = points(model, 1, spread=0.0)
    return torch.func.jacfwd(lambda a: model.rates(model.theta.detach(), a, u[0]))(x[0])[places][:, places]


def first_order(speed: float, g: float) -> dict[str, float]:
    """Tilt's own law in hover, hinges in the shaft: what the flap equation in fixed axes leaves of slow motion."""
    damping = torch.tensor([[g, 2 * speed], [-2 * speed, g]], dtype=torch.float64)
    slow = -torch.linalg.solve(damping, torch.tensor([[0.0, g * speed], [-g * speed, 0.0]], dtype=torch.float64))
    return {f"rotor.{r}.{c}": float(slow[i, j]) for i, r in enumerate(("a1", "b1")) for j, c in enumerate(("a1", "b1"))}


def test_second_order_flapping_has_the_rotor_s_modes():
    """In hover, hinges in the shaft, no coupling with the body: modes of the flap equation in fixed axes."""
    speed, g = 27.0, 8.2 * 27.0 / 8.0
    values = first_order(speed, g) | {"rotor.a0.a0": -20.0}
    free = msgspec.structs.replace(HELICOPTER, effects=("rotor.flap_second_order",))
    own = {"share": 1.0, "tau": 1.0 / g, "coupling": 2.0 * speed}
    model = with_values(build(free), values | {f"rotor.flap_second_order.{n}": v for n, v in own.items()})
    found = torch.linalg.eigvals(flapping_matrix(model))
    rotating = complex(-g / 2, math.sqrt(speed**2 - g**2 / 4))
    for wanted in (rotating - 1j * speed, rotating + 1j * speed):
        assert min(abs(complex(v) - wanted) for v in found) < 1e-6 * speed


def test_slow_flapping_stays_first_order():
    spec = msgspec.structs.replace(HELICOPTER, effects=("rotor.flap_second_order",))
    values = {"rotor.a0.a0": -8.0, "rotor.a1.a1": -8.0, "rotor.b1.b1": -8.0, "rotor.a1.lon": 5.0}
    model = with_values(build(spec), {**values, "rotor.flap_second_order.share": 1.0})
    own = tuple(0.0 for _ in model.own_states)
    found = rates(model, own, lon=0.01)
    assert found["rotor.flap_second_order.a1_rate"] == pytest.approx(0.05 / float(model.theta.detach()[
        model.parameter_set.index("rotor.flap_second_order.tau")]))  # fmt: skip


@pytest.mark.parametrize("direction", ["ccw", "cw"])
def test_second_order_flapping_on_a_turning_hub_is_that_of_single_blades(direction: str):
    """Against four blades, each by its own flap equation in rotating axes (Padfield, eq. 3.60), SciPy's integrator.

    Hinges in the shaft, hover, no inflow dynamics; the hub is turned faster than a body would, with nothing else. To
    the hub of a rotor that turns the other way a roll is one to the other side.
    """
    speed, g = 27.0, 8.2 * 27.0 / 8.0
    spin, places = (1.0 if direction == "ccw" else -1.0), 0.5 * np.pi * np.arange(4)
    hub = lambda t: np.array([0.3 * np.sin(9.0 * t), 0.2 * np.sin(6.0 * t + 1.0)])  # noqa: E731 p and q
    accelerated = lambda t: np.array([2.7 * np.cos(9.0 * t), 1.2 * np.cos(6.0 * t + 1.0)])  # noqa: E731

    def blades(t: float, y: np.ndarray) -> np.ndarray:
        (p, q), (dp, dq), psi = hub(t) * [spin, 1.0], accelerated(t) * [spin, 1.0], speed * t + places
        turned = 2.0 * speed * (p * np.cos(psi) - q * np.sin(psi)) + dq * np.cos(psi) + dp * np.sin(psi)
        lift = -g * (y[4:] - q * np.cos(psi) - p * np.sin(psi))
        return np.concatenate([y[4:], turned + lift - speed**2 * y[:4]])

    time = np.linspace(0.0, 3.0, 61)
    flown = solve_ivp(blades, (0.0, 3.0), np.zeros(8), t_eval=time, rtol=1e-9, atol=1e-12).y[:4]
    psi = speed * time + places[:, None]
    wanted = np.stack([-0.5 * (flown * np.cos(psi)).sum(0), -0.5 * (flown * np.sin(psi)).sum(0)], axis=-1)

    columns = ("a1", "b1")
    values = first_order(speed, g) | {"rotor.a0.a0": -20.0, "rotor.a1.q": -1.0, "rotor.b1.p": -spin}
    assert HELICOPTER.rotor is not None
    rotor = msgspec.structs.replace(HELICOPTER.rotor, direction=direction)
    spec = msgspec.structs.replace(HELICOPTER, rotor=rotor, effects=("rotor.flap_second_order",))
    own = {"share": 1.0, "tau": 1.0 / g, "coupling": 2.0 * speed}
    model = with_values(build(spec), values | {f"rotor.flap_second_order.{n}": v for n, v in own.items()})
    names = [n for n in model.layout.names if n in ("a0", "a1", "b1") or n.startswith("rotor.")]
    rest, u = points(model, 1, spread=0.0)
    rotor_at, hub_at = model.layout.places(names), model.layout.places(["p", "q"])
    rates_of = [names.index(f"rotor.flap_second_order.{n}_rate") for n in columns]

    def disc(t: float, y: np.ndarray) -> np.ndarray:
        x = rest[0].clone()
        x[rotor_at], x[hub_at] = torch.from_numpy(y), torch.from_numpy(hub(t))
        return model.rates(model.theta.detach(), x, u[0])[rotor_at].numpy()

    start = rest[0][rotor_at].numpy().copy()
    start[rates_of] = hub(0.0)[::-1] * [1.0, spin]  # blades at rest on a hub that turns
    found = solve_ivp(disc, (0.0, 3.0), start, t_eval=time, rtol=1e-8, atol=1e-11).y
    np.testing.assert_allclose(found[[names.index(n) for n in columns]].T, wanted, atol=2e-6)
    assert np.abs(wanted).max() > 0.01


def test_a_hub_that_turns_under_a_disc_at_rest_does_not_make_blades_lag():
    model = with_values(
        build(msgspec.structs.replace(HELICOPTER, effects=("rotor.lead_lag",))),
        {"rotor.a1.q": -1.0, "rotor.b1.p": -1.0, "rotor.a0.a0": -8.0},
    )
    found = rates(model, tuple(0.0 for _ in model.own_states), p=0.3, q=-0.2)
    assert (found["a1"], found["b1"]) == pytest.approx((0.2, -0.3))
    assert found["rotor.lead_lag.x_rate"] == pytest.approx(0.0, abs=1e-12)
    assert found["rotor.lead_lag.y_rate"] == pytest.approx(0.0, abs=1e-12)


def test_lag_motion_rings_at_its_frequencies():
    model = with_values(
        build(msgspec.structs.replace(HELICOPTER, effects=("rotor.lead_lag",))), {"rotor.lead_lag.damping": 1.0}
    )
    lag = math.sqrt(1.5 * 0.381 / (8.18 - 0.381))
    found = torch.linalg.eigvals(flapping_matrix(model))
    for wanted in (27.0 * (1.0 - lag), 27.0 * (1.0 + lag), 27.0 * lag):
        assert min(abs(complex(v) - complex(-1.0, wanted)) for v in found) < 1e-6


def test_yaw_by_the_collective_is_late_with_the_collective_lag():
    """SciPy's second-order step response; the slow yaw that the derivatives give is left as it is."""
    lag, damping = 27.0 * math.sqrt(1.5 * 0.381 / (8.18 - 0.381)), 2.0
    spec = msgspec.structs.replace(HELICOPTER, effects=("rotor.lead_lag",))
    model = with_values(build(spec), {"rotor.lead_lag.damping": damping, "rotor.lead_lag.N": 8.0})
    stiff = damping**2 + lag**2
    time, followed = signal.step(signal.lti([stiff], [1.0, 2.0 * damping, stiff]), T=np.linspace(0.0, 2.0, 401))
    at = {"rotor.lead_lag.z": 0.01 * followed, "rotor.lead_lag.z_rate": 0.01 * np.gradient(followed, time)}
    found = [rates(model, (), col=0.01, **{n: float(v[k]) for n, v in at.items()}) for k in (0, 50, 400)]
    yaw = [8.0 * 0.01 * (followed[k] - 1.0) for k in (0, 50, 400)]
    assert [f["r"] for f in found] == pytest.approx(yaw, abs=1e-12)
    change = np.gradient(at["rotor.lead_lag.z_rate"], time)
    assert found[1]["rotor.lead_lag.z_rate"] == pytest.approx(change[50], rel=1e-3)


def test_a_curved_wake_turns_the_tilt_against_the_off_axis_response():
    """In steady pitching the tilt is b1 = K_R q/speed, and none across; a rotor without hinge offset."""
    speed, g = 27.0, 8.2 * 27.0 / 8.0
    spec = msgspec.structs.replace(HELICOPTER, effects=("rotor.wake_distortion",))
    model = with_values(build(spec), {**first_order(speed, g), "rotor.wake_distortion.K_R": 1.2})
    at = {s.name: 0.0 for s in model.own_states}
    at |= {"b1": 1.2 * 0.3 / speed, "rotor.wake_distortion.q": 0.3}
    found = rates(model, (), q=0.3, **at)
    assert found["a1"] == pytest.approx(0.0, abs=1e-9)
    assert found["b1"] == pytest.approx(0.0, abs=1e-9)
    assert found["rotor.wake_distortion.q"] == pytest.approx(0.0, abs=1e-9)


def test_collective_slows_the_rotor_and_the_governor_brings_it_back():
    """After a step of the load c: speed -load c exp(-rate t/2) sin(f t)/f with f^2 = governor - rate^2/4."""
    spec = msgspec.structs.replace(RIGID, outputs=(*RIGID.outputs, "omega"))
    model = made("rotor.speed", spec, load=30.0, governor=6.0, rate=2.0, N=0.2)
    dt, step, first = 0.02, 0.02, 100
    u = torch.zeros(600, 4, dtype=torch.float64)
    u[first:, 2] = step
    states = simulate(model, torch.zeros(len(model.layout), dtype=torch.float64), u, dt)
    omega, rdot = (model.output(states, u)[:, model.body.outputs.index(n)].detach() for n in ("omega", "rdot"))
    t, f = dt * torch.arange(len(u) - first, dtype=torch.float64), math.sqrt(6.0 - 1.0)
    swing = 30.0 * step * torch.exp(-t)
    speed, faster = -swing * torch.sin(f * t) / f, swing * (torch.sin(f * t) / f - torch.cos(f * t))
    assert float(omega[0]) == 27.0
    torch.testing.assert_close(omega[first:] - 27.0, speed, rtol=0.0, atol=8e-3)  # the step is a ramp of one sample
    torch.testing.assert_close(rdot[first:], 0.2 * faster, rtol=0.0, atol=4e-3)


@pytest.mark.parametrize(("direction", "sense"), [("ccw", 1.0), ("cw", -1.0)])
def test_power_slows_the_rotor_where_the_model_has_inflow(direction: str, sense: float):
    """The load is thrust times the flow through the disc, beyond trim; the engine turns the body against the rotor."""
    assert RIGID.rotor is not None
    rotor = msgspec.structs.replace(RIGID.rotor, direction=direction)
    spec = msgspec.structs.replace(RIGID, inflow=True, rotor=rotor, reference={**RIGID.reference, "vi": 11.0})
    effect = make("rotor.speed", spec)
    signals = {n: torch.tensor(v, dtype=torch.float64) for n, v in (("vi", 12.0), ("w", -1.0), ("col", 0.3))}
    frame = Frame(signals, force=torch.tensor([0.0, 0.0, -11.0], dtype=torch.float64))
    values = Values(
        torch.tensor([p.value for p in effect.declared], dtype=torch.float64), tuple(p.name for p in effect.declared)
    )
    values.vector[0] = 0.03
    frame, found = effect(frame, torch.zeros(2, dtype=torch.float64), values)
    assert frame.moment is not None
    assert float(found[0]) == pytest.approx(9.80665 * 11.0 - 11.0 * 13.0)
    blades = 4 * 1.225 * 5.7 * 0.53 * 8.18**4 / 8.2  # kg m2
    assert float(frame.moment[2]) == pytest.approx(sense * blades / 50400.0 * 0.03 * float(found[0]))


def test_battery_scales_every_command():
    model = made("propulsion.voltage", MULTIROTOR, exponent=2.0)
    u = torch.tensor([[0.6, 0.6, 0.6, 0.6, 0.9 * 3.9]] * 3, dtype=torch.float64)
    wanted = torch.tensor([0.6 * 0.81] * 4 + [0.9 * 3.9], dtype=torch.float64)
    torch.testing.assert_close(model.tape(u, 0.01)[1].detach(), wanted)


def test_a_voltage_of_which_samples_fail_counts_by_the_others():
    model = made("propulsion.voltage", MULTIROTOR, exponent=2.0)
    u = torch.tensor([[0.5, 0.5, 0.5, 0.5, 3.9]] * 60, dtype=torch.float64)
    failed = u.clone()
    failed[20:25, 4] = torch.tensor([0.0, -1.0, 0.1, 0.0, 0.0])
    passed = model.tape(failed.requires_grad_(), 0.04)
    torch.testing.assert_close(passed[:, :4], u[:, :4])
    slope = torch.autograd.grad(passed[:, 0].sum(), failed)[0]
    assert bool(slope.isfinite().all() & (slope[:20, 4] > 0.0).all())
    silent = u.index_fill(1, torch.tensor([4]), 0.0)  # a sensor that failed all the flight says nothing
    torch.testing.assert_close(model.tape(silent, 0.04)[:, :4], u[:, :4])


def test_rotors_that_speed_up_turn_the_body():
    model = made("propulsion.rotor_inertia", MULTIROTOR, N=0.5)
    faster = torch.tensor([0.7, 0.6, 0.7, 0.6, 3.9], dtype=torch.float64)
    u = torch.stack([torch.full_like(faster, 0.6), faster]).index_fill(1, torch.tensor([4]), 3.9)
    x = torch.zeros(2, len(model.layout), dtype=torch.float64)
    turned = model.output(x, u)[:, model.body.outputs.index("r")].detach()
    assert turned.tolist() == pytest.approx([0.0, 0.5 * 0.2])
    assert rates(model, (0.0,), motor1=0.7, motor2=0.6, motor3=0.7, motor4=0.6)["w"] < 0.0


def test_rotors_turn_the_body_by_their_places_and_spins():
    spec = msgspec.structs.replace(MULTIROTOR, inputs=())
    model, hover = build(spec), dict.fromkeys(MOTORS, 0.6)
    assert rates(model, **hover)["w"] == pytest.approx(0.0, abs=1e-9)
    thrust = 0.03 * 9.80665 / 4
    more = thrust * ((0.66 / 0.6) ** 2 - 1.0)
    found = rates(model, **{**hover, "motor1": 0.66})  # in front, on the right, counter-clockwise
    assert found["p"] == pytest.approx(-0.028 * more / 1.66e-5)
    assert found["q"] == pytest.approx(0.028 * more / 1.67e-5)
    assert found["r"] == pytest.approx(0.1 * math.hypot(0.028, 0.028) * more / 2.93e-5)
    assert found["w"] == pytest.approx(-more / 0.03)


def test_rotor_drag_grows_with_speed():
    model = made("propulsion.rotor_drag", MULTIROTOR, x=0.4, y=0.2)
    still, moving = (rates(model, u=u, v=u, w=w) for u, w in ((0.0, 0.0), (2.0, -1.0)))
    assert moving["u"] - still["u"] == pytest.approx(-0.8)
    assert moving["v"] - still["v"] == pytest.approx(-0.4)
    assert moving["w"] == still["w"]


def test_drag_of_discs_that_lean_goes_with_thrust_over_speed():
    """A climb that costs thrust takes as much of the drag; faster rotors lean less at the same thrust."""
    built = build(msgspec.structs.replace(MULTIROTOR, effects=("propulsion.axial_inflow", "propulsion.rotor_drag")))
    drag = {"propulsion.rotor_drag.x": 0.4, "propulsion.rotor_drag.profile": 0.0}
    model = with_values(built, {**drag, "propulsion.axial_inflow.z": 0.3})
    for faster in (1.0, 1.2):
        driven = {name: faster * MULTIROTOR.reference[name] for name in MULTIROTOR.driven}
        felt = outputs(model, u=2.0, w=-3.0, **driven)
        assert felt["ax"] == pytest.approx(-0.8 * felt["az"] / outputs(model)["az"] / faster)


@pytest.mark.parametrize("faster", [0.9, 1.0, 1.2])
@pytest.mark.parametrize(
    ("across", "climb"), [(0.0, 1.0), (0.0, -3.0), (3.0, 0.0), (8.0, 2.0), (12.0, 4.0), (5.0, -3.0)]
)
def test_flow_through_rotors_takes_the_thrust_of_blade_elements(across: float, climb: float, faster: float):
    """The thrust at which blade elements and momentum theory agree, by brackets; thrust in hover goes as speed^2."""
    z, hover, pitch, g = 0.3, 4.5, 0.004, MULTIROTOR.gravity
    loss = 2.0 * z / (1.0 - z * hover / g)
    driven = {name: faster * MULTIROTOR.reference[name] for name in MULTIROTOR.driven}
    model = made("propulsion.axial_inflow", MULTIROTOR, z=z, hover=hover, pitch=pitch)
    still, moving = outputs(model, **driven), outputs(model, u=0.6 * across, v=0.8 * across, w=-climb, **driven)
    assert still["az"] == pytest.approx(-g * faster**2, rel=1e-6)

    def left(thrust: float) -> float:
        square = hover**2 * thrust / g
        v = brentq(lambda v: v * math.hypot(across, v + climb) - square, 0.0 if across else max(0.0, -climb), 20.0)
        return thrust - g * faster**2 + loss * (faster * (v + climb - faster * hover) - pitch * across**2)

    assert moving["az"] == pytest.approx(-brentq(left, 0.1, 50.0), rel=2e-3)
    assert (moving["ax"], moving["ay"]) == pytest.approx((still["ax"], still["ay"]))


def test_no_descent_in_crosswind_throws_the_vehicle_about():
    """The change is at most that of the flow: 2 z times descent and induced velocity in hover, with any wake."""
    model = made("propulsion.axial_inflow", MULTIROTOR, z=0.3, hover=1.0)
    still = rates(model)["w"]
    felt = [rates(model, u=u, w=0.05 * k)["w"] - still for u in (0.0, 0.3, 0.675, 1.2) for k in range(61)]
    assert max(map(abs, felt)) < 2.0 * 0.3 * (3.0 + 1.0)


def test_a_damaged_rotor_s_drag_falls_as_its_thrust():
    effects = ("propulsion.unequal", "propulsion.rotor_drag")
    built = build(msgspec.structs.replace(MULTIROTOR, effects=effects))
    lacks = {"propulsion.unequal.motor1": 0.4, "propulsion.rotor_drag.x": 0.4}
    model = with_values(built, lacks)
    assert rates(model, u=2.0)["u"] - rates(model)["u"] == pytest.approx(-0.8 * 0.9)


@pytest.mark.parametrize("hover", [0.5, 4.0, 20.0, 40.0])  # m/s, beyond 19.6 with less feedback
def test_slow_climbing_takes_thrust_by_its_speed(hover: float):
    model = made("propulsion.axial_inflow", MULTIROTOR, z=0.3, hover=hover)
    assert rates(model, w=-1e-3)["w"] - rates(model)["w"] == pytest.approx(3e-4, rel=2e-3)


def test_thrust_falls_in_proportion_to_the_climb_where_the_induced_velocity_is_fast():
    """As in simulators without induced velocity, and whatever the speed across."""
    model = made("propulsion.axial_inflow", MULTIROTOR, z=0.9, hover=43.0, pitch=0.0)
    still = rates(model)["w"]
    for climb, across in ((2.0, 0.0), (-3.0, 0.0), (2.0, 5.0)):
        assert rates(model, w=-climb, u=across)["w"] - still == pytest.approx(0.9 * climb, rel=0.15)


def test_rotors_that_turn_with_the_body_damp_its_rates():
    """Each hub moves at omega x place: the rotors' drag brakes yaw, and inflow brakes roll and pitch."""
    x, y, mass, (xx, yy, zz) = 0.028, 0.028, 0.03, (1.66e-5, 1.67e-5, 2.93e-5)
    model = made("propulsion.rotor_drag", MULTIROTOR, x=0.4, y=0.2)
    still, turning = (rates(model, r=r) for r in (0.0, 2.0))
    assert turning["r"] - still["r"] == pytest.approx(-2.0 * mass * (0.4 * y * y + 0.2 * x * x) / zz)
    assert [turning[n] - still[n] for n in ("p", "q", "w")] == pytest.approx([0.0] * 3)
    model = made("propulsion.axial_inflow", MULTIROTOR, z=0.3)
    still, turning = (rates(model, p=p, q=-p) for p in (0.0, 1.5))
    assert turning["p"] - still["p"] == pytest.approx(-1.5 * mass * 0.3 * y * y / xx, rel=1e-4)
    assert turning["q"] - still["q"] == pytest.approx(1.5 * mass * 0.3 * x * x / yy, rel=1e-4)


def test_rotors_that_move_sideways_lift_more_by_the_fall_of_the_induced_velocity_and_by_faster_blades():
    """Far below it by 2 z (1/(4 v_h) + pitch) V^2: at the same thrust v = v_h - V^2/(4 v_h)."""
    model = made("propulsion.axial_inflow", MULTIROTOR, z=0.3, hover=5.0, pitch=0.01)
    still, moving = (rates(model, u=u, v=v) for u, v in ((0.0, 0.0), (0.3, -0.4)))
    assert moving["w"] - still["w"] == pytest.approx(-2.0 * 0.3 * (1.0 / 20.0 + 0.01) * 0.25, rel=0.02)


def tilt(v: float) -> float:
    """Tilt of the usual disc by speed, over that in hover, where v/v_h of the usual flow goes through the disc.

    mu (8/3 theta - 2 lambda): lambda = 0.07 in hover, theta = 0.2 rad.
    """
    return (8.0 / 3.0 * 0.2 - 2.0 * 0.07 * v) / (8.0 / 3.0 * 0.2 - 2.0 * 0.07)


def test_rotors_raise_the_nose_as_they_move_ahead():
    model, hover = made("propulsion.flapping", MULTIROTOR, k=1.5), usual_inflow(MULTIROTOR)
    still, moving = (rates(model, u=u, v=v) for u, v in ((0.0, 0.0), (2.0, 1.0)))
    square = 0.5 * 5.0 / hover**2
    turned = 1.5 * tilt(math.sqrt(math.sqrt(1.0 + square**2) - square))  # Glauert: less flow at speed
    assert moving["q"] - still["q"] == pytest.approx(2.0 * turned, rel=1e-8)
    assert MULTIROTOR.inertia is not None
    (roll, _, _), (_, pitch, _), _ = MULTIROTOR.inertia  # moments are alike
    assert moving["p"] - still["p"] == pytest.approx(-turned * pitch / roll, rel=1e-8)
    assert moving["w"] == still["w"]


def turned_by_blades(speed: float, climb: float, shares: tuple[float, float]) -> tuple[list[float], list[float]]:
    """Angular acceleration (p, q) by blade elements and by the model, of a quadrotor that moves ahead.

    Stiff blades that flap in the inflow of their own thrust, of rotors at these shares of their speed in hover, by the
    way in which they turn.
    """
    craft = multirotor("quad")
    fleet, spins = Fleet.of([craft], [craft]), np.array(craft.spins, dtype=np.float64)[:, None]
    each = np.where(spins > 0.0, *shares)
    calm, omega = np.zeros_like(fleet.hover.speed), each * fleet.hover.speed
    flow, induced = Flow(calm + climb, calm + speed, np.stack([calm + speed, calm])), fleet.hover.induced
    strength = np.array(craft.lifts)[:, None]
    for _ in range(400):
        induced = fleet.blades.inflow_step(omega, induced, flow, strength, 0.01)
    hub = fleet.blades.loads(omega, induced, flow, strength, spins).hub[:2].sum(1)[:, 0]
    motors = tuple(
        MotorSpec(position=place, spin=float(spin)) for place, spin in zip(craft.places, craft.spins, strict=True)
    )
    spec = msgspec.structs.replace(MULTIROTOR, mass=craft.mass, motors=motors, inertia=craft.inertia, spins=craft.spins)
    aside = float(fleet.blades.stiffness[0] / (fleet.blades.lock[0] / 8.0))  # of the flap equation, first harmonics
    model = made("propulsion.flapping", spec, k=felt_per_speed(craft)[2], aside=aside)
    driven = dict(zip(MOTORS, 0.6 * each[:, 0], strict=True))  # thrust goes with the square of the example's commands
    still, moving = (rates(model, **driven, u=u, w=-climb) for u in (0.0, speed))
    by_blades = (hub / np.diag(craft.inertia_matrix)[:2]).tolist()
    return by_blades, [moving[n] - still[n] for n in ("p", "q")]


@pytest.mark.parametrize(
    ("speed", "climb", "share"), [(3.0, 0.0, 1.0), (9.0, 0.0, 1.0), (9.0, 3.0, 1.2), (5.0, -1.0, 0.8)]
)
def test_moments_of_flapping_blades_are_those_of_blade_elements(speed: float, climb: float, share: float):
    (_, by_blades), (_, pitch) = turned_by_blades(speed, climb, (share, share))
    assert pitch == pytest.approx(by_blades, rel=0.15)


def test_stiff_blades_tilt_to_the_side_by_how_their_rotor_turns():
    """Rotors alike cancel each other; those that turn faster one way than the other roll a vehicle that moves ahead."""
    (roll_alike, _), (alike, _) = turned_by_blades(5.0, 0.0, (1.0, 1.0))
    assert max(abs(roll_alike), abs(alike)) < 1e-9
    by_blades, by_model = turned_by_blades(5.0, 0.0, (1.2, 0.8))
    assert by_model == pytest.approx(by_blades, rel=0.15)
    assert abs(by_blades[0]) > 0.2 * by_blades[1]


def test_rotors_that_climb_raise_the_nose_less():
    """Slow climbing takes half of itself from the induced velocity."""
    model, hover = made("propulsion.flapping", MULTIROTOR, k=1.5), usual_inflow(MULTIROTOR)
    climb = 0.01 * hover
    still, moving = (rates(model, u=u, w=-climb) for u in (0.0, 1e-3))
    assert (moving["q"] - still["q"]) / 1e-3 == pytest.approx(1.5 * tilt(1.005), rel=1e-4)


def test_a_rotor_that_gives_less_lifts_and_turns_less():
    spec = msgspec.structs.replace(MULTIROTOR, inputs=(), effects=("propulsion.unequal",))
    model, hover = build(spec), dict.fromkeys(MOTORS, 0.6)
    model.start_from({"propulsion.unequal.motor1": 0.1})
    thrust = 0.03 * 9.80665 / 4
    found = rates(model, **hover)
    assert found["w"] == pytest.approx(0.1 * thrust / 0.03)
    assert found["p"] == pytest.approx(0.028 * 0.1 * thrust / 1.66e-5)
    assert found["q"] == pytest.approx(-0.028 * 0.1 * thrust / 1.67e-5)


def test_a_multirotors_ground_lifts_by_cheeseman_and_bennett():
    spec = msgspec.structs.replace(MULTIROTOR, inputs=(), effects=("environment.ground",))
    model, hover = build(spec), dict.fromkeys(MOTORS, 0.6)
    model.start_from({"environment.ground.radius": 0.1, "environment.ground.offset": 0.02})
    heights = {h: rates(model, **hover, **{"environment.ground.height": h})["w"] for h in (0.03, 0.08, 10.0)}
    for h in (0.03, 0.08):
        assert heights[h] == pytest.approx(9.80665 - 9.80665 / (1.0 - (0.1 / (4.0 * (h + 0.02))) ** 2))
    assert heights[10.0] == pytest.approx(0.0, abs=1e-3)


def test_sensors_err_as_they_say_and_the_motion_does_not():
    true = {"p": 0.3, "q": -0.2, "r": 0.1}
    plain = outputs(build(RIGID), **true)
    model = made("sensors.bias", p=0.02)
    assert outputs(model, **true)["p"] == pytest.approx(0.32)
    assert rates(model, **true) == rates(build(RIGID), **true)
    assert outputs(made("sensors.scale", az=0.1), **true)["az"] == pytest.approx(1.1 * plain["az"])
    turned = outputs(made("sensors.misalignment", z=0.01), **true)
    seen = Rotation.from_rotvec([0, 0, 0.01]).inv().apply([0.3, -0.2, 0.1])
    np.testing.assert_allclose([turned[n] for n in "pqr"], seen, atol=3e-5)
    moved = outputs(made("sensors.lever_arm", x=0.5), **true)
    elsewhere = msgspec.structs.replace(RIGID, imu=(RIGID.imu[0] + 0.5, *RIGID.imu[1:]))
    wanted = outputs(build(elsewhere), **true)
    for axis in ("ax", "ay", "az"):
        assert moved[axis] == pytest.approx(wanted[axis], abs=1e-12)


def test_what_data_cannot_test_is_refused_in_words():
    lacking = msgspec.structs.replace(RIGID, rotor=None, reference={k: 0.0 for k in ("lon", "lat", "col", "ped")})
    for effect, words in (
        ("environment.ground", "height is missing"),
        ("environment.wind", "psi is missing"),
        ("rotor.stall", "not declared"),
        ("propulsion.voltage", "no motor commands"),
    ):
        with pytest.raises(InputError, match=words):
            build(msgspec.structs.replace(lacking, effects=(effect,)))
    with pytest.raises(InputError, match="already"):
        make("rotor.inflow", msgspec.structs.replace(RIGID, inflow=True))
    with pytest.raises(InputError, match="blades fly along"):
        build(msgspec.structs.replace(RIGID, mass_excludes=("blades",), effects=("mass.inertia",)))


def test_a_spec_frees_and_starts_single_parameters():
    spec = msgspec.structs.replace(
        RIGID, effects=("control.delay",), free={"control.delay.common": False, "control.delay.lon": True},
        values={"control.delay.lon": 0.04, "control.delay.lat": 9.0},
    )  # fmt: skip
    model = build(spec)
    free = {n for n in model.parameter_set.free if n.startswith("control.")}
    assert free == {"control.delay.lon"}
    at = {
        n: float(model.theta.detach()[model.parameter_set.index(f"control.delay.{n}")]) for n in ("lon", "lat", "col")
    }
    assert at == {"lon": 0.04, "lat": 0.25, "col": 0.0}
    with pytest.raises(InputError, match="no such parameter"):
        build(msgspec.structs.replace(RIGID, values={"control.delay.common": 0.0}))


def test_lead_lag_starts_near_every_direction_of_its_pull():
    """Half a turn is the same pull with the sign changed."""
    tried = next(p for p in LeadLag.from_spec(HELICOPTER).declared if p.name == "phase").tried
    for turn in np.linspace(-math.pi, math.pi, 73):
        assert min(abs(math.remainder(turn - start, math.pi)) for start in tried) < 0.41
