"""Independent pieces of work on all cores: the C core, Embree and numpy's loops release the interpreter's lock.

Threads do not survive a fork, which is how `multiprocessing` starts processes on Linux before Python 3.14, and work
handed to those of the parent would never be done. So each process has threads of its own.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import ParamSpec, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Given = ParamSpec("Given")

BLOCK = 1 << 16  # rays or points at a time: their temporaries fit in the cache
_QUOTA = Path("/sys/fs/cgroup/cpu.max")  # of a container: microseconds of processors' time, in so many of the clock's
_this_thread = threading.local()  # `helps`: whether it is one of `Threads`


class Threads:
    """Threads that work is handed to, at most `count`; they are started as they are needed, in each process anew."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: tuple[int, ThreadPoolExecutor] | None = None

    def submit(self, work: Callable[Given, Result], *args: Given.args, **kwargs: Given.kwargs) -> Future[Result]:
        """Have a thread do some work; return its result to come."""
        process = os.getpid()
        if self._pool is None or self._pool[0] != process:
            self._pool = process, ThreadPoolExecutor(self._count, "cadcam", _help)
        return self._pool[1].submit(work, *args, **kwargs)


def usable_cores() -> int:
    """Return how many processors this process may use: fewer than there are where it, or its container, is limited."""
    try:
        count = len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        count = os.cpu_count() or 1
    return min(count, _quota() or count)


def on_cores(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return work(item) of each item, in order.

    A single item is processed in the calling thread: handing it over takes longer than a small scene's whole wireframe.
    So are the items of work that is handed over itself: threads that wait for each other would do so for ever.
    """
    items = list(items)
    if len(items) < 2 or getattr(_this_thread, "helps", False):
        return [work(item) for item in items]
    threads = _shared(usable_cores())
    under_way = [threads.submit(work, item) for item in items]
    try:
        return [one.result() for one in under_way]
    finally:  # after an error, or Ctrl-C, nobody wants the rest
        for one in under_way:
            one.cancel()


def blocks(n: int, size: int = BLOCK) -> list[slice]:
    """Return slices of 0..n of at most `size`; one empty slice for n = 0."""
    return [slice(i, min(i + size, n)) for i in range(0, max(n, 1), size)]


@cache
def _shared(count: int) -> Threads:
    return Threads(count)


@cache
def _quota() -> int | None:
    """Return how many processors' time a container may use; None where it is not limited."""
    try:
        share, period = _QUOTA.read_text().split()
        return max(1, math.ceil(int(share) / int(period)))
    except (OSError, ValueError, ZeroDivisionError):  # no container, or "max 100000"
        return None


def _help() -> None:
    _this_thread.helps = True
