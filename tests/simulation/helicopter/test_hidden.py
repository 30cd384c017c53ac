"""Every effect does to the aircraft what its name says, and nothing at size zero."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.signal import lsim

from rotorid_torch.data import load
from rotorid_torch.errors import InputError
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.flight.augmentation import design
from rotorid_torch.simulation.flight.linear import linearise
from rotorid_torch.simulation.flight.motion import rates
from rotorid_torch.simulation.flight.sensors import MEASURED, NOISE, true_channels
from rotorid_torch.simulation.flight.simulation import Programme, fly_batch
from rotorid_torch.simulation.flight.trim import find_trim, passage
from rotorid_torch.simulation.flight_test import FlightTest
from rotorid_torch.simulation.helicopter.hidden import HIDDEN, all_mass, differences
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft

AIRCRAFT = load_aircraft()
SECONDS = 1.5  # the stick moves after one


def altered(effect: str, size: float = 1.0):
    """The UH-60 with an effect."""
    return HIDDEN[effect].change(AIRCRAFT, size)


@pytest.fixture(scope="module")
def clean():
    """One short clean flight."""
    return flown()


def flown(*effects: str, flights: tuple[str, ...] = ("dbl_lat_p",), seconds: float = SECONDS, **options):
    """A short flight with effects."""
    test = fly(None, flights=flights, seconds=seconds, effects=[(effect, None) for effect in effects], **options)
    assert isinstance(test, FlightTest)
    return test


def test_every_id_of_a_helicopter_is_there():
    assert len(HIDDEN) == 28
    assert {"control.delay", "mass.slung_load", "sensors.filter", "environment.ground"} <= set(HIDDEN)


def test_gyros_behind_a_filter_of_second_order():
    """What p reads is the response of scipy's own second-order system to the true p; its effect is sensors.filter."""
    hidden = flown("sensors.filter.second_order")
    assert [one["id"] for one in hidden.hidden] == ["sensors.filter"]
    truth = hidden.truth["dbl_lat_p"]
    omega, damping = 25.0, 0.7
    system = ([omega**2], [1.0, 2.0 * damping * omega, omega**2])
    wanted = lsim(system, truth["p"] - truth["p"][0], truth["time"] - truth["time"][0])[1] + truth["p"][0]
    np.testing.assert_allclose(truth["effect_p"], wanted, atol=1e-9)
    assert np.abs(wanted - truth["p"]).max() > 0.01
    with pytest.raises(InputError, match="there twice"):
        flown("sensors.filter", "sensors.filter.second_order")


@pytest.mark.parametrize("effect", HIDDEN)
def test_size_zero_is_the_clean_aircraft(effect, hover):
    """The same rates at the same state to 1e-9, and the same sensors."""
    aircraft = altered(effect, 0.0)
    x = hover.trim.state[:, None] + 0.02 * np.random.default_rng(1).standard_normal((hover.aircraft.states, 3))
    was, _ = rates(hover.aircraft, x, x[12:16])
    now, _ = rates(aircraft, x, x[12:16])
    np.testing.assert_allclose(now, was, rtol=1e-9, atol=1e-9)
    assert aircraft.imu == AIRCRAFT.imu
    assert not any(np.ravel(list(aircraft.sensors.bias.values())))


@pytest.mark.parametrize("effect", HIDDEN)
def test_every_altered_aircraft_trims_and_differs(effect):
    """A periodic flight in hover, which stays where it is; the list of differences is not empty."""
    aircraft = altered(effect)
    changed = differences(AIRCRAFT, aircraft)
    assert changed
    assert differences(AIRCRAFT, altered(effect, 0.5)) != changed
    if all(place.startswith("sensors.") for place in changed):  # it flies as the clean one
        return
    trim = find_trim(aircraft, 0.0)
    assert trim.residual < 1e-8
    after = passage(aircraft, trim.state[:, None])[:, 0]
    np.testing.assert_allclose(after[:20], trim.state[:20], atol=1e-5)


def test_clean_flights_are_what_they_were(clean):
    """Checksum of a clean flight's physics: no effect may touch it."""
    truth = clean.truth["dbl_lat_p"]
    found = [float(np.sum(truth[c] * np.cos(np.arange(len(truth[c]))))) for c in ("u", "p", "theta", "az", "b1")]
    np.testing.assert_allclose(found, CHECKSUM, rtol=1e-8, atol=1e-10)
    assert not [name for name in truth if name.startswith("effect")]


CHECKSUM = [-0.022175097984108626, 0.2267611263747251, -0.026563166742451724, 3.553517776629546, 0.0037135464208863846]


def test_delay_is_between_record_and_swashplate():
    """The angle at the swashplate is the recorded one 60 ms ago; the aircraft answers that much later."""
    truth = flown("control.delay").truth["dbl_lat_p"]
    time, lat = truth["time"], truth["lat"]
    np.testing.assert_allclose(truth["effect_lat"], np.interp(time - 0.06, time, lat), atol=2e-4)
    lags = np.arange(20) / 154.0
    fit = [np.sum((np.interp(time - lag, time, lat) - truth["effect_lat"]) ** 2) for lag in lags]
    assert lags[int(np.argmin(fit))] == pytest.approx(0.06, abs=0.004)


def test_rate_limit_acts_behind_the_record(clean):
    """The record moves faster than the swashplate may, and the aircraft notices."""
    truth, was = flown("control.rate_limit").truth["dbl_lat_p"], clean.truth["dbl_lat_p"]
    assert np.abs(np.diff(truth["effect_lat"])).max() * 154.0 < 0.251
    assert np.abs(np.diff(truth["lat"])).max() * 154.0 > 0.5
    assert np.abs(truth["p"] - was["p"]).max() > 10.0 * NOISE["p"]


def test_payload_is_carried_by_the_collective_and_not_declared(clean):
    """8 % more weight: as much more thrust, by the clean aircraft's own collective; specific force is still g."""
    heavy = flown("mass.payload")
    assert heavy.aircraft.mass - AIRCRAFT.mass == pytest.approx(0.08 * all_mass(AIRCRAFT))
    gain = np.rad2deg(heavy.trim.controls[2] - clean.trim.controls[2])
    assert 0.3 < gain < 1.0
    assert heavy.declaration == clean.declaration
    assert heavy.truth["dbl_lat_p"]["az"][0] == pytest.approx(clean.truth["dbl_lat_p"]["az"][0], abs=0.02)
    weight = all_mass(heavy.aircraft) / all_mass(AIRCRAFT)
    assert weight == pytest.approx(1.08)


def test_centre_of_gravity_tilts_the_aircraft_and_velocity_stays_at_the_declared_point(clean):
    """0.16 m forward: the hub is behind, so the nose hangs lower by about 0.16 / 1.8; v' = v + omega x r holds."""
    moved = flown("mass.cg")
    arm = np.array(AIRCRAFT.rotor.hub) - moved.aircraft.rotor.hub
    np.testing.assert_allclose(arm, [0.02 * 8.178, 0.005 * 8.178, 0.0])
    assert moved.trim.state[7] - clean.trim.state[7] == pytest.approx(-arm[0] / 1.8 / 3.0, abs=0.02)
    vehicle = moved.declaration["vehicle"]
    np.testing.assert_allclose(vehicle["imu"], AIRCRAFT.imu)
    anchored = dataclasses.replace(moved.aircraft, reference=(0.0, 0.0, 0.0))
    record = fly_batch(moved.aircraft, moved.trim, moved.augmentation, Programme(["dbl_lat_p"], 0.1, substeps=1))
    record = dataclasses.replace(record, states=record.states + 0.3)
    at_cg, at_reference = (true_channels(one, record, 0) for one in (anchored, moved.aircraft))
    for name, extra in zip("uvw", np.cross([at_cg["p"][0], at_cg["q"][0], at_cg["r"][0]], -arm), strict=True):
        assert at_reference[name][0] - at_cg[name][0] == pytest.approx(extra)


def test_inertia_slows_the_roll(clean):
    """The first roll acceleration after a step falls nearly as the inertia (with the blades') rises."""
    slow, was = flown("mass.inertia").truth["dbl_lat_p"], clean.truth["dbl_lat_p"]
    assert 0.84 < np.abs(slow["pdot"]).max() / np.abs(was["pdot"]).max() < 0.97


def test_slung_load_swings_at_the_pendulum_frequency():
    """f = sqrt(g (1 + load / aircraft) / cable) / 2 pi, from the linear model's modes of the load."""
    aircraft = altered("mass.slung_load")
    trim = find_trim(aircraft, 0.0)
    load = aircraft.load
    assert load is not None
    expected = np.sqrt(9.80665 * (1.0 + load.mass / all_mass(aircraft)) / load.cable)
    modes = np.linalg.eigvals(linearise(aircraft, trim).full_a)
    swinging = min((mode for mode in modes if mode.imag > 0), key=lambda mode: abs(mode.imag - expected))
    assert swinging.imag == pytest.approx(expected, rel=0.12)
    assert 0.0 < -swinging.real / abs(swinging) < 0.25


def test_slung_load_pulls_with_its_weight(clean):
    """In trim the cable hangs vertically, and the hook carries the load: the same collective as for a payload."""
    carrying = flown("mass.slung_load")
    np.testing.assert_allclose(carrying.truth["dbl_lat_p"]["effect_swing_x"][:100], 0.0, atol=1e-5)
    payload = find_trim(altered("mass.payload"), 0.0)
    assert carrying.trim.controls[2] == pytest.approx(payload.controls[2], abs=2e-4)
    assert np.abs(carrying.truth["dbl_lat_p"]["effect_swing_y"]).max() > 0.001
    assert carrying.declaration == clean.declaration


def test_wind_is_another_trim_on_another_heading():
    """6 m/s from 40 degrees: ahead and to the right at heading zero, from behind the left at 180 degrees."""
    names = ("dbl_lat_p", "dbl_lat_p-180deg", "dbl_lat_p-40deg")
    windy = flown("environment.wind", flights=names, seconds=0.3)
    ahead = [windy.truth[name]["effect_wind_u"][0] for name in names]
    side = [windy.truth[name]["effect_wind_v"][0] for name in names]
    assert ahead == pytest.approx([-4.6, 4.6, -6.0], abs=0.1)
    assert side == pytest.approx([-3.86, 3.86, 0.0], abs=0.3)
    for name in names:
        np.testing.assert_allclose(windy.truth[name]["u"], 0.0, atol=0.02)
    lon = [windy.truth[name]["lon"][0] for name in names]
    assert np.ptp(lon) > 20.0 * NOISE["lon"]
    still = fly(None, flights=names, seconds=0.3)
    assert np.ptp([still.truth[name]["lon"][0] for name in names]) < 1e-9
    assert [still.truth[name]["psi"][0] for name in names] == pytest.approx(np.deg2rad([0.0, 180.0, 40.0]))


def test_turbulence_is_there_before_the_record_begins(hover):
    """Gusts of about 1 m/s move the aircraft from the first sample on."""
    aircraft = altered("environment.turbulence")
    record = fly_batch(
        aircraft, hover.trim, design(hover.linear), Programme(["dbl_lat_p", "f321_lat"], 0.05, 1, substeps=1)
    )
    gust = np.stack([record.hidden[f"effect_wind_{c}"][0] for c in "uvw"])
    assert 0.3 < np.abs(gust).max() < 4.0
    assert np.abs(gust[:, 0] - gust[:, 1]).max() > 0.1
    assert np.abs(record.states[0, :3] - hover.trim.state[:3, None]).max() > 0.05


def test_wind_is_the_same_for_a_rotor_of_the_other_sense(tmp_path):
    """From ahead on the right, in the data set's axes."""
    file = tmp_path / "cw.toml"
    file.write_text('name = "cw"\n[vehicle]\nmass = 6000.0\n[vehicle.rotor]\nradius = 8.0\ndirection = "cw"\n')
    truth = flown("environment.wind", "mass.slung_load", seconds=0.05, vehicle=file, heading=1.0).truth["dbl_lat_p"]
    assert truth["psi"][0] == pytest.approx(1.0)
    level = np.deg2rad(220.0) - 1.0
    assert truth["effect_wind_u"][0] == pytest.approx(6.0 * np.cos(level), abs=0.2)
    assert truth["effect_wind_v"][0] == pytest.approx(6.0 * np.sin(level), abs=0.5)
    assert abs(truth["v"][0]) < 0.01


def test_effects_combine():
    """Delay, lag, play, load, wind, payload and a moved centre of gravity at once: trimmed, and each one there."""
    effects = ("control.delay", "control.lag", "control.backlash", "mass.slung_load", "mass.cg", "mass.payload")
    many = flown(*effects, "environment.wind", "sensors.delay", seconds=0.1)
    assert [one["id"] for one in many.hidden] == [*effects, "environment.wind", "sensors.delay"]
    assert many.trim.residual < 1e-8
    assert {"effect_lat", "effect_swing_x", "effect_wind_u", "effect_p"} <= set(many.truth["dbl_lat_p"])
    load_there = many.aircraft.load
    assert load_there is not None
    np.testing.assert_allclose(load_there.hook, np.add(many.aircraft.reference, (0.0, 0.0, 0.15 * 8.178)))


def test_names_of_data_sets_do_not_tell(tmp_path, clean):
    """The declaration is the clean one, word for word; truth/effects.json has what was hidden, with the sizes."""
    out = tmp_path / "set"
    hidden = fly(out, flights=["dbl_lat_p"], seconds=1.5, effects=[("sensors.bias", 0.5), ("control.delay", None)])
    assert hidden.declaration | {"name": ""} == clean.declaration | {"name": ""}
    told = json.loads((out / "truth" / "effects.json").read_text())["effects"]
    assert [(one["id"], one["size"]) for one in told] == [("sensors.bias", 0.5), ("control.delay", 1.0)]
    assert told[1]["changes"]["path"][1]["delay"] == 0.06
    assert load(out).warnings == ()
    truth = hidden.truth["dbl_lat_p"]
    np.testing.assert_allclose(truth["effect_p"] - truth["p"], 0.005, atol=1e-12)
    assert set(hidden.flights["dbl_lat_p"]) == set(MEASURED)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([("propulsion.motor_lag", 1.0)], "helicopter"),
        ([("neural.forces", 1.0)], "neural"),
        ([("control.delay", -1.0)], "size"),
        ([("control.delay", float("nan"))], "factor"),
        ([("control.delay", 1.0), ("control.delay", 2.0)], "twice"),
    ],
)
def test_bad_effects_are_refused(effects, message):
    """One line."""
    with pytest.raises(InputError, match=message) as caught:
        fly(None, effects=effects)
    assert "\n" not in str(caught.value)
