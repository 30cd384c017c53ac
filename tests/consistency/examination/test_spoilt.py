"""Records that were spoilt on their way: copies that were edited, coarse steps, gravity taken out."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.examination.finding import finding
from rotorid_torch.consistency.examination.grade import graded
from rotorid_torch.data import Dataset
from tests.consistency.examination.test_check import dataset_of, rolling
from tests.consistency.examination.test_grade import flown

EDITS = {
    "rounded": lambda name, values: np.round(values, 4),
    "single precision": lambda name, values: values.astype(np.float32).astype(float),
    "a little noise": lambda name, values: (
        values + 2e-4 * np.random.default_rng(len(name)).standard_normal(len(values))
    ),
    "another heading": lambda name, values: values + 2.0 * (name == "psi"),
    "velocities filtered": lambda name, values: (
        np.convolve(values, np.ones(5) / 5, "same") if name in ("u", "v", "w") else values
    ),
}


@pytest.mark.parametrize("edit", EDITS)
def test_an_edited_copy_is_a_copy(edit: str):
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    copied = {name: v if name == "time" else EDITS[edit](name, v) for name, v in flights["f0"].items()}
    data = Dataset.from_arrays(flights | {"copy": copied}, identify=["f0", "f1", "f2"], acid=["copy"])
    (told,) = [f for f in check(data).findings if "sample by sample" in f.sentence]
    assert (told.severity, told.flight) == ("error", "copy")


def test_the_same_sticks_are_no_copy():
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    for flight in flights.values():
        flight["lat"], flight["lon"] = flights["f0"]["lat"], flights["f0"]["lon"]
    assert not [
        f for f in check(Dataset.from_arrays(flights, identify=[*flights])).findings if "sample by" in f.sentence
    ]


def stepped(step: float, frozen: bool = False) -> Dataset:
    """Flights with a coning that is stored in steps, and stands still for 6 s where it is frozen."""
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    for flight in flights.values():
        flight["a0"] = step * np.round(0.5 * np.sin(0.4 * flight["time"]) / step)
        flight["a0"][300:900] = flight["a0"][300] if frozen else flight["a0"][300:900]
    return Dataset.from_arrays(flights, identify=[*flights])


@pytest.mark.parametrize("step", [0.02, 0.1])
def test_coarse_steps_are_not_frozen(step: float):
    assert not [f for f in check(stepped(step)).findings if "frozen" in f.sentence]


def test_a_record_in_steps_can_be_frozen():
    assert [f.channel for f in check(stepped(0.02, frozen=True)).findings if "frozen" in f.sentence] == ["a0"]


def test_acceleration_without_gravity_is_an_error():
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    for flight in flights.values():
        phi, theta = flight["phi"], flight["theta"]
        down = (-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta))
        for channel, part in zip(("ax", "ay", "az"), down, strict=True):
            flight[channel] = flight[channel] + 9.80665 * part
    found = [
        f for f in check(Dataset.from_arrays(flights, identify=[*flights])).findings if "without gravity" in f.sentence
    ]
    assert [(f.severity, f.channel) for f in found] == [("error", "ax ay az")]
    assert not [f for f in check(dataset_of()).findings if "without gravity" in f.sentence]


@pytest.mark.parametrize(
    ("channel", "axis"), [("w", "vertical"), ("az", "vertical"), ("lon", "pitch"), ("q w", "pitch")]
)
def test_a_warning_on_any_channel_of_an_axis_limits_it(channel: str, axis: str):
    flight = flown() | {"w": 0.1 * np.sin(np.arange(2000) * 0.02)}
    controls = {stick: {"unit": "rad"} for stick in ("lat", "lon", "col", "ped")}
    data = Dataset.from_arrays({"f": flight}, identify=["f"], controls=controls)
    doubt = finding("warning", channel, "stands still.")
    result = graded(data, [doubt])
    assert result.grade == "limited"
    assert {one.axis: one.grade for one in result.axes}[axis] == "limited"


def departed(at: float) -> dict[str, np.ndarray]:
    """A flight that rolls on through a whole turn from some time on; rates and specific force follow."""
    flight = rolling(0)
    on = np.clip(flight["time"] - at, 0.0, None)
    flight["phi"], flight["p"] = (
        flight["phi"] + 2.0 * np.sin(on) * on,
        flight["p"] + 2.0 * (np.cos(on) * on + np.sin(on)),
    )
    return flight


def test_a_helicopter_that_turns_over_is_told_with_its_time():
    """No model about a trim holds upside down; other vehicles' models hold in any attitude."""
    flights = {"f0": departed(4.0), "f1": rolling(1), "f2": rolling(2)}
    told = [f for f in check(Dataset.from_arrays(flights, identify=[*flights])).findings if "upside down" in f.sentence]
    over = np.flatnonzero(np.cos(flights["f0"]["phi"]) < 0.0)[0]
    assert [(f.severity, f.flight) for f in told] == [("warning", "f0")]
    assert f"from {flights['f0']['time'][over]:.1f} s on" in told[0].sentence
    upright = {"f0": rolling(0), "f1": rolling(1), "f2": rolling(2)}
    assert not [f for f in check(Dataset.from_arrays(upright, identify=[*upright])).findings if "upside" in f.sentence]
