"""Work in a forked process: the same result, the same error, and a result in spite of a lost process."""

from __future__ import annotations

import multiprocessing
import os
import signal

import pytest
import torch

from rotorid_torch.core.processes.forks import forked, forked_each
from rotorid_torch.errors import InputError

HERE = os.getpid()


def test_a_result_comes_from_another_process():
    square = torch.arange(1000, dtype=torch.float64).square()
    made = forked(lambda: (os.getpid(), square.sum()))
    process, total = made()
    assert (process == HERE) == (len(os.sched_getaffinity(0)) < 2)
    assert total == square.sum()
    assert made() is made()


def test_what_it_raises_is_raised_where_the_result_is_asked_for():
    def refuse() -> None:
        raise InputError("file.csv", "u", "is missing", "a column")

    made = forked(refuse)
    with pytest.raises(InputError, match=r"file\.csv"):
        made()


def test_a_lost_process_costs_time_and_no_result():
    def lost() -> int:
        if os.getpid() != HERE:
            os.kill(os.getpid(), signal.SIGKILL)
        return 7

    assert forked(lost)() == 7


def test_what_cannot_travel_is_made_here():
    assert forked(lambda: lambda: 3)()() == 3


def test_in_a_process_that_may_have_no_children_it_is_made_there():
    """As in a worker of a pool."""
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply(_of_pool) == 7


def _of_pool() -> int:
    return forked(lambda: 7)()


def test_results_are_carried_in_the_order_of_their_items():
    made = forked_each([3, 1, 2], lambda n: (n, os.getpid()), lambda one: one, lambda n, one: one)
    assert [n for n, _ in made] == [3, 1, 2]
    assert [process == HERE for _, process in made] == [True, len(os.sched_getaffinity(0)) < 2, True]
