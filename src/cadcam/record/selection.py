"""The records of a store that matched at one moment, read a few at a time: there may be more than memory holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import TypeVar

from cadcam.record.record import Record

_Item = TypeVar("_Item")
AT_ONCE = 500  # records: some MB; a statement takes that many ids in SQLite and in PostgreSQL


class Selection:
    """Records of a store, oldest first; made by `Store.select`.

    Which they are is settled: what is added later is not among them. They may be gone through as often as one likes,
    while the store is open; a writer waits for a batch of them, not for all.
    """

    def __init__(
        self,
        ids: Sequence[str],
        read: Callable[[Sequence[str]], list[Record]],
        roles: Callable[[Sequence[str]], set[str]],
    ) -> None:
        self._ids, self._read, self._roles = ids, read, roles

    def __len__(self) -> int:
        return len(self._ids)

    def __iter__(self) -> Iterator[Record]:
        for some in batches(self._ids):
            yield from self._read(some)

    def __repr__(self) -> str:
        return f"Selection({len(self)} records)"

    def roles(self) -> set[str]:
        """Return the roles of all their sources; no record is read."""
        return set().union(*(self._roles(some) for some in batches(self._ids)))


def batches(items: Iterable[_Item]) -> Iterator[list[_Item]]:
    """Yield items some at a time, as they are asked for."""
    rest = iter(items)
    while some := list(islice(rest, AT_ONCE)):
        yield some
