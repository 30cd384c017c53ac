"""Clocks that do not run equally fast: one error with its rate, no constant delay, and silence where they do."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.pairs.clock_rate import clock_rate
from rotorid_torch.data import Dataset
from tests.consistency.pairs.test_alignment import dataset, flights, late

MADE = flights()
ATTITUDE, RATES = ("phi", "theta", "psi"), ("p", "q", "r")


def on_another_clock(channels: tuple[str, ...], fast: float) -> Dataset:
    """The flights with these channels stamped by a clock that runs so much too fast."""
    made = {}
    for name, flight in MADE.items():
        time = flight["time"]
        moved = {c: np.interp(time / (1.0 + fast), time, flight[c]) for c in channels}
        made[name] = flight | moved
    return dataset(made)


@pytest.mark.parametrize("fast", [-0.05, -0.02, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("channels", [RATES, ATTITUDE])
def test_another_rate_is_right_to_a_tenth_and_is_one_error(channels: tuple[str, ...], fast: float):
    data = on_another_clock(channels, fast)
    rate = clock_rate(list(data.flights.values()), alignment(data))
    assert rate is not None
    expected = 1.0 / (1.0 + fast) - 1.0 if channels == RATES else fast
    assert abs(rate.drift - expected) < max(4.0 * rate.se, 0.1 * abs(expected))
    said = [f.sentence for f in check(data).findings if f.severity == "error"]
    word = "faster" if (fast > 0.0) == (channels == RATES) else "slower"
    assert [s for s in said if "clock of the body rates" in s and word in s]
    assert not [f for f in check(data).findings if " late (±" in f.sentence and "phi" in f.channel]


def test_clocks_that_agree_or_differ_by_a_constant_have_one_rate():
    for made in (MADE, late(MADE, ATTITUDE, 0.1)):
        data = dataset(made)
        assert clock_rate(list(data.flights.values()), alignment(data)) is None
