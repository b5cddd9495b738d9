"""The entities of a STEP file as ISO 10303-21 writes them, each parsed when it is asked for."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable
from os import PathLike
from typing import Any, TypeAlias

from cadcam.arrays import LARGEST
from cadcam.errors import UnreadableFile

Parameters: TypeAlias = list[Any]
Entity: TypeAlias = dict[str, Parameters]  # by keyword: one of a simple entity, several of a complex one

_STATEMENT = re.compile(rb"#(\d+)\s*=\s*((?:[^;']++|'[^']*+')*+);")
_STRING, _KEYWORD = re.compile(rb"'[^']*'"), re.compile(rb"(\w+)\s*\(")
_TOKEN = re.compile(
    r"""\s+ | /\*.*?\*/ | (?P<text>'(?:[^']|'')*') | (?P<binary>"[^"]*") | \#(?P<ref>\d+) | (?P<enum>\.\w+\.)
    | (?P<number>[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?) | (?P<keyword>!?[A-Za-z]\w*) | (?P<mark>[()$*,])""",
    re.DOTALL | re.VERBOSE,
)
_WIDE = re.compile(r"\\X([24])\\((?:[0-9A-F]{4})+)\\X0\\")  # UTF-16 or UTF-32 in hexadecimal
_BYTE = re.compile(r"\\X\\([0-9A-F]{2})")
_AGAIN = "export it again"


class Ref(int):
    """The number of another entity."""


class Enumerated(str):
    """A value of an enumeration, without its dots."""

    __slots__ = ()


class Exchange:
    """The data section of a STEP file. Raises `UnreadableFile` where an entity is asked for that cannot be parsed.

    A parameter is a str, a float, a `Ref`, an `Enumerated`, None ($ or *), a list of parameters, or (keyword, list) of
    a value with a type.
    """

    def __init__(self, path: str | PathLike[str], data: bytes) -> None:
        self.path = path
        begin = data.find(b"DATA;")
        self._bodies = {int(m[1]): m[2] for m in _STATEMENT.finditer(data, max(begin, 0))}
        self._parsed: dict[int, Entity] = {}
        self._having: defaultdict[bytes, list[int]] | None = None

    def __getitem__(self, number: int) -> Entity:
        """Return an entity; raise `UnreadableFile` where there is none of this number, or none that can be parsed."""
        if number not in self._parsed:
            if number not in self._bodies:
                raise UnreadableFile(self.path, f"refers to #{int(number)}, which it does not have", _AGAIN)
            self._parsed[number] = self._entity(number)
        return self._parsed[number]

    def having(self, *keywords: str) -> list[int]:
        """Return the numbers of the entities that have one of these keywords, ascending."""
        if self._having is None:
            self._having = defaultdict(list)
            for number, body in self._bodies.items():
                for keyword in _keywords(body):
                    self._having[keyword].append(number)
        return sorted({number for keyword in keywords for number in self._having.get(keyword.encode(), ())})

    def _entity(self, number: int) -> Entity:
        text = self._bodies[number].decode("latin-1")
        try:
            return _Parser(text).entity()
        except (ValueError, IndexError, RecursionError):
            shown = " ".join(text.split())
            raise UnreadableFile(self.path, f"#{int(number)} is no entity: {shown[:60]}", _AGAIN) from None


def _keywords(body: bytes) -> list[bytes]:
    """Return the keywords of an entity as it is written; of a value with a type among them, its type, too."""
    if body[:1] != b"(":
        return [body.partition(b"(")[0].rstrip()]
    return _KEYWORD.findall(_STRING.sub(b"", body))


class _Parser:
    """One entity's text, token by token."""

    def __init__(self, text: str) -> None:
        self._tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(text):
            token = _TOKEN.match(text, at)
            if token is None:
                raise ValueError(text[at])
            if token.lastgroup:
                self._tokens.append((token.lastgroup, token[token.lastgroup]))
            at = token.end()
        self._at = 0

    def entity(self) -> Entity:
        """Return the entity: KEYWORD(...), or (KEYWORD(...) KEYWORD(...))."""
        out: Entity = {}
        is_complex = self._tokens[0][1] == "("
        self._at = int(is_complex)
        while self._at < len(self._tokens) - is_complex:
            kind, keyword = self._next()
            if kind != "keyword":
                raise ValueError(keyword)
            out[keyword.upper()] = self._listed()
        return out

    def _next(self) -> tuple[str, str]:
        token = self._tokens[self._at]
        self._at += 1
        return token

    def _listed(self) -> Parameters:
        if self._next()[1] != "(":
            raise ValueError("no list")
        out: Parameters = []
        while self._tokens[self._at][1] != ")":
            if out and self._next()[1] != ",":
                raise ValueError("no comma")
            out.append(self._parameter())
        self._at += 1
        return out

    def _parameter(self) -> Any:
        kind, text = self._tokens[self._at]
        if text == "(" and kind == "mark":
            return self._listed()
        self._at += 1
        if kind == "keyword":
            return text.upper(), self._listed()
        return _VALUES[kind](text)


def _number(text: str) -> float:
    value = float(text)
    if not abs(value) <= LARGEST:
        raise ValueError(text)
    return value


def _mark(text: str) -> None:
    if text not in "$*":
        raise ValueError(text)


def plain(text: str) -> str:
    """Return a string of a STEP file, without its quotes, with its escapes (clause 6.4.3) as characters."""
    text = text.replace("''", "'")
    text = _WIDE.sub(lambda m: bytes.fromhex(m[2]).decode("utf-16-be" if m[1] == "2" else "utf-32-be", "replace"), text)
    return _BYTE.sub(lambda m: bytes.fromhex(m[1]).decode("latin-1"), text).replace("\\\\", "\\")


_VALUES: dict[str, Callable[[str], Any]] = {
    "text": lambda text: plain(text[1:-1]),
    "binary": str,
    "ref": lambda digits: Ref(int(digits)),
    "enum": lambda text: Enumerated(text.strip(".").upper()),
    "number": _number,
    "mark": _mark,
}
