"""Multirotors in flight: balances of force, momentum and energy, drives and battery, the data set that comes out."""

import dataclasses

import numpy as np
import pytest

from rotorid_torch.data import load
from rotorid_torch.errors import InputError
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.multirotor.flight import Fleet, Task, fly_fleet
from rotorid_torch.simulation.multirotor.hidden import HIDDEN
from rotorid_torch.simulation.multirotor.manoeuvres import FLIGHTS, FORM, GROUPS, LISTS, lists, targets_of
from rotorid_torch.simulation.multirotor.vehicles import FRAMES, Build, built, drawn, is_multirotor, multirotor

G = 9.80665


def calm(name="quad", **changes):
    """A vehicle whose thrust does not flutter, recorded at every step."""
    return dataclasses.replace(multirotor(name), unsteady=0.0, rate=400, **changes)


def flown(craft, flight, seconds=5.0, clean=None):
    clean = clean or craft
    time = np.arange(round(seconds * 400) + 2) / 400.0
    rows = targets_of(flight, clean, time, 0.0)[..., None]
    fleet = Fleet.of([craft], [clean])
    return fleet, fly_fleet(fleet, Task([flight], round(seconds * craft.rate) + 1, lambda step: rows[:, step]), 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("flown") / "quad"
    return fly(out, vehicle="quad", flights=["roll_p", "translate_p", "mixed_n", "random_a"], seconds=6.0), out


def test_data_set_loads_with_its_lists_and_vehicle(folder):
    made, out = folder
    data = load(out)
    assert data.warnings == ()
    assert data.kind == "multirotor"
    assert (data.identify, data.validate, data.acid) == (("roll_p", "translate_p"), ("mixed_n",), ("random_a",))
    assert data.controls == tuple(f"motor{k}" for k in range(1, 5))
    assert data.vehicle.mass == 1.2
    assert [m.spin for m in data.vehicle.motors] == ["ccw", "cw", "ccw", "cw"]
    with np.load(out / "truth" / "roll_p.npz") as truth:
        np.testing.assert_array_equal(truth["p"], made.truth["roll_p"]["p"])
        assert set("XYZLMN") <= set(truth)
    assert made.dataset().scales() == pytest.approx(data.scales())


def test_truth_satisfies_the_declared_rigid_body(folder):
    made, _ = folder
    vehicle = made.declaration["vehicle"]
    inertia = np.array(vehicle["inertia"])
    for truth in made.truth.values():
        force, moment = np.stack([truth[c] for c in "XYZ"]), np.stack([truth[c] for c in "LMN"])
        omega, velocity = np.stack([truth[c] for c in "pqr"]), np.stack([truth[c] for c in "uvw"])
        turned = inertia @ np.stack([truth[f"{c}dot"] for c in "pqr"]) + np.cross(omega, inertia @ omega, axis=0)
        np.testing.assert_allclose(force / vehicle["mass"], np.stack([truth[f"a{c}"] for c in "xyz"]), atol=1e-9)
        np.testing.assert_allclose(moment, turned, atol=1e-9)
        phi, theta = truth["phi"], truth["theta"]
        down = np.stack([-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)])
        rate = force / vehicle["mass"] + G * down - np.cross(omega, velocity, axis=0)
        gained = np.cumsum(0.5 * (rate[:, 1:] + rate[:, :-1]), axis=1) / 100.0
        np.testing.assert_allclose(velocity[:, 1:] - velocity[:, :1], gained, atol=0.01)


def test_declared_motors_explain_a_clean_vehicle(folder):
    """Declared curve, places, spins and torque ratios give the clean vehicle's force and moments."""
    made, _ = folder
    motors = made.declaration["vehicle"]["motors"]
    for truth in made.truth.values():
        m = np.stack([truth[f"motor{k + 1}"] for k in range(4)])
        thrust = np.stack([np.polynomial.polynomial.polyval(m[k], one["thrust"]) for k, one in enumerate(motors)])
        place = np.array([one["position"] for one in motors])
        spin = np.array([(1.0 if one["spin"] == "ccw" else -1.0) * one["torque_ratio"] for one in motors])
        np.testing.assert_allclose(truth["Z"], -thrust.sum(0), atol=0.25)
        np.testing.assert_allclose(truth["L"], -place[:, 1] @ thrust, atol=0.05)
        np.testing.assert_allclose(truth["M"], place[:, 0] @ thrust, atol=0.05)
        np.testing.assert_allclose(truth["N"], spin @ thrust, atol=0.02)
        assert np.abs(truth["X"]).max() == 0.0


def test_hover_carries_the_weight_and_draws_the_power_of_its_rotors():
    craft = calm()
    fleet, record = flown(craft, "hover_p", 1.0)
    thrust = fleet.hover.curve * fleet.hover.speed**2
    assert thrust.sum() == pytest.approx(craft.mass * G, rel=1e-9)
    np.testing.assert_allclose(record.force[:, 2], -craft.mass * G, rtol=1e-3)
    np.testing.assert_allclose(thrust / (2.0 * 1.225 * craft.propeller.disc), fleet.hover.induced**2, rtol=1e-9)
    power = (fleet.hover.ratio * thrust * fleet.hover.speed).sum()
    battery = craft.battery
    gone = battery.full - (battery.full - battery.empty) * np.linspace(0.0, 1.0, 10001)
    current = power / (battery.efficiency * record.voltage[-1, 0])
    assert np.abs(gone - battery.resistance * current - record.voltage[-1, 0]).min() < 1e-3 * battery.full
    fall = -np.polyfit(record.time, record.voltage[:, 0], 1)[0]  # V/s, by the charge that flows
    charge = (battery.full - battery.empty) * current / battery.capacity
    more = 1.0 / (1.0 - battery.resistance * current / record.voltage[-1, 0])  # less voltage takes more current
    assert fall == pytest.approx(charge * more, rel=0.01)


def test_spinning_up_rotors_hand_their_momentum_to_the_body():
    """Izz r less the rotors' momentum changes by the shafts' torques alone; without inertia nothing is handed over."""
    craft = HIDDEN["propulsion.rotor_inertia"].change(calm(), 1.0)
    fleet, record = flown(craft, "yaw_p", 4.0, calm())
    spins = np.array(craft.spins)
    momentum = -craft.drive.inertia * (record.speeds[:, :, 0] @ spins)
    inner = craft.inertia_matrix[2, 2] * record.rates[:, 2, 0]
    torque = (fleet.hover.ratio * fleet.hover.curve)[:, 0] * record.speeds[:, :, 0] ** 2 @ spins
    total = inner[1:] + 0.5 * (momentum[1:] + momentum[:-1])  # speeds are those at the ends of steps
    gained = np.cumsum(0.5 * (torque[1:] + torque[:-1])) / 400.0
    assert np.ptp(momentum) > 0.05 * np.ptp(inner)
    np.testing.assert_allclose(total - total[0], gained - gained[0], atol=0.02 * np.ptp(inner))


def test_vehicle_and_slung_load_keep_their_momentum():
    """Rotors' thrust and gravity move vehicle and load together, the load by its own path."""
    craft = HIDDEN["mass.slung_load"].change(calm(), 1.0)
    assert craft.load is not None
    load = dataclasses.replace(craft.load, drag_area=0.0, damping=0.0)
    craft = dataclasses.replace(craft, load=load)
    fleet, record = flown(craft, "pitch_p", 5.0, calm())
    north, east = record.swing[:, :, 0].T
    cable = np.stack([north, east, np.sqrt(1.0 - north**2 - east**2)], axis=1)
    phi, theta, psi = record.euler[:, :, 0].T
    assert np.abs(psi).max() < 1e-2
    hook = np.asarray(load.hook)[2]
    across = np.stack([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)], axis=1)
    below = record.place[:, :, 0] + hook * across + load.cable * cable
    acceleration = np.gradient(np.gradient(below, 1 / 400.0, axis=0), 1 / 400.0, axis=0)
    thrust = (fleet.hover.curve[:, 0] * record.speeds[:, :, 0] ** 2).sum(1)
    body = np.gradient(record.velocity[:, :, 0], 1 / 400.0, axis=0)
    down = np.array([0.0, 0.0, G])
    total = craft.mass * (body - down) + load.mass * (acceleration - down)
    error = (total + thrust[:, None] * across)[4:-4]
    assert np.abs(north).max() > 0.05
    assert np.sqrt((error**2).mean()) < 0.01 * craft.mass * G


def test_load_at_rest_hangs_straight_and_is_carried():
    craft = HIDDEN["mass.slung_load"].change(calm(), 1.0)
    assert craft.load is not None
    _, record = flown(craft, "hover_p", 2.0, calm())
    assert np.abs(record.swing[-1]).max() < 1e-3
    assert record.force[-1, 2, 0] == pytest.approx(-craft.mass * G, rel=2e-3)
    fleet = Fleet.of([craft], [craft])
    thrust = (fleet.hover.curve[:, 0] * record.speeds[-1, :, 0] ** 2).sum()
    assert thrust == pytest.approx((craft.mass + craft.load.mass) * G, rel=2e-3)


def test_subset_and_length_do_not_change_a_flight(folder):
    made, _ = folder
    alone = fly(None, vehicle="quad", flights=["random_a"], seconds=3.0)
    for name, values in alone.flights["random_a"].items():
        np.testing.assert_allclose(made.flights["random_a"][name][:301], values, rtol=1e-6, atol=1e-9)
    other = fly(None, vehicle="quad", flights=["random_a"], seconds=3.0, seed=1).flights["random_a"]["p"]
    assert np.abs(other - alone.flights["random_a"]["p"]).max() > 0.01


def test_heading_turns_the_flight(folder):
    made, _ = folder
    one = fly(None, vehicle="quad", flights=["translate_p"], seconds=4.0, heading=2.0).truth["translate_p"]
    same = {name: made.truth["translate_p"][name][:401] for name in ("u", "psi")}
    np.testing.assert_allclose(one["u"], same["u"], atol=1e-6)
    np.testing.assert_allclose(one["psi"] - same["psi"], 2.0, atol=1e-6)


def test_lists_follow_names():
    assert lists(FLIGHTS) == {key: list(names) for key, names in LISTS.items()}
    assert all(FORM.fullmatch(name) for names in GROUPS.values() for name in names)
    assert lists(["eight_n-270deg"])["validate"] == ["eight_n-270deg"]


@pytest.mark.parametrize("frame", FRAMES)
def test_every_frame_is_balanced_and_flies(frame):
    craft = built(frame, Build(frame=frame))
    place, spins = np.array(craft.places), np.array(craft.spins)
    np.testing.assert_allclose(place[:, :2].mean(0), 0.0, atol=1e-9)
    assert spins.sum() == 0
    craft = dataclasses.replace(craft, unsteady=0.0)
    _, record = flown(craft, "mixed_n", 2.5)
    assert np.abs(record.euler).max() < 0.7
    assert np.abs(record.place[-1, 2] + craft.height).max() < 0.5


def test_a_lower_rotor_of_a_pair_gives_less():
    pair = [built("y", Build(frame="coaxial-y"))]
    fleet = Fleet.of(pair, pair)
    upper, lower = fleet.hover.curve[:3, 0], fleet.hover.curve[3:, 0]
    assert np.all(lower < 0.9 * upper)
    assert np.all(lower > 0.6 * upper)


def test_drawn_vehicles_are_many_and_the_same_each_time():
    builds = [drawn(k) for k in range(200)]
    masses = np.array([b.mass for b in builds])
    assert masses.min() < 0.05
    assert masses.max() > 4.0
    assert {b.frame for b in builds} == set(FRAMES)
    assert drawn(7) == builds[7]
    for number, build in enumerate(builds):  # no body has a principal moment above the sum of the others
        moments = np.linalg.eigvalsh(built(f"multirotor-{number}", build).inertia_matrix)
        assert 0.0 < moments[2] < moments[0] + moments[1]
    assert is_multirotor("multirotor-7")
    assert not is_multirotor("multirotor-x")


@pytest.mark.parametrize("number", [3, 7, 9, 14])
def test_drawn_vehicles_fly(number):
    """The heaviest of them too, with drag of the air and a lag."""
    clean = multirotor(f"multirotor-{number}")
    craft = clean
    for effect in ("propulsion.motor_lag", "propulsion.rotor_drag", "propulsion.axial_inflow"):
        craft = HIDDEN[effect].change(craft, 1.0)
    made = fly(None, vehicle=clean.name, flights=["eight_p", "roll_p"], seconds=4.0)
    assert made.declaration["vehicle"]["mass"] == clean.mass
    for truth in made.truth.values():
        assert np.abs(truth["theta"]).max() < 0.7
        assert 0.0 < truth["motor1"].min() <= truth["motor1"].max() < 1.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"vehicle": "quad", "effects": [("rotor.stall", None)]}, "it is a multirotor"),
        ({"vehicle": "quad", "effects": [("mass.cg", 11.0)]}, "a factor of its typical size"),
        ({"effects": [("propulsion.voltage", None)]}, "it is a helicopter"),
        ({"vehicle": "quad", "flights": ["f321_lon"]}, "there is no flight 'f321_lon'"),
        ({"vehicle": "quad", "flights": []}, "the list is empty"),
        ({"vehicle": "quad", "speed": 50.0}, "a speed of figures"),
        ({"vehicle": "quad", "height": -1.0}, "a height above ground"),
        ({"vehicle": "hexa"}, "hexa"),
    ],
)
def test_refused_in_one_line(options, said):
    with pytest.raises(InputError, match=said.replace("(", "\\(")):
        fly(None, seconds=1.0, **options)
