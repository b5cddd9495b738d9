"""JSON with positions for errors: every error names the file and the key."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

import cadcam
from cadcam.arrays import LARGEST, Array
from cadcam.errors import CadcamError, UnknownName, UnreadableFile
from cadcam.files.text import TextFile
from cadcam.whole import utf8

T = TypeVar("T")

_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+\s*")
_NO_TEXT = re.compile("[\ud800-\udfff]")
_DECIMAL_POINT = "numbers have a decimal point, 0.5 instead of 0,5"


@dataclass(frozen=True, slots=True)
class Place:
    """A value inside a JSON file, and the path to it."""

    path: str
    keys: tuple[str, ...]
    value: Any

    @property
    def object(self) -> dict[str, Any]:
        """Return the value as a JSON object; an error otherwise."""
        if not isinstance(self.value, dict):
            raise self.error(f"is {shortened(self.value)}", "an object {...} is expected")
        return self.value

    def error(self, reason: str, remedy: str = "") -> UnreadableFile:
        """Return the error that names this place."""
        where = f"{'.'.join(self.keys)} " if self.keys else ""
        return UnreadableFile(self.path, where + reason, remedy)

    def at(self, key: str) -> Place:
        """Return the place under a key; an error if there is none."""
        if key not in self.object:
            raise self.error(f"has no {key!r}", f"keys are {', '.join(self.object) or 'none'}")
        return Place(self.path, (*self.keys, key), self.object[key])

    def only(self, *known: str) -> None:
        """Refuse keys other than these, suggesting the nearest."""
        for key, value in self.object.items():
            if key not in known:
                comma = value is None and key.isdigit()  # YAML's {position_mm: 0,5}
                raise self.error(f"has an {UnknownName('key', key, known)}", _DECIMAL_POINT * comma)

    def number(self) -> float:
        """Return a finite number, at most `LARGEST` in size."""
        return float(self.array(()))

    def text(self) -> str:
        """Return a string."""
        if not isinstance(self.value, str):
            raise self.error(f"is {shortened(self.value)}", "a text is expected")
        return self.value

    def texts(self) -> tuple[str, ...]:
        """Return a list of strings."""
        if not isinstance(self.value, list) or not all(isinstance(v, str) for v in self.value):
            raise self.error(f"is {shortened(self.value)}", "a list of texts is expected")
        return tuple(self.value)

    def items(self, remedy: str = "a list [...] is expected") -> list[Place]:
        """Return the places in a list, counted from 0 as JSON's own tools do."""
        if not isinstance(self.value, list):
            raise self.error("is not a list", remedy)
        return [Place(self.path, (*self.keys, str(i)), value) for i, value in enumerate(self.value)]

    def flag(self) -> bool:
        """Return true or false."""
        if not isinstance(self.value, bool):
            raise self.error(f"is {shortened(self.value)}", "true or false is expected")
        return self.value

    def whole(self) -> int:
        """Return a whole number."""
        number = self.number()
        if number != int(number):
            raise self.error(f"is {number:g}", "a whole number is expected")
        return int(number)

    def array(self, shape: tuple[int | None, ...]) -> Array:
        """Return an array of finite numbers, at most `LARGEST` in size, of this shape; None is any length."""
        expected = f"{_in_words(shape)} is expected"
        if isinstance(self.value, str) and _DECIMAL_COMMA.fullmatch(self.value):
            raise self.error(f"is {shortened(self.value)}", f"{expected}: {_DECIMAL_POINT}")
        if _has_other_than_numbers(self.value):
            raise self.error(f"is {shortened(self.value)}", expected)
        try:
            array = np.array(self.value, dtype=np.float64)
        except (ValueError, TypeError, OverflowError):
            raise self.error(f"is {shortened(self.value)}", expected) from None
        if array.size == 0 and None in shape:
            array = array.reshape([0 if n is None else n for n in shape])
        fits = array.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
        if not fits:
            raise self.error(f"has shape {array.shape}", expected)
        if not np.isfinite(array).all():
            raise self.error("is not finite", expected)
        if (np.abs(array) > LARGEST).any():
            raise self.error(f"is {shortened(self.value)}", f"numbers of at most {LARGEST:g} in size are expected")
        return array

    def covariance(self, size: int | None = None) -> Array:
        """Return a covariance or a cofactor: a square array, symmetric, without negative variances.

        Correlations may exceed 1 by a millionth: those of a covariance without full rank do, by rounding.
        """
        array = self.array((size, size))
        expected = "a symmetric array without negative variances is expected, as it was written"
        if array.shape[0] != array.shape[1]:
            raise self.error(f"has shape {array.shape}", expected)
        sd = np.sqrt(np.diag(array).clip(0))
        unit = np.where(sd > 0, sd, 1.0)
        correlation = array / unit[:, None] / unit
        lowest = np.linalg.eigvalsh(correlation)[0] if array.size else 0.0
        if not (np.abs(correlation - correlation.T) <= 1e-6).all() or lowest < -1e-6:
            raise self.error("is no covariance", expected)
        return array

    def check_head(self, form: str, version: int, *, stated: bool = True, remedy: str = "") -> None:
        """Refuse a document of another format or version than these; stated: whether it must state them."""
        given = self.object.get("format", None if stated else form)
        if given != form:
            said = "does not say its format" if given is None else f"says its format is {given!r}"
            raise self.error(said, remedy or f"only {form!r} is read here")
        number = self.object.get("version", None if stated else version)
        if number != version:
            remedy = f"this cadcam ({cadcam.__version__}) reads version {version}; use a newer one"
            raise self.error(f"has version {number!r}", remedy)

    def build(self, make: Callable[[], T]) -> T:
        """Return what `make` returns; its `CadcamError` becomes one that names this place."""
        try:
            return make()
        except UnreadableFile:
            raise
        except CadcamError as error:
            raise self.error(f"is refused: {error}" if self.keys else str(error)) from error


def parsed(file: TextFile) -> Place:
    """Return the JSON object in a file; `UnreadableFile` with line and column where it is none."""
    try:
        value = json.loads(file.text, object_pairs_hook=_once)
    except json.JSONDecodeError as error:
        raise UnreadableFile(
            file.path, f"is not JSON: {error.msg} at line {error.lineno}, column {error.colno}", "is it cut off?"
        ) from None
    except RecursionError:
        raise UnreadableFile(file.path, "is nested too deeply to be read") from None
    except (_Twice, ValueError) as error:  # ValueError: a number of more than 4300 digits
        raise UnreadableFile(file.path, str(error)) from None
    place = Place(file.path, (), value)
    _ = place.object
    return place


def split_lines(text: str) -> list[str]:
    """Return the lines of JSON lines: cut at line feeds alone, as within a text JSON allows other separators of lines.

    U+0085 and U+2028 are such; `str.splitlines` cuts at them.
    """
    return text.removesuffix("\n").split("\n") if text else []


def parsed_line(path: str | os.PathLike[str], number: int, line: str) -> Place:
    """Return the JSON object in a line of a file of JSON lines; `UnreadableFile` with the line where it is none."""
    try:
        value = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise UnreadableFile(path, f"line {number} is not JSON: {error}", "is it cut off?") from None
    place = Place(os.fspath(path), (f"line {number}",), value)
    _ = place.object
    return place


def as_json(value: Any) -> bytes:
    """Return indented JSON with rows of numbers on one line; floats keep every bit, NaN and infinity are refused."""
    return utf8(_written(value, "") + "\n")


def as_json_pieces(head: dict[str, Any], key: str, items: Iterable[Any]) -> Iterator[bytes]:
    """Yield the bytes of `as_json(head | {key: [*items]})` bit by bit, each item as it is asked for."""
    opened = _written(head | {key: []}, "").removesuffix("[]\n}")
    between = "[\n"
    for item in items:
        yield utf8(f"{opened}{between}    {_written(item, '    ')}")
        opened, between = "", ",\n"
    yield utf8(f"{opened}[]\n}}\n" if opened else "\n  ]\n}\n")


def json_line(value: Any) -> str:
    """Return JSON on one line; what is no text in the name of a file is spelled out (`whole.utf8`)."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=False, default=_of_numpy)
    return _NO_TEXT.sub(lambda lone: rf"\\u{ord(lone[0]):x}", text)


def _of_numpy(value: object) -> Any:
    """Return a number of numpy as Python's: arguments may be either, and json knows but one, or float64 by chance."""
    if isinstance(value, np.generic) or getattr(value, "shape", None) == ():
        return np.asarray(value).item()
    raise TypeError(f"a {type(value).__name__} is nothing that JSON has")


def head_as_json(form: str, version: int) -> dict[str, Any]:
    """Return the first keys of our documents, which `Place.check_head` checks."""
    return {"format": form, "version": version, "written_by": f"cadcam {cadcam.__version__}"}


class _Twice(ValueError):
    pass


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        keys = [k for k, _ in pairs]
        raise _Twice(f"has the key {next(k for k in keys if keys.count(k) > 1)!r} twice")
    return out


def or_null(value: float) -> float | None:
    """Return a number, or None where it is not finite: JSON has only null for that."""
    return float(value) if np.isfinite(value) else None


def or_nulls(values: Iterable[float]) -> list[float | None]:
    """Return numbers, None where one is not finite."""
    return [or_null(value) for value in values]


def shortened(value: Any) -> str:
    """Return a value as JSON for a message, cut where it is long."""
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _written(value: Any, indent: str) -> str:
    deeper = indent + "  "
    if isinstance(value, dict) and value:
        items = [f"{deeper}{json.dumps(k)}: {_written(v, deeper)}" for k, v in value.items()]
        return "{\n" + ",\n".join(items) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(v, (list, dict)) for v in value):
        return "[\n" + ",\n".join(deeper + _written(v, deeper) for v in value) + f"\n{indent}]"
    return json_line(value)


def _in_words(shape: tuple[int | None, ...]) -> str:
    if not shape:
        return "a number"
    words = "numbers"
    for n in reversed(shape):
        words = f"lists of {words}" if n is None else f"lists of {n} {words}"
    return f"a {words.replace('lists', 'list', 1)}"


def _has_other_than_numbers(value: Any) -> bool:
    if isinstance(value, list):
        return any(_has_other_than_numbers(v) for v in value)
    return isinstance(value, bool) or not isinstance(value, (int, float))
