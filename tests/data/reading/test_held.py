"""Stretches without new samples: held, bridged by a line, drawn on by a cubic; what moves or stands is left alone."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.data import Dataset
from rotorid_torch.data.reading.held import without_held, without_repeats
from tests.helpers import small_flight

DT, COUNT = 0.02, 1500
CHANNELS = ("u", "v", "w", "p", "q", "r", "phi", "theta")


def flight(kind: str, first: int, last: int, channels: tuple[str, ...] = CHANNELS) -> dict[str, np.ndarray]:
    """A flight whose channels have no samples of their own from `first` to `last`."""
    arrays = {name: values.astype(np.float32) for name, values in small_flight(COUNT, DT).items()}
    arrays["time"] = DT * np.arange(COUNT)
    at = np.arange(COUNT)
    for name in channels:
        x = arrays[name].astype(float)
        if kind == "held":
            x[first:last] = x[first - 1]
        elif kind == "bridged":
            x[first:last] = np.interp(at[first:last], [first - 1, last], [x[first - 1], x[last]])
        else:
            cubic = np.polynomial.Polynomial.fit(at[first - 60 : first], x[first - 60 : first], 3)
            x[first:last] = np.clip(cubic(at[first:last]), -20.0, 20.0)
        arrays[name] = x.astype(np.float32)
    return arrays


@pytest.mark.parametrize("kind", ["held", "bridged", "cubic"])
@pytest.mark.parametrize(("first", "last"), [(700, 760), (1440, COUNT - 1), (300, 340)])
@pytest.mark.parametrize("channels", [CHANNELS, ("u", "v", "w"), ("phi", "theta", "p", "q")])
def test_a_stretch_is_missing_and_named(kind: str, first: int, last: int, channels: tuple[str, ...]) -> None:
    arrays, sentences = without_held(flight(kind, first, last, channels))
    (sentence,) = sentences
    assert sentence.startswith(f"{' '.join(sorted(channels, key=[*arrays].index))}: no new samples from")
    for name in channels:
        gone = np.flatnonzero(np.isnan(arrays[name]))
        assert abs(gone[0] - first) <= 4
        assert abs(gone[-1] - last) <= 4
        assert len(gone) == gone[-1] - gone[0] + 1
    assert not any(np.isnan(values).any() for name, values in arrays.items() if name not in channels)


def test_check_tells_it_once_and_without_other_causes() -> None:
    flights = {f"f{k}": flight("held", 900, 1100) for k in range(2)}
    findings = check(Dataset.from_arrays(flights, identify=[*flights])).findings
    (told,) = [f for f in findings if "no new samples from 18.00 to 21.98 s" in f.sentence]
    assert told.channel.split() == sorted(CHANNELS, key=[*flights["f0"]].index)
    words = ("frozen", "cut off", "no motion makes", "lost and the last one held")
    assert not any(word in f.sentence for f in findings for word in words)


def test_what_stands_before_it_flies_and_what_is_smooth_or_coarse_stays() -> None:
    standing = flight("held", 1, 200)
    assert without_held(standing)[1] == []
    smooth = {
        "time": DT * np.arange(COUNT),
        **{c: np.sin(0.2 * DT * np.arange(COUNT) + k) for k, c in enumerate("pqr")},
    }
    assert without_held(smooth)[1] == []
    coarse = flight("held", 700, 701)
    assert without_held({n: np.round(v, 1) if n != "time" else v for n, v in coarse.items()})[1] == []


def test_one_channel_alone_is_a_sensor_s_fault_and_stays() -> None:
    assert without_held(flight("held", 700, 900, ("p", "q")))[1] == []


@pytest.mark.parametrize(("every", "new"), [(1, 1000), (2, 500), (8, 125), (40, 25)])
def test_of_a_slower_stream_that_is_held_only_new_samples_count(every: int, new: int):
    rng, time = np.random.default_rng(0), 0.005 * np.arange(1000)
    rows = np.arange(1000) // every * every
    attitude = {
        c: np.sin(w * time)[rows] + 1e-3 * rng.standard_normal(1000)[rows]
        for c, w in zip(("phi", "theta"), (2, 3), strict=True)
    }
    arrays = without_repeats({"time": time, "p": rng.standard_normal(1000)[rows], **attitude})
    assert [int(np.isfinite(arrays[c]).sum()) for c in ("phi", "theta", "p")] == [new, new, 1000]
    assert arrays["phi"][::every].tolist() == attitude["phi"][::every].tolist()


def test_a_record_that_is_rounded_or_rests_is_not_held():
    time = 0.005 * np.arange(1000)
    rounded = np.round(np.sin(0.5 * time), 2)
    assert without_repeats({"time": time, "north": rounded})["north"].tolist() == rounded.tolist()
    assert not np.isnan(without_repeats({"time": time, "phi": 0.0 * time})["phi"]).any()
