"""Channels that never change are left out and told, or refused where a step needs them; what may rest is kept."""

import numpy as np
import pytest

from rotorid_torch import cli
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.core import names
from rotorid_torch.data import Dataset
from rotorid_torch.data.reading.dead import STEADY
from rotorid_torch.errors import InputError
from rotorid_torch.report.remarks import of_reading
from rotorid_torch.run import pipeline
from tests.helpers import small_arrays, small_folder

MEASURED = [n for n in (*names.CHANNELS, "omega1") if n != "time" and not names.is_control(n)]
LEFT_OUT = [n for n in MEASURED if n not in names.RATES]
LISTS = {"identify": ["one", "two"], "validate": ["three"]}


def flights_with(channel):
    """Three noisy flights that all have this channel, which moves in them."""
    arrays = small_arrays()
    for seed, flight in enumerate(arrays.values()):
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(len(flight["time"]))
        flight.setdefault(channel, 0.3 + 0.1 * np.sin(flight["time"]) + noise)
    return arrays


def still(arrays, channel, flights=("one", "two", "three"), value=0.3):
    for name in flights:
        arrays[name][channel] = np.full(len(arrays[name]["time"]), value)
    return Dataset.from_arrays(arrays, **LISTS)


@pytest.mark.parametrize("channel", MEASURED)
def test_nothing_is_dead_where_everything_moves(channel):
    assert Dataset.from_arrays(flights_with(channel), **LISTS).dead == ()


@pytest.mark.parametrize("value", [0.0, 0.3, -1.0])
@pytest.mark.parametrize("channel", LEFT_OUT)
def test_a_channel_that_never_changes_is_as_if_it_were_not_recorded(channel, value):
    arrays = flights_with(channel)
    without = Dataset.from_arrays({n: {c: v for c, v in f.items() if c != channel} for n, f in arrays.items()}, **LISTS)
    dataset = still(arrays, channel, value=value)
    assert [(one.channel, one.everywhere) for one in dataset.dead] == [(channel, True)]
    assert dataset.scales() == without.scales()
    assert {*dataset.facts["three"].channels} == {*without.facts["three"].channels}
    assert all(channel not in flight.channels for flight in dataset.flights.values())
    told = [f for f in check(dataset).findings if f.channel == channel and "never changes" in f.sentence]
    assert [f.severity for f in told] == ["warning"]
    assert sum(s.startswith(f"{channel} never changes in the identify flights") for s in of_reading(dataset)) == 1


@pytest.mark.parametrize("flights", [("one", "two", "three"), ("one", "two"), ("two",), ("three",)])
@pytest.mark.parametrize("rate", names.RATES)
def test_a_dead_rate_is_an_error(rate, flights, tmp_path):
    dataset = still(flights_with(rate), rate, flights)
    first = flights[0]
    with pytest.raises(InputError, match=rf"flight {first}: {rate}: never changes: dead, or not connected; expected"):
        pipeline.identify(dataset, out=tmp_path / "run")
    assert not list(tmp_path.iterdir())
    found = check(dataset)
    assert not found.fit
    assert [(f.flight, f.channel) for f in found.of("error")] == [(first, rate)]
    assert not [f for f in found.of("warning") if f.channel == rate]  # the error says it


@pytest.mark.parametrize("channel", LEFT_OUT)
def test_a_channel_that_is_still_in_all_identify_flights_tells_nothing_to_identify_from(channel):
    dataset = still(flights_with(channel), channel, ("one", "two"))
    assert [(one.channel, one.everywhere) for one in dataset.dead] == [(channel, True)]
    assert not dataset.facts["three"].has(channel)


@pytest.mark.parametrize("channel", LEFT_OUT)
def test_a_channel_that_dies_in_one_flight_is_left_out_there(channel):
    dataset = still(flights_with(channel), channel, ("two",))
    assert [(one.channel, one.everywhere, one.flights) for one in dataset.dead] == [(channel, False, ("two",))]
    assert [dataset.facts[name].has(channel) for name in ("one", "two", "three")] == [True, False, True]
    assert any(s.startswith(f"{channel} never changes in two") for s in of_reading(dataset))


def test_each_flight_may_have_its_own_constant():
    arrays = flights_with("u")
    for level, flight in enumerate(arrays.values()):
        flight["u"] = np.full(400, 10.0 * level)
    assert [one.channel for one in Dataset.from_arrays(arrays, **LISTS).dead] == ["u"]


def test_the_rounding_of_a_constant_is_no_change():
    arrays = flights_with("theta")
    for flight in arrays.values():
        flight["theta"] = 0.1 + 1e-17 * np.arange(400) + np.where(np.arange(400) % 2, 2e-17, 0.0)
        flight["theta"][7] = np.nextafter(0.1, 1.0)
    assert [one.channel for one in Dataset.from_arrays(arrays, **LISTS).dead] == ["theta"]


@pytest.mark.parametrize("channel", [*STEADY, "omega1"])
def test_a_simulator_s_steady_channel_that_differs_from_flight_to_flight_is_kept(channel):
    arrays = flights_with(channel)
    for level, flight in enumerate(arrays.values(), 1):
        flight[channel] = np.full(400, 0.25 * level)
    dataset = Dataset.from_arrays(arrays, **LISTS)
    assert dataset.dead == ()
    assert dataset.facts["two"].has(channel)


def test_a_record_without_noise_may_rest_in_a_flight_that_moves_another_axis():
    time = 0.02 * np.arange(400)
    pulse = np.where((time > 1.0) & (time < 3.0), np.sin(np.pi * (time - 1.0)), 0.0)
    rest = np.zeros(400)

    def flight(axis):
        moved = {"lat": ("lat", "p", "phi", "v"), "lon": ("lon", "q", "theta", "u"), "ped": ("ped", "r", "psi")}
        channels = dict.fromkeys(("lat", "lon", "ped", "p", "q", "r", "phi", "theta", "psi", "u", "v"), rest)
        return {"time": time} | channels | dict.fromkeys(moved[axis], 0.1 * pulse)

    flights = {axis: flight(axis) for axis in ("lat", "lon", "ped")}
    dataset = Dataset.from_arrays(flights, identify=["lat", "lon", "ped"])
    assert dataset.dead == ()
    dataset.require_rates()


def test_a_control_may_rest():
    arrays = small_arrays()
    arrays["two"]["lat"] = np.zeros(400)
    dataset = Dataset.from_arrays(arrays, **LISTS)
    assert dataset.dead == ()
    assert check(dataset).fit


def zeros(arrays):
    return {n: {c: v if c == "time" else 0.0 * v for c, v in f.items()} for n, f in arrays.items()}


def constant_controls(arrays):
    return {n: f | {c: np.full(400, 0.1) for c in ("lat", "lon")} for n, f in arrays.items()}


def ten_samples(arrays):
    return {n: {c: v[:10] for c, v in f.items()} for n, f in arrays.items()}


def ten_slow_samples(arrays):
    return {n: f | {"time": 0.5 * np.arange(10)} for n, f in ten_samples(arrays).items()}


def rates_of_ten_samples(arrays):
    return {n: f | {"p": np.where(np.arange(400) < 10, f["p"], np.nan)} for n, f in arrays.items()}


def no_rates(arrays):
    return {n: {c: v for c, v in f.items() if c not in names.RATES} for n, f in arrays.items()}


def dead_q(arrays):
    return {n: f | {"q": np.full(400, 0.02)} for n, f in arrays.items()}


UNFIT = {
    zeros: {"p", "q", "r"},
    constant_controls: {"lat", "lon"},
    ten_samples: {"time"},
    ten_slow_samples: {"lat", "lon"},
    rates_of_ten_samples: {"p"},
    no_rates: {"p", "q", "r"},
    dead_q: {"q"},
}


@pytest.mark.parametrize("spoil", UNFIT)
@pytest.mark.parametrize("kind", ["helicopter", "multirotor"])
def test_what_identify_refuses_is_not_fit(spoil, kind, tmp_path):
    arrays = spoil(small_arrays())
    if kind == "multirotor":
        arrays = {
            n: {c.replace("lat", "motor1").replace("lon", "motor2"): v for c, v in f.items()} for n, f in arrays.items()
        }
    dataset = Dataset.from_arrays(arrays, **LISTS, kind=kind)
    found = check(dataset)
    assert not found.fit
    renamed = {"lat": "motor1", "lon": "motor2"} if kind == "multirotor" else {}
    assert {f.channel for f in found.of("error")} & {renamed.get(c, c) for c in UNFIT[spoil]}
    with pytest.raises(InputError):
        pipeline.identify(dataset, out=tmp_path / "run")


@pytest.mark.parametrize("spoil", UNFIT)
def test_check_exits_with_3_where_a_set_is_not_fit(spoil, tmp_path, capsys):
    folder = small_folder(tmp_path / "small")
    assert cli.main(["check", str(folder)]) == 0
    for name, arrays in spoil(small_arrays()).items():
        np.savez(folder / "flights" / f"{name}.npz", **arrays)
    capsys.readouterr()
    assert cli.main(["check", str(folder), "--out", str(tmp_path / "run")]) == 3
    said = capsys.readouterr()
    assert "not usable" in said.out.splitlines()[0]
    assert said.err == ""
    assert (tmp_path / "run" / "check.json").exists()
