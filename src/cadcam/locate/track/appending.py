"""Files that grow line by line, each line whole and on disk before the next."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from cadcam.errors import UnwritableFile
from cadcam.whole import FULL, utf8


def opened_to_append(path: str | os.PathLike[str]) -> io.FileIO:
    """Open a file to append to, without a buffer, in which what a full disk does not take would wait and fail again."""
    try:
        return io.FileIO(os.fspath(path), "ab")
    except OSError as error:
        raise UnwritableFile(path, error.strerror or str(error), "choose a place you may write to") from error


def lock(file: io.FileIO, path: str | os.PathLike[str]) -> None:
    """Keep others from writing to a log while it is open here: lines of two runs would stand between each other.

    The system lets go of it when this process ends, however it ends. Where it has no locks, on some network drives,
    nobody is kept away.
    """
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        reason = "another run is writing to it"
        raise UnwritableFile(path, reason, "wait for its end, or name another log") from None
    except OSError:
        return


def write(path: str | os.PathLike[str], lines: Iterable[str]) -> None:
    """Begin a file anew with these lines."""
    try:
        with Path(path).open("wb") as file:
            file.writelines(map(utf8, lines))
    except OSError as error:
        raise UnwritableFile(path, error.strerror or str(error), "choose a place you may write to") from error


def append(file: io.FileIO, line: str) -> int:
    """Append a line and wait until it is on disk; return where it begins. What cannot be written whole is not there."""
    begin, left = file.seek(0, os.SEEK_END), memoryview(utf8(line))
    try:
        while left:
            left = left[file.write(left) :]
        os.fsync(file.fileno())
    except OSError as error:
        with suppress(OSError):
            file.truncate(begin)
        remedy = "free some space, then run it again: it goes on" if error.errno in FULL else "run it again: it goes on"
        raise UnwritableFile(str(file.name), error.strerror or str(error), remedy) from error
    return begin
