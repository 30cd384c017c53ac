"""What is written is read back the same; the data set is whole or absent."""

import numpy as np
import pytest
import torch

from rotorid_torch.data import load
from rotorid_torch.data.write import to_toml, write_dataset
from rotorid_torch.errors import InputError
from tests.helpers import small_arrays, small_folder

LISTS = {"identify": ["one", "two"], "acid": ["three"]}


def test_round_trip(tmp_path):
    known = load(small_folder(tmp_path / "known"))
    place = write_dataset(
        tmp_path / "deep" / "written",
        small_arrays(),
        **LISTS,
        description='a "quoted" line\nand another, 3°',
        vehicle=known.vehicle,
        controls={**known.control_specs},
        channels={"p": {"noise": 0.001}},
        model={"reference": "hover"},
        truth={"one": {"X": np.zeros(400)}},
    )
    dataset = load(place)
    assert dataset.name == "written"
    assert dataset.description == 'a "quoted" line\nand another, 3°'
    assert dataset.vehicle == known.vehicle
    assert dataset.control_specs == known.control_specs
    assert dataset.noise("p") == 0.001
    assert (dataset.identify, dataset.validate, dataset.acid) == (("one", "two"), (), ("three",))
    for name, values in known.flights["two"].channels.items():
        assert torch.equal(values, dataset.flights["two"].channels[name])
    with np.load(place / "truth" / "one.npz") as truth:
        assert truth["X"].shape == (400,)
    assert [entry.name for entry in place.parent.iterdir()] == ["written"]


def test_motors_and_float32_survive(tmp_path):
    motors = [{"position": [0.1, sign * 0.1, 0.0], "spin": "ccw", "thrust": [0.0, 0.1, 0.2]} for sign in (1, -1)]
    time = np.arange(100) * 0.01
    flight = {"time": time, "motor1": 0.5 + 0 * time, "motor2": 0.4 + 0 * time, "p": np.sin(time).astype(np.float32)}
    place = write_dataset(
        tmp_path / "quad", {"f": flight}, identify=["f"], kind="multirotor", vehicle={"motors": motors, "mass": 0.03}
    )
    assert load(place).vehicle.motors[1].position == (0.1, -0.1, 0.0)
    with np.load(place / "flights" / "f.npz") as stored:
        assert stored["p"].dtype == np.float32


def test_earlier_data_set_is_replaced_whole(tmp_path):
    first = load(write_dataset(tmp_path / "set", small_arrays(), **LISTS))
    second = load(write_dataset(tmp_path / "set", small_arrays(), identify=["one"]))
    assert second.sha256 != first.sha256
    assert not (tmp_path / "set" / "flights" / "three.npz").exists()
    assert [entry.name for entry in tmp_path.iterdir()] == ["set"]


def test_same_content_gives_the_same_sha(tmp_path):
    shas = {load(write_dataset(tmp_path / n, small_arrays(), name="same", **LISTS)).sha256 for n in ("a", "b")}
    assert len(shas) == 1


def test_bad_data_and_things_in_the_way_leave_everything_as_it_was(tmp_path):
    place = write_dataset(tmp_path / "set", small_arrays(), **LISTS)
    before = load(place).sha256
    with pytest.raises(InputError, match=r"vehicle\.mass"):
        write_dataset(place, small_arrays(), **LISTS, vehicle={"mass": -1.0})
    assert load(place).sha256 == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="is in the way and is not a data set"):
        write_dataset(tmp_path / "mine", small_arrays(), **LISTS)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is in the way and is not a folder"):
        write_dataset(tmp_path / "file", small_arrays(), **LISTS)
    assert {entry.name for entry in tmp_path.iterdir()} == {"set", "mine", "file"}


@pytest.mark.parametrize("name", ["notes.txt", "flights/log.bin", "truth/mine.csv", "logs/one.npz"])
def test_a_data_set_that_holds_other_files_stays(tmp_path, name):
    place = write_dataset(tmp_path / "set", small_arrays(), **LISTS)
    (place / name).parent.mkdir(exist_ok=True)
    (place / name).write_text("mine")
    with pytest.raises(InputError, match=f"{name}: would be deleted, and is no part of a data set"):
        write_dataset(place, small_arrays(), **LISTS)
    assert (place / name).read_text() == "mine"


def test_interrupted_writing_leaves_the_earlier_one(tmp_path, monkeypatch):
    place = write_dataset(tmp_path / "set", small_arrays(), **LISTS)
    before = load(place).sha256

    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", stop)
    with pytest.raises(KeyboardInterrupt):
        write_dataset(place, small_arrays(), identify=["one"])
    assert load(place).sha256 == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["set"]


def test_toml_of_odd_keys():
    import tomllib

    document = {"a b": {"c": [1, 2.5, True]}, "t": [{"x": 1}, {"x": 2, "y": {"z": "é\t"}}], "n": 1e-20}
    assert tomllib.loads(to_toml(document)) == document
