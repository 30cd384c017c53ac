"""A value that by chance is not that of the others."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.outliers import outliers


def apart(values: list[float], least: float = 0.1) -> dict[int, float]:
    return outliers(range(len(values)), lambda k, _: (values[k], 0.0), least)


@pytest.mark.parametrize("away", [(0.5,), (0.5, 0.5), (-0.5, 0.9, 0.5)])
def test_several_wrong_ones_hide_no_other(away: tuple[float, ...]):
    right = [*np.random.default_rng(0).normal(1.0, 0.02, 9)]
    found = apart([*(1.0 + x for x in away), *right])
    assert sorted(found) == [*range(len(away))]
    assert [found[k] for k in sorted(found)] == pytest.approx(away, abs=0.05)


def test_values_of_one_distribution_are_not_apart_whatever_their_spread():
    for seed in range(200):
        rng = np.random.default_rng(seed)
        assert not apart([*rng.normal(0.0, rng.choice([0.01, 1.0, 100.0]), rng.integers(2, 20))])


def test_what_is_hardly_known_is_not_apart():
    values = [(1.0, 0.05)] * 5 + [(3.0, 2.0)]
    assert not outliers(range(6), lambda k, _: values[k], 0.1)


def test_two_of_three_tell_the_third_and_two_of_four_none():
    assert [*apart([1.0, 1.01, 2.0])] == [2]
    assert not apart([1.0, 2.0, 1.0, 2.0])
    assert not apart([1.0, 2.0])
