"""Output files: checked before the work starts, written whole at its end."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.errors import UnknownName, UnwritableFile

if TYPE_CHECKING:
    from cadcam.report.table import Table


def check_target(path: str | None, suffixes: Sequence[str]) -> None:
    """Refuse an output, if any, that could not be written later: before minutes of work, and without side effects."""
    if path is None:
        return
    target = Path(path)
    try:
        folder = target.is_dir()
    except OSError as error:  # a name too long for the system
        raise UnwritableFile(path, error.strerror or str(error), "choose another name") from None
    if folder:
        raise UnwritableFile(path, "is a folder", "name a file in it")
    if target.suffix.lower() not in suffixes:
        raise UnknownName(f"suffix of output {path!r}:", target.suffix or "none", suffixes)
    if target.parent.is_file():
        raise UnwritableFile(path, f"{str(target.parent)!r} is a file, no folder", "name a folder that is there")
    if not target.parent.is_dir():
        raise UnwritableFile(
            path, f"there is no folder {str(target.parent)!r}", f"make it first: mkdir -p {target.parent}"
        )
    for place in (target, target.parent):
        if place.exists() and not os.access(place, os.W_OK):
            raise UnwritableFile(path, f"{place} is read-only", "choose another place, or change its permissions")


def check_folder(path: str | None) -> None:
    """Refuse a folder for results, if any, that could not be one later, as `check_target` does a file."""
    if path is None:
        return
    target = Path(path)
    try:
        there = next(p for p in (target, *target.absolute().parents) if p.exists())
    except OSError as error:  # a name too long for the system
        raise UnwritableFile(path, error.strerror or str(error), "choose another name") from None
    if not there.is_dir():
        raise UnwritableFile(path, f"{str(there)!r} is a file", "name a folder, new or there already")
    if not os.access(there, os.W_OK):
        raise UnwritableFile(path, f"{there} is read-only", "choose another place, or change its permissions")


def refuse_own_folder(path: str | None, read: Iterable[str]) -> None:
    """Refuse a folder for pictures, if any, that holds one of the pictures read.

    Pictures of one name would be lost; a second run on the folder would take what the first one drew for photos.
    """
    folder = None if path is None else Path(path).resolve()
    if folder in {Path(picture).parent.resolve() for picture in read}:
        raise UnwritableFile(str(path), "holds the pictures that are read", "name another folder for what is drawn")


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON document to stdout, in UTF-8 whatever the terminal's characters are."""
    from cadcam.files.jsontext import as_json

    _write(as_json(document))


def print_json_line(document: dict[str, Any]) -> None:
    """Print a JSON document in one line, at once: who reads it need not wait for the next."""
    from cadcam.files.jsontext import json_line
    from cadcam.whole import utf8

    _write(utf8(json_line(document) + "\n"))
    sys.stdout.flush()


def _write(said: bytes) -> None:
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.flush()
        sys.stdout.buffer.write(said)
    else:
        sys.stdout.write(said.decode())


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables to stdout."""
    from cadcam.report.table import show

    show(tables, sys.stdout)


def say(text: str) -> None:
    """Print a message to stderr, out of the way of results."""
    print(text, file=sys.stderr)


def say_written(*paths: str | None) -> None:
    """Say which files were written; None for those that were not asked for."""
    for path in paths:
        if path is not None:
            say(f"wrote {path}")


@contextmanager
def working(text: str) -> Iterator[None]:
    """Show on a terminal what is going on while it lasts; say nothing anywhere else."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(file=sys.stderr).status(text):
        yield


@contextmanager
def counting(text: str, what: str) -> Iterator[Callable[[int], None]]:
    """Show on a terminal what is going on while it lasts; yield what to call with how many there are so far."""
    if not sys.stderr.isatty():
        yield lambda count: None
        return
    from rich.console import Console

    with Console(file=sys.stderr).status(text) as status:
        yield lambda count: status.update(f"{text}: {count} {what}")


@contextmanager
def stages(first: str) -> Iterator[Callable[[str, int, int], None]]:
    """Show on a terminal a bar for each stage of some work, the `first` without a count.

    Yield what to call with a stage's name, the number of its pieces that are done, and of all; it may begin again.
    """
    if not sys.stderr.isatty():
        yield lambda stage, done, pieces: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(file=sys.stderr)) as bar:
        tasks = {first: bar.add_task(first, total=None)}

        def tell(stage: str, done: int, pieces: int) -> None:
            bar.update(tasks[first], total=1, completed=1)
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage)
            elif bar.tasks[tasks[stage]].finished and done == 0:
                bar.reset(tasks[stage])
            bar.update(tasks[stage], completed=done, total=pieces)

        yield tell


@contextmanager
def progress(text: str, total: int) -> Iterator[Callable[[], None]]:
    """Show on a terminal a bar with count, rate and time left; yield what to call after each of `total` pieces."""
    if not sys.stderr.isatty():
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(file=sys.stderr)) as bar:
        task = bar.add_task(text, total=total, rate="")

        def step() -> None:
            speed = bar.tasks[task].speed
            bar.update(task, advance=1, rate=f"{speed:.3g} a second" if speed else "")

        yield step
