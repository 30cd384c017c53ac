"""Declared mass, arms and inertia against what the motors of a multirotor do."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from rotorid_torch.consistency.examination import check as examination
from rotorid_torch.data import Dataset, load
from rotorid_torch.effects.examples import MULTIROTOR
from rotorid_torch.identification.mixer import declared_powers
from rotorid_torch.model.rotors import believable
from rotorid_torch.run.check import check
from rotorid_torch.simulation import fly
from rotorid_torch.validate.declared_vehicle import of_declaration
from tests.helpers import shared

MOTORS = tuple(f"motor{k}" for k in (1, 2, 3, 4))
PLACES = np.array([[0.2, 0.15, 0.0], [-0.2, 0.15, 0.0], [-0.2, -0.15, 0.0], [0.2, -0.15, 0.0]])
INERTIA = np.array([[0.01, 0.001, 0.0], [0.001, 0.02, 0.0], [0.0, 0.0, 0.03]])
MASS, DT = 1.5, 0.01


def flown(exponent: float, noise: float = 0.0) -> Dataset:
    """Motors that thrust by a power of their commands on exact rigid-body rotation, without damping."""
    rng, time = np.random.default_rng(0), DT * np.arange(4000)
    slow = np.stack([np.convolve(rng.standard_normal(4100), np.ones(101) / 101, "valid") for _ in MOTORS], axis=-1)
    commands = 0.5 + 0.2 * slow
    thrust = 9.81 * MASS / 4 * (commands / 0.5) ** exponent
    moments = np.stack([-thrust @ PLACES[:, 1], thrust @ PLACES[:, 0], thrust @ [0.01, -0.01, 0.01, -0.01]], axis=-1)
    rates = np.cumsum(moments @ np.linalg.inv(INERTIA).T, axis=0) * DT + noise * rng.standard_normal((4000, 3))
    flight = {"time": time, "az": -thrust.sum(-1) / MASS, **dict(zip("pqr", rates.T, strict=True))}
    flight |= dict(zip(MOTORS, commands.T, strict=True))
    motors = [{"position": place.tolist(), "spin": spin} for place, spin in zip(PLACES, ("ccw", "cw") * 2, strict=True)]
    vehicle = {"mass": MASS, "inertia": INERTIA.tolist(), "motors": motors}
    return Dataset.from_arrays({"one": flight}, identify=["one"], kind="multirotor", vehicle=vehicle)


def with_mass(data: Dataset, factor: float) -> Dataset:
    """The same with another declared mass."""
    assert data.vehicle.mass is not None
    return replace(data, vehicle=msgspec.structs.replace(data.vehicle, mass=factor * data.vehicle.mass))


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_control_power_lies_between_its_bounds(exponent: float, noise: float):
    data = flown(exponent, noise)
    powers = declared_powers(data, MOTORS)
    assert all(power.low < 1.0 < power.high for power in powers.values())
    assert noise > 0.0 or powers.keys() == {"p", "q"}
    for rate, power in declared_powers(with_mass(data, 10.0), MOTORS).items():
        assert power == pytest.approx([bound / 10.0 for bound in powers[rate]])


def test_where_places_are_found_mass_and_inertia_say_which_control_power_can_be():
    """Rotors stand about as far out as the body's mass, or further; of yaw only the ratio of torque says anything."""
    assert MULTIROTOR.inertia is not None
    spec = msgspec.structs.replace(MULTIROTOR, found_places={"L": 0.9, "M": 0.9})
    right = 1.0 / MULTIROTOR.inertia[0][0]
    assert [believable(spec, "L", share * right) for share in (0.1, 1.0, 10.0)] == [False, True, False]
    nearer = tuple(
        msgspec.structs.replace(m, position=tuple(0.1 * one for one in m.position)) for m in MULTIROTOR.motors
    )
    assert believable(msgspec.structs.replace(spec, motors=nearer), "L", 10.0 * right)  # the scale is that of the arms
    assert believable(spec, "N", 1e-9)
    assert believable(msgspec.structs.replace(spec, mass=None), "L", 1e-9)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    place = tmp_path_factory.mktemp("flown")
    fly(place, vehicle="quad", flights=["roll_p", "pitch_p"])
    return load(place)


def test_a_mass_that_is_right_is_not_doubted(written: Dataset):
    assert not [f for f in check(written).findings if "declared mass" in f.sentence]


@pytest.mark.parametrize(("factor", "said"), [(10.0, "too large, or the"), (0.1, "too small, or the")])
def test_a_mass_that_is_wrong_ten_times_is_told_and_limits_roll_and_pitch(factor: float, said: str, written: Dataset):
    wrong = check(with_mass(written, factor))
    (told,) = [f for f in wrong.findings if "declared mass" in f.sentence]
    assert told.channel == "p q"
    assert said in told.sentence
    assert {one.axis for one in wrong.axes if one.grade == "limited"} >= {"roll", "pitch"}


@pytest.mark.parametrize("order", [(3, 2, 1, 0), (1, 0, 3, 2), (1, 2, 3, 0)])
def test_motors_that_are_placed_otherwise_are_no_error_of_the_mass(order: tuple[int, ...], written: Dataset):
    """Right and left exchanged, ahead and behind, all turned by one."""
    examined = examination.check(written)
    vehicle, motors = examined.flown.vehicle, examined.flown.vehicle.motors
    moved = tuple(motors[k] for k in order)
    flown = replace(examined.flown, vehicle=msgspec.structs.replace(vehicle, motors=moved))
    assert not [*of_declaration(replace(examined, flown=flown))]


@pytest.mark.parametrize("name", ["crazyflie-motors", "crazypad-normal", "crazypad-x1", "crazypad-x2", "nanodrone"])
def test_measured_multirotors_as_declared_are_not_accused(name: str):
    assert not [*of_declaration(examination.check(load(shared("flightdata", name)), ()))]
