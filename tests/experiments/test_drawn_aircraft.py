"""Drawn aircraft and causes outside the library: the same again, declared truthfully, changed only as they say."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from rotorid_torch.simulation import fly
from rotorid_torch.simulation.flight.manoeuvres import Condition
from rotorid_torch.simulation.flight.simulation import Programme, fly_batch
from rotorid_torch.simulation.flight_test import load_aircraft
from rotorid_torch.simulation.helicopter.aircraft import CONTROLS, RATES
from rotorid_torch.simulation.multirotor.vehicles import multirotor


def test_flying_with_the_recorded_angles_is_flying(tmp_path: Path) -> None:
    causes, drawn = import_module("hidden.outside_causes"), import_module("hidden.drawn_aircraft")
    aircraft, names = load_aircraft(), ("f321_lat", "dbl_col_p")
    trims, gains = drawn._prepared(aircraft, [Condition(0.0, 27.4, 0.0)] * 2, 1.0)
    usual = fly_batch(aircraft, trims, gains, Programme(names, 0.5))
    own = causes.fly_with(aircraft, trims, gains, names, 0.5, lambda time, x, trimmed: x[CONTROLS])
    np.testing.assert_allclose(own.states, usual.states, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(own.specific_force, usual.specific_force, rtol=1e-12, atol=1e-12)


def test_outside_causes_change_only_what_they_say() -> None:
    causes = import_module("hidden.outside_causes")
    aircraft = load_aircraft()
    x, trimmed = np.zeros((aircraft.states, 2)), np.full((4, 2), 0.1)
    x[CONTROLS], x[RATES.start] = 0.12, 0.2
    slipped = causes.CAUSES["outside.slipped_control"].at_blades(0, aircraft, 1.0)
    np.testing.assert_array_equal(slipped(5.9, x, trimmed), x[CONTROLS])
    low, high = aircraft.limits[1]
    np.testing.assert_allclose(slipped(6.1, x, trimmed)[1], 0.11 + causes.SLIP * (high - low))
    np.testing.assert_array_equal(slipped(6.1, x, trimmed)[[0, 2, 3]], x[CONTROLS][[0, 2, 3]])
    product = causes.CAUSES["outside.product"].at_blades(0, aircraft, 1.0)
    np.testing.assert_allclose(product(1.0, x, trimmed)[3], 0.12 + causes.PICKED_UP * 0.02 * 0.2)
    np.testing.assert_array_equal(product(1.0, x, trimmed)[:3], x[CONTROLS][:3])


def test_drawn_aircraft_are_the_same_again_and_declare_themselves(tmp_path: Path) -> None:
    drawn = import_module("hidden.drawn_aircraft")
    first, second = drawn.draw(0, 7, tmp_path), drawn.draw(1, 7, tmp_path)
    assert first == drawn.draw(0, 7, tmp_path)
    assert first.vehicle["vehicle"]["mass"] != second.vehicle["vehicle"]["mass"]
    flown = drawn.fly_drawn(first, ("sensors.bias",), 2.0, ("dbl_lat_p",), 3, tmp_path, seconds=2.0)
    assert flown.declaration["vehicle"]["mass"] == pytest.approx(first.vehicle["vehicle"]["mass"])
    assert flown.declaration["channels"]["p"]["noise"] == pytest.approx(0.002 * first.noise)
    measured, right = flown.measured["dbl_lat_p"], flown.right["dbl_lat_p"]
    np.testing.assert_allclose(measured["p"] - right["p"], 0.02, atol=1e-9)
    np.testing.assert_array_equal(measured["phi"], right["phi"])
    assert np.std(measured["q"][:150]) == pytest.approx(0.002 * first.noise, rel=0.3)
    folder = flown.write(tmp_path / "set")
    assert not (folder / "truth").exists()


def test_wakes_blow_down_three_times_with_twice_the_induced_velocity_of_hover() -> None:
    wakes = import_module("hidden.wakes")
    craft, time = multirotor("quad"), np.arange(-3.0, 12.0, 0.01)
    air = wakes._passes(craft, "hover", time, 5)
    induced = np.sqrt(craft.mass * craft.gravity / (2.0 * craft.air_density * craft.count * craft.propeller.disc))
    starts = np.flatnonzero(np.diff((air[:, 2] > 0.0).astype(int)) == 1)
    assert len(starts) == 3
    assert time[starts[0]] >= 0.0
    np.testing.assert_allclose(air[:, 2].max(), 2.0 * induced, rtol=1e-3)
    assert (air[:, 2] > 0.0).sum() * 0.01 <= 1.52


def test_flights_are_calm_again_behind_wakes() -> None:
    wakes, felt = import_module("hidden.wakes"), [("propulsion.axial_inflow", 1.0)]
    flying = dict(vehicle="quad", flights=("hover_p",), effects=felt, seconds=2.0, seed=1)
    calm = fly(None, **flying).dataset().to_numpy()
    with wakes.wakes(2.0):
        disturbed = fly(None, **flying).dataset().to_numpy()
    again = fly(None, **flying).dataset().to_numpy()
    assert all(np.array_equal(calm[name]["az"], again[name]["az"]) for name in calm)
    assert any(np.abs(calm[name]["az"] - disturbed[name]["az"]).max() > 0.5 for name in calm)
