"""Items by name that are made when they are asked for: a thousand flights in the memory of a few dozen."""

import os
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import IO, Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core.storage.atomic import writing_temporary

Item = TypeVar("Item")

BUDGET = 64 * 2**20
"""Bytes of items that stay in memory; a few dozen flights of a quarter of a minute."""


class OnDemand(Mapping[str, Item], Generic[Item]):
    """Items by name, each made when first asked for; those used last stay in memory.

    What leaves the memory is made again when it is wanted again, or, where that is costly, read from a temporary file
    that ends with this mapping, however the process dies. What fits into the budget is made once and stays.

    names : of the items, in order.
    make : gives the item of a name; None where `keep` hands over all of them.
    costly : write what leaves the memory to disk; items are then dataclasses, with float64 tensors, also in dicts.
    budget : bytes in memory, `BUDGET` by default; the item used last stays whatever its size.
    """

    def __init__(
        self,
        names: Iterable[str],
        make: Callable[[str], Item] | None = None,
        *,
        costly: bool = False,
        budget: int | None = None,
    ) -> None:
        self._names = tuple(names)
        self._places = {name: i for i, name in enumerate(self._names)}
        self._make, self._costly = make, costly
        self._budget = BUDGET if budget is None else budget
        self._memory: dict[str, tuple[Item, int]] = {}  # used last stands last
        self._bytes = 0
        self._disk: IO[bytes] | None = None
        self._written: dict[str, tuple[int, type[Item], Any]] = {}  # place on disk, and how to put it together

    def __getitem__(self, name: str) -> Item:
        if name in self._memory:
            self._memory[name] = self._memory.pop(name)
            return self._memory[name][0]
        if name in self._written:
            item = self._read(name)
        elif self._make is not None and name in self._places:
            item = self._make(name)
        else:
            raise KeyError(name)
        self.keep(name, item)
        return item

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __reduce__(self) -> tuple[Any, ...]:
        """For other processes, which have neither the temporary file nor what makes items: all of them, as a dict."""
        return dict, (dict(self),)

    def keep(self, name: str, item: Item) -> None:
        """Take an item that is already made."""
        size = _bytes(item)
        self._memory[name] = item, size
        self._bytes += size
        while self._bytes > self._budget and len(self._memory) > 1:
            oldest = next(iter(self._memory))
            gone, size = self._memory.pop(oldest)
            self._bytes -= size
            if self._costly and oldest not in self._written:
                self._write(oldest, gone)

    def _write(self, name: str, item: Item) -> None:
        parts: list[Tensor] = []
        form = _taken_apart(vars(item), parts)
        with writing_temporary():
            if self._disk is None:
                self._disk = tempfile.TemporaryFile(prefix="rotorid-", buffering=0)
                weakref.finalize(self, self._disk.close)
            place = self._disk.seek(0, os.SEEK_END)
            left = memoryview(torch.cat(parts).numpy().view(np.uint8).data)
            while left:  # a call may write less than it was given
                left = left[self._disk.write(left) :]
        self._written[name] = place, type(item), form

    def _read(self, name: str) -> Item:
        assert self._disk is not None
        place, kind, form = self._written[name]
        sizes = _sizes(form)
        self._disk.seek(place)
        numbers = torch.from_numpy(np.fromfile(self._disk, count=sum(sizes)))
        return kind(**_put_together(form, iter(numbers.split(sizes))))


def _bytes(item: Any) -> int:
    if isinstance(item, Tensor):
        return item.nbytes
    if isinstance(item, Mapping):
        return sum(map(_bytes, item.values()))
    return sum(map(_bytes, vars(item).values())) if hasattr(item, "__dict__") else 0


def _taken_apart(value: Any, parts: list[Tensor]) -> Any:
    """The value with shapes in place of its tensors, whose numbers are appended to `parts` in order."""
    if isinstance(value, Tensor):
        parts.append(value.detach().reshape(-1))
        return value.shape
    return {key: _taken_apart(v, parts) for key, v in value.items()} if isinstance(value, Mapping) else value


def _sizes(form: Any) -> list[int]:
    """How many numbers each tensor has, in order."""
    if isinstance(form, torch.Size):
        return [form.numel()]
    return [size for part in form.values() for size in _sizes(part)] if isinstance(form, Mapping) else []


def _put_together(form: Any, parts: Iterator[Tensor]) -> Any:
    """The value that was taken apart."""
    if isinstance(form, torch.Size):
        return next(parts).reshape(form)
    return {key: _put_together(part, parts) for key, part in form.items()} if isinstance(form, Mapping) else form
