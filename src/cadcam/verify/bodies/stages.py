"""How far an inspection has come: its stages, and of each how many pieces are done."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

Stages = Callable[[str, int, int], None]  # called with a stage's name, the number of its pieces done, and of all
T = TypeVar("T")


def untold(stage: str, done: int, pieces: int) -> None:
    """Do nothing: the default."""


def each(things: Sequence[T], stage: str, tell: Stages) -> Iterator[T]:
    """Yield things, telling before each how many are done, and at the end that all are."""
    for number, thing in enumerate(things):
        tell(stage, number, len(things))
        yield thing
    if things:
        tell(stage, len(things), len(things))
