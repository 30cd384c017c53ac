"""Large arrays: ordinary tensors whose numbers survive leaving the process, and a full disk that is told."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

import pytest
import torch

from rotorid_torch.core.storage import mapped_arrays
from rotorid_torch.errors import InputError

ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a process' pages in /proc")


def in_memory() -> int:
    """Bytes of files' pages that are in this process."""
    lines = (line.split() for line in Path("/proc/self/status").read_text().splitlines())
    return 1024 * sum(int(line[1]) for line in lines if line[0] in ("RssFile:", "RssShmem:"))


@ON_LINUX
def test_pages_leave_the_process_and_numbers_stay() -> None:
    array = mapped_arrays.empty(8, 1024, 1024).copy_(torch.arange(8.0, dtype=torch.float64)[:, None, None])
    before = in_memory()
    mapped_arrays.let_go()
    assert before - in_memory() > 0.9 * array.nbytes
    assert array.mean(dim=(1, 2)).tolist() == list(range(8))


def test_a_copy_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapped_arrays, "LARGE", 0)
    one = mapped_arrays.empty(3, 2).fill_(1.0)
    other = mapped_arrays.copied(one)
    other[1] = 5.0
    mapped_arrays.let_go()
    assert one.tolist() == [[1.0, 1.0]] * 3
    assert other.tolist() == [[1.0, 1.0], [5.0, 5.0], [1.0, 1.0]]


def test_an_empty_array_needs_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapped_arrays, "LARGE", 0)
    assert mapped_arrays.empty(4, 0).shape == (4, 0)


@ON_LINUX
def test_a_disk_that_is_full_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(InputError, match="No space left"):
        mapped_arrays.empty(mapped_arrays.LARGE)
