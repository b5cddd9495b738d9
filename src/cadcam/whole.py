"""Files written whole or not at all: no reader ever meets half a picture, mesh or camera."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from pathlib import Path

from cadcam.errors import UnwritableFile


def write_whole(path: str | os.PathLike[str], data: bytes) -> None:
    """Write `data` to `path` so that the file is either the old one or complete; parent folders are made.

    The bytes go to a temporary file in the same folder, which then replaces `path` in one step. Raises
    `UnwritableFile` with the system's reason.
    """
    target = Path(path)
    try:
        try:
            _replace(target, data)
        except FileNotFoundError:  # mostly the folder is there
            target.parent.mkdir(parents=True, exist_ok=True)
            _replace(target, data)
    except OSError as error:
        raise UnwritableFile(path, error.strerror or str(error), _remedy(error)) from error


def _remedy(error: OSError) -> str:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    return "free some space, then run it again" if full else "choose a folder you may write to"


def _replace(target: Path, data: bytes) -> None:
    old = _mode(target)
    name = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    try:
        with name.open("xb", buffering=0) as file:  # a call of the system, or where a disk is nearly full a few
            left = memoryview(data)
            while left:
                left = left[file.write(left) :]
        if old is not None:
            name.chmod(old)
        name.replace(target)
    except BaseException:
        name.unlink(missing_ok=True)
        raise


def _mode(target: Path) -> int | None:
    """Return the permissions of the file that is there, which stay; None where there is none."""
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(mode):
        raise UnwritableFile(target, "is a folder", "name a file in it")
    return mode & 0o7777
