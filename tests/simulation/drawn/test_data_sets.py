"""Drawn clean aircraft: repeatable, as noisy as the data set, near its motion, and refused where they make no sense."""

import msgspec
import numpy as np
import pytest

from rotorid_torch.data import Dataset, load
from rotorid_torch.data.schema import Rotor, Vehicle
from rotorid_torch.data.write import declared_by
from rotorid_torch.errors import InputError
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.drawn.data_sets import Drawn, clean_flights, undrawable
from rotorid_torch.simulation.drawn.resemblance import Recorded, look
from rotorid_torch.simulation.drawn.tracking import tapes
from rotorid_torch.simulation.flight.sensors import MIRRORED
from rotorid_torch.simulation.multiblade.priors import numbers
from tests.helpers import shared, small_arrays

FLIGHTS = ("f321_lon", "f321_lat", "f321_col", "f321_ped")


@pytest.fixture(scope="module")
def flown():
    """The UH-60's four 3-2-1-1 flights, 6 s each."""
    return fly(None, flights=FLIGHTS, seconds=6.0).dataset()


@pytest.fixture(scope="module")
def drawn(flown):
    """Two drawn aircraft."""
    return list(clean_flights(flown, 1, [0, 1]))


def mirrored(dataset: Dataset) -> Dataset:
    """The same flights of the mirrored aircraft, whose rotor turns clockwise."""
    flights = {
        name: {c: (-v if c in MIRRORED else v).numpy() for c, v in flight.channels.items()}
        for name, flight in dataset.flights.items()
    }
    vehicle = {"mass": dataset.vehicle.mass, "mass_excludes": ["blades"], "hub": dataset.vehicle.hub}
    rotor = dataset.vehicle.rotor
    assert rotor is not None
    declared = {key: getattr(rotor, key) for key in rotor.__struct_fields__} | {"direction": "cw"}
    vehicle |= {"inertia": dataset.vehicle.inertia, "rotor": declared, "air_density": dataset.vehicle.air_density}
    return Dataset.from_arrays(
        flights,
        identify=dataset.identify,
        vehicle=vehicle | {"imu": dataset.vehicle.imu, "gravity": dataset.vehicle.gravity},
        controls=dict(dataset.control_specs),
        channels=dict(dataset.channel_specs),
    )


def apart(one: Drawn, other: Drawn) -> float:
    """Rms of the roll rate by which two aircraft differ in one flight, over that of its noise."""
    p, q = (draw.dataset.flights["f321_lon"].channels["p"] for draw in (one, other))
    return float((p - q).std()) / 2.0**0.5 / one.dataset.noise("p")


def test_draws_resemble_the_data_set(flown, drawn):
    """They are told to, and the derivatives of their own noisy flights do: most within twice what counts as alike."""
    evidence = look(flown)
    for draw in drawn:
        assert draw.alike
        off = np.abs(look(draw.dataset).table - evidence.table) / evidence.tolerance
        asked = np.isfinite(evidence.tolerance)
        assert np.mean(off[asked] < 2.0) > 0.85
        for angle in ("phi", "theta"):
            assert draw.dataset.reference()[angle] == pytest.approx(flown.reference()[angle], abs=0.05)
        for control in flown.controls:
            assert draw.dataset.reference()[control] == pytest.approx(flown.reference()[control], abs=2e-3)


def test_draws_stay_near_the_measured_motion(flown, drawn):
    """Rms of the difference below 0.4 of the channel's own, and yet more than two noises: it is another aircraft."""
    for draw in drawn:
        for channel in ("u", "v", "w", "p", "q", "r", "phi", "theta", "lon", "lat", "col", "ped"):
            off = [
                (draw.dataset.flights[name].channels[channel] - flown.flights[name].channels[channel]).numpy()
                for name in flown.flights
            ]
            moved = np.concatenate([part - part[:77].mean() for part in off])
            assert np.sqrt(np.mean(moved**2)) < 0.4 * flown.scales()[channel]
            if channel == "r":
                assert np.std(moved) > 1.8 * flown.noise("r")


def test_flights_at_several_speeds_start_from_trims_of_their_own():
    """As near as flights at one speed; controls differ from speed to speed by the drawn aircraft's own trims."""
    flown = fly(None, flights=("f321_lat", "dbl_lat_p-20mps"), seconds=6.0).dataset()
    draw = next(clean_flights(flown, 1, [0]))
    for channel in ("u", "v", "w", "p", "q", "r", "phi", "theta"):
        pairs = [(draw.dataset.flights[n].channels[channel], flown.flights[n].channels[channel]) for n in flown.flights]
        off = np.concatenate([(own - own[:77].mean() - measured + measured[:77].mean()) for own, measured in pairs])
        moved = np.concatenate([measured - measured[:77].mean() for _, measured in pairs])
        assert np.sqrt(np.mean(off**2)) < 0.4 * np.sqrt(np.mean(moved**2)) + 2.0 * flown.noise(channel), channel
    for one in (flown, draw.dataset):
        hover, fast = (one.flights[n].channels["lon"][:77].mean() for n in one.flights)
        assert abs(float(fast - hover)) > 0.01


def starting(u: float, p: float = 0.0, **other: float) -> Recorded:
    """A flight at 50 Hz that starts so."""
    channels = {name: np.zeros(200) for name in ("v", "w", "q", "r", "phi", "theta", "lon", "lat", "col", "ped")}
    channels |= {"u": np.full(200, u), "p": np.full(200, p)} | {name: np.full(200, v) for name, v in other.items()}
    return Recorded(0.02, 200, channels)


@pytest.mark.parametrize("speeds", [(0.0, 3.8, 1.8, 20.0), (20.0, 1.8, 3.8, 0.0), (1.8, 0.0, 20.0, 3.8)])
def test_which_flights_start_from_one_trim_does_not_depend_on_their_order(speeds):
    tape = tapes([starting(u) for u in speeds], {"u": 5.0})
    found = {u: round(own["u"], 9) for u, own in zip(speeds, tape.trims, strict=True)}
    assert found == {0.0: 0.9, 1.8: 0.9, 3.8: 3.8, 20.0: 20.0}


def test_a_flight_that_starts_turning_keeps_its_deviation_from_the_nearest_trim():
    flights = [starting(0.0), starting(20.0), starting(4.0, p=0.5, psi=1.0), starting(0.1)]
    tape = tapes(flights, {"u": 5.0})
    assert tape.trims[2] == tape.trims[0] == tape.trims[3]
    assert tape.motion[0, :, 2] == pytest.approx([3.95, 0.0, 0.0, 0.5, *5 * [0.0]])


def test_all_flights_start_from_the_data_sets_trim_where_they_start_alike():
    trim = {"u": 0.3}
    assert all(own is trim for own in tapes([starting(0.0), starting(1.0), starting(9.0, p=0.5)], trim).trims)


def test_padding_is_no_motion():
    short = starting(0.0, theta=0.3)
    longer = Recorded(0.02, 2000, {name: np.repeat(v, 10) for name, v in starting(0.0).channels.items()})
    assert tapes([short, longer], {"theta": 0.0}).sizes[7] == pytest.approx(0.3 * np.sqrt(200 / 2200))


def test_form_and_noise_are_the_data_sets(flown, drawn):
    """The same lists, channels, samples, declaration; white noise of the declared size."""
    for draw in drawn:
        other = draw.dataset
        assert (other.identify, other.validate, other.acid) == (flown.identify, flown.validate, flown.acid)
        assert other.vehicle == flown.vehicle
        for name, flight in flown.flights.items():
            assert set(other.flights[name].channels) == set(flight.channels)
            assert other.flights[name].samples == flight.samples
        for channel in ("u", "p", "phi", "ax", "a1", "height"):
            quiet = np.concatenate([np.diff(flight.channels[channel][:100]) for flight in other.flights.values()])
            assert np.std(quiet) / np.sqrt(2.0) == pytest.approx(flown.noise(channel), rel=0.15)


def test_a_draw_depends_on_its_number_and_seed_alone(flown, drawn):
    """The second draw alone is the second of two; the first is another aircraft."""
    alone = next(iter(clean_flights(flown, 1, [1])))
    for name, flight in drawn[1].dataset.flights.items():
        for channel, values in flight.channels.items():
            np.testing.assert_allclose(alone.dataset.flights[name].channels[channel], values, rtol=1e-4, atol=1e-4)
    assert apart(*drawn) > 1.5


def test_a_clockwise_rotor_is_drawn_in_the_mirror(flown, drawn):
    """From the mirrored flights come the mirrored draws (the noise goes into the fit: not to the last digit)."""
    other = next(iter(clean_flights(mirrored(flown), 1, [0])))
    for name, flight in drawn[0].dataset.flights.items():
        for channel in ("p", "v", "q", "r", "lat"):
            sign = -1.0 if channel in MIRRORED else 1.0
            scale = flown.scales()[channel]
            off = sign * other.dataset.flights[name].channels[channel] - flight.channels[channel]
            level = off - off[:77].mean()
            assert float((level**2).mean().sqrt()) < 0.2 * scale, (name, channel)


def test_gaps_stay_gaps(flown, drawn):
    """Missing samples are missing in the draws; another seed is another aircraft."""
    flights = {name: {c: v.numpy().copy() for c, v in f.channels.items()} for name, f in flown.flights.items()}
    flights["f321_lon"]["q"][200:240] = np.nan
    tables = {"controls": dict(flown.control_specs), "channels": dict(flown.channel_specs)}
    gappy = Dataset.from_arrays(flights, identify=flown.identify, vehicle=flown.vehicle, **tables)
    draw = next(iter(clean_flights(gappy, 2, [0])))
    missing = draw.dataset.flights["f321_lon"].channels["q"].isnan()
    assert missing.sum() == 40
    assert missing[200:240].all()
    assert apart(draw, drawn[0]) > 1.5


def test_what_cannot_be_drawn_is_refused_in_words():
    """Missing controls."""
    dataset = Dataset.from_arrays(small_arrays(), identify=["one", "two", "three"])
    assert undrawable(dataset) == "the controls lack col, ped"
    with pytest.raises(InputError, match="the controls lack col, ped"):
        next(iter(clean_flights(dataset, 0, [0])))


def declaring(dataset: Dataset, **vehicle: object) -> Dataset:
    """The same flights, of whose vehicle only this is declared."""
    flights = {
        name: {c: v.numpy() for c, v in flight.channels.items()} | {"time": flight.time.numpy()}
        for name, flight in dataset.flights.items()
    }
    return Dataset.from_arrays(flights, **declared_by(dataset) | {"vehicle": vehicle})


@pytest.mark.parametrize("vehicle", [{"mass": 7257.0}, {"rotor": {"radius": 8.178, "direction": "cw"}}, {}])
def test_a_size_that_is_not_declared_is_drawn(flown, vehicle):
    """Aircraft alike in trim and derivatives, as far apart in size as helicopters of one size are."""
    cw = "rotor" in vehicle
    draws = list(clean_flights(declaring(mirrored(flown) if cw else flown, **vehicle), 1, [0, 1]))
    assert [draw.alike for draw in draws] == [True, True]
    drawn = numbers(msgspec.convert(vehicle, Vehicle), 0.0)
    assert drawn["radius"].value == pytest.approx(8.178, rel=0.03)
    assert drawn["inertia11"].spread > 0.1


@pytest.mark.parametrize(("mass", "radius"), [(2200.0, 4.912), (1157.0, 4.013), (2793.0, 7.24), (15000.0, 11.0)])
def test_mass_and_radius_of_known_helicopters_lie_within_two_spreads(mass, radius):
    """Bo 105, OH-6A, UH-1H and CH-53 by one of the two: R goes with the cube root of m."""
    by_mass = numbers(Vehicle(mass=mass), 0.0)["radius"]
    by_radius = numbers(Vehicle(rotor=Rotor(radius=radius)), 0.0)["mass"]
    assert abs(np.log(radius / by_mass.value)) < 2.0 * by_mass.spread
    assert abs(np.log(mass / by_radius.value)) < 2.0 * by_radius.spread


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uh60-hover", "uh60-60kt", "ah1-hover", "uh60b-hover"])
def test_other_peoples_helicopters_are_drawn(name):
    """Aircraft of four other simulators: alike in trim and derivatives, near their motion."""
    dataset = load(shared("flightdata", name))
    for draw in clean_flights(dataset, 0, range(3)):
        for channel in ("u", "v", "w", "p", "q", "r", "phi", "theta"):
            ratio = draw.dataset.scales()[channel] / dataset.scales()[channel]
            assert 0.7 < ratio < 1.4, channel
