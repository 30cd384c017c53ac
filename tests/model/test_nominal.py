"""The nominal model: units, priors and bounds of its parameters, and which physics a declaration brings."""

from __future__ import annotations

import math

import msgspec
import pytest

from rotorid_torch.effects.examples import MULTIROTOR
from rotorid_torch.model.nominal import EVERYTHING, build, per_unit
from tests.known_models import body_spec, helicopter_spec

UNITS = [
    ("rad/s2", "rad/s", "1/s"),
    ("rad/s2", "rad", "1/s2"),
    ("rad/s2", "m/s", "rad/(m s)"),
    ("m/s2", "m/s", "1/s"),
    ("m/s2", "rad/s", "m/(rad s)"),
    ("m/s2", "rad", "m/(rad s2)"),
    ("m/s2", "norm", "m/s2"),
    ("m/s2", "m", "1/s2"),
    ("rad/s", "rad", "1/s"),
    ("rad/s", "m/s", "rad/m"),
    ("rad/s", "rad/s", "1"),
    ("rad", "rad", "1"),
    ("rad", "rad/s", "s"),
    ("rad", "m/s", "rad s/m"),
    ("rad", "norm", "rad"),
]


@pytest.mark.parametrize(("above", "below", "unit"), UNITS)
def test_unit_of_a_derivative(above: str, below: str, unit: str):
    assert per_unit(above, below) == unit


def test_what_is_declared_decides_on_the_physics():
    ids = lambda spec: [e.id for e in build(spec).chain]  # noqa: E731
    assert ids(body_spec()) == ["forces"]
    assert ids(helicopter_spec()) == ["rotor", "tail_inflow", "forces", "rotor.tilt", "inflow", "tail", "tailplane"]
    assert ids(helicopter_spec(mass=None, inflow=False)) == ["rotor", "forces"]
    assert ids(helicopter_spec(hub=None)) == ["rotor", "tail_inflow", "forces", "inflow", "tail", "tailplane"]
    assert ids(helicopter_spec("none")) == ["tail_inflow", "forces", "inflow", "tail", "tailplane"]


def test_priors_scale_with_the_excursions_of_row_and_regressor():
    model = build(body_spec(sizes={"row.L": 2.0, "p": 0.1, "lat": 0.02}))
    declared = {p.name: p for p in model.parameter_set.parameters}
    assert declared["forces.L.p"].prior_sd == pytest.approx(5.0 * 2.0 / 0.1)
    assert declared["forces.L.lat"].prior_sd == pytest.approx(5.0 * 2.0 / 0.02)
    assert declared["forces.L.trim"].prior_sd == pytest.approx(10.0)
    assert declared["forces.Z.trim"].value == pytest.approx(-9.80665)


def test_a_channel_that_never_moves_leaves_finite_priors():
    model = build(body_spec(sizes={"row.L": 2.0, "p": 0.0}))
    assert all(math.isfinite(p.prior_sd) and p.prior_sd > 0 for p in model.parameter_set.parameters)


def test_rotors_damp_the_body_unless_flapping_does():
    bounds = lambda spec: {p.name: p.bounds for p in build(spec).parameter_set.parameters}  # noqa: E731
    without, lagged = bounds(body_spec()), bounds(helicopter_spec())
    for name in ("forces.L.p", "forces.M.q", "forces.N.r"):
        assert without[name] == (-50.0, 0.0)
        assert lagged[name] == EVERYTHING
    assert bounds(helicopter_spec("algebraic"))["forces.L.p"] == (-50.0, 0.0)


def test_every_parameter_has_a_unit():
    assert all(p.unit for p in build(helicopter_spec()).parameter_set.parameters)


def test_a_yaw_power_without_a_declared_torque_says_over_what_it_is():
    about = {p.name: p.doc for p in build(MULTIROTOR).parameter_set.parameters}["rotors.power.N"]
    assert about == "yaw by the rotors, over a torque of 0.1 arms times thrust (no torque_ratio is declared)"
    motors = tuple(msgspec.structs.replace(motor, torque_ratio=0.006) for motor in MULTIROTOR.motors)
    declared = build(msgspec.structs.replace(MULTIROTOR, motors=motors)).parameter_set.parameters
    assert {p.name: p.doc for p in declared}["rotors.power.N"] == "yaw by the rotors, over what is declared"
