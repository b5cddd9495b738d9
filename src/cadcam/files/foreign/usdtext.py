"""The part of USD's text form needed for cameras: prims, their attributes and children, without composition."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from cadcam.errors import UnreadableFile
from cadcam.files.text import TextFile

_TOKEN = re.compile(
    r'(?P<space>\s+|\#[^\n]*|/\*.*?\*/)|(?P<string>"""(?:\\.|[^\\])*?"""|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\')'
    r"|(?P<number>[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?(?![\w:]))|(?P<path><[^>\n]*>|@[^@\n]*@)"
    r"|(?P<word>[-+]?[A-Za-z_][\w:.\-]*(?:\[\])?|\d+)|(?P<mark>[(){}\[\]=,;&])",
    re.DOTALL,
)
_CLOSES = {"(": ")", "[": "]", "{": "}"}
_DEEPEST = 60
_SPECIFIERS = ("def", "over", "class")


@dataclass(slots=True)
class Prim:
    """A prim: type, name, attributes with their values, metadata words and children."""

    kind: str
    name: str
    attributes: dict[str, Any] = field(default_factory=dict)
    children: list[Prim] = field(default_factory=list)


def parsed_usda(file: TextFile) -> Prim:
    """Return a prim of kind "" that holds the layer's metadata and its root prims; `UnreadableFile` with the line."""
    if not file.text.lstrip().startswith("#usda"):
        raise UnreadableFile(file.path, "is no USD text", "convert it: usdcat file.usd -o file.usda")
    if not re.match(r"\s*#usda 1\.", file.text):
        said = file.text.split("\n", 1)[0][:40]
        raise UnreadableFile(file.path, f"says {said!r}", "version 1 of USD's text is read here")
    return _Parser(file).layer()


class _Parser:
    def __init__(self, file: TextFile) -> None:
        self.file = file
        self.tokens = list(self._tokens())
        self.at = 0

    def _tokens(self) -> Iterator[tuple[str, str, int]]:
        text, at, line = self.file.text, 0, 1
        while at < len(text):
            found = _TOKEN.match(text, at)
            if found is None:
                raise UnreadableFile(
                    self.file.path, f"line {line}: {text[at : at + 20]!r} is no USD text", "is it cut off?"
                )
            if found.lastgroup != "space":
                yield str(found.lastgroup), found[0], line
            line += found[0].count("\n")
            at = found.end()

    def error(self, reason: str) -> UnreadableFile:
        line = self.tokens[min(self.at, len(self.tokens) - 1)][2] if self.tokens else 1
        return UnreadableFile(self.file.path, f"line {line}: {reason}", "is it cut off?")

    def peek(self) -> str:
        return self.tokens[self.at][1] if self.at < len(self.tokens) else ""

    def take(self, wanted: str = "") -> tuple[str, str]:
        if self.at >= len(self.tokens):
            raise self.error("the file ends here")
        kind, text, _ = self.tokens[self.at]
        if wanted and text != wanted:
            raise self.error(f"{text[:20]!r} where {wanted!r} is expected")
        self.at += 1
        return kind, text

    def layer(self) -> Prim:
        root = Prim("", "")
        if self.peek() == "(":
            root.attributes.update(self.metadata(0))
        while self.at < len(self.tokens):
            root.children.append(self.prim(0))
        return root

    def prim(self, depth: int) -> Prim:
        if depth > _DEEPEST:
            raise self.error(f"prims are nested more than {_DEEPEST} deep")
        if self.peek() not in _SPECIFIERS:
            raise self.error(f"{self.peek()[:20]!r} where a prim (def ...) is expected")
        self.take()
        kind, text = self.take()
        typed = text if kind == "word" else ""
        if kind == "word":
            kind, text = self.take()
        if kind != "string":
            raise self.error("a prim has no name")
        prim = Prim(typed, _unquoted(text))
        if self.peek() == "(":
            self.metadata(depth)
        self.take("{")
        while self.peek() != "}":
            if self.peek() in _SPECIFIERS:
                prim.children.append(self.prim(depth + 1))
            else:
                self.attribute(prim.attributes, depth)
        self.take("}")
        return prim

    def attribute(self, into: dict[str, Any], depth: int) -> None:
        """Consume words up to "=" and a value; without a value nothing is kept."""
        name = ""
        while (kind := self.take())[0] == "word":
            name = kind[1]
            if self.peek() not in ("=", "(") and self.tokens[self.at - 1 : self.at] and self._line_ends():
                return
            if self.peek() in ("=", "("):
                break
        else:
            if kind[1] not in (";",):
                raise self.error(f"{kind[1][:20]!r} where an attribute is expected")
            return
        if self.peek() == "=":
            self.take()
            into[name] = self.value(depth)
        if self.peek() == "(":
            self.metadata(depth)

    def _line_ends(self) -> bool:
        if self.at >= len(self.tokens):
            return True
        return self.tokens[self.at][2] > self.tokens[self.at - 1][2]

    def metadata(self, depth: int) -> dict[str, Any]:
        out: dict[str, Any] = {}
        self.take("(")
        while self.peek() != ")":
            kind, text = self.take()
            if kind == "word" and self.peek() == "=":
                self.take()
                out[text] = self.value(depth)
        self.take(")")
        return out

    def value(self, depth: int) -> Any:
        if depth > _DEEPEST:
            raise self.error(f"values are nested more than {_DEEPEST} deep")
        kind, text = self.take()
        if kind == "number":
            return float(text)
        if kind == "string":
            return _unquoted(text)
        if text in ("(", "["):
            out = []
            while self.peek() != _CLOSES[text]:
                out.append(self.value(depth + 1))
                if self.peek() == ",":
                    self.take()
            self.take()
            return out
        if text == "{":
            return self.dictionary()
        return text

    def dictionary(self) -> dict[str, Any]:
        """Skip what stands in braces (time samples, dictionaries): no camera here needs it."""
        depth = 1
        while depth:
            _, text = self.take()
            depth += (text == "{") - (text == "}")
        return {}


def _unquoted(text: str) -> str:
    size = 3 if text.startswith('"""') else 1
    return text[size:-size]
