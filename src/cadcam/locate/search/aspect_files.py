"""Aspects cached on disk between runs: for a model of some thousand triangles computing them takes seconds.

A file holds the aspects of one part and is named by the hash of its scene, so a changed model has another file.
It is written whole or not at all, and ends with a digest; what a damaged one held is computed anew.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import numpy as np

from cadcam.errors import UnwritableFile
from cadcam.locate.part import Part
from cadcam.locate.views.aspects import Aspect
from cadcam.locate.views.drawing import SIZE
from cadcam.locate.views.pieces import PLACES
from cadcam.native.fields import PLACE
from cadcam.whole import write_whole

_VERSION = 5  # of the format of aspects: files of other versions have other names
_NAMES = ("key", "distance", "length", "count", "places", "line", "telling")
_DIGEST = 32  # bytes of it
_MOST_BYTES = 256 * 2**20  # of all files together; the oldest are removed


def file_of(part: Part, folder: Path) -> Path:
    """Return the cache file of a part's aspects."""
    digest = hashlib.sha256(f"{_VERSION} {PLACES} {SIZE} {part.scene.sha256}".encode())
    digest.update(np.ascontiguousarray(part.aspects.net).tobytes())
    return folder / f"{digest.hexdigest()[:32]}.npz"


def read_aspects(part: Part, folder: Path) -> int:
    """Add the cached aspects to a part; return how many, 0 where there is no file, or a damaged one."""
    aspects = part.aspects
    try:
        data = file_of(part, folder).read_bytes()
    except OSError:
        return 0
    if data[-_DIGEST:] != _digest(data[:-_DIGEST]):
        return 0
    with np.load(io.BytesIO(data[:-_DIGEST]), allow_pickle=False) as kept:
        rows = {name: kept[name] for name in _NAMES}
    ends = np.cumsum(rows["count"])[:-1]
    runs = zip(*(np.split(rows[name], ends) for name in ("places", "line", "telling")), strict=True)
    of_each = zip(rows["key"], rows["distance"], rows["length"], runs, strict=True)
    made = {
        (int(d), int(s)): Aspect(
            aspects.net[d], float(far), places.astype(PLACE), line, telling.astype(PLACE), float(length)
        )
        for (d, s), far, length, (places, line, telling) in of_each
    }
    aspects.take(made)
    return len(made)


def write_aspects(part: Part, folder: Path) -> None:
    """Cache all aspects computed for a part; does nothing where the folder cannot be written to."""
    made = part.aspects.made
    if not made:
        return
    every = list(made.values())
    buffer = io.BytesIO()
    np.savez(
        buffer,
        key=np.array(list(made), np.int32).reshape(-1, 2),
        distance=np.array([a.distance for a in every]),
        length=np.array([a.length for a in every]),
        count=np.array([len(a.places) for a in every]),
        places=np.concatenate([a.places for a in every]),
        line=np.concatenate([a.line for a in every]),
        telling=np.concatenate([a.telling for a in every]),
    )
    try:
        write_whole(file_of(part, folder), buffer.getvalue() + _digest(buffer.getvalue()))
        _forget(folder)
    except (OSError, UnwritableFile):
        return


def _digest(data: bytes) -> bytes:
    """Return what ends a file: of damaged ones `numpy.load` and `zipfile` raise more kinds of errors than they say."""
    return hashlib.sha256(data).digest()


def _forget(folder: Path) -> None:
    """Remove the oldest files beyond `_MOST_BYTES`."""
    files = sorted(folder.glob("*.npz"), key=lambda file: -file.stat().st_mtime)
    sizes = np.cumsum([file.stat().st_size for file in files])
    for file in (f for f, total in zip(files, sizes, strict=True) if total > _MOST_BYTES):
        file.unlink(missing_ok=True)
