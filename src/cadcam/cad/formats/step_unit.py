"""The unit of length of a STEP file: by its factor, which counts; a name is only a name, in the exporter's language."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from cadcam.arrays import significant
from cadcam.cad.units import MM, unit_name
from cadcam.errors import UnknownName

# the standard's prefixes: powers of ten of a metre
_POWERS = {b"DECA": 1, b"HECTO": 2, b"KILO": 3, b"MEGA": 6, b"GIGA": 9, b"TERA": 12, b"PETA": 15, b"EXA": 18}
_POWERS |= {
    b"DECI": -1,
    b"CENTI": -2,
    b"MILLI": -3,
    b"MICRO": -6,
    b"NANO": -9,
    b"PICO": -12,
    b"FEMTO": -15,
    b"ATTO": -18,
}
_STRING = rb"'((?:[^']|'')*)'"
_NUMBER = rb"\s*([-+.\dEe]+)\s*"
_DEEPEST = 8  # units, each by a factor of the next: a file that goes on longer goes in a circle
_SAME = 1e-4  # of factors: 25.4 is written as 25.4000508 (US survey), 0.3048006
_ASSUMED = "mm"  # by Open CASCADE, too


@dataclass(frozen=True, slots=True)
class LengthUnit:
    """A unit of length: its short name, or what it is in mm where it has none here, and its length in mm.

    called: what the file calls it, where that is the name of another unit; else empty.
    """

    name: str
    mm: float
    called: str = ""


def declared_unit(data: bytes) -> LengthUnit:
    """Return the unit of length that the first geometric context of a STEP file assigns; mm where none does."""
    for context in re.finditer(rb"GLOBAL_UNIT_ASSIGNED_CONTEXT\s*\(\s*\(([^)]*)\)", data):
        for number in re.findall(rb"#(\d+)", context[1]):
            body = _entity(data, number)
            if b"LENGTH_UNIT" in body:
                mm = _mm(data, body)
                return LengthUnit(_ASSUMED, MM[_ASSUMED]) if mm is None else _named(body, mm)
    return LengthUnit(_ASSUMED, MM[_ASSUMED])


def length_unit_mm(data: bytes, number: int) -> float | None:
    """Return the length in mm of the unit that is entity `number` of a STEP file; None where it is none."""
    body = _entity(data, b"%d" % number)
    return _mm(data, body) if b"LENGTH_UNIT" in body else None


def _entity(data: bytes, number: bytes) -> bytes:
    """Return what stands between #number= and its semicolon; nothing where there is no such entity."""
    found = re.search(rb"#" + number + rb"\s*=\s*((?:[^;']|'[^']*')*);", data)
    return found[1] if found else b""


def _mm(data: bytes, body: bytes) -> float | None:
    """Return the length in mm of a unit; None where the file does not say it."""
    factor = 1.0
    for _ in range(_DEEPEST):
        si = re.search(rb"SI_UNIT\s*\(\s*(?:\.(\w+)\.|\$)\s*,\s*\.METRE\.", body)
        if si:
            power = _POWERS.get(si[1]) if si[1] else 0
            return None if power is None else factor * 10.0 ** (power + 3)
        by = re.search(rb"CONVERSION_BASED_UNIT\s*\(\s*" + _STRING + rb"\s*,\s*#(\d+)", body)
        if by is None:
            return None
        measure = re.search(rb"MEASURE\s*\(" + _NUMBER + rb"\)\s*,\s*#(\d+)", _entity(data, by[2]))
        if measure is None:
            return None
        try:
            factor *= float(measure[1])
        except ValueError:
            return None
        body = _entity(data, measure[2])
    return None


def _named(body: bytes, mm: float) -> LengthUnit:
    """Return a unit by its short name, else by its length, and with what the file calls it if that is wrong."""
    name = next((n for n, length in MM.items() if math.isclose(length, mm, rel_tol=_SAME)), f"{significant(mm, 6)} mm")
    by = re.search(rb"CONVERSION_BASED_UNIT\s*\(\s*" + _STRING, body)
    if by is None:
        return LengthUnit(name, mm)
    called = by[1].decode("latin-1").replace("''", "'").strip()
    try:
        wrong = unit_name(called) != name
    except UnknownName:  # Zoll, YARD: the factor says what that is
        wrong = False
    return LengthUnit(name, mm, called if wrong else "")
