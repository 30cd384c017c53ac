"""Values that no aircraft has: refused where they are declared, missing samples or an error where they are recorded."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rotorid_torch as rotorid
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.core.ranges import CHANNELS, DECLARED, OTHER, of_channel
from rotorid_torch.data import Dataset, load
from rotorid_torch.data.declare import declare
from rotorid_torch.errors import InputError
from tests.helpers import small_flight, small_folder, small_toml

SAMPLES = 400
MEMBERS = {"motorN": "motor3", "omegaN": "omega3"}
RECORDED = [
    (MEMBERS.get(name, name), row.samples.unit)
    for row in CHANNELS
    for name in row.names
    if name != "time" and row.noise
]
FEW = {"max_examples": 8, "deadline": None, "derandomize": True}


def outside(allowed):
    """Finite numbers outside a range, from just beyond its ends to the largest double."""
    above = st.floats(min_value=1.001 * allowed.high + 1e-6, max_value=1.7e308)
    lowest = allowed.low - 0.001 * abs(allowed.low) - 1e-12
    below = st.floats(min_value=-1.7e308, max_value=lowest)
    between = [] if allowed.low <= 0.0 else [st.floats(min_value=1e-300, max_value=0.999 * allowed.low)]
    zero = [] if allowed.holds(0.0) else [st.just(0.0)]
    return st.one_of(above, below, *between, *zero).filter(lambda value: not allowed.holds(value))


def declared(key, value):
    """A document that declares one number of the vehicle, as the key says."""
    if key == "vehicle.inertia":
        return {"inertia": np.diag([value] * 3).tolist()}
    names, motor = key.split(".")[1:], {"position": [0.1, 0.0, 0.0], "spin": "ccw"}
    if names[0] == "motors":
        held = [0.1, 0.0, value] if names[1] != "torque_ratio" else value
        return {"motors": [motor | {names[1]: held}]}
    if names[0] == "rotor":
        return {"rotor": {names[1]: round(value) if names[1] == "blades" else value}}
    return {names[0]: [0.0, value, 0.0] if names[0] in ("hub", "imu") else value}


def refusal(vehicle=None, controls=None, channels=None):
    document = {"format": 1, "kind": "helicopter", "flights": {"identify": ["f"]}}
    tables = {"vehicle": vehicle, "controls": controls, "channels": channels}
    with pytest.raises(InputError) as caught:
        declare(document | {name: table for name, table in tables.items() if table}, "dataset.toml")
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize("key", DECLARED)
@settings(**FEW)
@given(data=st.data())
def test_a_declared_number_outside_its_range_is_refused(key, data):
    value = data.draw(outside(DECLARED[key]))
    if key == "vehicle.rotor.blades" and DECLARED[key].holds(round(value)):
        return
    told = refusal(vehicle=declared(key, value))
    assert told.key.startswith(key) or told.key.startswith("vehicle.motors[0]")
    assert key.split(".")[-1] in told.key
    unit = DECLARED[key].unit
    assert unit in told.expected or "positive" in told.expected


@pytest.mark.parametrize(("name", "unit"), RECORDED)
@settings(**FEW)
@given(data=st.data())
def test_noise_outside_its_range_is_refused(name, unit, data):
    row = of_channel(name, unit)
    value = data.draw(outside(row.noise))
    table, spec = (
        ("controls", {"unit": unit}) if row.samples.unit and name in (*CONTROLS, "motor3") else ("channels", {})
    )
    told = refusal(**{table: {name: spec | {"noise": value}}})
    assert told.key == f"{table}.{name}.noise"
    assert told.expected == str(row.noise)


CONTROLS = ("lon", "lat", "col", "ped")


@pytest.mark.parametrize("unit", ["rad", "m", "norm"])
@settings(**FEW)
@given(data=st.data())
def test_limits_outside_the_control_s_range_are_refused(unit, data):
    value = data.draw(outside(of_channel("lat", unit).samples))
    limits = sorted((value, 0.0))
    assert refusal(controls={"lat": {"unit": unit, "limits": limits}}).key == "controls.lat.limits"


INERTIAS = {
    "beyond the mass": (np.diag([5e5, 2e6, 1.8e6]), "radius of gyration"),
    "of a point": (np.diag([5e-5, 2e-4, 1.8e-4]), "radius of gyration"),
    "beyond the rotor": (np.diag([5e5, 5e5, 5e5]), "radius of gyration"),
    "flat beyond a plate": (np.diag([500.0, 2000.0, 2600.0]), "no body has this"),
    "negative": (np.diag([500.0, -2000.0, 1800.0]), "positive"),
    "of product only": (np.array([[500.0, -1500.0, 0.0], [-1500.0, 600.0, 0.0], [0.0, 0.0, 1000.0]]), "positive"),
    "1e300": (np.diag([1e300] * 3), "principal moments"),
    "1.7e308": (np.full((3, 3), 1.7e308), "principal moments"),
    "1e-300": (np.diag([1e-300] * 3), "principal moments"),
}


@pytest.mark.parametrize("case", INERTIAS)
def test_an_inertia_that_no_body_of_this_mass_and_size_has_is_refused(case):
    inertia, words = INERTIAS[case]
    told = refusal(vehicle={"mass": 1000.0, "inertia": inertia.tolist(), "rotor": {"radius": 5.0}})
    assert told.key == "vehicle.inertia"
    assert words in str(told)


def test_a_rotor_speed_in_rpm_is_refused():
    told = refusal(vehicle={"rotor": {"radius": 8.18, "speed": 258.0}})
    assert told.key == "vehicle.rotor.speed"
    assert "tip speed of 2110 m/s" in told.wrong


@pytest.mark.parametrize(
    ("thrust", "speeds"), [([0.0, 0.0, 1e-300], False), ([0.0, 0.0, 50.0], False), ([0.0, 0.0, 1.2], True)]
)
def test_motors_that_cannot_lift_their_vehicle_are_refused(thrust, speeds):
    time = 0.01 * np.arange(SAMPLES)
    motors = {f"motor{k}": 0.4 + 0.1 * np.sin(k * time) for k in (1, 2)}
    omegas = {f"omega{k}": 2000.0 + 100.0 * np.sin(k * time) for k in (1, 2)} if speeds else {}
    vehicle = {"mass": 0.03, "motors": [{"position": [0.0, y, 0.0], "spin": "cw", "thrust": thrust} for y in (-1, 1)]}
    flights = {"f": {"time": time, **motors, **omegas}}
    with pytest.raises(InputError, match=r"vehicle.motors.thrust: make .* times the weight"):
        Dataset.from_arrays(flights, identify=["f"], kind="multirotor", vehicle=vehicle)


def flight_with(name, unit):
    """A small flight with this channel, and its own units of the controls."""
    flight = small_flight(SAMPLES)
    row = of_channel(name, unit)
    middle, size = 0.5 * (row.samples.low + row.samples.high), min(row.samples.high - row.samples.low, 2.0)
    flight.setdefault(name, middle + 0.1 * size * np.sin(flight["time"]))
    specs = {name: {"unit": unit}} if name in CONTROLS else {}
    kind = "multirotor" if name == "motor3" else "helicopter"
    return flight, {"identify": ["f"], "controls": specs, "kind": kind}


@pytest.mark.parametrize(("name", "unit"), RECORDED)
@settings(**FEW)
@given(data=st.data())
def test_few_impossible_samples_are_missing_with_their_number(name, unit, data):
    flight, given = flight_with(name, unit)
    at = data.draw(st.lists(st.integers(0, SAMPLES - 1), min_size=1, max_size=4, unique=True))
    flight[name][at] = [data.draw(outside(of_channel(name, unit).samples).filter(lambda v: v != 0.0)) for _ in at]
    dataset = Dataset.from_arrays({"f": flight}, **given)
    assert np.flatnonzero(dataset.flights["f"].channels[name].isnan().numpy()).tolist() == sorted(at)
    told = [w for w in dataset.warnings if w.startswith(f"flight f: {name} reaches")]
    count = "1 sample " if len(at) == 1 else f"{len(at)} samples "
    assert len(told) == 1
    assert count in told[0]
    assert told[0].endswith("taken as missing samples")


@pytest.mark.parametrize(("name", "unit"), RECORDED)
@settings(**FEW)
@given(data=st.data())
def test_many_impossible_samples_are_an_error(name, unit, data):
    flight, given = flight_with(name, unit)
    value = data.draw(outside(of_channel(name, unit).samples).filter(lambda v: v != 0.0))
    flight[name][: data.draw(st.integers(5, SAMPLES))] = value
    with pytest.raises(
        InputError, match=rf"^arrays: flight f: {name}: reaches .* of {SAMPLES} samples outside"
    ) as caught:
        Dataset.from_arrays({"f": flight}, **given)
    assert str(of_channel(name, unit).samples) in str(caught.value)


@pytest.mark.parametrize("value", [1e30, 1.7e308, -1.7e308])
def test_channels_of_other_names_do_not_overflow(value):
    flight = small_flight(SAMPLES) | {"mine": np.sin(0.02 * np.arange(SAMPLES))}
    flight["mine"][7] = value
    dataset = Dataset.from_arrays({"f": flight}, identify=["f"])
    assert float(dataset.flights["f"].channels["mine"].nan_to_num(0.0).abs().max()) <= OTHER.samples.high
    assert check(dataset).findings


def test_check_tells_of_impossible_samples_in_their_channel():
    flight = small_flight(SAMPLES)
    flight["theta"][[100, 200]] = 1e30
    found = check(Dataset.from_arrays({"f": flight}, identify=["f"])).findings
    assert [(f.severity, f.channel) for f in found if "2 samples outside -1.58 to 1.58 rad" in f.sentence] == [
        ("warning", "theta")
    ]


def test_files_are_cleaned_like_arrays_and_again_when_they_are_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr("rotorid_torch.data.on_demand.BUDGET", 1)  # only the flight read last stays in memory
    folder, arrays = small_folder(tmp_path / "small"), small_flight(SAMPLES)
    arrays["lat"][100], arrays["u"][200] = 1e30, 1.7e308
    (folder / "dataset.toml").write_text(small_toml().replace("[controls.lon]", '[controls.lon]\nunit = "norm"'))
    arrays["lon"] = 5.0 * np.sin(arrays["time"])
    np.savez(folder / "flights" / "one.npz", **arrays)
    dataset = load(folder)
    channels = dataset.flights["one"].channels
    assert [int(channels[name].isnan().sum()) for name in ("lat", "u", "lon")] == [1, 1, 0]


def table(**changed):
    flight = small_flight(600, 0.01)
    columns = {name: flight[name] for name in ("time", "lat", "lon", "p", "q", "r", "phi", "theta", "psi")} | changed
    columns["lat"] = columns["lat"] + 0.1 * np.sin(columns["time"])
    return columns


def csv(file, columns):
    rows = np.stack(list(columns.values()), axis=1)
    file.write_text(",".join(columns) + "\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist()))
    return file


@pytest.mark.parametrize(
    ("name", "unit"), [("vn", "m/s"), ("ve", "m/s"), ("q0", ""), ("latitude", "rad"), ("p", "rad/s")]
)
@pytest.mark.parametrize("value", [1e37, 1.3e8, -1e300])
def test_what_import_makes_channels_of_has_ranges_too(tmp_path, name, unit, value):
    columns = table()
    time, quaternion = columns["time"], name.startswith("q0")
    extra = {"vn": np.sin(time), "ve": np.cos(time), "vd": 0.1 * np.sin(3 * time)}
    extra |= {"latitude": 0.8 + 1e-7 * time, "longitude": 0.1 + 1e-7 * time}
    extra |= {f"q{k}": np.cos(0.1 * time) if k == 0 else np.sin(0.1 * time) / math.sqrt(3) for k in range(4)}
    columns |= extra
    columns[name] = columns[name].copy()
    columns[name][[100, 300]] = value
    given = {c: {"field": c} for c in columns if c != "time" and not (quaternion and c in ("phi", "theta", "psi"))}
    done = rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set", mapping={"channels": given})
    assert [w for w in done.warnings if f"{name} reaches" in w and "2 samples outside" in w]
    channels = rotorid.load(done.folder).flights["f"].channels
    worst = max(
        float(v.nan_to_num(0.0).abs().max()) for c, v in channels.items() if c in "u v w phi theta psi p".split()
    )
    assert worst < 20.0
    columns[name][:50] = value
    with pytest.raises(InputError, match=rf"\({name}\): reaches .* of 600 samples outside"):
        rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set2", mapping={"channels": given})
    assert not (tmp_path / "set2").exists()


def test_a_motor_of_1e8_in_a_log_is_missing(tmp_path):
    time = table()["time"]
    columns = table() | {f"motor{k}": 0.5 + 0.1 * np.sin(k * time) for k in (1, 2, 3, 4)}
    columns = {name: values for name, values in columns.items() if name not in CONTROLS}
    columns["motor2"][[50, 51]] = 1.3e8
    done = rotorid.import_log(csv(tmp_path / "f.csv", columns), tmp_path / "set")
    assert [w for w in done.warnings if "motor2 reaches 1.3e+08 norm: 2 samples outside -1.5 to 1.5 norm" in w]
    assert float(rotorid.load(done.folder).flights["f"].channels["motor2"].nan_to_num(0.0).max()) < 1.0
