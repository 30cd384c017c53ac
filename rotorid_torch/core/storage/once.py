"""Results that belong to an object and do not change: computed once, and let go of with the object."""

import functools
from collections.abc import Callable
from typing import TypeVar
from weakref import WeakKeyDictionary

Subject = TypeVar("Subject")
Result = TypeVar("Result")


def once(function: Callable[[Subject], Result]) -> Callable[[Subject], Result]:
    """The function of an object that never changes, called once for each object as long as that lives."""
    results: WeakKeyDictionary[Subject, Result] = WeakKeyDictionary()

    @functools.wraps(function)
    def result(subject: Subject) -> Result:
        if subject not in results:
            results[subject] = function(subject)
        return results[subject]

    return result
