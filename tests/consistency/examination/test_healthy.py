"""Healthy records raise nothing: flips, touch-downs, sensors of little resolution, missing sensors, full deflection."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.imu_place import placed_pairs
from rotorid_torch.consistency.records.coherence import coherences
from rotorid_torch.consistency.records.repeated import examine
from rotorid_torch.consistency.sensor_pairs import agreement, attitude_pairs
from rotorid_torch.data import Dataset
from rotorid_torch.simulation import fly
from tests.consistency.examination.test_acting import hovering
from tests.consistency.examination.test_check import dataset_of, placed, rolling

Arrays = dict[str, np.ndarray]


def grave(data: Dataset, words: str) -> list[str]:
    return [f.sentence for f in check(data).findings if words in f.sentence and f.severity in ("warning", "error")]


def looping(seed: int = 0, dt: float = 0.01) -> Arrays:
    """An aircraft that rolls and yaws a little, and turns over its nose once."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 16.0, dt)
    about = np.stack([0.3 * np.sin(1.9 * time + seed), 0.2 * np.sin(1.3 * time), 0.2 * np.sin(0.7 * time)], axis=1)
    about[:, 1] += 2.0 * np.pi / 0.7 * ((time > 6.0) & (time < 6.7))
    turn = Rotation.identity()
    angles = []
    for k in range(len(time)):
        angles.append(turn.as_euler("ZYX")[::-1])
        turn = turn * Rotation.from_rotvec(dt * 0.5 * (about[k] + about[min(k + 1, len(time) - 1)]))
    arrays = {c: about[:, i] + 2e-3 * rng.standard_normal(len(time)) for i, c in enumerate("pqr")}
    arrays |= {
        c: x + 1e-3 * rng.standard_normal(len(time))
        for c, x in zip(("phi", "theta", "psi"), np.array(angles).T, strict=True)
    }
    return {"time": time, "lon": 0.02 * np.sin(1.1 * time), **arrays}


def test_a_loop_through_the_vertical_is_no_step_and_no_contradiction():
    data = Dataset.from_arrays({f"f{seed}": looping(seed) for seed in range(2)}, identify=["f0", "f1"])
    assert grave(data, "no motion makes") == []
    assert grave(data, "contradict each other") == []
    results = [agreement(pair, data.flights.values()) for pair in attitude_pairs()]
    assert min(result.r2 for result in results if result is not None) > 0.95


def test_a_touch_down_is_motion_and_a_wild_sample_is_none():
    flight = placed(0)
    at, dt = 1200, float(flight["time"][1])
    flight["az"][at : at + 2] -= 8.0
    bumped = flight | {"w": flight["w"] - 8.0 * dt * np.clip(np.arange(len(flight["w"])) - at + 0.5, 0, 2)}
    for one, many in ((flight, 1), (bumped, 0)):
        assert len(grave(Dataset.from_arrays({"f": one}, identify=["f"]), "stand alone")) == many


def test_a_quick_motion_at_a_low_rate_does_not_stand_alone():
    time = np.arange(0.0, 20.0, 0.04)
    peaks = sum(np.exp(-(((time - t) / 0.05) ** 2)) for t in (5.0, 11.0))
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(time))
    assert len(examine(noise + peaks, 0.04).alone) == 0
    assert examine(noise + 1.0 * (np.arange(len(time)) == 200), 0.04).alone.tolist() == [200]


@pytest.mark.parametrize("backward", [False, True])
def test_a_record_that_ends_or_begins_in_motion_has_no_sample_that_stands_alone(backward: bool):
    noise = 0.01 * np.random.default_rng(0).normal(size=500)
    turn = slice(None, None, -1 if backward else 1)
    motion = 1.8 * np.sin(2.0 * np.pi * (np.arange(500) - 495.5) / 15.0).clip(0.0)  # speeds above their idle
    assert len(examine((noise + motion)[turn], 0.01).alone) == 0
    lone = (noise + 1.8 * (np.arange(500) == 499))[turn]
    assert examine(lone, 0.01).alone.tolist() == [0 if backward else 499]


@pytest.mark.parametrize(("noise", "told"), [(0.6, False), (0.1, True)])
def test_noise_over_the_steps_of_a_record_is_their_dither(noise: float, told: bool):
    flight, step = rolling(), 0.1
    rng = np.random.default_rng(2)
    for channel in ("p", "q"):
        flight[channel] = step * np.round(flight[channel] / step + noise * rng.standard_normal(len(flight["time"])))
    assert bool(grave(Dataset.from_arrays({"f": flight}, identify=["f"]), "stored in steps")) == told


def test_a_lever_arm_that_is_declared_leaves_what_none_leaves():
    arm = (1.0, -0.5, 2.0)
    away, at_centre = dataset_of({"imu": list(arm)}, arm=arm), dataset_of()
    for one, other in zip(placed_pairs(away), placed_pairs(at_centre), strict=True):
        left, least = agreement(one, away.flights.values()), agreement(other, at_centre.flights.values())
        assert left is not None
        assert least is not None
        assert 1.0 - left.r2 < 5.0 * (1.0 - least.r2)


def test_thrust_is_seen_in_w_where_no_accelerometer_is(tmp_path: Path):
    flown = fly(tmp_path / "d", vehicle="quad", flights=["thrust_p", "roll_p", "translate_p"], seed=3)
    flights = {n: {c: v for c, v in f.items() if c not in ("ax", "ay", "az")} for n, f in flown.flights.items()}
    data = Dataset.from_arrays(flights, identify=list(flights), kind="multirotor")
    (w,) = coherences(data, ["w"])
    assert w.band is not None


def test_a_helicopter_with_flapping_and_no_accelerometer_is_examined(tmp_path: Path):
    flown = fly(tmp_path / "d", flights=["dbl_lon_p", "dbl_lat_p"], seed=1)
    flights = {n: {c: v for c, v in f.items() if c not in ("ax", "ay", "az")} for n, f in flown.flights.items()}
    assert check(Dataset.from_arrays(flights, identify=list(flights))).findings


@pytest.mark.parametrize(("share", "told"), [(0.04, "note"), (0.3, "warning")])
def test_full_deflection_for_a_moment_is_a_test_input(share: float, told: str):
    flight = hovering()
    count = round(share * len(flight["time"]))
    flight["motor2"][500 : 500 + count] = 1.0
    controls = {f"motor{i}": {"limits": [0.0, 1.0]} for i in range(1, 5)}
    data = Dataset.from_arrays({"f": flight}, identify=["f"], kind="multirotor", controls=controls)
    assert [f.severity for f in check(data).findings if "on a limit" in f.sentence] == [told]


def test_motors_that_are_off_are_on_no_limit():
    flight = hovering()
    for i in range(1, 5):
        flight[f"motor{i}"][:900] = 0.0
    controls = {f"motor{i}": {"limits": [0.0, 1.0]} for i in range(1, 5)}
    data = Dataset.from_arrays({"f": flight}, identify=["f"], kind="multirotor", controls=controls)
    assert not [f for f in check(data).findings if "on a limit" in f.sentence]


@pytest.mark.parametrize(("channels", "every"), [("u v w", 50), ("phi theta psi", 20), ("u v w phi theta psi", 10)])
def test_a_slower_stream_that_is_held_contradicts_no_sensor(channels: str, every: int):
    flights = {f"f{seed}": rolling(seed) for seed in range(2)}
    for flight in flights.values():
        rows = np.arange(len(flight["time"])) // every * every
        flight |= {c: flight[c][rows] for c in channels.split()}
    told = check(Dataset.from_arrays(flights, identify=[*flights])).findings
    blamed = ("late (", "alone", "filter of", "contradict")
    assert [f.sentence for f in told if f.severity == "error" or any(words in f.sentence for words in blamed)] == []
    (slow,) = [f for f in told if "sampled more slowly" in f.sentence]
    assert (slow.severity, slow.channel) == ("note", channels)
