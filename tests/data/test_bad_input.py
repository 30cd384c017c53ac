"""Every bad input is an InputError of one line: file, channel or key, what is wrong, what was expected."""

import io
import tomllib
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorid_torch.data import Dataset, load
from rotorid_torch.errors import InputError
from tests.helpers import small_arrays, small_flight, small_folder, small_toml


@pytest.fixture
def folder(tmp_path):
    return small_folder(tmp_path / "small")


def refused(folder, *words):
    with pytest.raises(InputError) as caught:
        load(folder)
    line = str(caught.value)
    assert "\n" not in line
    assert "; expected " in line
    for word in words:
        assert word in line, line


DECLARATIONS = {
    "broken": ("format = 1", "format = = 1", ["dataset.toml", "not TOML"]),
    "other format": ("format = 1", "format = 2", ["format: is 2", "expected 1"]),
    "no format": ("format = 1\n", "", ["format: is missing"]),
    "unknown kind": ('"helicopter"', '"balloon"', ["kind: is 'balloon'", "'helicopter' or 'multirotor'"]),
    "unknown key": ("mass = 1000.0", "mas = 1000.0", ["vehicle.mas: unknown key", "did you mean 'mass'"]),
    "unknown key at the top": ("format = 1", "format = 1\nversion = 3", ["version: unknown key"]),
    "negative mass": ("mass = 1000.0", "mass = -1000.0", ["vehicle.mass: is -1000.0", "0.001 to 200000 kg"]),
    "mass nan": ("mass = 1000.0", "mass = nan", ["vehicle.mass: is nan"]),
    "mass inf": ("mass = 1000.0", "mass = inf", ["vehicle.mass: is inf"]),
    "mass huge": ("mass = 1000.0", f"mass = 1{'0' * 400}", ["vehicle.mass", "a number"]),
    "mass text": ("mass = 1000.0", 'mass = "heavy"', ["vehicle.mass: is 'heavy'", "a number"]),
    "mass true": ("mass = 1000.0", "mass = true", ["vehicle.mass: is True", "a number"]),
    "inertia not symmetric": ("[-50.0, 0.0, 1800.0]", "[50.0, 0.0, 1800.0]", ["vehicle.inertia: is not symmetric"]),
    "inertia negative": ("2000.0, 0.0]", "-2000.0, 0.0]", ["vehicle.inertia", "principal moments", "positive"]),
    "inertia of no body": ("2000.0, 0.0]", "2500.0, 0.0]", ["vehicle.inertia", "sum of the other two"]),
    "inertia of the wrong size": (
        "[[500.0, 0.0, -50.0], [0.0, 2000.0, 0.0], [-50.0, 0.0, 1800.0]]",
        "[500.0, 2000.0, 1800.0]",
        ["vehicle.inertia[0]: is 500.0", "3 numbers"],
    ),
    "inertia with nan": ("2000.0, 0.0]", "nan, 0.0]", ["vehicle.inertia[1][1]: is nan"]),
    "negative radius": ("radius = 5.0", "radius = -5.0", ["vehicle.rotor.radius: is -5.0", "0.01 to 25 m"]),
    "absurd radius": ("radius = 5.0", "radius = 5000.0", ["vehicle.rotor.radius", "to 25 m"]),
    "chord beyond radius": (
        "radius = 5.0\nchord = 0.3",
        "radius = 2.0\nchord = 2.5",
        ["vehicle.rotor.chord: is 2.5 m", "radius"],
    ),
    "half a blade": ("blades = 4", "blades = 3.5", ["vehicle.rotor.blades: is 3.5", "whole number"]),
    "direction": ('"ccw"', '"left"', ["vehicle.rotor.direction: is 'left'", "'ccw' or 'cw'"]),
    "negative gravity": ("mass = 1000.0", "gravity = -9.81", ["vehicle.gravity: is -9.81"]),
    "imu with two numbers": ("[0.1, 0.0, 0.2]", "[0.1, 0.0]", ["vehicle.imu: is [0.1, 0.0]", "3 numbers"]),
    "imu nan": ("[0.1, 0.0, 0.2]", "[0.1, 0.0, nan]", ["vehicle.imu[2]: is nan"]),
    "imu in the next county": ("[0.1, 0.0, 0.2]", "[0.1, 0.0, 99999.0]", ["vehicle.imu[2]: is 99999.0"]),
    "limits reversed": ("[-0.1, 0.1]", "[0.1, -0.1]", ["controls.lat.limits", "lower below upper"]),
    "limits in degrees": ("[-0.1, 0.1]", "[-16.0, 16.0]", ["controls.lat.limits", "degrees"]),
    "control unit": ('unit = "rad"', 'unit = "deg"', ["controls.lat.unit: is 'deg'", "'m' or 'norm' or 'rad'"]),
    "control noise": (
        "0.1]\nnoise = 0.001",
        "0.1]\nnoise = -0.001",
        ["controls.lat.noise: is -0.001", "0 or 1e-09 to 0.1 rad"],
    ),
    "unknown control": ("[controls.lon]", "[controls.long]", ["controls.long", "did you mean 'lon'"]),
    "declared control not recorded": ("[controls.lon]", "[controls.col]", ["one.npz: col: is missing"]),
    "channel noise": ("[channels.p]\nnoise = 0.001", "[channels.p]\nnoise = -1", ["channels.p.noise: is -1"]),
    "channel bias": ('bias = "none"', 'bias = "maybe"', ["channels.p.bias: is 'maybe'", "'free' or 'none'"]),
    "channel of no flight": ("[channels.p]", "[channels.pp]", ["channels.pp", "did you mean 'p'"]),
    "channel that is a control": ("[channels.p]", "[channels.lat]", ["channels.lat: is a control"]),
    "no flights": ('identify = ["one"]', "identify = []", ["flights.identify: is empty"]),
    "flights not a list": ('identify = ["one"]', 'identify = "one"', ["flights.identify: is 'one'", "a list"]),
    "no identify": ('identify = ["one"]\n', "", ["flights.identify: is missing"]),
    "flight in two lists": ('acid = ["three"]', 'acid = ["one"]', ["flights.acid: flight 'one'", "flights.identify"]),
    "flight twice": ('["one"]', '["one", "one"]', ["flights.identify: flight 'one'"]),
    "flight that leaves": ('["three"]', '["../../three"]', ["flights.acid", "plain name", "inside the data set"]),
    "flight with a root": ('["three"]', '["/etc/passwd"]', ["flights.acid", "plain name"]),
    "flight misspelt": ('["three"]', '["thre"]', ["thre.npz: there is no such file (did you mean 'three'?)"]),
    "flight not there": ('["three"]', '["four"]', ["four.npz: there is no such file"]),
    "controls not a table": ("[controls.lon]", "[controls]\nlon = 3", ["controls"]),
}


@pytest.mark.parametrize("case", DECLARATIONS)
def test_declaration_is_refused(folder, case):
    old, new, words = DECLARATIONS[case]
    assert old in small_toml()
    (folder / "dataset.toml").write_text(small_toml().replace(old, new), encoding="utf-8")
    refused(folder, "dataset.toml" if ".npz" not in words[0] else "small", *words)


def with_channel(name, values):
    arrays = small_flight()
    arrays[name] = values
    return arrays


def without(*channels):
    return {name: values for name, values in small_flight().items() if name not in channels}


def changed_time(at, value):
    time = small_flight()["time"]
    time[at] = value
    return with_channel("time", time)


def with_value(name, at, value):
    arrays = small_flight()
    arrays[name][at] = value
    return arrays


def scaled(factor, *channels):
    arrays = small_flight()
    return arrays | {channel: arrays[channel] * factor for channel in channels}


NAN = np.full(400, np.nan)
FLIGHTS = {
    "time repeats": (changed_time(5, 0.08), ["time: repeats at sample 5"]),
    "time runs backwards": (changed_time(5, 0.01), ["time: runs backwards at sample 5"]),
    "time holds nan": (changed_time(5, np.nan), ["time: is nan at sample 5"]),
    "time is infinite": (changed_time(399, np.inf), ["time: is inf"]),
    "time in milliseconds": (with_channel("time", 1000.0 * small_flight()["time"]), ["time: ", "20 s apart", "in s"]),
    "time in hours": (with_channel("time", small_flight()["time"] / 3600.0), ["time: ", "5.556e-06 s apart", "in s"]),
    "no time": (without("time"), ["time: is missing"]),
    "unequal lengths": (with_channel("p", np.zeros(399)), ["p: has 399 samples", "400"]),
    "two dimensions": (with_channel("p", np.zeros((400, 1))), ["p: has 2 dimensions"]),
    "a single number": (with_channel("p", np.float64(1.0)), ["p: has 0 dimensions"]),
    "infinite": (with_value("q", 7, -np.inf), ["q: is infinite at sample 7"]),
    "text": (with_channel("p", np.full(400, "fast")), ["p: is text"]),
    "complex": (with_channel("p", np.zeros(400, dtype=complex)), ["p: is complex"]),
    "whole numbers": (with_channel("p", np.zeros(400, dtype=int)), ["p: is int64", "float32 or float64"]),
    "half precision": (with_channel("p", np.zeros(400, dtype=np.float16)), ["p: is float16"]),
    "pickled": (with_channel("p", np.array([{"a": 1}] * 400, dtype=object)), ["p: is a pickled object"]),
    "one sample": ({name: values[:1] for name, values in small_flight().items()}, ["time: has 1 sample;"]),
    "no samples": ({name: values[:0] for name, values in small_flight().items()}, ["time: has 0 samples"]),
    "no controls": (without("lat", "lon"), ["lon: is missing", "control"]),
    "a control all nan": (with_channel("lat", NAN), ["lat: is all NaN"]),
    "theta in degrees": (with_value("theta", slice(50, 90), 2.8), ["theta: reaches 2.8", "degrees"]),
    "attitude in small degrees": (scaled(57.3 / 8, "phi") | {"p": small_flight()["p"] / 8}, ["phi: moves", "degrees"]),
    "rates in degrees": (scaled(57.3, "p"), ["p: is", "degrees"]),
    "roll in degrees": (scaled(57.3, "phi"), ["phi: ", "degrees"]),
    "blade angle in degrees": (with_value("lat", slice(60, 90), 8.0), ["lat: reaches 8", "degrees"]),
}


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("case", FLIGHTS)
def test_flight_is_refused(folder, case):
    arrays, words = FLIGHTS[case]
    np.savez(folder / "flights" / "one.npz", **arrays)
    refused(folder, "one.npz", *words)


def bytes_of(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def bomb():
    """A member whose header promises little and whose body unpacks to much more."""
    stream, header = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array(header, np.zeros(10), allow_pickle=False)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time.npy", header.getvalue() + bytes(50_000_000))
    return stream.getvalue()


def long_promise():
    stream, header = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("time.npy", header.getvalue() + bytes(80))
    return stream.getvalue()


WHOLE = bytes_of(**small_flight())
NPY = io.BytesIO()
np.save(NPY, np.zeros(5))
FILES = {
    "empty": (b"", "is empty"),
    "truncated": (WHOLE[: len(WHOLE) // 2], "not a whole npz"),
    "damaged": (WHOLE[:3000] + b"damage" + WHOLE[3006:], "time"),
    "text": (b"time,p\n0,1\n", "not a whole npz"),
    "a bare array": (NPY.getvalue(), "not a whole npz"),
    "pickle": (b"\x80\x04\x95\x10\x00\x00\x00\x00\x00\x00\x00]\x94(K\x01K\x02e.", "not a whole npz"),
    "bomb": (bomb(), "time: has"),
    "long promise": (long_promise(), "samples"),
    "not an array inside": (None, "is not an array"),
}


@pytest.mark.parametrize("case", FILES)
def test_file_is_refused(folder, case):
    content, words = FILES[case]
    if content is None:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            archive.writestr("readme.txt", "hello")
        content = stream.getvalue()
    (folder / "flights" / "one.npz").write_bytes(content)
    refused(folder, "one.npz", words)


CSV = {
    "text": ("time,lat,lon,p\n0,0,0,1\n0.1,0,0,fast\n", ["p: is 'fast' in line 3"]),
    "semicolons": (
        "time;lat;lon;p\n0;0;0;1\n0.1;0;0;2\n",
        ["line 1: is 'time;lat;lon;p', one column", "rotorid import"],
    ),
    "ragged": ("time,lat,lon,p\n0,0,0,1\n0.1,0,0\n", ["line 3: has 3 fields", "4"]),
    "name twice": ("time,lat,lat\n0,0,0\n", ["lat: is there twice"]),
    "no name": ("time,,lat\n0,0,0\n", ["column 2: has no name"]),
    "no header": ("0,0,0\n0.1,0,0\n", ["0"]),
    "nothing": ("\n\n", ["is empty"]),
    "header only": ("time,lat,lon,p\n", ["time: has 0 samples"]),
    "infinite": ("time,lat,lon,p\n0,0,0,1\n0.1,0,0,inf\n", ["p: is infinite"]),
}


@pytest.mark.parametrize("case", CSV)
def test_csv_is_refused(folder, case):
    text, words = CSV[case]
    (folder / "flights" / "one.npz").unlink()
    (folder / "flights" / "one.csv").write_text(text, encoding="utf-8")
    refused(folder, "one.csv", *words)


def test_what_is_not_a_data_set_is_refused(tmp_path):
    refused(tmp_path / "nowhere", "nowhere", "there is no such folder")
    refused(tmp_path, "holds no dataset.toml")
    (tmp_path / "file").write_text("")
    refused(tmp_path / "file", "is not a folder")
    (tmp_path / "dataset.toml").write_bytes(b"\xff\xfe")
    refused(tmp_path, "dataset.toml", "is not text")
    (tmp_path / "dataset.toml").write_text("")
    refused(tmp_path, "dataset.toml", "is missing")


def test_motors_must_match_commands():
    arrays = {"time": np.arange(50) * 0.01, **{f"motor{k}": np.full(50, 0.5) for k in (1, 2)}, "p": np.zeros(50)}
    motor = {"position": [0.1, 0.0, 0.0], "spin": "ccw"}
    with pytest.raises(InputError, match=r"vehicle.motors: declares 1 motors; expected 2"):
        Dataset.from_arrays({"f": arrays}, identify=["f"], kind="multirotor", vehicle={"motors": [motor]})
    with pytest.raises(InputError, match=r"vehicle.motors\[0\].spin: is missing"):
        Dataset.from_arrays({"f": arrays}, identify=["f"], vehicle={"motors": [{"position": [0, 0, 0]}]})


def test_arrays_are_refused_like_files():
    arrays = small_arrays()
    with pytest.raises(InputError, match=r"arrays: flights: there is no flight 'four'"):
        Dataset.from_arrays(arrays, identify=["four"])
    with pytest.raises(InputError, match=r"arrays: flight one: p: is text"):
        Dataset.from_arrays({"one": arrays["one"] | {"p": ["a"] * 400}}, identify=["one"])
    with pytest.raises(InputError, match=r"arrays: flight one: p: is not an array of numbers"):
        Dataset.from_arrays({"one": arrays["one"] | {"p": [[1.0], [1.0, 2.0]]}}, identify=["one"])
    with pytest.raises(InputError, match=r"arrays: vehicle.mass: is -3"):
        Dataset.from_arrays(arrays, identify=["one"], vehicle={"mass": -3})


def test_a_flight_without_the_control_of_the_others_is_refused(folder):
    np.savez(folder / "flights" / "two.npz", **without("lon"))
    refused(folder, "two.npz", "lon: is missing")
    arrays = without("lon") | {"lonn": small_arrays()["two"]["lon"]}
    np.savez(folder / "flights" / "two.npz", **arrays)
    refused(folder, "two.npz", "lon: is missing ('lonn' is there, a name that nothing knows)")


KEYS = ["format", "name", "kind", "vehicle", "mass", "inertia", "rotor", "blades", "motors", "controls", "lat", "unit"]
KEYS += [
    "limits",
    "channels",
    "p",
    "noise",
    "bias",
    "flights",
    "identify",
    "validate",
    "acid",
    "model",
    "reference",
    "x",
]
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from(["one", "rad", "helicopter", "free"]),
)
TABLES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.sampled_from(KEYS) | st.text(max_size=3), inner, max_size=5)
    ),
    max_leaves=20,
)


def refusal(read):
    """Line of the InputError that reading raises, or None; any other exception is a failure of the test."""
    try:
        read()
    except InputError as error:
        return str(error)
    return None


PARTS = ["vehicle", "controls", "channels", "flights", "model", "kind", "format", "name"]


@settings(max_examples=200, deadline=None, derandomize=True)
@given(part=st.sampled_from(PARTS), value=TABLES)
def test_any_declaration_gives_a_data_set_or_an_input_error(part, value):
    from rotorid_torch.data.declare import declare

    document = {"format": 1, "kind": "helicopter", "flights": {"identify": ["one"]}} | {part: value}
    told = refusal(lambda: declare(document, "dataset.toml"))
    assert told is None or "\n" not in told


@settings(max_examples=150, deadline=None, derandomize=True)
@given(cut=st.integers(0, len(small_toml())), length=st.integers(0, 40), new=st.text(max_size=12))
def test_any_toml_gives_a_data_set_or_an_input_error(tmp_path_factory, cut, length, new):
    folder = tmp_path_factory.getbasetemp() / "any"
    if not folder.exists():
        small_folder(folder)
    text = small_toml()[:cut] + new + small_toml()[cut + length :]
    (folder / "dataset.toml").write_text(text, encoding="utf-8", errors="replace", newline="")
    told = refusal(lambda: load(folder))
    assert told is None or "\n" not in told
    assert told is not None or tomllib.loads(text.replace("\r\n", "\n"))["format"] == 1


@settings(max_examples=150, deadline=None, derandomize=True)
@given(at=st.integers(0, len(WHOLE) - 1), new=st.binary(min_size=1, max_size=8))
def test_any_damage_to_a_flight_gives_a_data_set_or_an_input_error(tmp_path_factory, at, new):
    folder = tmp_path_factory.getbasetemp() / "damaged"
    if not folder.exists():
        small_folder(folder)
    (folder / "flights" / "one.npz").write_bytes(WHOLE[:at] + new + WHOLE[at + len(new) :])
    told = refusal(lambda: load(folder))
    assert told is None or "\n" not in told
