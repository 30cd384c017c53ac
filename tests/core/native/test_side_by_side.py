"""Work in threads: the same results in the same order, items from the calling thread, few at once, errors told."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
import torch

from rotorid_torch.core.native.side_by_side import AT_ONCE, side_by_side


@pytest.fixture(params=["1", "2"], ids=["one thread", "two threads"])
def count(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setenv("ROTORID_THREADS", request.param)
    return int(request.param)


def test_results_stand_in_the_items_order_and_items_come_from_the_calling_thread(count: int):
    makers, taken = set[int](), list[int]()

    def items() -> Iterator[int]:
        for k in range(7):
            taken.append(threading.get_ident())
            yield k

    def square(k: int) -> int:
        makers.add(threading.get_ident())
        return k * k

    assert list(side_by_side(square, items())) == [k * k for k in range(7)]
    assert set(taken) == {threading.get_ident()}
    assert (threading.get_ident() in makers) == (count == 1)


def test_no_more_items_are_taken_than_are_at_work(count: int):
    taken = list[int]()

    def items() -> Iterator[int]:
        for k in range(20):
            taken.append(k)
            yield k

    for done, _ in enumerate(side_by_side(lambda k: k, items()), 1):
        assert len(taken) < done + AT_ONCE


@pytest.mark.usefixtures("count")
def test_an_error_and_whether_gradients_are_wanted_reach_the_other_side():
    def graded(tensor: torch.Tensor) -> bool:
        return (2.0 * tensor).requires_grad

    leaf = torch.ones(1, requires_grad=True)
    assert list(side_by_side(graded, [leaf])) == [True]
    with torch.no_grad():
        assert list(side_by_side(graded, [leaf])) == [False]
    with pytest.raises(ZeroDivisionError):
        list(side_by_side(lambda k: 1 / k, [1, 0]))
