"""XML with positions for errors, hardened: no document type, hence no entities that expand or load other files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import UnreadableFile
from cadcam.files.text import TextFile


@dataclass(frozen=True, slots=True)
class Node:
    """An XML element and the file it is in."""

    path: str
    element: ElementTree.Element

    @property
    def tag(self) -> str:
        """Return the element's name."""
        return self.element.tag

    def error(self, reason: str, remedy: str = "") -> UnreadableFile:
        """Return the error that names this element."""
        return UnreadableFile(self.path, f"<{self.tag}> {reason}", remedy)

    def all(self, name: str) -> Iterator[Node]:
        """Yield the children of a name (or those on a path a/b)."""
        return (Node(self.path, e) for e in self.element.iterfind(name))

    def maybe(self, name: str) -> Node | None:
        """Return the first child of a name, if there is one."""
        return next(self.all(name), None)

    def at(self, name: str) -> Node:
        """Return the first child of a name; an error if there is none."""
        found = self.maybe(name)
        if found is None:
            raise self.error(f"has no <{name}>", "is it the right file?")
        return found

    def text(self) -> str:
        """Return the element's own text, stripped."""
        return (self.element.text or "").strip()

    def numbers(self, count: int | None = None) -> Array:
        """Return the finite numbers in the element's text; an error if there are others than `count`."""
        words = self.text().split()
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            raise self.error(f"is {self.text()[:40]!r}, not numbers") from None
        if count is not None and values.size != count:
            raise self.error(f"has {values.size} numbers", f"{count} are expected")
        if not np.isfinite(values).all():
            raise self.error("has a number that is not finite")
        return values

    def number(self, name: str, default: float | None = None) -> float:
        """Return the number in a child; the default if there is none."""
        found = self.maybe(name)
        if found is None and default is not None:
            return default
        return float(self.at(name).numbers(1)[0])

    def whole(self, name: str, value: float) -> int:
        """Return a number of this element as a whole one; an error naming it otherwise."""
        if value != int(value):
            raise self.error(f"has {name} {value:g}", "a whole number is expected")
        return int(value)

    def attribute(self, name: str) -> float:
        """Return a number in an attribute."""
        try:
            value = float(self.element.get(name, ""))
        except ValueError:
            raise self.error(f"has {name}={str(self.element.get(name))[:40]!r}", "a number is expected") from None
        if not np.isfinite(value):
            raise self.error(f"has {name}={value}", "a finite number is expected")
        return value


def parsed_xml(file: TextFile) -> Node:
    """Return the root of an XML file; `UnreadableFile` with line and column where it is none."""
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", file.text, re.IGNORECASE):
        raise UnreadableFile(
            file.path, "declares a document type or entities", "no camera file needs them: remove them"
        )
    try:
        return Node(file.path, ElementTree.fromstring(file.text))
    except ElementTree.ParseError as error:
        line, column = error.position
        raise UnreadableFile(
            file.path, f"is not XML: {error.msg.split(':')[0]} at line {line}, column {column}", "is it cut off?"
        ) from None
    except ValueError as error:
        raise UnreadableFile(file.path, f"is not XML: {error}") from None
