"""The paired test against SciPy; residuals that know nothing of the motion."""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from rotorid_torch.trace.terms.significance import exceeds, share_at_least, turned


@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_log_ratios_exceed_nothing_where_a_one_sided_t_test_says_so(confidence: float):
    chance = np.random.default_rng(0)
    told = []
    for count in (2, 3, 8, 20):
        for shift in (-0.5, 0.0, 0.3, 0.6, 1.0, 3.0):
            better = shift + chance.standard_normal(count)
            p = float(stats.ttest_1samp(better, 0.0, alternative="greater").pvalue)
            told.append(exceeds(torch.from_numpy(better), confidence))
            assert told[-1] == (p < 1.0 - confidence)
    assert True in told
    assert False in told


def test_a_single_flight_exceeds_where_it_gains_and_lost_flights_tell_nothing():
    assert exceeds(torch.tensor([0.1], dtype=torch.float64))
    assert not exceeds(torch.tensor([-0.1], dtype=torch.float64))
    assert not exceeds(torch.tensor([], dtype=torch.float64))
    assert not exceeds(torch.full((3,), math.nan, dtype=torch.float64))
    some = torch.tensor([0.10, 0.11, 0.12], dtype=torch.float64)
    lost = torch.tensor([math.nan, -math.inf], dtype=torch.float64)
    assert exceeds(some)
    assert exceeds(torch.cat([some, lost]))


def test_a_turned_record_is_the_record_from_another_time_on():
    record = torch.arange(24.0, dtype=torch.float64).reshape(12, 2)
    made = turned(record, 8, torch.Generator().manual_seed(0))
    assert made.shape == (12, 2, 8)
    rolls = [sign * record.roll(n, dims=0) for n in range(1, 12) for sign in (1.0, -1.0)]
    assert all(any(torch.equal(one, roll) for roll in rolls) for one in made.unbind(-1))
    assert turned(record, 0, torch.Generator()).shape == (12, 2, 0)


def test_a_share_is_sure_by_the_t_of_the_flights_that_tell_it():
    before, after = (torch.tensor(one, dtype=torch.float64) for one in ([1.0, 1.0, 1.0], [0.3, 0.6, 0.0]))
    without_one = 1.0 - torch.tensor([0.3, 0.15, 0.45], dtype=torch.float64)
    error = float((2.0 / 3.0 * (without_one - without_one.mean()).square().sum()).sqrt())
    assert share_at_least(before, after) == pytest.approx(0.7 - float(stats.t.ppf(0.9, 2)) * error)


def test_evidence_of_few_flights_is_no_doubt_where_they_agree():
    before = torch.tensor([3.9, 0.1, 0.0, 0.0], dtype=torch.float64)
    assert share_at_least(before, 0.01 * before) == pytest.approx(0.99)
