"""Reading good data: formats, units, reference, scales, noise; nothing good is refused."""

import math
import weakref

import numpy as np
import pytest
import torch

from rotorid_torch.data import Dataset, load
from rotorid_torch.data.flight import Flight
from rotorid_torch.errors import InputError
from tests.helpers import shared, shared_sets, small_arrays, small_flight, small_folder


@pytest.fixture
def folder(tmp_path):
    return small_folder(tmp_path / "small")


@pytest.mark.parametrize("name", shared_sets())
def test_every_shared_set_loads(name):
    dataset = load(shared("flightdata", name))
    assert dataset.name == name
    assert set(dataset.flights) == {*dataset.identify, *dataset.validate, *dataset.acid}
    for flight in dataset.flights.values():
        assert all(values.dtype == torch.float64 for values in flight.channels.values())
        assert torch.allclose(flight.time, flight.dt * torch.arange(flight.samples, dtype=torch.float64))
        assert not flight.bridged(dataset.controls).isnan().any()
    assert {"p", "q", "r"} <= set(dataset.scored())


def test_trim_yardstick_of_the_shared_readme():
    dataset, flights = load(shared("flightdata", "uh60-hover")), {}
    for name, flight in dataset.flights.items():
        eight = round(8.0 / flight.dt) + 1
        errors = [
            (flight.channels[c][:eight] - flight.channels[c][flight.lead()].mean()) / dataset.scales()[c]
            for c in dataset.scored()
        ]
        flights[name] = float(torch.stack(errors).square().mean())
    told = {"identify": 1.34, "validate": 0.90, "acid": 1.19}
    for which, figure in told.items():
        listed = getattr(dataset, which)
        assert math.sqrt(sum(flights[name] for name in listed) / len(listed)) == pytest.approx(figure, abs=0.006)


def test_declared_values_arrive(folder):
    dataset = load(folder)
    assert dataset.controls == ("lon", "lat")
    assert dataset.vehicle.rotor is not None
    assert (dataset.vehicle.mass, dataset.vehicle.rotor.radius, dataset.vehicle.gravity) == (1000.0, 5.0, 9.80665)
    assert dataset.vehicle.rotor.lock_number is None
    assert dataset.control_specs["lat"].limits == (-0.1, 0.1)
    assert dataset.control_specs["lon"].unit == "rad"
    assert (dataset.noise("lat"), dataset.noise("p")) == (0.001, 0.001)
    assert (dataset.bias("p"), dataset.bias("q"), dataset.bias("phi")) == ("none", "free", "none")
    assert dataset.settings.reference == "hover"
    assert dataset.listed("three") == "acid"


def test_csv_equals_npz(folder):
    before = load(folder)
    arrays = small_arrays()["one"]
    rows = zip(*arrays.values(), strict=True)
    text = ",".join(arrays) + "\n" + "\n".join(",".join(repr(float(v)) for v in row) for row in rows)
    (folder / "flights" / "one.npz").unlink()
    (folder / "flights" / "one.csv").write_text(text + "\n", encoding="utf-8")
    after = load(folder)
    for name, values in before.flights["one"].channels.items():
        assert torch.equal(values, after.flights["one"].channels[name])
    assert before.sha256 != after.sha256


def test_csv_may_leave_samples_out(folder):
    (folder / "flights" / "one.npz").unlink()
    rows = "\n".join(f"{0.1 * k},0.0,,{'' if k == 3 else 0.1 * k},0.1" for k in range(20))
    (folder / "flights" / "one.csv").write_text(f"time, lat,q,p,lon\n{rows}\n", encoding="utf-8")
    flight = load(folder).flights["one"]
    assert flight.channels["p"].isnan().nonzero().flatten().tolist() == [3]
    assert flight.has("p", "lat")
    assert not flight.has("q")
    assert not flight.has("missing")


def test_arrays_equal_files(folder):
    files = load(folder)
    arrays = {name: {c: torch.as_tensor(v) for c, v in f.items()} for name, f in small_arrays().items()}
    memory = Dataset.from_arrays(
        arrays,
        identify=["one"],
        validate=["two"],
        acid=["three"],
        vehicle=files.vehicle,
        controls=dict(files.control_specs),
        channels=dict(files.channel_specs),
    )
    assert memory.path is None
    assert memory.vehicle == files.vehicle
    assert memory.scales() == files.scales()
    assert memory.reference() == files.reference()
    assert memory.file("one") == "arrays: flight one"


def test_sha_follows_content_of_toml_and_flights(folder):
    first = load(folder).sha256
    assert load(folder).sha256 == first
    arrays = small_arrays()["three"]
    arrays["p"] = arrays["p"] + 1e-9
    np.savez(folder / "flights" / "three.npz", **arrays)
    second = load(folder).sha256
    text = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(text + "# one more word\n")
    assert len({first, second, load(folder).sha256}) == 3
    (folder / "truth").mkdir()
    (folder / "truth" / "one.npz").write_bytes(b"never read")
    assert load(folder).flights.keys() == {"one", "two", "three"}


def test_other_channels_are_kept_and_not_used(folder):
    arrays = small_arrays()["one"] | {"pilot_mood": np.ones(400)}
    np.savez(folder / "flights" / "one.npz", **arrays)
    dataset = load(folder)
    assert dataset.flights["one"].has("pilot_mood")
    assert "pilot_mood" not in dataset.scored()


@pytest.mark.parametrize(
    ("name", "meant"),
    [("Theta", "theta"), ("p [rad/s]", "p"), ("collective", "col"), ("omega_z", ""), ("psi_cmd", ""), ("thrust", "")],
)
def test_a_channel_of_another_name_is_told_where_it_may_stand_for_one_that_is_missing(name: str, meant: str):
    arrays = {c: v for c, v in small_flight().items() if c != meant}
    dataset = Dataset.from_arrays({"f": arrays | {name: arrays["q"]}}, identify=["f"])
    told = [sentence for sentence in dataset.warnings if name in sentence]
    assert told == ([f"channel '{name}' is kept and not used (did you mean '{meant}'?)"] if meant else [])


@pytest.mark.parametrize("kind", ["helicopter", "multirotor"])
@pytest.mark.parametrize("numbers", [(1, 2, 3, 4), (1, 3, 4)])
def test_motors_that_are_missing_and_those_of_a_helicopter_are_told(kind: str, numbers: tuple[int, ...]):
    arrays = {name: values for name, values in small_flight().items() if name not in ("lon", "lat")}
    arrays |= {f"motor{i}": 0.5 + 0.1 * np.sin(i * arrays["time"]) for i in numbers}
    told = " ".join(Dataset.from_arrays({"f": arrays}, identify=["f"], kind=kind).warnings)
    assert ("motor2: not recorded beside motor1 motor3 motor4" in told) == (2 not in numbers)
    assert ("every control is a motor command" in told) == (kind == "helicopter")


def test_reference_is_the_mean_of_the_quiet_part(folder):
    dataset = load(folder)
    samples = dataset.quiet("one")
    assert 0.8 < samples * dataset.flights["one"].dt <= 1.02
    assert dataset.reference()["az"] == pytest.approx(-9.80665, abs=1e-3)
    assert dataset.reference()["lat"] == pytest.approx(0.0, abs=1e-3)


def test_a_flight_that_moves_at_once_has_half_a_second():
    arrays = small_flight()
    arrays["lat"] = 0.05 * np.sin(3.0 * arrays["time"])
    dataset = Dataset.from_arrays({"f": arrays}, identify=["f"])
    assert dataset.quiet("f") == 25


def test_scale_is_the_rms_from_the_first_half_second():
    arrays = small_flight()
    dataset = Dataset.from_arrays({"f": arrays, "g": arrays}, identify=["f", "g"])
    change = arrays["p"] - arrays["p"][arrays["time"] < 0.5].mean()
    assert dataset.scales()["p"] == pytest.approx(np.sqrt(np.mean(change**2)))


def test_undeclared_control_and_unknown_model_key_are_told():
    dataset = Dataset.from_arrays({"f": small_flight()}, identify=["f"], model={"referense": "hover"})
    assert "lon lat: no [controls.lon] says the unit, taken as rad" in dataset.warnings
    assert any("did you mean 'reference'" in sentence for sentence in dataset.warnings)


def test_require_rates_names_the_file_and_the_rate(folder):
    arrays = small_arrays()["two"]
    arrays["q"] = np.full(400, np.nan)
    np.savez(folder / "flights" / "two.npz", **arrays)
    with pytest.raises(InputError, match=r"two\.npz: q: is all NaN; expected body rates"):
        load(folder).require_rates()


@pytest.mark.parametrize(("rate", "values", "told"), [("r", None, "is missing"), ("q", np.nan, "is all NaN")])
def test_a_rate_that_no_flight_has_is_required_all_the_same(rate, values, told):
    arrays = {channel: np.array(signal) for channel, signal in small_flight().items() if channel != rate}
    arrays |= {} if values is None else {rate: np.full(400, values)}
    with pytest.raises(InputError, match=rf"flight f: {rate}: {told}"):
        Dataset.from_arrays({"f": arrays}, identify=["f"]).require_rates()


def test_declared_zero_noise_still_has_a_weight():
    dataset = Dataset.from_arrays({"f": small_flight()}, identify=["f"], channels={"p": {"noise": 0.0}})
    assert 0.0 < dataset.noise("p") < 1e-5


def test_flights_that_are_changed_are_made_when_asked_for_and_let_go():
    """Thirty flights of 8 MB: those used last stay, no more than a budget holds."""
    time = np.arange(50.0)
    flights = {f"f{k}": {"time": time, "lon": np.sin(time), "p": time} for k in range(30)}
    data, alive = Dataset.from_arrays(flights, identify=[*flights]), weakref.WeakSet[Flight]()
    most = 0

    def longer(flight: Flight) -> Flight:
        nonlocal most
        time = torch.arange(1_000_000, dtype=torch.float64)
        made = Flight(flight.name, flight.dt, {"time": time, "p": flight.channels["p"].mean().expand(len(time))})
        alive.add(made)
        most = max(most, len(alive))
        return made

    changed = data.changed(longer)
    assert [flight.samples for flight in changed] == [1_000_000] * 30
    assert most < 15


def test_a_declaration_may_hold_numbers_of_numpy():
    flights = {"one": small_flight()}
    motors = [{"position": row, "spin": "ccw"} for row in np.eye(3)]
    vehicle = {"mass": np.float64(1.5), "inertia": np.diag([1.0, 2.0, 2.5]), "motors": motors}
    read = Dataset.from_arrays(flights, identify=["one"], vehicle=vehicle).vehicle
    assert (read.mass, read.inertia, read.motors[1].position) == (
        1.5, ((1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.5)), (0.0, 1.0, 0.0),
    )  # fmt: skip
    with pytest.raises(InputError, match="holds object; expected numbers"):
        Dataset.from_arrays(flights, identify=["one"], vehicle={"mass": object()})
