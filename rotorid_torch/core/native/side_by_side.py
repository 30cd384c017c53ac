"""Algebra of one item beside that of another, in threads: torch's operations let go of Python's lock."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import torch

from rotorid_torch.core.native.build import threads

Item = TypeVar("Item")
Result = TypeVar("Result")

AT_ONCE = 2
"""Items at work, at most: what is known of one flight takes fifty megabytes."""


def side_by_side(make: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """What is made of each item, in the items' order; by two threads where native loops may have several.

    Items come from the calling thread, one by one as they are needed: what changes a model is done there.
    """
    if threads() == 1 or torch.get_default_device().type != "cpu":
        yield from map(make, items)
        return
    graded, waiting = torch.is_grad_enabled(), deque[Future[Result]]()

    def graded_as_here(item: Item) -> Result:
        with torch.set_grad_enabled(graded):
            return make(item)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        for item in items:
            waiting.append(pool.submit(graded_as_here, item))
            if len(waiting) == AT_ONCE:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
