"""The available memory, checked before it is used; and picture buffers that are reused once no view needs them."""

from __future__ import annotations

import os
import weakref
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cadcam.errors import NotEnoughMemory

_CGROUP = Path("/sys/fs/cgroup")
_DROPPED = ("inactive_file", "active_file")  # of memory.stat: what was read and written, and need not be kept


def available_bytes() -> int | None:
    """Return the memory available without swapping, None where the system does not report it."""
    known = [n for n in (_meminfo(), _cgroup()) if n is not None]
    if known:
        return min(known)
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def check_memory(need: int, what: str) -> None:
    """Raise `NotEnoughMemory` if `what` needs more bytes than are available."""
    have = available_bytes()
    if have is not None and need > have:
        raise NotEnoughMemory(
            f"{what} needs {need / 2**30:.1f} GiB of memory and {have / 2**30:.1f} GiB are free; "
            "ask for fewer channels, less supersampling or a smaller picture (Camera.resize, Camera.crop)"
        )


class Buffers:
    """Arrays for pictures, reused once every view of them is gone: fresh memory costs more than rendering."""

    def __init__(self, keep: int = 12) -> None:
        self._keep = keep
        self._free: list[npt.NDArray[np.uint8]] = []

    def take(self, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[np.generic]:
        """Return an array of this shape and type with arbitrary contents."""
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        store = next((b for b in self._free if b.nbytes == size), None)
        if store is None:
            store = np.zeros(size, np.uint8)
        else:
            self._free = [b for b in self._free if b is not store]
        # over a memoryview, numpy keeps *this* array as the base of every view and slice: it is freed with the last
        owner = np.frombuffer(store.data, dtype)
        weakref.finalize(owner, self._give_back, store)
        return owner.reshape(shape)

    def _give_back(self, store: npt.NDArray[np.uint8]) -> None:
        self._free = [*self._free, store][-self._keep :]


def _meminfo() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return None


def _cgroup() -> int | None:
    """Return what a container's limit leaves; copies of files in memory count as free, as the system drops them first.

    Without that a run that writes many files would soon be told that nothing is left.
    """
    try:
        limit = (_CGROUP / "memory.max").read_text().strip()
        if limit == "max":
            return None
        used = int((_CGROUP / "memory.current").read_text())
        held = dict(line.split() for line in (_CGROUP / "memory.stat").read_text().splitlines())
        return int(limit) - used + sum(int(held.get(name, 0)) for name in _DROPPED)
    except (OSError, ValueError):
        return None
