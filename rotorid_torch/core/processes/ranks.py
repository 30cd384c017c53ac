"""Processes that share a run (torchrun's ranks): which flights each takes, and sums that come out alike for any number.

A sum over flights is made block by block: a flight's place in its list says its block, a block lies at one rank whole,
and the blocks are added in their order at every rank. So one rank and several round in the same way.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

import torch
import torch.distributed as distributed
from torch import Tensor
from torch.distributed.rendezvous import rendezvous

from rotorid_torch.errors import InputError, LostRank, ReportedElsewhere

Item = TypeVar("Item")
Made = TypeVar("Made")
Message = TypeVar("Message")

BLOCKS = 40
"""Blocks of flights that sums are made of, at most."""
PATIENCE_S = 600.0
"""How long a rank waits for the others; they do the same work on about as many flights."""
PATIENCE_FOR_FITS_S = 3600.0
"""The same where whole fits are spread, of which one rank may have one more than another."""


@dataclass(frozen=True)
class Ranks:
    """One process of the several of a run, alone by default; every rank calls the same methods in the same order.

    rank, size : this process' number from 0 on, and how many there are.
    """

    rank: int = 0
    size: int = 1

    @property
    def first(self) -> bool:
        """Whether this is the rank that writes and speaks."""
        return self.rank == 0

    def mine(self, items: Sequence[Item]) -> list[Item]:
        """The items that are this rank's to work on."""
        return [item for place, item in enumerate(items) if place % BLOCKS % self.size == self.rank]

    def blocks(self, count: int) -> Tensor:
        """Block of each of this rank's items of a list of so many."""
        return torch.tensor(self.mine([place % BLOCKS for place in range(count)]), dtype=torch.int64)

    def sum(self, tensor: Tensor) -> Tensor:
        """Sum over the ranks in their order; the same shape [...] at each."""
        if self.size == 1:
            return tensor
        local = tensor.cpu().contiguous()  # what ranks exchange is small, and the processor's on every machine
        parts = [torch.empty_like(local) for _ in range(self.size)]
        _joined(lambda: distributed.all_gather(parts, local))
        return torch.stack(parts).sum(dim=0).to(tensor.device)

    def largest(self, number: float) -> float:
        """The largest of the ranks' numbers; NaN where one is."""
        if self.size == 1:
            return number
        return float(self._all(torch.tensor([number], dtype=torch.float64)).amax())

    def _all(self, tensor: Tensor) -> Tensor:
        numbered = tensor.new_zeros(self.size, *tensor.shape)
        numbered[self.rank] = tensor
        return self.sum(numbered)

    def gather(self, item: Item) -> list[Item]:
        """Every rank's item, in the order of ranks, at each."""
        if self.size == 1:
            return [item]
        gathered: list[Any] = [None] * self.size
        _joined(lambda: distributed.all_gather_object(gathered, item))
        return gathered

    def exchange(self, parts: Iterable[list[Item]]) -> Iterator[Item]:
        """Items of all ranks at each, part by part as they are made."""
        if self.size == 1:
            for part in parts:
                yield from part
            return
        local, nothing = iter(parts), list[Item]()
        while True:
            gathered = self.gather(next(local, nothing))
            if not any(gathered):
                return
            for part in gathered:
                yield from part

    def share(self, items: Sequence[Item], make: Callable[[Item], Made]) -> list[Made]:
        """What is made of each item, by one rank each; all of it at every rank, in the items' order."""
        return self.carry(items, make, lambda item: item, lambda item, result: result)

    def carry(
        self,
        items: Sequence[Item],
        make: Callable[[Item], Made],
        message: Callable[[Made], Message],
        again: Callable[[Item, Message], Made],
    ) -> list[Made]:
        """The same for what cannot travel: `message` is what does, and `again` makes it once more at the other ranks.

        One item alone is made at every rank, for the others would only wait for it.
        """
        if self.size == 1 or len(items) == 1:
            return [make(item) for item in items]
        local = {place: make(items[place]) for place in self.mine(range(len(items)))}
        messages = dict[int, Message]()
        for part in self.gather({place: message(result) for place, result in local.items()}):
            messages |= part
        return [local[k] if k in local else again(item, messages[k]) for k, item in enumerate(items)]

    def from_first(self, item: Item) -> Item:
        """The first rank's item, at each."""
        if self.size == 1:
            return item
        held: list[Any] = [item if self.first else None]
        _joined(lambda: distributed.broadcast_object_list(held, src=0))
        return held[0]

    def refuse_more_than(self, flights: int) -> None:
        """Raise InputError where a rank would have no flight."""
        most = min(flights, BLOCKS)
        if self.size > most:
            raise InputError("torchrun", "", f"started {self.size} processes", f"{most} at most for {flights} flights")


ALONE = Ranks()
"""One process and nobody else."""


def _joined(exchange: Callable[[], object]) -> None:
    """Exchange with the others; LostRank where one of them is gone or silent."""
    try:
        exchange()
    except RuntimeError as error:
        raise LostRank from error


@contextmanager
def ranks_of_torchrun(patience: float = PATIENCE_S) -> Iterator[Ranks]:
    """The ranks that torchrun (or its environment variables RANK, WORLD_SIZE, MASTER_ADDR, MASTER_PORT) has started.

    One process alone without them; InputError where only some are set. Where the block fails at several ranks, all but
    the first to fail raise `ReportedElsewhere`.

    patience : s until a rank that does not answer counts as lost.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Ranks()
        return
    try:
        met = timedelta(seconds=min(patience, PATIENCE_S))
        store, rank, size = next(iter(rendezvous("env://", timeout=met)))
        wait = timedelta(seconds=patience)
        distributed.init_process_group("gloo", store=store, rank=rank, world_size=size, timeout=wait)
    except RuntimeError as error:
        raise LostRank from error
    except ValueError as error:
        wanted = "all four variables that torchrun sets, or none"
        raise InputError("torchrun", "", f"cannot be joined: {error}", wanted) from error
    try:
        yield Ranks(rank, size)
    except BaseException as error:
        if not _first_to_report(store):
            raise ReportedElsewhere(error) from error
        raise
    finally:
        distributed.destroy_process_group()


def _first_to_report(store: Any) -> bool:
    try:
        return store.add("rotorid/failed", 1) == 1
    except RuntimeError:  # the store has gone with the rank that held it
        return True
