"""Telemetry spikes leave on reading, motion stays, and neither check nor a fit is spoilt by them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch.consistency.examination.records import condensed
from rotorid_torch.data import Dataset, load
from rotorid_torch.data.reading.spikes import spikes, without_spikes
from rotorid_torch.run.pipeline import identify
from rotorid_torch.simulation import fly
from tests.helpers import shared, shared_sets, small_flight

TIME = 0.01 * np.arange(2000)


@given(st.integers(0, 1999), st.integers(1, 3), st.sampled_from([1e5, -1e5, 40.0]))
def test_a_spike_is_found_wherever_it_is(at, length, size):
    x = np.sin(TIME) + 0.01 * np.random.default_rng(0).standard_normal(2000)
    at = min(at, 2000 - length)
    x[at : at + length] = size
    assert spikes("p", x, TIME).tolist() == list(range(at, at + length))


def test_motion_noise_steps_and_last_digits_are_no_spikes():
    rng = np.random.default_rng(1)
    step = np.where(TIME > 7.0, 1.0, 0.0)
    digit = np.where(np.arange(2000) == 900, 3.71, 3.72)
    tap = np.where((TIME > 5.0) & (TIME < 5.04), 1.0, 0.0)
    for x in (rng.standard_normal(2000), rng.standard_t(4, 2000), step, digit, tap, np.zeros(2000), TIME % 2.0):
        assert not len(spikes("p", x, TIME))
    heading = np.angle(np.exp(1j * (np.pi + 0.1 * np.sin(TIME))))
    assert not len(spikes("psi", heading, TIME))


def test_many_are_no_spikes_but_another_fault():
    x = np.sin(TIME)
    x[::50] = 1e5
    assert not len(spikes("p", x, TIME))


def test_missing_samples_stay_and_the_sentence_names_the_spike():
    x = np.sin(TIME)
    x[100:120], x[1500] = np.nan, -1e5
    found, told = without_spikes({"time": TIME, "p": x})
    assert np.flatnonzero(np.isnan(found["p"])).tolist() == [*range(100, 120), 1500]
    assert x[1500] == -1e5
    assert told == ["p has a spike of up to -1e+05 (-1 to 1 rad/s otherwise) from 15.00 s on: taken as missing samples"]


def test_a_data_set_with_spikes_reads_and_tells_each_once():
    flight = small_flight()
    flight["p"][200], flight["psi"][100], flight["lat"][300] = 90.0, 1e4, 1e5
    dataset = Dataset.from_arrays({"a": flight, "b": flight}, identify=["a", "b"])
    told = condensed([w for w in dataset.warnings if "taken as missing" in w])
    assert [sentence.split()[0] for _, sentence in told] == ["lat", "p", "psi"]
    assert all(sentence.endswith("(likewise in b)") for _, sentence in told)
    assert abs(dataset.scales()["p"]) < 1.0
    assert float(dataset.flights["a"].channels["psi"].nan_to_num(0.0).abs().max()) < 0.1


@pytest.mark.parametrize("name", shared_sets())
def test_shared_sets_hold_the_three_known_spikes_and_no_other(name):
    told = [w for w in load(shared("flightdata", name)).warnings if "taken as missing" in w]
    assert ["chirp_3: omega1 reaches 33036 rad/s: 3 samples" in w for w in told] == (
        [True] if name == "nanodrone" else []
    )


@pytest.mark.slow
def test_spikes_do_not_spoil_the_fit(tmp_path):
    fly(tmp_path / "flown", seed=3, flights=("dbl_lon_p", "dbl_lat_p", "dbl_col_p", "dbl_ped_p", "dbl_lon_n"))
    clean = load(tmp_path / "flown")
    flights = {n: {c: v.numpy().copy() for c, v in f.channels.items()} for n, f in clean.flights.items()}
    flights["dbl_lat_p"]["p"][700], flights["dbl_lon_p"]["lon"][300], flights["dbl_lon_p"]["theta"][400] = 1e5, 7, -3e3
    flights["dbl_col_p"]["az"][500:502], flights["dbl_ped_p"]["psi"][300] = -1e5, 1e4
    declared = {"vehicle": clean.vehicle, "controls": clean.control_specs, "channels": clean.channel_specs}
    lists = {"identify": clean.identify, "validate": clean.validate, "acid": clean.acid}
    spoilt = identify(Dataset.from_arrays(flights, **lists, **declared, model=clean.settings))
    assert sum("taken as missing" in w for w in spoilt.record.warnings) == 5
    for a, b in zip(identify(clean).parameters, spoilt.parameters, strict=True):
        assert a.name == b.name
        if a.se:
            assert abs(a.value - b.value) < 0.1 * a.se
