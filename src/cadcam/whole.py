"""Files written whole or not at all: no reader ever meets half a picture, mesh or camera."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from cadcam.errors import UnwritableFile

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # of a disk, a user's share of it, or the largest file
_NO_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.ENOSYS}  # of file systems that cannot be asked to have it on the disk
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)


def write_whole(path: str | os.PathLike[str], data: bytes | Iterable[bytes], *, durable: bool = True) -> None:
    """Write `data` to `path` so that the file is either the old one or complete; parent folders are made.

    data: the bytes, or pieces of them that are asked for one after the other, of a file larger than should be in
    memory; where one of them cannot be had, the old file stays, and the error that says so goes on.

    The bytes go to a temporary file in the same folder, which then replaces `path` in one step. durable: they are on
    the disk before, so that a power cut leaves no half file either, and the name is when this returns, where the system
    allows it. That takes a few ms on a solid-state disk; without it the system writes when it likes, and a power cut
    within half a minute may leave the name of a file that is empty or short. Of a symbolic link the
    file that it names is written; what is no file, such as /dev/stdout, takes the bytes as they come. Raises
    `UnwritableFile` with the system's reason.
    """
    pieces = (data,) if isinstance(data, bytes) else data
    try:
        try:
            _replace(os.fspath(path), pieces, durable)
        except FileNotFoundError:  # mostly the folder is there; no piece was asked for yet
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            _replace(os.fspath(path), pieces, durable)
    except OSError as error:
        raise UnwritableFile(path, error.strerror or str(error), _remedy(error)) from error
    except ValueError as error:  # a zero byte in the name
        raise UnwritableFile(repr(path), str(error), "choose another name") from None


def utf8(text: str) -> bytes:
    r"""Return text as the bytes of a file, whatever names are in it.

    Linux takes any bytes for a name, such as those of a disk in Latin-1. Python keeps what is no text of them as lone
    surrogates, which neither UTF-8 nor a database takes: here they are spelled out, as \udcfc.
    """
    return text.encode(errors="backslashreplace")


def plain(text: str) -> str:
    """Return text with what is no text in it spelled out, as by `utf8`."""
    return utf8(text).decode()


def _remedy(error: OSError) -> str:
    return "free some space, then run it again" if error.errno in FULL else "choose a folder you may write to"


def _replace(target: str, data: Iterable[bytes], durable: bool) -> None:
    old = _mode(target, os.lstat)
    if old is not None and stat.S_ISLNK(old):
        old = _mode(target, os.stat)
        if old is None or stat.S_ISREG(old):
            target = os.path.realpath(target)
    if old is not None and stat.S_ISDIR(old):
        raise UnwritableFile(target, "is a folder", "name a file in it")
    if old is not None and not stat.S_ISREG(old):
        _write(target, os.O_WRONLY, data, durable=False)
        return
    half = os.path.join(os.path.dirname(target), f".{secrets.token_hex(8)}.part")
    try:
        _write(half, _NEW, data, durable=durable)
        if old is not None:
            os.chmod(half, stat.S_IMODE(old))  # the permissions of the file that is there stay
        os.replace(half, target)
    except BaseException:
        with suppress(FileNotFoundError):
            os.unlink(half)
        raise
    if durable:
        _sync_folder(os.path.dirname(target) or os.curdir)


def _sync_folder(folder: str) -> None:
    """Have the names in a folder on the disk; where the system does not let it be opened (Windows), it sees to that."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _write(path: str, how: int, data: Iterable[bytes], *, durable: bool) -> None:
    """Write a file by the system's own calls: Python's ask more of it, and a data set has seven files a view."""
    file = os.open(path, how, 0o666)
    try:
        for piece in data:
            left = memoryview(piece)
            while left:  # once, or where a disk is nearly full a few times
                left = left[os.write(file, left) :]
        if durable:
            _sync(file)
    finally:
        os.close(file)


def _sync(file: int) -> None:
    try:
        os.fsync(file)
    except OSError as error:
        if error.errno not in _NO_SYNC:  # such as a disk that is full, or broken: the bytes are not there
            raise


def _mode(path: str, status: Callable[[str], os.stat_result]) -> int | None:
    """Return the kind and permissions of what is there, None where nothing is."""
    try:
        return status(path).st_mode
    except FileNotFoundError:
        return None
