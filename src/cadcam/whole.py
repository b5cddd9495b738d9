"""Files written whole or not at all: no reader ever meets half a picture, mesh or camera."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

from cadcam.errors import UnwritableFile

_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)


def write_whole(path: str | os.PathLike[str], data: bytes) -> None:
    """Write `data` to `path` so that the file is either the old one or complete; parent folders are made.

    The bytes go to a temporary file in the same folder, which then replaces `path` in one step. Raises
    `UnwritableFile` with the system's reason.
    """
    try:
        try:
            _replace(os.fspath(path), data)
        except FileNotFoundError:  # mostly the folder is there
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            _replace(os.fspath(path), data)
    except OSError as error:
        raise UnwritableFile(path, error.strerror or str(error), _remedy(error)) from error


def _remedy(error: OSError) -> str:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    return "free some space, then run it again" if full else "choose a folder you may write to"


def _replace(target: str, data: bytes) -> None:
    old = _mode(target)
    folder, name = os.path.split(target)
    half = os.path.join(folder, f".{name}.{secrets.token_hex(4)}")
    try:
        _write(half, data)
        if old is not None:
            os.chmod(half, old)
        os.replace(half, target)
    except BaseException:
        with suppress(FileNotFoundError):
            os.unlink(half)
        raise


def _write(path: str, data: bytes) -> None:
    """Write a new file by the system's own calls: Python's ask more of it, and a data set has seven files a view."""
    file, left = os.open(path, _NEW, 0o666), memoryview(data)
    try:
        while left:  # once, or where a disk is nearly full a few times
            left = left[os.write(file, left) :]
    finally:
        os.close(file)


def _mode(target: str) -> int | None:
    """Return the permissions of the file that is there, which stay; None where there is none."""
    try:
        mode = os.stat(target).st_mode
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(mode):
        raise UnwritableFile(target, "is a folder", "name a file in it")
    return mode & 0o7777
