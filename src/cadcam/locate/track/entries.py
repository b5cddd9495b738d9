"""The frames in a log of tracking, read from its file as they are asked for: a film may be longer than memory holds."""

from __future__ import annotations

import json
import os
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, overload

from cadcam.errors import UnreadableFile
from cadcam.files.jsontext import Place, parsed_line

Entry = dict[str, Any]


class Entries(Sequence[Entry]):
    """The lines of a log's frames; in memory is only where each begins."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = path
        self._begins = array("q")

    def __len__(self) -> int:
        return len(self._begins)

    def __iter__(self) -> Iterator[Entry]:
        yield from self._read(self._begins)

    @overload
    def __getitem__(self, index: int) -> Entry: ...
    @overload
    def __getitem__(self, index: slice) -> list[Entry]: ...
    def __getitem__(self, index: int | slice) -> Entry | list[Entry]:
        if isinstance(index, slice):
            return list(self._read(self._begins[index]))
        return next(self._read([self._begins[index]]))

    def __repr__(self) -> str:
        return f"Entries({os.fspath(self._path)!r}, {len(self)} frames)"

    def note(self, begin: int) -> None:
        """Take in the line that begins at a byte of the file."""
        self._begins.append(begin)

    def _read(self, begins: Sequence[int]) -> Iterator[Entry]:
        try:
            with Path(self._path).open("rb") as file:
                for begin in begins:
                    file.seek(begin)
                    yield json.loads(file.readline())
        except (OSError, ValueError) as error:
            raise UnreadableFile(
                self._path, f"was changed while it was open here: {error}", "start a new log"
            ) from error


def check_frame(path: str | os.PathLike[str], number: int, line: str) -> Entry:
    """Return the line of a frame; `UnreadableFile` names what is missing in it, or of another kind."""
    place: Place = parsed_line(path, number, line)
    for name in ("files", "sha256"):
        place.at(name).texts()
    for name in ("how", "reason"):
        place.at(name).text()
    place.at("frame").whole()
    place.at("quality").number()
    found, filtered = place.at("found").flag(), place.at("filtered")
    for pose in (place.at("pose"), *([filtered] if found or filtered.value is not None else [])):
        for name in ("sigma_mm", "sigma_deg"):
            pose.at(name).array((3,))
        for name, shape in (("rotation", (3, 3)), ("translation_mm", (3,))):
            pose.at("world_from_part").at(name).array(shape)
    return place.object
