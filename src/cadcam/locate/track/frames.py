"""Frames in order, of one camera or of several that are synchronised: from folders, files and videos."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from glob import glob
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Brief, Picture
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue, SizeMismatch, UnreadableFile
from cadcam.image import video
from cadcam.image.camera_picture import FullScale, full_scale_of, read_camera_picture_with_info
from cadcam.image.picture import check_full_scale, to_gray
from cadcam.image.suffixes import READABLE, natural_order
from cadcam.kinds import expect_each, expect_several, said
from cadcam.locate.photo import Photo


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Frame(Brief):
    """What the cameras saw at one moment: a photo each, the file or frame each came from, and its fingerprint.

    whites: the stored value that was taken as white in each; none for photos that are in no file.
    """

    index: int
    photos: tuple[Photo, ...]
    names: tuple[str, ...] = ()
    sha256: tuple[str, ...] = ()
    whites: tuple[float, ...] = ()

    @classmethod
    def of(cls, index: int, *photos: Photo) -> Frame:
        """Return the frame of photos that are in no file; the fingerprints are of their pixels."""
        names = tuple(f"{photo.viewpoint.name} {index}" for photo in photos)
        return cls(index, photos, names, tuple(_fingerprint(photo.gray) for photo in photos))

    def only(self, photos: Sequence[int]) -> Frame:
        """Return the frame with the photos of these numbers alone."""
        return Frame(self.index, *(_some(of, photos) for of in (self.photos, self.names, self.sha256, self.whites)))


def _some(each: tuple[Any, ...], numbers: Sequence[int]) -> tuple[Any, ...]:
    """Return the entries of these numbers, none where there are none."""
    return tuple(each[k] for k in numbers) if each else ()


class Frames:
    """The frames of sources, one source per viewpoint; may be iterated over repeatedly, pictures are read on the way.

    A source is a folder of pictures (in the order of the numbers in their names), a pattern such as left/*.png, a
    picture, or a video file. The n-th pictures of all sources were taken together.

    full_scale: the stored value of white in pictures of more than 8 bits, as for `read_camera_picture`. By default all
    16-bit pictures of a source are read once beforehand, for the one white that none of them exceeds.
    """

    def __init__(
        self,
        sources: Sequence[str | os.PathLike[str]],
        viewpoints: Sequence[Viewpoint],
        *,
        full_scale: float | None = None,
    ) -> None:
        viewpoints = expect_each(viewpoints, "viewpoints", Viewpoint)
        sources = _sources(sources)
        check_full_scale(full_scale)
        if len(sources) != len(viewpoints) or not sources:
            raise BadValue("number of sources", len(sources), f"one for each of {len(viewpoints)} cameras")
        self.sources: tuple[str, ...] = tuple(os.fspath(source) for source in sources)
        self.viewpoints: tuple[Viewpoint, ...] = tuple(viewpoints)
        self._full_scale = full_scale
        self._files = [None if _is_video(source) else picture_files(source) for source in self.sources]
        counts = {s: len(files) for s, files in zip(self.sources, self._files, strict=True) if files is not None}
        if len(set(counts.values())) > 1:
            said = ", ".join(f"{source} {count}" for source, count in counts.items())
            raise BadValue("numbers of pictures", said, "as many of each camera: the n-th of all were taken together")
        _check_together([files for files in self._files if files is not None])
        self.count: int | None = next(iter(counts.values()), None) or video.count_frames(self.sources[0])

    @cached_property
    def full_scales(self) -> tuple[FullScale | None, ...]:
        """What is white in the pictures of each source, found from all of them; None where it is not in question."""
        return tuple(None if files is None else full_scale_of(files) for files in self._files)

    @property
    def pictures(self) -> tuple[str, ...]:
        """The first picture of each source that is not a video."""
        return tuple(files[0] for files in self._files if files is not None)

    @property
    def files(self) -> tuple[str, ...]:
        """All pictures of all sources that are not videos."""
        return tuple(file for files in self._files if files is not None for file in files)

    @property
    def gaps(self) -> tuple[str, ...]:
        """Where numbers are left out that count the pictures of a source, in words: a line for each such source."""
        return tuple(filter(None, (_gaps(*pair) for pair in zip(self.sources, self._files, strict=True))))

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames. Raises `UnreadableFile`, or `SizeMismatch` where a picture is not of its camera's size."""
        streams = [_pictures(*three) for three in zip(self.sources, self._files, self._whites(), strict=True)]
        for index, shots in enumerate(zip_longest(*streams)):
            there = [shot for shot in shots if shot is not None]
            if len(there) < len(shots):
                ended = next(s for s, shot in zip(self.sources, shots, strict=True) if shot is None)
                raise UnreadableFile(ended, f"ends before frame {index}, the others go on", "give as many of each")
            photos = tuple(_photo(*pair) for pair in zip(there, self.viewpoints, strict=True))
            names, digests, whites = zip(*((s.name, s.sha256, s.white) for s in there), strict=True)
            yield Frame(index, photos, names, digests, whites)

    def _whites(self) -> list[float | None]:
        if self._full_scale is not None:
            return [self._full_scale] * len(self.sources)
        return [None if found is None else found.white for found in self.full_scales]

    def __repr__(self) -> str:
        return f"Frames({self.count} of {', '.join(self.sources)})"


def _sources(sources: Sequence[str | os.PathLike[str]]) -> tuple[str | os.PathLike[str], ...]:
    """Return the sources; `BadValue` for one name in place of several, or pictures in place of names."""
    if isinstance(sources, (str, os.PathLike)):
        raise BadValue("sources", said(sources), "a list of them, one for each camera: [source]")
    expect_several(sources, "sources", str, os.PathLike)
    names = tuple(sources)
    for i, name in enumerate(names):
        if not isinstance(name, (str, os.PathLike)):
            raise BadValue(f"sources[{i}]", said(name), "a folder, pattern or video; pictures in memory: Frame.of")
    return names


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
    return sorted(found, key=natural_order)


def _check_together(sources: Sequence[Sequence[str]]) -> None:
    """Raise `BadValue` where each camera lacks a picture, but not the same one: from there on none belong together.

    Only numbers that count pictures say so: those that mostly grow by 1. Times in names say nothing.
    """
    numbers = [[_last_number(file) for file in files] for files in sources]
    first = numbers[0] if numbers else []
    if len(numbers) < 2 or not all(map(_counts, numbers)):
        return
    for files, others in zip(sources[1:], numbers[1:], strict=True):
        apart = [b - a for a, b in zip(first, others, strict=True)]
        n = next((n for n, one in enumerate(apart) if one != apart[0]), None)
        if n is not None:
            pair = f"{sources[0][n]} and {files[n]}"
            before = f"{sources[0][n - 1]} and {files[n - 1]}"
            expected = f"numbers that go on as in {before}: a camera lacks a picture; remove what was taken beside it"
            raise BadValue(f"pictures of frame {n}", pair, expected)


def _gaps(source: str, files: Sequence[str] | None) -> str:
    """Return how many pictures lack in the count of a source's names, and where the first; "" for none."""
    numbers = [_last_number(file) for file in files or ()]
    if not _counts(numbers):
        return ""
    missing = sum(b - a - 1 for a, b in pairwise(numbers) if b > a)
    if not missing or files is None:
        return ""
    n = next(n for n, (a, b) in enumerate(pairwise(numbers)) if b > a + 1)
    where = f"the first after {Path(files[n]).name}"
    return f"{source}: {missing} missing by the numbers of the names, {where}; frames are counted without them"


def _counts(numbers: Sequence[int]) -> bool:
    steps = [b - a for a, b in pairwise(numbers)]
    return min(numbers, default=-1) >= 0 and 2 * steps.count(1) > len(steps)


def _last_number(file: str) -> int:
    """Return the last number in the name of a file, -1 without one."""
    return next((int(text) for text in reversed(re.findall(r"\d+", Path(file).stem))), -1)


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    gray: Picture
    name: str
    sha256: str
    white: float


def _photo(shot: _Shot, viewpoint: Viewpoint) -> Photo:
    """Return the photo; if its size is not the camera's, raise an error that names the file."""
    try:
        return Photo(shot.gray, viewpoint)
    except SizeMismatch as error:
        raise SizeMismatch(shot.name, error.size, error.expected) from None


def _pictures(source: str, files: list[str] | None, white: float | None) -> Iterator[_Shot]:
    if files is None:
        for number, gray in enumerate(video.read_video(source)):
            yield _Shot(gray, f"{Path(source).name} {number}", _fingerprint(gray), video.WHITE)
        return
    for file in files:
        picture, info = read_camera_picture_with_info(file, full_scale=white)
        yield _Shot(to_gray(picture), file, info.sha256, info.white)


def _is_video(source: str) -> bool:
    return Path(source).suffix.lower() in video.SUFFIXES


def _fingerprint(gray: Picture) -> str:
    return hashlib.sha256(np.ascontiguousarray(gray).tobytes()).hexdigest()
