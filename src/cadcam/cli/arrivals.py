"""Photos of parts in folders, as they arrive: a folder or a pattern for each camera, a serial number in each name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeAlias

from cadcam.cli.photos import file_of
from cadcam.errors import BadValue, UnreadableFile
from cadcam.image.suffixes import READABLE, natural_order

_Stamp: TypeAlias = "tuple[tuple[int, int], ...]"  # size and time of change of each photo of a part
_Photos: TypeAlias = "dict[str, list[list[str]]]"  # by serial those of each camera


class Arrival(NamedTuple):
    """The photos of one part, one of each camera, and its serial number."""

    serial: str
    files: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Source:
    """Where a camera's photos are put: those in `folder` whose names begin and end so; what is between is the serial.

    Without an end all pictures count, and the serial is the name without its suffix.
    """

    folder: Path
    begins: str = ""
    ends: str = ""

    @classmethod
    def of(cls, text: str) -> Source:
        """Return the source that a folder, or a pattern such as cell/*_left.png, stands for, without NAME= before it.

        Raises `BadValue` for a pattern that does not have one * in the name of the file, `UnreadableFile` without the
        folder.
        """
        path = Path(file_of(text))
        if path.is_dir():
            return cls(path)
        if path.is_file():
            expected = "a folder, or a pattern with a *, in quotes: `cadcam verify` judges one part"
            raise BadValue("photos", f"{str(path)!r}, a file", expected)
        if any(c in str(path.parent) for c in "*?[") or path.name.count("*") != 1 or any(c in path.name for c in "?["):
            if "*" not in str(path):
                raise UnreadableFile(path, "no such folder", "name the folder that photos are put into")
            raise BadValue("photos", repr(str(path)), "one * in the name of the file: the serial number")
        if not path.parent.is_dir():
            raise UnreadableFile(path.parent, "no such folder", "name the folder that photos are put into")
        begins, _, ends = path.name.partition("*")
        return cls(path.parent, begins, ends)

    def __str__(self) -> str:
        return str(self.folder / f"{self.begins}*{self.ends}" if self.begins or self.ends else self.folder)

    def wanted(self, serial: str) -> str:
        """Return the file that a photo of this serial number would be."""
        return str(self.folder / f"{self.begins}{serial}{self.ends or '.*'}")

    def photos(self) -> dict[str, list[str]]:
        """Return the photos there by serial number, mostly one each. Raises `UnreadableFile` without the folder."""
        out: dict[str, list[str]] = {}
        try:
            paths = sorted(self.folder.iterdir())
        except OSError as error:
            raise UnreadableFile(
                self.folder, error.strerror or str(error), "is it there, and may it be read?"
            ) from None
        for path in paths:
            name = path.name
            counts = path.suffix.lower() in READABLE and not name.startswith(".")
            if counts and name.startswith(self.begins) and name.endswith(self.ends):
                serial = name[len(self.begins) : -len(self.ends)] if self.ends else path.stem[len(self.begins) :]
                out.setdefault(serial, []).append(str(path))
        out.pop("", None)
        return out


class Arrivals:
    """What is in the sources of all cameras: parts of which every camera has a photo, in the order of their names."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self.sources: tuple[Source, ...] = tuple(sources)
        self._before: dict[Arrival, _Stamp] = {}
        self._given: dict[Arrival, _Stamp] = {}
        self._lacking: dict[str, str] = {}
        self._waiting: dict[str, float] = {}  # since when, by serial
        self._told: set[str] = set()

    def there(self) -> list[Arrival]:
        """Return the parts that are there."""
        return _whole(self._each())

    def incomplete(self) -> dict[str, str]:
        """Return by serial number what parts lack of which a camera has no photo, or several."""
        return self._lacks(self._each())

    def _each(self) -> _Photos:
        """Return by serial number the photos of each camera, in the order of names."""
        each = [source.photos() for source in self.sources]
        serials = sorted({serial for photos in each for serial in photos}, key=natural_order)
        return {serial: [photos.get(serial, []) for photos in each] for serial in serials}

    def _lacks(self, photos: _Photos) -> dict[str, str]:
        """Return by serial number, where there is not one photo of each camera, what is to be changed about that."""
        out = {}
        for serial, each in photos.items():
            lacking = [source.wanted(serial) for source, files in zip(self.sources, each, strict=True) if not files]
            if several := [file for files in each if len(files) > 1 for file in files]:
                out[serial] = f"has several photos of a camera: {', '.join(several)}"
            elif lacking:
                out[serial] = f"waits for {', '.join(lacking)}"
        return out

    def new(self) -> list[Arrival]:
        """Return the parts that have arrived since this was last asked; of photos written anew the part is new, too.

        Their photos are as they were when it was last asked: nobody is writing to them any more.
        """
        photos = self._each()
        now = {arrival: _stamp(arrival) for arrival in _whole(photos)}
        empty = {a.serial: "waits for a photo that is empty as yet" for a, stamp in now.items() if not stamp}
        self._lacking = self._lacks(photos) | empty
        before, self._before = self._before, now
        out = {a: stamp for a, stamp in now.items() if stamp and before.get(a) == stamp != self._given.get(a)}
        self._given |= out
        return list(out)

    def overdue(self, now_s: float, after_s: float) -> dict[str, str]:
        """Return by serial number what parts lacked at the last look and have waited for so long; each is told once."""
        self._waiting = {serial: self._waiting.get(serial, now_s) for serial in self._lacking}
        late = {serial for serial, since_s in self._waiting.items() if now_s - since_s >= after_s}
        out = {serial: why for serial, why in self._lacking.items() if serial in late - self._told}
        self._told = late  # who has its photos by now is told anew if it lacks one again
        return out


def _whole(photos: _Photos) -> list[Arrival]:
    return [Arrival(s, tuple(f[0] for f in each)) for s, each in photos.items() if all(len(f) == 1 for f in each)]


def _stamp(arrival: Arrival) -> _Stamp:
    """Return size and time of the photos; () for one that is gone, or empty as yet."""
    try:
        states = [Path(file).stat() for file in arrival.files]
    except OSError:
        return ()
    return tuple((s.st_size, s.st_mtime_ns) for s in states) if all(s.st_size for s in states) else ()
