"""Frames in order, of one camera or of several that are synchronised: from folders, files and videos."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from glob import glob
from itertools import zip_longest
from pathlib import Path

import numpy as np

from cadcam.arrays import Picture
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue, SizeMismatch, UnreadableFile
from cadcam.image import video
from cadcam.image.picture import read_picture_with_info, to_gray
from cadcam.image.suffixes import READABLE
from cadcam.locate.photo import Photo


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What the cameras saw at one moment: a photo each, the file or frame each came from, and its fingerprint."""

    index: int
    photos: tuple[Photo, ...]
    names: tuple[str, ...] = ()
    sha256: tuple[str, ...] = ()

    @classmethod
    def of(cls, index: int, *photos: Photo) -> Frame:
        """Return the frame of photos that are in no file; the fingerprints are of their pixels."""
        names = tuple(f"{photo.viewpoint.name} {index}" for photo in photos)
        return cls(index, photos, names, tuple(_fingerprint(photo.gray) for photo in photos))


class Frames:
    """The frames of sources, one source per viewpoint; may be iterated over repeatedly, pictures are read on the way.

    A source is a folder of pictures (in the order of the numbers in their names), a pattern such as left/*.png, a
    picture, or a video file. The n-th pictures of all sources were taken together.
    """

    def __init__(self, sources: Sequence[str | os.PathLike[str]], viewpoints: Sequence[Viewpoint]) -> None:
        if len(sources) != len(viewpoints) or not sources:
            raise BadValue("number of sources", len(sources), f"one for each of {len(viewpoints)} cameras")
        self.sources = tuple(os.fspath(source) for source in sources)
        self.viewpoints = tuple(viewpoints)
        self._files = [None if _is_video(source) else picture_files(source) for source in self.sources]
        counts = {s: len(files) for s, files in zip(self.sources, self._files, strict=True) if files is not None}
        if len(set(counts.values())) > 1:
            said = ", ".join(f"{source} {count}" for source, count in counts.items())
            raise BadValue("numbers of pictures", said, "as many of each camera: the n-th of all were taken together")
        self.count = next(iter(counts.values()), None) or video.count_frames(self.sources[0])

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames. Raises `UnreadableFile`, or `SizeMismatch` where a picture is not of its camera's size."""
        streams = [_pictures(*pair) for pair in zip(self.sources, self._files, strict=True)]
        for index, shots in enumerate(zip_longest(*streams)):
            there = [shot for shot in shots if shot is not None]
            if len(there) < len(shots):
                ended = next(s for s, shot in zip(self.sources, shots, strict=True) if shot is None)
                raise UnreadableFile(ended, f"ends before frame {index}, the others go on", "give as many of each")
            photos = tuple(_photo(*pair) for pair in zip(there, self.viewpoints, strict=True))
            yield Frame(index, photos, tuple(s.name for s in there), tuple(s.sha256 for s in there))


def picture_files(source: str) -> list[str]:
    """Return the picture files of a folder, a pattern or a single file, in the order of the numbers in their names."""
    if Path(source).is_dir():
        found = [str(p) for p in Path(source).iterdir() if p.suffix.lower() in READABLE]
        if not found:
            raise UnreadableFile(source, "is a folder without pictures", f"pictures end in {' '.join(READABLE)}")
    elif any(c in source for c in "*?[") and not Path(source).exists():
        found = glob(source)  # noqa: PTH207 - a pattern that includes folders, as in a shell
        if not found:
            raise UnreadableFile(source, "no file has such a name", "check the folder and the pattern")
    elif not Path(source).exists():
        raise UnreadableFile(source, "no such file or folder", "check the path")
    else:
        return [source]
    return sorted(found, key=_natural)


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    gray: Picture
    name: str
    sha256: str


def _photo(shot: _Shot, viewpoint: Viewpoint) -> Photo:
    """Return the photo; if its size is not the camera's, raise an error that names the file."""
    try:
        return Photo(shot.gray, viewpoint)
    except SizeMismatch as error:
        raise SizeMismatch(shot.name, error.size, error.expected, "give the camera that took it") from None


def _pictures(source: str, files: list[str] | None) -> Iterator[_Shot]:
    if files is None:
        for number, gray in enumerate(video.read_video(source)):
            yield _Shot(gray, f"{Path(source).name} {number}", _fingerprint(gray))
        return
    for file in files:
        picture, info = read_picture_with_info(file)
        yield _Shot(to_gray(picture), file, info.sha256)


def _is_video(source: str) -> bool:
    return Path(source).suffix.lower() in video.SUFFIXES


def _natural(path: str) -> list[tuple[int, str]]:
    """Return a sort key by which 9.png comes before 10.png."""
    return [(int(text), "") if text.isdecimal() else (-1, text) for text in re.split(r"(\d+)", path)]


def _fingerprint(gray: Picture) -> str:
    return hashlib.sha256(np.ascontiguousarray(gray).tobytes()).hexdigest()
