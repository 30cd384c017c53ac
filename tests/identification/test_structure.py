"""The structure that is proposed: what is measured and declared decides."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
import pytest
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification import structure
from rotorid_torch.identification.structure import lagged, propose
from rotorid_torch.model.inflow import INDUCED
from rotorid_torch.model.nominal import build
from tests.known_models import BODY, INERTIA, STICKS

RATES = ("p", "q", "r")
FLAPPING = ("a0", "a1", "b1")
FORCES, MOMENTS = ("X", "Y", "Z"), ("L", "M", "N")
ROTOR = {"blades": 4, "radius": 8.18, "chord": 0.53, "speed": 27.0, "direction": "cw"}
VEHICLE = {"mass": 7257.0, "inertia": [list(row) for row in INERTIA], "hub": [0.1, 0.0, -2.1], "rotor": ROTOR}
DT = 0.02


def recorded(
    seed: int, channels: tuple[str, ...], controls: tuple[str, ...], lag: float = 0.0
) -> dict[str, np.ndarray]:
    """Steps in the controls, random slow motion, and flapping that follows both with a lag in samples."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(400)
    made = {}
    for k, name in enumerate(controls):
        made[name] = 0.2 + 0.05 * np.sign(np.sin(2 * np.pi * (0.3 + 0.17 * k) * time)) * (time > 1.0)
    slow = lambda: np.convolve(rng.standard_normal(420), np.ones(21) / 21, "valid") * (time > 1.0)  # noqa: E731
    for name in channels:
        if name not in FLAPPING:
            made[name] = slow() * 0.2
    drivers = np.stack([made[n] for n in (*RATES, *controls) if n in made], axis=-1)
    gains = np.random.default_rng(9).standard_normal((3, drivers.shape[1])) * 0.3
    follow = lagged(torch.tensor(drivers), lag).numpy() @ gains.T
    made |= {n: follow[:, k] for k, n in enumerate(FLAPPING) if n in channels}
    if "az" in channels:
        made["az"] = made["az"] - 9.8
    noisy = {n: v + 1e-3 * rng.standard_normal(400) for n, v in made.items()}
    return {"time": time, **noisy}


def a_dataset(channels: tuple[str, ...], controls: tuple[str, ...] = STICKS, lag: float = 0.0, **more: Any) -> Dataset:
    flights = {name: recorded(k, channels, controls, lag) for k, name in enumerate(("one", "two"))}
    noise = {n: {"noise": 1e-3} for n in channels}
    return Dataset.from_arrays(flights, identify=["one", "two"], channels=noise, **more)


class Loads:
    """What `propose` reads of a reconstruction: specific forces and moments."""

    def __init__(self, data: Dataset) -> None:
        generator = torch.Generator().manual_seed(0)
        loads = torch.randn(400, 6, generator=generator, dtype=torch.float64) * torch.arange(1.0, 7.0)
        self.flights: Mapping[str, Any] = {n: type("Flown", (), {"specific": loads}) for n in data.flights}


def proposed(*args: Any, **more: Any) -> ModelSpec:
    data = a_dataset(*args, **more)
    spec = propose(data, Loads(data))  # pyright: ignore[reportArgumentType]
    model = build(spec)  # whatever is proposed can be built and evaluated
    x, u = torch.zeros(2, len(model.layout)).double(), torch.zeros(2, len(model.body.controls)).double()
    assert model(torch.tensor(0.0), x, u).shape == x.shape
    assert model.output(x, u).shape == (2, len(spec.outputs))
    assert ModelSpec.from_plain(msgspec.json.decode(msgspec.json.encode(spec.plain()))) == spec
    return spec


def test_velocity_and_attitude_are_states_where_measured():
    spec = proposed((*BODY, "ax", "ay", "az"))
    assert spec.states == BODY
    assert spec.outputs == (*BODY, "ax", "ay", "az")
    assert set(spec.patterns) == {*FORCES, *MOMENTS}
    assert spec.patterns["L"] == ("u", "v", "w", "p", "q", "r", *STICKS)
    assert spec.flapping == "none"
    assert not spec.inflow


def test_rates_alone_make_a_model_of_rates():
    spec = proposed(RATES)
    assert spec.states == spec.outputs == RATES
    assert set(spec.patterns) == set(MOMENTS)
    assert spec.patterns["M"] == (*RATES, *STICKS)


def test_forces_have_equations_without_velocity_where_all_accelerometers_are():
    assert set(proposed((*RATES, "ax", "ay", "az")).patterns) == {*FORCES, *MOMENTS}
    some = proposed((*RATES, "ax", "az"))
    assert set(some.patterns) == set(MOMENTS)
    assert some.outputs == RATES


def test_velocity_without_attitude_is_no_state():
    assert proposed(("u", "v", "w", *RATES)).states == RATES
    assert proposed((*RATES, "phi", "theta", "psi")).states == (*RATES, "phi", "theta")


def test_sticks_of_an_undeclared_helicopter_command_its_rates_one_by_one():
    flights = {name: recorded(k, BODY, STICKS) for k, name in enumerate(("one", "two"))}
    sticks = {c: {"unit": "norm"} for c in STICKS}
    alone = {"L": ("p", *STICKS), "M": ("q", *STICKS), "N": ("r", *STICKS)}
    alone |= {"X": ("u",), "Y": ("v",), "Z": ("w", "col")}
    whole = dict.fromkeys(alone, ("u", "v", "w", "p", "q", "r", *STICKS))
    for vehicle, patterns in (({}, alone), ({"mass": 800.0}, whole)):
        data = Dataset.from_arrays(flights, identify=["one", "two"], controls=sticks, vehicle=vehicle)
        spec = propose(data, Loads(data))  # pyright: ignore[reportArgumentType]
        assert spec.patterns == patterns


def test_a_multirotor_has_its_motors():
    motors = tuple(f"motor{k}" for k in range(1, 5))
    spec = proposed((*RATES, "phi", "theta", "ax", "ay", "az"), motors, kind="multirotor", vehicle={"mass": 1.2})
    assert spec.controls == motors
    assert spec.states == (*RATES, "phi", "theta")
    assert spec.control_units == dict.fromkeys(motors, "norm")
    assert spec.patterns["L"] == ()  # no damping: rotors have effects of their own
    assert spec.found_places == {}  # commands that go with nothing say nothing of where motors stand
    assert [m.position for m in spec.motors] == [(0.0, 0.0, 0.0)] * 4
    units = {p.name: p.unit for p in build(spec).parameter_set.parameters}
    assert units["rotors.thrust.c2"] == "N"
    assert not any(name.startswith("forces.") for name in units)  # motors push along z alone


def test_declared_motors_bring_rotors_at_their_places():
    motors = tuple(f"motor{k}" for k in range(1, 5))
    places = [([0.1, 0.1, 0.0], "ccw"), ([-0.1, 0.1, 0.0], "cw"), ([-0.1, -0.1, 0.0], "ccw"), ([0.1, -0.1, 0.0], "cw")]
    vehicle = {"mass": 1.2, "motors": [{"position": at, "spin": spin} for at, spin in places]}
    spec = proposed((*RATES, "az"), motors, kind="multirotor", vehicle=vehicle)
    assert spec.driven == motors
    assert set(spec.patterns) == {"Z", *MOMENTS}  # nothing sees X and Y
    assert spec.outputs == (*RATES, "az")
    assert spec.spins == (1.0, -1.0, 1.0, -1.0)
    units = {p.name: p.unit for p in build(spec).parameter_set.parameters}
    assert units["rotors.thrust.c2"] == "N"
    assert units["rotors.power.L"] == "rad/(kg m2)"  # the inertia is not declared
    assert "rotors.trim.X" not in units
    assert not any(name.startswith("forces.") for name in units)
    blind = build(proposed(RATES, motors, kind="multirotor", vehicle=vehicle))
    assert "rotors.thrust.c2" not in blind.parameter_set.free  # nothing shows the thrust


def test_measured_rotor_speeds_drive_the_rotors_and_follow_the_commands():
    motors, speeds = tuple(f"motor{k}" for k in range(1, 5)), tuple(f"omega{k}" for k in range(1, 5))
    places = [([0.1, 0.1, 0.0], "ccw"), ([-0.1, 0.1, 0.0], "cw"), ([-0.1, -0.1, 0.0], "ccw"), ([0.1, -0.1, 0.0], "cw")]
    vehicle = {"mass": 1.2, "motors": [{"position": at, "spin": spin} for at, spin in places]}
    spec = proposed((*RATES, "az", *speeds, "voltage"), motors, kind="multirotor", vehicle=vehicle)
    assert spec.inputs == (*speeds, "voltage")
    assert spec.driven == speeds
    assert spec.outputs == (*RATES, "az", *speeds)
    model = build(spec)
    u = torch.tensor([spec.reference[n] for n in model.body.controls], dtype=torch.float64).repeat(3, 1)
    told = model.output(torch.zeros(3, len(model.layout), dtype=torch.float64), model.tape(u, DT)).detach()
    for name in speeds:  # at the reference's mean command the reference's mean speed
        own = spec.reference[f"motor{name[-1]}"] / (sum(spec.reference[m] for m in motors) / 4)
        mean = sum(spec.reference[n] for n in speeds) / 4
        assert float(told[0, spec.outputs.index(name)]) == pytest.approx(mean * own**0.5, rel=1e-9)


def test_a_declared_rotor_brings_inflow_and_its_physics():
    spec = proposed((*BODY, *FLAPPING), vehicle=VEHICLE, lag=6)
    assert spec.inflow
    assert spec.rotor is not None
    assert spec.rotor.spin == -1.0
    assert spec.reference[INDUCED] == pytest.approx(11.755, abs=0.05)
    assert INDUCED in spec.patterns["Z"]
    assert {"rotor", "rotor.tilt", "inflow", "tail"} <= {e.id for e in build(spec).chain}
    for missing in ("mass", "inertia", "rotor"):
        partial = {k: v for k, v in VEHICLE.items() if k != missing}
        assert not proposed((*BODY, *FLAPPING), vehicle=partial, lag=6).inflow


def test_flapping_that_lags_is_a_state():
    spec = proposed((*BODY, *FLAPPING), lag=6)
    assert spec.flapping == "first order"
    assert build(spec).layout.names == (*BODY, *FLAPPING)
    assert set(FLAPPING) <= set(spec.patterns["L"])
    assert set(FLAPPING) <= set(spec.patterns["a1"])
    assert spec.outputs[-3:] == FLAPPING


def test_flapping_that_does_not_lag_is_algebraic():
    spec = proposed((*BODY, *FLAPPING), lag=0)
    assert spec.flapping == "algebraic"
    assert build(spec).layout.names == BODY
    assert not set(FLAPPING) & set(spec.patterns["L"])
    assert spec.reference["a1.trim"] == pytest.approx(spec.reference["a1"])
    assert spec.outputs[-3:] == FLAPPING


def test_a_doubtful_lag_has_a_rival_without_it_unless_an_effect_needs_the_lag():
    spec = proposed((*BODY, *FLAPPING), lag=1)
    assert spec.flapping_doubtful
    other = structure.rival(spec)
    assert other is not None
    assert other.flapping == "algebraic"
    assert structure.rival(msgspec.structs.replace(spec, effects=("rotor.flap_second_order",))) is None


def test_flapping_needs_velocity_and_all_three():
    assert proposed((*RATES, *FLAPPING)).flapping == "none"
    assert proposed((*BODY, "a1", "b1")).flapping == "none"


def test_trims_balance_gravity_at_the_reference():
    spec = proposed((*BODY, "ax", "ay", "az"))
    model = build(spec)
    x = torch.tensor([spec.reference[n] if n in ("phi", "theta") else 0.0 for n in BODY], dtype=torch.float64)
    u = torch.tensor([spec.reference[n] for n in STICKS], dtype=torch.float64)
    theta = model.theta.detach().clone()
    rates = model.rates(theta, x, u)
    torch.testing.assert_close(rates[:3], torch.zeros(3).double(), atol=1e-12, rtol=0)


def test_sizes_and_ranges_are_those_of_the_flights():
    data = a_dataset((*BODY,))
    spec = propose(data, Loads(data))  # pyright: ignore[reportArgumentType]
    p = torch.cat([f.channels["p"] for f in data.flights.values()])
    assert spec.ranges["p"] == (float(p.min()), float(p.max()))
    assert spec.sizes["p"] == pytest.approx(float((p - data.reference()["p"]).square().mean().sqrt()))
    assert spec.sizes["row.N"] == pytest.approx(6.0, rel=0.1)
    assert spec.reference["col"] == pytest.approx(0.2, abs=0.01)


def test_a_signal_at_rest_has_the_size_of_its_noise():
    flights = {
        name: recorded(k, BODY, STICKS) | {"v": 0.3 + 1e-9 * np.arange(400)} for k, name in enumerate(("one", "two"))
    }
    data = Dataset.from_arrays(flights, identify=["one", "two"], channels={"v": {"noise": 0.05}})
    assert propose(data, Loads(data)).sizes["v"] == 0.05  # pyright: ignore[reportArgumentType]


def test_effects_are_handed_on():
    data = a_dataset(RATES)
    spec = propose(data, Loads(data), ("control.delay",))  # pyright: ignore[reportArgumentType]
    assert spec.effects == ("control.delay",)
    assert build(spec).effect("control.delay") is not None


def test_a_lag_starts_in_equilibrium_and_follows_a_step():
    signal = torch.ones(50, 2, dtype=torch.float64)
    assert torch.allclose(lagged(signal, 4), signal)
    assert torch.equal(lagged(signal, 0), signal)
    signal[10:] = 2.0
    wanted = 2.0 - torch.exp(-torch.arange(1, 41, dtype=torch.float64) / 4.0)
    torch.testing.assert_close(lagged(signal, 4)[10:, 0], wanted)
    assert structure.LAGS[0] == 0
