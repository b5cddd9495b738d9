"""A camera file, or a folder of them, as bytes: on disk, or just made and not yet written."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cadcam.errors import UnreadableFile
from cadcam.files.text import TextFile, read_bytes, text_of

MAX_BYTES = 256_000_000


@dataclass(frozen=True, slots=True, eq=False)
class ForeignFile:
    """The input of a reader: `path` as given, with the caller's values for what the file does not state.

    size: the picture's (width, height) for formats without one. mm: millimetres per unit of length for formats without
    a unit. memory: the files' content by name instead of the disk's ("" is `path` itself).
    """

    path: str
    size: tuple[int, int] | None = None
    mm: float = 1.0
    memory: Mapping[str, bytes] | None = None
    _kept: dict[str, bytes] = field(default_factory=dict, repr=False)

    @property
    def is_folder(self) -> bool:
        """Return whether the path is a folder."""
        return "" not in self.memory if self.memory is not None else Path(self.path).is_dir()

    def at(self, name: str) -> str:
        """Return the path of a file in the folder, or beside the file; "" is the path itself."""
        if not name:
            return self.path
        return os.fspath((Path(self.path) if self.is_folder else Path(self.path).parent) / name)

    def has(self, name: str) -> bool:
        """Return whether there is such a file in the folder, or beside the file."""
        return name in self.memory if self.memory is not None else Path(self.at(name)).is_file()

    def data(self, name: str = "") -> bytes:
        """Return the content of a file; `UnreadableFile` if it is missing, empty or huge."""
        if name not in self._kept:
            if self.memory is None:
                self._kept[name] = read_bytes(self.at(name), max_bytes=MAX_BYTES)
            elif name in self.memory:
                self._kept[name] = self.memory[name]
            else:
                raise UnreadableFile(self.at(name), "no such file", "check the path")
        return self._kept[name]

    def text(self, name: str = "") -> TextFile:
        """Return the text of a file; `UnreadableFile` if it is not text."""
        return text_of(self.at(name), self.data(name))

    def head(self, name: str = "") -> str:
        """Return the first 64 kB as text to recognise the format from, whatever the bytes are; "" for a folder."""
        if self.is_folder and not name:
            return ""
        data = self.data(name)[:65536]
        return data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig", errors="replace")

    def needed_size(self, what: str) -> tuple[int, int]:
        """Return the picture's size given by the caller; an error if it is required and missing."""
        if self.size is None:
            raise UnreadableFile(self.path, f"{what} has no picture size", "say it: --size WIDTHxHEIGHT (size=)")
        return self.size
