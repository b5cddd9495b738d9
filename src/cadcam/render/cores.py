"""Independent pieces of work on all cores: Embree and numpy's loops release the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

BLOCK = 1 << 16  # rays or points at a time: their temporaries fit in the cache


def on_all_cores(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return work(item) for each item, in order; `work` must not call this function again.

    A single item is processed in the calling thread: handing it over takes longer than a small scene's whole wireframe.
    """
    items = list(items)
    return [work(item) for item in items] if len(items) < 2 else list(_pool().map(work, items))


def blocks(n: int, size: int = BLOCK) -> list[slice]:
    """Return slices of 0..n of at most `size`; one empty slice for n = 0."""
    return [slice(i, min(i + size, n)) for i in range(0, max(n, 1), size)]


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=os.cpu_count() or 1, thread_name_prefix="cadcam")
