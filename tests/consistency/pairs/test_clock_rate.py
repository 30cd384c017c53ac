"""Clocks that do not run equally fast: one error with its rate, no constant delay, and silence where they do."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.correction import without_errors_of_flight
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.pairs.clock_rate import ClockRate, clock_rate
from rotorid_torch.data import Dataset
from tests.consistency.pairs.test_alignment import dataset, flights, late, without

FLOWN = flights()
ATTITUDE, RATES = ("phi", "theta", "psi"), ("p", "q", "r")


def on_another_clock(channels: tuple[str, ...], fast: float) -> dict[str, dict[str, np.ndarray]]:
    """The flights with these channels stamped by a clock that runs so much too fast."""
    changed = {}
    for name, flight in FLOWN.items():
        time = flight["time"]
        changed[name] = flight | {c: np.interp(time / (1.0 + fast), time, flight[c]) for c in channels}
    return changed


def rate_of(data: Dataset) -> ClockRate | None:
    errors = alignment(data).errors
    return clock_rate([without_errors_of_flight(flight, errors) for flight in data.flights.values()])


@pytest.mark.parametrize("fast", [-0.05, -0.02, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("channels", [RATES, ATTITUDE])
def test_another_rate_is_right_to_a_tenth_and_is_one_error(channels: tuple[str, ...], fast: float):
    data = dataset(on_another_clock(channels, fast))
    rate = rate_of(data)
    assert rate is not None
    expected = 1.0 / (1.0 + fast) - 1.0 if channels == RATES else fast
    assert abs(rate.drift - expected) < max(4.0 * rate.se, 0.1 * abs(expected))
    said = [f.sentence for f in check(data).findings if f.severity == "error"]
    word = "faster" if (fast > 0.0) == (channels == RATES) else "slower"
    assert [s for s in said if "clock of the body rates" in s and word in s]
    assert not [f for f in check(data).findings if " late (±" in f.sentence and "phi" in f.channel]


def test_clocks_that_agree_or_differ_by_a_constant_have_one_rate():
    for arrays in (FLOWN, late(FLOWN, ATTITUDE, 0.1), without(ATTITUDE, "end", 0.5)):
        assert rate_of(dataset(arrays)) is None


@pytest.mark.parametrize("fast", [-0.02, 0.02])
def test_a_rate_is_right_on_a_clock_that_is_far_off_too(fast: float):
    data = dataset(late(on_another_clock(ATTITUDE, fast), ATTITUDE, 3.2))
    rate = rate_of(data)
    assert rate is not None
    assert rate.drift == pytest.approx(fast, rel=0.1)
    assert [f for f in check(data).of("error") if "clock of the body rates" in f.sentence]


@pytest.mark.parametrize("fast", [-0.2, 0.2, 0.4])
def test_a_rate_beyond_what_is_looked_for_is_none(fast: float):
    assert rate_of(dataset(on_another_clock(ATTITUDE, fast))) is None


@pytest.mark.parametrize("shift", [1, 2, 3])
def test_attitudes_of_other_flights_have_no_rate(shift: int):
    names = [*FLOWN]
    others = {name: FLOWN[names[(i + shift) % len(names)]] for i, name in enumerate(names)}
    arrays = {name: flight | {c: others[name][c] for c in ATTITUDE} for name, flight in FLOWN.items()}
    assert rate_of(dataset(arrays)) is None


def test_only_flights_to_identify_say_a_rate():
    spoilt = {f"{name}x": flight for name, flight in on_another_clock(ATTITUDE, 0.02).items()}
    both = [([*spoilt], [*FLOWN]), ([*FLOWN], [*spoilt])]
    for identify, acid in both:
        data = Dataset.from_arrays({**FLOWN, **spoilt}, identify=identify, acid=acid)
        said = [f for f in check(data).findings if "clock of the body rates" in f.sentence]
        assert len(said) == (identify == [*spoilt])
