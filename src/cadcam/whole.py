"""Files written whole or not at all: no reader ever meets half a picture, mesh or camera."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

from cadcam.errors import UnwritableFile


def write_whole(path: str | os.PathLike[str], data: bytes) -> None:
    """Write `data` to `path` so that the file is either the old one or complete; parent folders are made.

    The bytes go to a temporary file in the same folder, which then replaces `path` in one step. Raises
    `UnwritableFile` with the system's reason.
    """
    target = Path(path)
    try:
        if target.is_dir():
            raise UnwritableFile(path, "is a folder", "name a file in it")
        target.parent.mkdir(parents=True, exist_ok=True)
        _replace(target, data)
    except OSError as error:
        raise UnwritableFile(path, error.strerror or str(error), _remedy(error)) from error


def _remedy(error: OSError) -> str:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    return "free some space, then run it again" if full else "choose a folder you may write to"


def _replace(target: Path, data: bytes) -> None:
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        Path(name).chmod(_mode(target))
        Path(name).replace(target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _mode(target: Path) -> int:
    """Return the old file's permissions or the user's default: mkstemp's 0600 would hide files from others."""
    if target.exists():
        return target.stat().st_mode & 0o7777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
