"""Errors of the library in the words of the command line: reach_px is called --reach there."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING

from cadcam.errors import BadValue, CadcamError

if TYPE_CHECKING:
    from cadcam.cli.arguments import Parser

_UNIT = re.compile(r"_(px|mm|deg|percent)$")
_OF = re.compile(r" of (the|a) \w+$")  # "distance_mm of the views"
_NAMES = re.compile(r"\b[a-z]+(?:_[a-z]+)+\b")
_IN_PYTHON = re.compile(r" \(\w+=\)")  # how the library is asked for what an option just named asks for


def worded(error: CadcamError, arguments: argparse.Namespace) -> str:
    """Return the message of an error; what the library calls otherwise than the options given, by their names.

    An argument of the library's is an option's where name and value are the same: a file may hold such a name, too.
    """
    text = _IN_PYTHON.sub("", str(error))
    if not isinstance(error, BadValue):
        return text
    option, value = _option(arguments, _OF.sub("", error.what)), _numbers(error.value)
    if option is None or value != _numbers(getattr(arguments, arguments.parser.destination(option))):
        return text
    expected = _NAMES.sub(lambda name: _option(arguments, name[0]) or name[0], error.expected)
    return str(BadValue(option, value, expected))


def _option(arguments: argparse.Namespace, name: str) -> str | None:
    parser: Parser = arguments.parser
    option = f"--{_UNIT.sub('', name).replace('_', '-')}"
    return option if parser.has(option) else None


def _numbers(value: object) -> object:
    """Return numbers as they are typed, with commas between; anything else as it is."""
    try:
        return ",".join(f"{float(number):g}" for number in str(value).strip("()[]").split(","))
    except ValueError:
        return value
