"""Items made when asked for: what stays in memory, what is made again, what is read back from disk."""

from __future__ import annotations

import gc
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.data import Dataset, load, on_demand
from rotorid_torch.data.dataset import ENOUGH
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.errors import InputError
from tests.helpers import small_arrays, small_folder


@dataclass(frozen=True)
class Record:
    name: str
    values: Tensor
    parts: dict[str, Tensor]


def record(name: str) -> Record:
    values = torch.full((100,), float(ord(name)), dtype=torch.float64)
    return Record(name, values, {"half": 0.5 * values[:1, None]})


def counted(**settings: object) -> tuple[OnDemand[Record], list[str]]:
    made: list[str] = []

    def make(name: str) -> Record:
        made.append(name)
        return record(name)

    return OnDemand("abcd", make, **settings), made  # pyright: ignore[reportArgumentType]


def test_what_fits_into_the_budget_is_made_once():
    items, made = counted()
    assert list(items) == list("abcd")
    assert len(items) == 4
    assert "c" in items
    assert "e" not in items
    assert items["b"] is items["b"]
    assert [item.name for item in items.values()] == list("abcd")
    assert made == ["b", "a", "c", "d"]
    with pytest.raises(KeyError):
        items["e"]


def test_what_was_used_last_stays_in_memory():
    items, made = counted(budget=2 * 808 + 10)
    for name in "abacab":
        assert items[name].name == name
    assert made == ["a", "b", "c", "b"]


def test_one_item_above_the_budget_still_comes():
    items, made = counted(budget=10)
    assert torch.equal(items["a"].values, record("a").values)
    assert items["a"] is items["a"]
    assert made == ["a"]


def test_costly_items_are_written_once_and_read_back_as_they_were():
    items, made = counted(budget=900, costly=True)
    for name in "abcdabcd":
        assert torch.equal(items[name].values, record(name).values)
        assert torch.equal(items[name].parts["half"], record(name).parts["half"])
    assert made == list("abcd")
    disk = items._disk
    assert disk is not None
    assert disk.seek(0, 2) == 4 * 808
    del items
    gc.collect()
    assert disk.closed


def test_a_disk_that_is_full_is_told():
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no device that is always full here")
    items, _ = counted(budget=900, costly=True)
    with full.open("r+b", buffering=0) as disk:
        items._disk = disk
        items["a"]
        with pytest.raises(InputError, match="TMPDIR"):
            items["b"]


def test_flights_are_read_again_where_memory_does_not_suffice(tmp_path, monkeypatch):
    folder = small_folder(tmp_path / "small")
    whole = load(folder)
    monkeypatch.setattr(on_demand, "BUDGET", 1)
    few = load(folder)
    for name in (*whole.flights, *whole.flights):
        for channel, values in whole.flights[name].channels.items():
            assert torch.equal(values, few.flights[name].channels[channel])
    assert few.reference() == whole.reference()
    assert few.scales() == whole.scales()
    assert [few.quiet(name) for name in few.flights] == [whole.quiet(name) for name in whole.flights]


def test_a_file_that_changes_after_loading_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(on_demand, "BUDGET", 1)
    dataset = load(small_folder(tmp_path / "small"))
    file = tmp_path / "small" / "flights" / "one.npz"
    arrays = dict(np.load(file))
    np.savez(file, **(arrays | {"p": arrays["p"] + 1e-6}))
    with pytest.raises(InputError, match=r"one\.npz.*has changed"):
        dataset.flights["one"]
    file.unlink()
    with pytest.raises(InputError, match="no such file"):
        dataset.flights["one"]


def test_facts_are_those_of_the_samples():
    flight = load_arrays().flights["one"]
    facts = Facts.of(flight)
    assert facts.seconds == pytest.approx(float(flight.time[-1]))
    assert facts.has("p") == flight.has("p")
    assert not facts.has("p", "nothing")
    for name, values in flight.channels.items():
        there, spread = values[~values.isnan()], facts.spreads[name]
        assert spread.count == len(there)
        assert spread.mean() == pytest.approx(float(there.mean()), abs=1e-12)
        assert spread.squares_about(0.3) == pytest.approx(float((there - 0.3).square().sum()), rel=1e-10)
        assert (spread.low, spread.high) == (float(there.min()), float(there.max()))


def load_arrays() -> Dataset:
    flights = small_arrays()
    flights["one"]["p"] = flights["one"]["p"].copy()
    flights["one"]["p"][:3] = np.nan
    return Dataset.from_arrays(flights, identify=list(flights))


def test_a_channel_without_samples_has_no_facts():
    flights = small_arrays()
    flights["one"]["q"] = np.full(len(flights["one"]["time"]), np.nan)
    facts = Dataset.from_arrays(flights, identify=list(flights)).facts["one"]
    assert "q" in facts.channels
    assert not facts.has("q")


def test_slowed_flights_are_made_on_demand():
    time = np.arange(400) / 200.0
    slow, fast = ({"time": t, "lon": np.sin(t), "p": t, "q": t, "r": t} for t in (time[::2], time))
    dataset = Dataset.from_arrays({"slow": slow, "fast": fast}, identify=["slow", "fast"])
    seen = at_one_rate(dataset)
    assert seen.facts["fast"].samples == seen.flights["fast"].samples == 200
    assert seen.facts["fast"].dt == seen.facts["slow"].dt


def test_some_flights_stand_for_all_of_a_long_list():
    time = np.arange(30) / 10.0
    channels = {"time": time, "lon": np.sin(time), "p": time}
    names = [f"f{k}" for k in range(40)]
    dataset = Dataset.from_arrays(dict.fromkeys(names, channels), identify=names)
    assert dataset.some(40) == tuple(names)
    chosen = [names.index(name) for name in dataset.some(8)]
    assert [k // 5 for k in chosen] == list(range(8))
    assert len({k % 4 for k in chosen}) > 1
    assert dataset.some(8) == dataset.some(8)


def test_a_channel_that_few_of_many_flights_have_keeps_its_noise():
    time, chance = np.arange(200) / 50.0, np.random.default_rng(0)
    channels = {"time": time, "lon": np.sin(time), "p": time}
    names = [f"f{k}" for k in range(120)]
    without = Dataset.from_arrays(dict.fromkeys(names, channels), identify=names)
    only = next(name for name in names if name not in without.some(ENOUGH))
    flights = dict.fromkeys(names, channels) | {only: channels | {"beta": 0.01 * chance.standard_normal(200)}}
    dataset = Dataset.from_arrays(flights, identify=names)
    assert [len(record) for record in dataset.records("beta")] == [200]
    assert dataset.noise("beta") == pytest.approx(0.01, rel=0.3)
    assert len(dataset.records("p")) == ENOUGH
