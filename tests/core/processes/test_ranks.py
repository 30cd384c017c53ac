"""Ranks: every item has one, sums come out alike for any number of them, a silent one is found out."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch.core.processes.ranks import ALONE, BLOCKS, Ranks, ranks_of_torchrun
from rotorid_torch.errors import InputError

TOGETHER = """
import torch
from rotorid_torch.core.processes.ranks import ranks_of_torchrun
with ranks_of_torchrun() as ranks:
    assert ranks.size == 2
    assert ranks.sum(torch.tensor([ranks.rank + 1.0])).tolist() == [3.0]
    assert ranks.largest(-2.0 * ranks.rank) == 0.0
    assert ranks.largest(float("nan") if ranks.rank else 1.0) != ranks.largest(1.0)
    assert ranks.gather(ranks.rank) == [0, 1]
    assert ranks.from_first(f"of {ranks.rank}") == "of 0"
    assert list(ranks.exchange([[ranks.rank]] * (1 + ranks.rank))) == [0, 1, 1]
    assert ranks.share("abc", lambda letter: letter + str(ranks.rank)) == ["a0", "b1", "c0"]
    assert ranks.share("a", lambda letter: letter + str(ranks.rank)) == [f"a{ranks.rank}"]
    assert ranks.share("", lambda letter: letter) == []
    own, other = f"made of {'ab'[ranks.rank]}", f"{'ab'[1 - ranks.rank]} by {1 - ranks.rank}"
    made, again = lambda one: f"made of {one}", lambda one, rank: f"{one} by {rank}"
    told = ranks.carry("ab", made, lambda made: ranks.rank, again)
    assert told == ([own, other] if ranks.first else [other, own])
"""
SILENT = """
import time
from rotorid_torch.core.processes.ranks import ranks_of_torchrun
from rotorid_torch.errors import LostRank, ReportedElsewhere
try:
    with ranks_of_torchrun(patience=2.0) as ranks:
        if not ranks.first:
            time.sleep(4.0)
        ranks.gather(1)
except (LostRank, ReportedElsewhere) as error:
    print(type(error).__name__, flush=True)
    if ranks.first:
        time.sleep(4.0)  # the first rank holds what the others look into; torchrun itself does under torchrun
"""


def both(code: str) -> tuple[str, str]:
    """What two processes print that run this together."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        place = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free.getsockname()[1])}
    place |= {"OMP_NUM_THREADS": "1", "TORCH_CPP_LOG_LEVEL": "ERROR"}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env={**os.environ, **place, "RANK": rank},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in ("0", "1")
    ]
    told = [process.communicate(timeout=60) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], told
    return told[0][0].strip(), told[1][0].strip()


def test_what_ranks_exchange():
    both(TOGETHER)


def test_a_silent_rank_is_lost_and_told_once():
    assert both(SILENT) == ("LostRank", "ReportedElsewhere")


@given(count=st.integers(1, 150), size=st.integers(1, BLOCKS))
def test_every_item_has_one_rank_and_a_block_lies_at_one_rank_whole(count: int, size: int):
    items = list(range(count))
    ranks = [Ranks(rank, size) for rank in range(size)]
    assert sorted(item for rank in ranks for item in rank.mine(items)) == items
    blocks = [set(rank.blocks(count).tolist()) for rank in ranks]
    assert sum(map(len, blocks)) == len(set().union(*blocks)) == min(count, BLOCKS)
    assert all(len(rank.blocks(count)) == len(rank.mine(items)) for rank in ranks)
    if count <= BLOCKS:
        assert max(map(len, blocks)) - min(map(len, blocks)) <= 1


def test_one_alone_exchanges_with_nobody():
    values = torch.arange(3.0)
    assert ALONE.sum(values) is values
    assert ALONE.largest(2.0) == 2.0
    assert ALONE.gather("own") == ["own"]
    assert ALONE.from_first("own") == "own"
    assert ALONE.share([1, 2], lambda number: 2 * number) == [2, 4]
    assert list(ALONE.exchange([[1, 2], [], [3]])) == [1, 2, 3]
    assert ALONE.first
    with ranks_of_torchrun() as ranks:
        assert ranks == ALONE


def test_a_rank_without_flights_is_refused():
    Ranks(0, 3).refuse_more_than(3)
    with pytest.raises(InputError, match="started 4 processes; expected 3 at most"):
        Ranks(0, 4).refuse_more_than(3)


def test_half_of_what_torchrun_sets_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.delenv("RANK", raising=False)
    with pytest.raises(InputError, match=r"torchrun: cannot be joined: .*RANK expected"), ranks_of_torchrun():
        pass
