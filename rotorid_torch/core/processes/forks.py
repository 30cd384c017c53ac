"""Forks of this process: a result that is not needed yet is made on another processor while this one goes on."""

import multiprocessing
import os
import pickle
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import torch

Item = TypeVar("Item")
Made = TypeVar("Made")


def forked(make: Callable[[], Made]) -> Callable[[], Made]:
    """Begin to make a result in a forked process; the function that is returned waits for the result.

    The process has all that this one has at the fork, and may write none of its files. It has one thread for torch and
    for the native loops, as torch's own loaders of data have. Where there is one processor, or a system that does not
    fork safely, and where the process fails or is lost, the result is made here, and what is raised is raised here.
    """
    may_fork = sys.platform == "linux" and not multiprocessing.current_process().daemon  # a daemon has no children
    if not may_fork or len(os.sched_getaffinity(0)) < 2:
        return cache(make)
    forks = multiprocessing.get_context("fork")
    receiving, sending = forks.Pipe(duplex=False)
    process = forks.Process(target=_send, args=(make, sending), daemon=True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads
            process.start()
    except OSError:  # no room for another process
        return cache(make)
    sending.close()

    @cache
    def result() -> Made:
        try:
            return pickle.loads(receiving.recv_bytes())
        except EOFError:
            return make()
        finally:
            receiving.close()
            process.kill()  # all is said; at its end it might wait for a lock that a thread held at the fork
            process.join()

    return result


def forked_each(
    items: Sequence[Item],
    make: Callable[[Item], Made],
    message: Callable[[Made], object],
    again: Callable[[Item, Any], Made],
) -> list[Made]:
    """What is made of each item, in their order; of every second one in a forked process.

    message : what travels of a result, little beside the work; again : makes it once more of that.
    """
    if len(items) < 2:
        return [make(item) for item in items]
    others = forked(lambda: [message(make(item)) for item in items[1::2]])
    results = {2 * k: make(item) for k, item in enumerate(items[::2])}
    results |= {2 * k + 1: again(item, said) for k, (item, said) in enumerate(zip(items[1::2], others(), strict=True))}
    return [results[k] for k in range(len(items))]


def _send(make: Callable[[], object], sending: Connection) -> None:
    """What the other process does; what it raises it keeps to itself."""
    os.environ["ROTORID_THREADS"] = "1"
    torch.set_num_threads(1)
    with suppress(Exception, KeyboardInterrupt):
        sending.send_bytes(pickle.dumps(make()))
