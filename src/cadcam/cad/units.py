"""Units of length by name, in millimetres."""

from __future__ import annotations

from cadcam.errors import UnknownName
from cadcam.kinds import expect

MM = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3, "in": 25.4, "ft": 304.8}

_LONG = {
    **dict.fromkeys(("micron", "microns", "µm", "μm", "micrometre", "micrometer", "micrometres", "micrometers"), "um"),
    **dict.fromkeys(("millimetre", "millimeter", "millimetres", "millimeters"), "mm"),
    **dict.fromkeys(("centimetre", "centimeter", "centimetres", "centimeters"), "cm"),
    **dict.fromkeys(("metre", "meter", "metres", "meters"), "m"),
    **dict.fromkeys(("inch", "inches", '"'), "in"),
    **dict.fromkeys(("foot", "feet", "'"), "ft"),
}


def unit_name(name: str) -> str:
    """Return the short name (um, mm, cm, m, in, ft) of a unit of length; raises `UnknownName`."""
    expect(name, "unit", str)
    short = _LONG.get(name.strip().lower(), name.strip().lower())
    if short not in MM:
        raise UnknownName("unit", name, [*MM, "millimetre", "metre", "inch", "foot"])
    return short
