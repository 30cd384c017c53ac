"""Typical mistakes with data sets, runs and models: each is answered in one line that names the argument."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

import rotorid_torch as rotorid
from rotorid_torch.data import Dataset
from rotorid_torch.model.model import Model
from tests.known_models import flown, manoeuvres, rate_vehicle
from tests.mistakes import one_line

DT = 0.04
Row = tuple[str, dict[str, Any], str]


def ids(table: list[Row]) -> list[str]:
    return [row[0] for row in table]


@pytest.fixture(scope="module")
def data() -> Dataset:
    lists = {"identify": ["f_lon", "f_lat", "f_col"], "validate": ["f_ped"]}
    return flown(rate_vehicle(), manoeuvres(6.0, DT), DT, noise=0.02, lists=lists)


@pytest.fixture(scope="module")
def model() -> Model:
    return rate_vehicle()


TIME = 0.02 * np.arange(200)
CHANNELS: dict[str, Any] = {"time": TIME, "lon": 0.02 * np.sin(TIME)} | dict.fromkeys("pqr", 0.1 * np.cos(TIME))


def with_flight(**change: Any) -> dict[str, Any]:
    return {"flights": {"f1": CHANNELS | change}}


def without(channel: str) -> dict[str, Any]:
    return {"flights": {"f1": {k: v for k, v in CHANNELS.items() if k != channel}}}


ARRAYS: list[Row] = [
    ("a list for the dict of flights", {"flights": [CHANNELS]}, "flights"),
    ("None for flights", {"flights": None}, "flights"),
    ("channels themselves for flights", {"flights": CHANNELS}, "flights"),
    ("an array for a flight", {"flights": {"f1": np.zeros((200, 5))}}, "f1"),
    ("None for a flight", {"flights": {"f1": None}}, "f1"),
    ("no time", without("time"), "time"),
    ("no control", without("lon"), "controls"),
    ("None for a channel", with_flight(q=None), "q"),
    ("numbers beyond all floats", with_flight(q=[10**400] * 200), "q | no"),
    ("text for a channel", with_flight(q="rate"), "q"),
    ("complex rates", with_flight(q=CHANNELS["q"] + 0j), "q"),
    ("a column for a record", with_flight(q=CHANNELS["q"][:, None]), "q"),
    ("a record too short", with_flight(q=CHANNELS["q"][:-1]), "q"),
    ("ragged samples", with_flight(q=[[0.0], [0.0, 1.0]]), "q"),
    ("an infinite rate", with_flight(q=np.where(TIME > 1.0, math.inf, 0.0)), "q"),
    ("time runs back", with_flight(time=TIME[::-1]), "time"),
    ("NaN in time", with_flight(time=np.where(TIME > 1.0, math.nan, TIME)), "time"),
    ("one sample", {"flights": {"f1": {key: value[:1] for key, value in CHANNELS.items()}}}, "time"),
    ("a single name for a list", {"identify": "f1"}, "identify"),
    ("None for a list", {"identify": None}, "identify"),
    ("nothing to identify", {"identify": []}, "identify"),
    ("a flight that there is not", {"identify": ["f2"]}, "flights"),
    ("a number for a name", {"identify": [1]}, "identify"),
    ("a flight in two lists", {"validate": ["f1"]}, "validate"),
    ("an unknown kind", {"kind": "glider"}, "kind"),
    ("None for a name", {"name": None}, "name"),
    ("a list for the vehicle", {"vehicle": [1.0]}, "vehicle"),
    ("a key that no vehicle has", {"vehicle": {"weight": 1.0}}, "vehicle"),
    ("mass in words", {"vehicle": {"mass": "heavy"}}, "mass"),
    ("a list for the controls", {"controls": ["lon"]}, "controls"),
    ("a unit that there is not", {"controls": {"lon": {"unit": "deg"}}}, "unit"),
    ("a sparse record", with_flight(q=torch.zeros(200).to_sparse()), "q | .to_dense()"),
    ("noise below zero", {"channels": {"q": {"noise": -1.0}}}, "noise"),
]


@pytest.mark.parametrize("row", ARRAYS, ids=ids(ARRAYS))
def test_from_arrays(row: Row) -> None:
    given: dict[str, Any] = {"flights": {"f1": CHANNELS}, "identify": ["f1"]} | row[1]
    one_line(lambda: Dataset.from_arrays(**given), row[2])


def test_flights_of_a_data_set_make_another() -> None:
    first = Dataset.from_arrays({"f1": CHANNELS, "f2": CHANNELS}, identify=["f1", "f2"])
    second = Dataset.from_arrays({"f2": first["f2"]}, identify=["f2"])
    assert second["f2"]["q"].equal(first["f2"]["q"])


def test_what_pandas_writes_for_a_missing_value_is_one() -> None:
    class NAType:
        """As pandas has it."""

    made = Dataset.from_arrays({"f1": CHANNELS | {"q": [*CHANNELS["q"][:-1], NAType()]}}, identify=["f1"])
    assert made["f1"]["q"].isnan().nonzero().tolist() == [[199]]


def test_what_is_done_to_a_channel_leaves_the_flight_as_it_was() -> None:
    flight = Dataset.from_arrays({"f1": CHANNELS}, identify=["f1"])["f1"]
    was = flight["q"].clone()
    flight["q"].mul_(2.0)
    flight.to_numpy()["q"] *= 2.0
    flight.arrays(controls=["lon"], outputs=["q"])["time"].mul_(2.0)
    assert flight["q"].equal(was)
    assert float(flight["time"][-1]) == pytest.approx(3.98)


@pytest.mark.parametrize("function", [rotorid.identify, rotorid.close_loop, rotorid.reconstruct])
def test_a_multirotor_without_motors_is_refused(function: Any) -> None:
    flights = {name: CHANNELS | {"lon": 0.02 * np.sin(k * TIME)} for k, name in ((1.0, "f1"), (2.0, "f2"))}
    drone = Dataset.from_arrays(flights, identify=["f1"], validate=["f2"], kind="multirotor")
    assert rotorid.check(drone).grade == "not usable"
    if function is not rotorid.reconstruct:
        one_line(lambda: function(drone), 'motor1 | "helicopter"')
    else:
        made = function(drone)
        assert len(repr(made)) + len(repr(made["f1"])) <= 2000
        with pytest.raises(KeyError, match="no flight 'f3', but f1, f2"):
            made.arrays("f3")


def test_motors_that_turn_nothing_are_refused() -> None:
    rng = np.random.default_rng(0)
    rates = {rate: 0.1 * rng.standard_normal(200) for rate in "pqr"}
    motors = {f"motor{k}": 0.5 + 0.02 * np.sin(k * TIME) for k in (1, 2, 3)}
    flights = dict.fromkeys(("f1", "f2"), {"time": TIME} | motors | rates)
    drone = Dataset.from_arrays(flights, identify=["f1"], validate=["f2"], kind="multirotor")
    one_line(lambda: rotorid.identify(drone), " | tell no parameter")


PLACES: list[tuple[str, Any]] = [
    ("None", None),
    ("a number", 1),
    ("a list", ["DATASET"]),
    ("a dict", {"f1": CHANNELS}),
    ("no such folder", "no/such/folder"),
    ("a file that there is not", Path("no/such/dataset.toml")),
    ("empty text", ""),
    ("a zero byte", "a\0b"),
    ("a tensor", torch.zeros(3)),
    ("bytes", b"DATASET"),
]


@pytest.mark.parametrize("row", PLACES, ids=[row[0] for row in PLACES])
@pytest.mark.parametrize("function", ["load", "open_run"])
def test_places(row: tuple[str, Any], function: str) -> None:
    one_line(lambda: getattr(rotorid, function)(row[1]), "")


SIMULATE: list[Row] = [
    ("None for a model", {"model": None}, "model"),
    ("a module of torch", {"model": nn.Linear(1, 1)}, "model"),
    ("the class", {"model": Model}, "model"),
    ("no such model", {"model": "no/such/model.pt"}, "model.pt"),
    ("a dict for a model", {"model": {}}, "model"),
    ("a number for a model", {"model": 3}, "model"),
    ("None for a flight", {"flight": None}, "flight"),
    ("a name for a flight", {"flight": "f_ped"}, "flight"),
    ("arrays for a flight", {"flight": CHANNELS}, "flight"),
    ("the data set for a flight", {"flight": "DATA"}, "flight"),
    ("None for start", {"start": None}, "start"),
    ("start in words", {"start": "1 s"}, "start"),
    ("NaN for start", {"start": math.nan}, "start"),
    ("start before the flight", {"start": -1.0}, "start"),
    ("start beyond the flight", {"start": 100.0}, "start"),
    ("no seconds", {"seconds": 0.0}, "seconds"),
    ("negative seconds", {"seconds": -1.0}, "seconds"),
    ("NaN seconds", {"seconds": math.nan}, "seconds"),
    ("seconds in words", {"seconds": "8 s"}, "seconds"),
    ("a list of seconds", {"seconds": [1.0, 2.0]}, "seconds"),
    ("a path for the data", {"data": "DATASET"}, "data"),
    ("a dict for the data", {"data": {}}, "data"),
]


@pytest.mark.parametrize("row", SIMULATE, ids=ids(SIMULATE))
def test_simulate(row: Row, data: Dataset, model: Model) -> None:
    given: dict[str, Any] = {"model": model, "flight": data["f_ped"], "data": data} | row[1]
    given = {key: data if isinstance(value, str) and value == "DATA" else value for key, value in given.items()}
    one_line(lambda: rotorid.simulate(**given), row[2])


def test_simulate_a_model_in_single_precision(data: Dataset) -> None:
    one_line(lambda: rotorid.simulate(rate_vehicle().float(), data["f_ped"], data=data), "model | model.double()")


def test_simulate_where_a_control_was_not_recorded(data: Dataset, model: Model) -> None:
    """It was held at its next value, seconds later."""
    flight = data["f_ped"]
    lost = replace(flight, channels={**flight.channels, "ped": flight["ped"].where(flight.time > 2.0, math.nan)})
    one_line(lambda: rotorid.simulate(model, lost, seconds=1.5, data=data), "ped | control is missing")
    assert float(rotorid.simulate(model, lost, seconds=2.5, data=data)["time"][-1]) == pytest.approx(2.5, abs=DT)


def test_masked_samples_are_missing_samples() -> None:
    """The numbers behind a mask were taken for samples."""
    hidden = np.ma.masked_where(TIME < 1.0, np.where(TIME < 1.0, 0.7, CHANNELS["p"]))
    masked = Dataset.from_arrays({"f1": CHANNELS | {"p": hidden}}, identify=["f1"])["f1"]["p"].numpy()
    assert np.array_equal(np.isnan(masked), TIME < 1.0)


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_free_runs_in_half_precision(half: torch.dtype, data: Dataset, model: Model) -> None:
    """A model's numbers with three digits fly 0.4 % off."""
    flight, body = data["f_ped"], torch.zeros(3)
    one_line(lambda: rate_vehicle().to(half).free_run(flight, 0.0, 1.0), "model | float64 or float32")
    one_line(lambda: model.free_run(flight, 0.0, 1.0, x0=body.to(half)), f"x0 | holds numbers of {half}")
    one_line(lambda: model.free_run(flight, torch.tensor([1.3]).to(half), 1.0), "start | float64 or float32")


@pytest.mark.parametrize("kind", [np.float32, torch.float32])
def test_free_runs_from_states_in_single_precision_are_those_in_double(kind: Any, data: Dataset, model: Model) -> None:
    body = [0.25, -0.125, 0.5]
    x0: Any = np.array(body, dtype=kind) if kind is np.float32 else torch.tensor(body, dtype=kind)
    runs = [model.free_run(data["f_ped"], 0.0, 1.0, x0=start).states for start in (x0, torch.tensor(body).double())]
    torch.testing.assert_close(*runs, rtol=0.0, atol=0.0)


def test_a_flight_that_was_changed_flies_as_it_is(data: Dataset, model: Model) -> None:
    def turned(flight: rotorid.Flight) -> rotorid.Flight:
        return replace(flight, channels={**flight.channels, "ped": -flight["ped"]})

    free = rotorid.simulate(model, turned(data["f_ped"]), data=data)
    of_all = data.changed(turned)
    for name, values in rotorid.simulate(model, of_all["f_ped"], data=of_all).items():
        np.testing.assert_array_equal(free[name], values)
    assert abs(free["r"] - rotorid.simulate(model, data["f_ped"], data=data)["r"]).max() > 0.1
    short = replace(data["f_ped"], channels={**data["f_ped"].channels, "ped": data["f_ped"]["ped"][:-1]})
    one_line(lambda: rotorid.simulate(model, short, data=data), "ped")


def test_a_model_of_the_package_is_a_model_for_the_estimators(data: Dataset, model: Model) -> None:
    flight = data["f_lon"].arrays(model.body.controls, model.body.outputs, [0.0] * len(model.layout))
    found = rotorid.output_error(model, [flight], free=["forces.M.q"], max_iterations=1)
    assert math.isfinite(found["M.q"].value)


VALUES: list[Row] = [
    ("NaN", {"forces.L.p": math.nan}, "start_from: forces.L.p | is nan"),
    ("infinity", {"forces.L.p": math.inf}, "start_from: forces.L.p | a number"),
    ("a value in words", {"forces.L.p": "large"}, "start_from: forces.L.p | a number"),
    ("a list for a value", {"forces.L.p": [1.0, 2.0]}, "start_from: forces.L.p | a number"),
    ("a parameter that there is not", {"forces.L.P": -3.0}, "start_from: forces.L.P | did you mean 'forces.L.p'?"),
    ("the last parts of a name", {"L.p": -3.0}, "start_from: L.p | did you mean 'forces.L.p'?"),
    ("an empty name", {"": -3.0}, "start_from | no such parameter"),
]


@pytest.mark.parametrize("row", VALUES, ids=ids(VALUES))
def test_values_that_a_model_cannot_start_from(row: Row) -> None:
    model = rate_vehicle()
    before = model.named_values
    one_line(lambda: model.start_from(row[1]), row[2])
    one_line(lambda: model.start_from({"forces.M.q": -3.0, **row[1]}), row[2])
    assert model.named_values == before


def test_what_is_no_table_of_values() -> None:
    one_line(lambda: rate_vehicle().start_from([1.0]), "start_from: values")  # pyright: ignore[reportArgumentType]


def test_simulate_without_the_controls_of_the_model(data: Dataset, model: Model) -> None:
    poor = Dataset.from_arrays({"f1": CHANNELS}, identify=["f1"])
    one_line(lambda: rotorid.simulate(model, poor["f1"], seconds=1.0), "lat")
    one_line(lambda: rotorid.simulate(model, poor["f1"], seconds=1.0, data=data), "flight")


RUNS: list[Row] = [
    ("a path for the data", {"dataset": "DATASET"}, "dataset"),
    ("None for the data", {"dataset": None}, "dataset"),
    ("a dict for the data", {"dataset": {"f1": CHANNELS}}, "dataset"),
    ("a list for the data", {"dataset": [CHANNELS]}, "dataset"),
    ("the class", {"dataset": Dataset}, "dataset"),
    ("seed in words", {"seed": "one"}, "seed"),
    ("None for the seed", {"seed": None}, "seed"),
    ("half a seed", {"seed": 0.5}, "seed"),
    ("a negative seed", {"seed": -1}, "seed"),
    ("a seed as a float", {"seed": 1.0}, "seed"),
    ("a seed as a float of NumPy", {"seed": np.float64(1.0)}, "seed"),
    ("a list for the seed", {"seed": [1]}, "seed"),
    ("True for the seed", {"seed": True}, "seed"),
    ("True of NumPy for the seed", {"seed": np.True_}, "seed"),
    ("True of torch for the seed", {"seed": torch.tensor(True)}, "seed"),
    ("a seed of twenty digits", {"seed": 10**19}, "seed"),
    ("an unknown device", {"device": "tpu"}, "device"),
    ("None for the device", {"device": None}, "device"),
    ("a number for the device", {"device": 0}, "device"),
    ("a number for out", {"out": 3}, "out"),
    ("a list for out", {"out": ["RUN"]}, "out"),
    ("a function for a monitor", {"monitor": print}, "monitor"),
    ("a word for a monitor", {"monitor": "quiet"}, "monitor"),
    ("the class Monitor", {"monitor": "MONITOR"}, "monitor"),
    ("a number for ranks", {"ranks": 2}, "ranks"),
    ("None for ranks", {"ranks": None}, "ranks"),
]
IDENTIFY: list[Row] = [
    ("a single name for effects", {"effects": "control.delay"}, "effect"),
    ("an unknown effect", {"effects": ["control.dely"]}, "effect"),
    ("an effect twice", {"effects": ["control.delay", "control.delay"]}, "effect"),
    ("a class for effects", {"effects": rotorid.Effect}, "effect"),
    ("a class in effects", {"effects": [rotorid.Effect]}, "effects | the class Effect"),
    ("None for effects", {"effects": None}, "effect"),
    ("an unknown method", {"method": "least-squares"}, "method"),
    ("None for the method", {"method": None}, "method"),
    ("a word for resume", {"resume": "yes"}, "resume"),
    ("nothing to resume", {"resume": True, "out": None}, "resume"),
]
CLOSE_LOOP: list[Row] = [
    ("a word for hybrid", {"hybrid": "yes"}, "hybrid"),
    ("None for hybrid", {"hybrid": None}, "hybrid"),
]


@pytest.mark.parametrize("row", RUNS + IDENTIFY, ids=ids(RUNS + IDENTIFY))
def test_identify(row: Row, data: Dataset) -> None:
    one_line(lambda: rotorid.identify(**_with(data, row)), row[2])


def test_names_of_a_generator_are_read_once(data: Dataset) -> None:
    effects: Any = (name for name in ["control.dely"])
    one_line(lambda: rotorid.identify(data, effects=effects), "control.dely | did you mean")


@pytest.mark.parametrize("row", RUNS + CLOSE_LOOP, ids=ids(RUNS + CLOSE_LOOP))
def test_close_loop(row: Row, data: Dataset) -> None:
    one_line(lambda: rotorid.close_loop(**_with(data, row)), row[2])


def _with(data: Dataset, row: Row) -> dict[str, Any]:
    from rotorid_torch.run.output.monitor import Monitor

    given: dict[str, Any] = {"dataset": data} | row[1]
    return given | ({"monitor": Monitor} if given.get("monitor") == "MONITOR" else {})


@pytest.mark.parametrize("wrong", ["DATASET", None, {"f1": CHANNELS}, [1], Dataset])
def test_check(wrong: Any) -> None:
    one_line(lambda: rotorid.check(wrong), "dataset")
    one_line(lambda: rotorid.reconstruct(wrong), "dataset")


FLY: list[Row] = [
    ("a number for out", {"out": 3}, "out"),
    ("speed in words", {"speed": "fast"}, "speed"),
    ("NaN for speed", {"speed": math.nan}, "speed"),
    ("a speed that nothing reaches", {"speed": 900.0}, "speed"),
    ("None for heading", {"heading": None}, "heading"),
    ("height below ground", {"height": -1.0}, "height"),
    ("height infinite", {"height": math.inf}, "height"),
    ("no seconds", {"seconds": 0.0}, "seconds"),
    ("a list of seconds", {"seconds": [8.0]}, "seconds"),
    ("seconds that no memory holds", {"seconds": 1e9}, "seconds"),
    ("seed in words", {"seed": "one"}, "seed"),
    ("half a seed", {"seed": 0.5}, "seed"),
    ("a flight that there is not", {"flights": ["f321_long"]}, "flights"),
    ("a single name for flights", {"flights": "f321_lon"}, "flights"),
    ("a number for flights", {"flights": 3}, "flights"),
    ("no such vehicle", {"vehicle": "no/such/file.toml"}, "file.toml"),
    ("a dict for a vehicle", {"vehicle": {}}, "vehicle"),
    ("an effect that there is not", {"effects": [("control.dely", 1.0)]}, "effect"),
    ("a single name for effects", {"effects": "control.delay"}, "effects"),
    ("a size in words", {"effects": [("control.delay", "large")]}, "effects"),
    ("an effect twice", {"effects": ["control.delay", "control.delay"]}, "effect"),
]
IMPORT: list[Row] = [
    ("None for logs", {"paths": None}, "paths"),
    ("a number for a log", {"paths": [3]}, "paths"),
    ("no log", {"paths": []}, ""),
    ("no such log", {"paths": ["no/such/flight.ulg"]}, "flight.ulg"),
    ("None for out", {"out": None}, "out"),
    ("rate in words", {"rate": "fast"}, "rate"),
    ("a rate below zero", {"rate": -1.0}, "rate"),
    ("a word for split", {"split": "yes"}, "split"),
]


@pytest.mark.parametrize("row", FLY, ids=ids(FLY))
def test_fly(row: Row) -> None:
    given: dict[str, Any] = {"out": None, "flights": ["f321_lon"], "seconds": 2.0} | row[1]
    one_line(lambda: rotorid.fly(**given), row[2])


@pytest.mark.parametrize("row", IMPORT, ids=ids(IMPORT))
def test_import_log(row: Row, tmp_path: Path) -> None:
    given: dict[str, Any] = {"paths": ["flight.ulg"], "out": tmp_path / "DATASET"} | row[1]
    one_line(lambda: rotorid.import_log(**given), row[2])
