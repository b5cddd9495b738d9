"""YAML with a place, hardened: no anchors, no tags that make objects, no key twice, no bottomless nesting.

Read from the parser's events, not through its constructors: OpenCV's own tags pass, and every error can say its line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from cadcam.errors import UnreadableFile
from cadcam.files.jsontext import Place, shortened
from cadcam.files.text import TextFile

_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?")
_NOT_FINITE = {".nan": float("nan"), ".inf": float("inf"), "+.inf": float("inf"), "-.inf": float("-inf")}
_TABS = re.compile(r"^ *\t", re.MULTILINE)
_DEEPEST = 40


def parsed_yaml(file: TextFile) -> Place:
    """Return the mapping in a YAML file; `UnreadableFile` with the line where it is none.

    OpenCV's first line "%YAML:1.0", which is not YAML, is let pass.
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the C parser where the wheel has it
    text = re.sub(r"\A%YAML:[^\n]*", "", file.text)
    try:
        tree = _Tree(file.path, yaml.parse(text, Loader=loader))
        place = Place(file.path, (), tree.document())
    except yaml.YAMLError as error:
        remedy = "indent with blanks: YAML takes no tabs" if _TABS.search(text) else "is it cut off?"
        raise UnreadableFile(file.path, f"is not YAML: {_said(error)}", remedy) from None
    if not isinstance(place.value, dict):
        raise UnreadableFile(file.path, f"is {shortened(place.value)}", "'key: value' lines are expected")
    return place


def yaml_number(value: float) -> str:
    """Return a number with all its bits as YAML 1.1 has it: with a point, without which 1e-05 is a text.

    So it is for PyYAML, with which Kalibr and the Python programs of ROS read.
    """
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


class _Tree:
    def __init__(self, path: str, events: Iterator[Any]) -> None:
        self.path, self.events = path, events

    def document(self) -> Any:
        for _ in range(2):  # the stream's start, the document's start
            first = next(self.events)
        if type(first).__name__ != "DocumentStartEvent":
            raise UnreadableFile(self.path, "holds no YAML document", "is it cut off?")
        value = self.value(next(self.events), 0)
        next(self.events)
        if type(next(self.events)).__name__ != "StreamEndEvent":
            raise UnreadableFile(self.path, "holds more than one YAML document", "leave one of them")
        return value

    def value(self, event: Any, depth: int) -> Any:
        kind = type(event).__name__
        if kind == "AliasEvent" or getattr(event, "anchor", None):
            raise self.error(event, "uses anchors (&, *)", "write the values out")
        if depth > _DEEPEST:
            raise self.error(event, f"is nested more than {_DEEPEST} deep", "is it the right file?")
        if kind == "ScalarEvent":
            return event.value if event.style in ("'", '"', "|", ">") else _resolved(event.value)
        return self.sequence(depth) if kind == "SequenceStartEvent" else self.mapping(depth)

    def sequence(self, depth: int) -> list[Any]:
        out = []
        while type(event := next(self.events)).__name__ != "SequenceEndEvent":
            out.append(self.value(event, depth + 1))
        return out

    def mapping(self, depth: int) -> dict[str, Any]:
        out: dict[str, Any] = {}
        while type(event := next(self.events)).__name__ != "MappingEndEvent":
            if type(event).__name__ != "ScalarEvent":
                raise self.error(event, "has a key that is no word", "is it the right file?")
            if event.value in out:
                raise self.error(event, f"has the key {event.value[:40]!r} twice", "leave one of them")
            out[event.value] = self.value(next(self.events), depth + 1)
        return out

    def error(self, event: Any, reason: str, remedy: str) -> UnreadableFile:
        return UnreadableFile(self.path, f"line {event.start_mark.line + 1} {reason}", remedy)


def _resolved(text: str) -> Any:
    if _NUMBER.fullmatch(text):
        return float(text)
    if text.lower() in _NOT_FINITE:
        return _NOT_FINITE[text.lower()]
    return {"": None, "~": None, "null": None, "true": True, "false": False}.get(text, text)


def _said(error: Exception) -> str:
    mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
    return f"{problem} at line {mark.line + 1}" if mark is not None and problem else " ".join(str(error).split())[:120]
