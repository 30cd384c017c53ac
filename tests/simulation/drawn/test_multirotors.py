"""Drawn multirotors follow a data set's flights with its channels, and have what they are asked to have, no more."""

import numpy as np
import pytest

from rotorid_torch.data import Dataset
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.drawn.multirotor_draws import draw, hovering
from rotorid_torch.simulation.drawn.multirotors import clean_balances, clean_multirotors, undrawable_multirotor
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.measured.fitted import FittedAtStates


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


@pytest.mark.parametrize(
    "effects",
    [
        {"propulsion.rotor_drag": {"x": 0.4, "y": 0.4}},
        {"propulsion.rotor_drag": {"x": 0.4, "y": 0.4}, "environment.wind": {"north": 2.0, "east": -1.0}},
        {"propulsion.motor_lag": {"tau": 0.06}},
        {"control.delay": {"common": 0.03}},
        {"propulsion.axial_inflow": {"z": 0.5}},
        {"forces.drag": {"x": 0.03, "y": 0.03}},
    ],
)
def test_draws_have_the_effects_of_a_model_of_the_data(flown, effects):
    """As identification finds them, which shares no equation with the flights."""
    having = {e: dict.fromkeys("xyz", 0.0) | one if e == "forces.drag" else one for e, one in effects.items()}
    (one,) = clean_multirotors(flown, 0, (0,), having)
    data = at_one_rate(one.dataset)
    found = reconstruct(data)
    fitted = FittedAtStates.of(propose(data, found, ()).with_effects(*effects), Flights(data, found))
    for effect, values in effects.items():
        for name, value in values.items():
            error = 0.1 * abs(value) + 3.0 * fitted.error(f"{effect}.{name}")
            assert error < 1.0 * abs(value), (effect, name)
            assert fitted.values[f"{effect}.{name}"] == pytest.approx(value, abs=error), (effect, name)


def test_a_rotor_of_a_draw_lacks_what_the_model_says(flown):
    """The thrusts in hover balance where the weak rotor's share is missing."""
    hover = hovering(flown)
    less = {"motor1": 0.1, "motor2": 0.0, "motor3": 0.0, "motor4": 0.0}
    clean, weak = (draw(flown, hover, np.random.default_rng(0), one) for one in ({}, {"propulsion.unequal": less}))
    lost = np.array(weak.lifts) / np.array(clean.lifts)
    assert lost[1:] == pytest.approx(1.0)
    assert 0.8 < lost[0] < 0.9  # less thrust makes less inflow, so that lift falls by more than thrust does
    assert draw(flown, hover, np.random.default_rng(0), {"my.effect": {"k": 1.0}}) == clean


def test_a_load_below_a_draw_is_as_large_as_the_model_says(flown):
    values = {"ratio": 0.03, "length": 2.0, "damping": 0.1, "hook": 0.02}
    (clean, loaded) = (
        draw(flown, hovering(flown), np.random.default_rng(0), one) for one in ({}, {"mass.slung_load": values})
    )
    load = loaded.load
    assert load is not None
    assert (load.mass / clean.mass, load.cable, load.damping) == pytest.approx((0.03, 2.0, 0.1))
    assert np.subtract(load.hook, clean.reference) == pytest.approx((0.0, 0.0, 0.02))
    assert loaded.mass == clean.mass
