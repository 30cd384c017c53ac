"""Drawn multirotors follow a data set's flights with its channels, and have what they are asked to have, no more."""

import numpy as np
import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.drawn.multirotors import clean_balances, clean_multirotors, undrawable_multirotor


@pytest.fixture(scope="module")
def flown() -> Dataset:
    """A vehicle with drag, a lag and a gap in a channel; rates of 100 Hz."""
    effects = [("propulsion.rotor_drag", 1.0), ("propulsion.motor_lag", 1.0)]
    flights = ["roll_p", "eight_p", "mixed_n"]
    made = fly(None, vehicle="multirotor-2", flights=flights, effects=effects, seconds=8.0)
    made.flights["roll_p"]["q"][100:120] = np.nan
    return made.dataset()


@pytest.fixture(scope="module")
def drawn(flown):
    return list(clean_multirotors(flown, 0, (0, 1)))


def channel(dataset, flight, name):
    return dataset.flights[flight].channels[name].numpy()


def test_draws_have_the_flights_lists_channels_and_gaps_of_the_data(flown, drawn):
    assert [one.number for one in drawn] == [0, 1]
    for one in drawn:
        data = one.dataset
        assert (data.identify, data.validate, data.acid) == (flown.identify, flown.validate, flown.acid)
        for name, flight in flown.flights.items():
            assert set(data.flights[name].channels) == set(flight.channels)
            np.testing.assert_allclose(data.flights[name].time, flight.time)
        assert np.isnan(channel(data, "roll_p", "q")[100:120]).all()
        assert [m.position for m in data.vehicle.motors] == [m.position for m in flown.vehicle.motors]
        np.testing.assert_allclose(channel(data, "eight_p", "voltage"), channel(flown, "eight_p", "voltage"), rtol=1e-6)


def test_draws_follow_the_motion(flown, drawn):
    for one in drawn:
        assert one.alike
        for flight, name in (("roll_p", "p"), ("eight_p", "u"), ("eight_p", "height"), ("mixed_n", "az")):
            ours, theirs = channel(one.dataset, flight, name), channel(flown, flight, name)
            assert np.std(ours - theirs) < 0.5 * np.std(theirs), (flight, name)


def test_draws_are_clean(drawn):
    """No drag: nothing of ax goes with u; the declared curve tells the thrust at once."""
    for one in drawn:
        data = one.dataset
        u, ax = channel(data, "eight_p", "u"), channel(data, "eight_p", "ax")
        assert abs(np.polyfit(u, ax, 1)[0]) < 0.03
        m = np.stack([channel(data, "mixed_n", f"motor{k + 1}") for k in range(4)])
        curve = [motor.thrust for motor in data.vehicle.motors]
        thrust = sum(np.polynomial.polynomial.polyval(m[k], curve[k]) for k in range(4)) / data.vehicle.mass
        assert np.std(channel(data, "mixed_n", "az") + thrust) < 0.25


def test_balance_of_a_draw_is_that_of_its_flights(flown, drawn):
    """Mean thrusts by the common curve, of flights that turn little on average."""
    places = np.array([m.position[:2] for m in flown.vehicle.motors])
    spins = np.array([1.0 if m.spin == "ccw" else -1.0 for m in flown.vehicle.motors])
    for one, balance in zip(drawn, clean_balances(flown, 0, (0, 1)), strict=True):
        curve = one.dataset.vehicle.motors[0].thrust
        m = np.stack([channel(one.dataset, "eight_p", f"motor{k + 1}") for k in range(4)])
        thrust = np.polynomial.polynomial.polyval(m, curve).mean(axis=1)
        centre = np.concatenate([places.T, spins[None]]) @ thrust / thrust.sum()
        np.testing.assert_allclose(centre[:2], balance[:2], atol=2e-4)
        assert centre[2] == pytest.approx(balance[2], abs=0.01)
        assert np.abs(balance).max() > 1e-3


def test_a_draw_depends_on_its_number_alone(flown, drawn):
    (alone,) = clean_multirotors(flown, 0, (1,))
    np.testing.assert_array_equal(channel(alone.dataset, "roll_p", "p"), channel(drawn[1].dataset, "roll_p", "p"))
    assert np.nanstd(channel(drawn[0].dataset, "roll_p", "p") - channel(drawn[1].dataset, "roll_p", "p")) > 1e-3


def test_flights_of_rates_and_accelerations_alone_are_followed(flown):
    """No attitude, velocity or place, no voltage; of a declared speed the rotors turn as fast."""
    keep = ("time", "p", "q", "r", "az", *flown.controls)
    flights = {
        name: {c: v.numpy() for c, v in {"time": f.time, **f.channels}.items() if c in keep}
        for name, f in flown.flights.items()
    }
    bare = Dataset.from_arrays(
        flights, identify=flown.identify, validate=flown.validate, kind="multirotor", vehicle=flown.vehicle
    )
    (one,) = clean_multirotors(bare, 0, (0,))
    ours, theirs = channel(one.dataset, "mixed_n", "az"), channel(bare, "mixed_n", "az")
    assert np.std(ours - theirs) < 0.6 * np.std(theirs)
    assert np.std(channel(one.dataset, "roll_p", "p") - channel(bare, "roll_p", "p")) < 0.5 * np.std(
        channel(bare, "roll_p", "p")
    )


def test_what_lacks_places_cannot_be_drawn(flown):
    bare = Dataset.from_arrays(
        {name: {c: v.numpy() for c, v in {"time": f.time, **f.channels}.items()} for name, f in flown.flights.items()},
        identify=flown.identify,
        kind="multirotor",
    )
    assert undrawable_multirotor(flown) is None
    assert undrawable_multirotor(bare) == "the places of the motors are not declared"
    with pytest.raises(ValueError, match="places of the motors"):
        next(clean_multirotors(bare, 0, (0,)))
