"""The data set that comes out: channels, lists, noise, truth, reading, refusals."""

import dataclasses

import numpy as np
import pytest

from rotorid_torch.data import load
from rotorid_torch.errors import InputError
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.flight.augmentation import Augmentation, design
from rotorid_torch.simulation.flight.manoeuvres import FLIGHTS, LISTS, pilot
from rotorid_torch.simulation.flight.sensors import MEASURED, NOISE, measured_channels
from rotorid_torch.simulation.flight.simulation import Programme, fly_batch
from rotorid_torch.simulation.flight.trim import find_trim
from tests.helpers import small_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short data set on disk: two flights of three seconds."""
    out = tmp_path_factory.mktemp("flown") / "short"
    return fly(out, flights=["sweep_col", "dbl_lat_p"], seconds=3.0), out


def test_channels_are_those_of_the_reference_sets(folder):
    """154 Hz, 1/154 s apart, every channel, float32; truth float64 with the loads."""
    flown, out = folder
    with np.load(out / "flights" / "dbl_lat_p.npz") as flight:
        assert tuple(flight) == MEASURED
        assert all(flight[name].shape == (463,) for name in flight)
        np.testing.assert_allclose(np.diff(flight["time"]), 1.0 / 154.0, rtol=1e-9)
        assert flight["p"].dtype == np.float32
    with np.load(out / "truth" / "dbl_lat_p.npz") as truth:
        assert set("XYZLMN") <= set(truth)
        np.testing.assert_array_equal(truth["p"], flown.truth["dbl_lat_p"]["p"])
    assert not list(out.parent.glob(".*partial*"))


def test_data_set_loads(folder):
    """Our own reader takes it without a warning, from disk and from memory."""
    flown, out = folder
    data = load(out)
    assert data.warnings == ()
    assert tuple(data.flights) == ("dbl_lat_p", "sweep_col")
    assert data.identify == ("dbl_lat_p",)
    assert data.acid == ("sweep_col",)
    assert data.controls == ("lon", "lat", "col", "ped")
    assert tuple(data.vehicle.mass_excludes) == ("blades",)
    assert data.noise("p") == 0.002
    assert data.reference()["col"] == pytest.approx(0.319, abs=0.01)
    in_memory = flown.dataset()
    assert in_memory.identify == data.identify
    assert in_memory.scales() == pytest.approx(data.scales())


def test_truth_satisfies_the_declared_rigid_body(folder):
    """X Y Z over the declared mass is specific force, L M N turn the declared inertia, and the velocities follow."""
    flown, _ = folder
    for truth in flown.truth.values():
        vehicle = flown.declaration["vehicle"]
        mass, inertia = vehicle["mass"], np.array(vehicle["inertia"])
        force, moment = np.stack([truth[c] for c in "XYZ"]), np.stack([truth[c] for c in "LMN"])
        omega = np.stack([truth[c] for c in "pqr"])
        turned = inertia @ np.stack([truth[f"{c}dot"] for c in "pqr"]) + np.cross(omega, inertia @ omega, axis=0)
        np.testing.assert_allclose(force / mass, np.stack([truth[f"a{c}"] for c in "xyz"]), rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(moment, turned, rtol=1e-6, atol=1e-4)
        phi, theta = truth["phi"], truth["theta"]
        gravity = vehicle["gravity"] * np.stack(
            [-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)]
        )
        velocity = np.stack([truth[c] for c in "uvw"])
        rate = force / mass + gravity - np.cross(omega, velocity, axis=0)
        gained = np.cumsum(0.5 * (rate[:, 1:] + rate[:, :-1]), axis=1) / 154.0
        np.testing.assert_allclose(velocity[:, 1:] - velocity[:, :1], gained, atol=2e-3)


def test_first_second_is_quiet(folder):
    """Trimmed flight before the manoeuvre: nothing moves by more than a hundredth of the noise."""
    flown, _ = folder
    for truth in flown.truth.values():
        for name in MEASURED[1:]:
            assert np.ptp(truth[name][:154]) < 0.01 * NOISE[name], name


def test_same_seed_same_data_and_another_seed_independent_noise(folder):
    """Noise depends on seed, flight and channel alone; its deviation is the declared one."""
    flown, _ = folder
    truth = flown.truth["dbl_lat_p"]
    again = measured_channels(truth, MEASURED, "dbl_lat_p", 0)
    other = measured_channels(truth, MEASURED, "dbl_lat_p", 1)
    neighbour = measured_channels(truth, MEASURED, "sweep_col", 0)
    noises = []
    for name in MEASURED[1:]:
        np.testing.assert_array_equal(again[name], flown.flights["dbl_lat_p"][name])
        for channels in (again, other, neighbour):
            noises.append((channels[name] - truth[name]) / NOISE[name])
    noises = np.array(noises)
    assert np.all(np.abs(noises.std(axis=1) - 1.0) < 0.15)
    correlation = np.corrcoef(noises) - np.eye(len(noises))
    assert np.abs(correlation).max() < 5.0 / np.sqrt(noises.shape[1])


def test_subset_and_length_do_not_change_a_flight(folder):
    """One flight alone, shorter, is the same flight from its first sample."""
    flown, _ = folder
    alone = fly(None, flights=["dbl_lat_p"], seconds=1.5)
    for name in MEASURED:
        longer = flown.flights["dbl_lat_p"][name][:232]
        np.testing.assert_allclose(alone.flights["dbl_lat_p"][name], longer, rtol=1e-6, atol=1e-9)


def test_heading_turns_the_flight_and_nothing_else(folder):
    """Body channels do not know the heading."""
    flown, _ = folder
    turned = fly(None, flights=["dbl_lat_p"], seconds=1.5, heading=2.0).truth["dbl_lat_p"]
    same = flown.truth["dbl_lat_p"]
    np.testing.assert_allclose(turned["psi"], same["psi"][:232] + 2.0, atol=1e-9)
    for name in ("u", "v", "p", "q", "r", "ax", "L", "a1"):
        np.testing.assert_allclose(turned[name], same[name][:232], atol=1e-6)


def test_lists_and_sticks_are_those_of_the_paper():
    """Thirteen flights; 3-2-1-1 of 0.8 s units, doublets of 1.2 s halves, amplitude 10 % of full deflection."""
    assert len(FLIGHTS) == 13
    assert [len(names) for names in LISTS.values()] == [8, 4, 1]
    time = np.array([0.99, 1.01, 3.39, 3.41, 4.99, 5.01, 5.79, 5.81, 6.59, 6.61])
    limits = ((-0.29, 0.22), (-0.14, 0.14), (0.17, 0.45), (0.0, 0.52))
    steps = pilot(["f321_lat"], time, limits)[1, :, 0] / 0.028
    np.testing.assert_allclose(steps, [0, 1, 1, -1, -1, 1, 1, -1, -1, 0])
    doublet = pilot(["dbl_ped_n"], np.array([0.5, 2.0, 3.0, 3.5]), limits)[3, :, 0] / 0.052
    np.testing.assert_allclose(doublet, [0, -1, 1, 0])
    fine = np.linspace(0.0, 15.0, 30001)
    sweep = pilot(["sweep_col"], fine, limits)[2, :, 0]
    assert np.abs(sweep).max() == pytest.approx(0.028, rel=1e-3)
    assert np.all(sweep[(fine < 1.0) | (fine >= 7.0)] == 0.0)


def test_unstable_without_augmentation_and_bounded_with_it(hover):
    """Ten seconds of a longitudinal doublet and a lateral 3-2-1-1."""
    names = ["dbl_lon_p", "f321_lat"]
    with_it = fly_batch(hover.aircraft, hover.trim, design(hover.linear), Programme(names, 10.0, substeps=1))
    assert np.abs(with_it.states[:, 6:9]).max() < 0.5
    assert np.abs(with_it.states[-1, 3:6]).max() < 0.06
    without = fly_batch(hover.aircraft, hover.trim, Augmentation(np.zeros((4, 6))), Programme(names, 10.0, substeps=1))
    assert np.abs(without.states[:, 6:9]).max() > 0.5
    assert np.abs(without.states[-1, 3:6]).max() > 0.2


def test_halving_the_step_changes_nothing_that_sensors_see(hover):
    """Two seconds: a hundredth of the noise."""
    coarse = fly_batch(hover.aircraft, hover.trim, design(hover.linear), Programme(["dbl_lat_p"], 2.0))
    fine = fly_batch(hover.aircraft, hover.trim, design(hover.linear), Programme(["dbl_lat_p"], 2.0, substeps=4))
    assert np.abs(coarse.states - fine.states)[:, :3].max() < 0.01 * NOISE["u"]
    assert np.abs(coarse.states - fine.states)[:, 3:9].max() < 0.01 * NOISE["p"]
    assert np.abs(coarse.specific_force - fine.specific_force).max() < 0.01 * NOISE["ax"]


def test_governor_holds_the_rotor_speed_through_a_collective_doublet(hover):
    """A free rotor droops by some per cent (UH-60: 1 to 3 % on an inch of collective) and comes back."""
    free = dataclasses.replace(hover.aircraft, governor=dataclasses.replace(hover.aircraft.governor, held=False))
    record = fly_batch(free, find_trim(free, 0.0), design(hover.linear), Programme(["dbl_col_p"], 4.0, substeps=1))
    droop = np.abs(record.states[:, 21, 0] / 27.0 - 1.0)
    assert 0.003 < droop.max() < 0.06
    assert droop[:154].max() < 1e-4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"effects": [("rotor.magic", 1.0)]}, "rotor.magic"),
        ({"flights": ["loop"]}, "loop"),
        ({"flights": []}, "empty"),
        ({"speed": -1.0}, "speed"),
        ({"speed": float("nan")}, "speed"),
        ({"height": 0.0}, "height"),
        ({"heading": float("inf")}, "heading"),
    ],
)
def test_bad_requests_are_refused(options, message):
    """One line that names the option."""
    with pytest.raises(InputError, match=message):
        fly(None, **options)


def test_measured_flights_are_not_replaced_by_flown_ones(tmp_path):
    place = small_folder(tmp_path / "mine")
    before = load(place).sha256
    with pytest.raises(InputError, match="is in the way and is not a data set whose description begins with"):
        fly(place, flights=["dbl_lat_p"], seconds=0.1)
    assert load(place).sha256 == before


def test_flown_flights_are_replaced_and_what_was_declared_by_hand_stays(tmp_path):
    place = tmp_path / "set"
    for _ in range(2):
        fly(place, flights=["dbl_lat_p"], seconds=0.1)
        assert {entry.name for entry in place.iterdir()} == {"dataset.toml", "flights", "truth"}
    edited = (place / "dataset.toml").read_text(encoding="utf-8") + "\n# mine\n"
    (place / "dataset.toml").write_text(edited, encoding="utf-8")
    fly(place, flights=["dbl_lat_p"], seconds=0.1, seed=1)
    assert (place / "dataset.before1.toml").read_text(encoding="utf-8") == edited


def test_something_in_the_way_is_refused_and_left_alone(tmp_path):
    """What is not a data set is not overwritten."""
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="in the way"):
        fly(tmp_path / "kept")
    assert [entry.name for entry in (tmp_path / "kept").iterdir()] == ["thesis.txt"]


@pytest.mark.slow
def test_all_flights_in_a_minute(tmp_path):
    """Thirteen flights of 15 s, processor time."""
    import time

    start = time.process_time()
    flown = fly(tmp_path / "all", seed=2)
    assert time.process_time() - start < 60.0
    assert tuple(flown.flights) == FLIGHTS
    data = load(tmp_path / "all")
    assert data.warnings == ()
    for truth in flown.truth.values():
        assert np.abs(truth["phi"]).max() < 0.6
        assert np.abs(truth["theta"]).max() < 0.6
        assert np.abs(truth["psi"]).max() < 0.6
